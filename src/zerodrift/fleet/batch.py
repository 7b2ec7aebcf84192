"""Units that are worked on one after the other in one process, and the comparison of their bits."""

from collections.abc import Callable, Sequence
from typing import ParamSpec, TypeVar

import numpy as np

from zerodrift.base.errors import CheckError, ZerodriftError
from zerodrift.base.files import explain_refusal
from zerodrift.c_runtime.host import HostModel
from zerodrift.dataset.runs import Dataset
from zerodrift.fleet.result import SensorOutcome
from zerodrift.verify.firmware import list_sequences
from zerodrift.verify.host_check import check_host, check_starts

UNFORESEEN = (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError)
"""What a sensor's logs might raise that nobody thought of: told in its name, others go on."""
RANDOM_STEPS = 5000
"""Drawn inputs beside the logs: noise, jumps, the rails, a walk, a dwell."""
START_STEPS = 4
"""Each sequence is begun on its own for these steps, from rest and from cold; then all of them run
one after the other, which gives the state jumps to live through as well."""
P = ParamSpec("P")
T = TypeVar("T")


class UnitBatch:
    """The sensors of a batch; one that fails leaves it with its message."""

    def __init__(self, sensors: Sequence[str]) -> None:
        self.sensors = sensors
        self.outcomes: dict[str, SensorOutcome] = {}

    def attempt(
        self, sensor: str, work: Callable[P, T], *args: P.args, **named: P.kwargs
    ) -> T | None:
        """Return what `work` returns, or None once its failure is noted."""
        try:
            return work(*args, **named)
        except ZerodriftError as error:
            self.fail(sensor, str(error))
        except UNFORESEEN as error:
            self.fail(sensor, explain_unforeseen(error))
        return None

    def fail(self, sensor: str, message: str) -> None:
        """Note why a sensor has no result."""
        self.outcomes[sensor] = SensorOutcome(sensor, None, message)

    def list(self) -> list[SensorOutcome]:
        """Return the outcomes in the sensors' order."""
        return [self.outcomes[sensor] for sensor in self.sensors]


def explain_unforeseen(error: Exception) -> str:
    """Return the message for an error that is none of zerodrift's own."""
    told = explain_refusal(error) if isinstance(error, OSError) else None
    return told or f"unforeseen {type(error).__name__}: {error}. Please report it."


def check_bits(host: HostModel, dataset: Dataset) -> int:
    """Return the steps at which the C was equal to the reference: drift, flags and states.

    Raises:
        CheckError: they differ, or the model's own self-test fails.
    """
    sequences = list_sequences(host.model, dataset, random_steps=RANDOM_STEPS)
    everything = np.concatenate(list(sequences.values()))
    vectors = 0
    for outcome in (
        check_starts(host, sequences, START_STEPS, settled=True),
        check_starts(host, sequences, START_STEPS, settled=False),
        check_host(host, everything, settled=True),
    ):
        if outcome.mismatch is not None:
            raise CheckError(
                f"the C differs from the reference: {outcome.mismatch}."
                " Nothing written for this sensor."
            )
        vectors += outcome.steps
    if host.selftest() != 0:
        raise CheckError("the generated self-test fails on this host. Nothing written.")
    return vectors
