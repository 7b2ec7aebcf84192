"""Elapsed time where each step is given its duration: a sum that stops at its limit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError, NoRuleError
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.c_text import StateField
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import (
    CODES,
    ELAPSED,
    IntegerNode,
    Names,
    OnnxStep,
    State,
    Values,
    Writer,
)
from zerodrift.operations.signals import Real
from zerodrift.operations.times import LONGEST_US, count_us

TICKS_PER_PERIOD = 4
"""At least: elapsed time is told in the largest power of two of microseconds that is so short."""


@dataclass(frozen=True)
class IntegerElapsed(IntegerNode):
    """Time since the start in ticks of 2**bits microseconds, to the nearest, up to `limit`."""

    kind: ClassVar[str] = "elapsed"
    reads: ClassVar[int | None] = 0
    limit: int
    bits: int
    period_us: int
    """Of a log's step, for logs that begin after power-on."""

    @property
    def ends(self) -> tuple[int, int]:
        """No time is as short as -1, and the one at which it stops."""
        return -1, self.limit

    @property
    def most_us(self) -> int:
        """The time at which it stops."""
        return self.limit << self.bits

    @property
    def needs_variable_step(self) -> bool:
        """Whether the step takes the time since the last one."""
        return True

    def rest(self, values: Values) -> State:
        """Return a time of 0, with as many entries as the batch has."""
        return {"time": np.zeros(values[CODES].shape[0], dtype=np.int64)}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the time at this step."""
        time = np.minimum(state["time"] + values[ELAPSED], self.most_us)
        return {"time": time}, np.asarray(round_shift(time, self.bits))

    def elapse(self, state: State, steps: int) -> State:
        """Return the time after some steps of a log."""
        return {"time": state["time"] + min(steps * self.period_us, self.most_us)}

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the time, which saturates; the sum before that fits 64 bits."""
        if not (self.limit >= 1 and self.bits >= 0 and self.limit.bit_length() + self.bits <= 61):
            raise CheckError(
                f"{self.name}: a limit of {self.limit} times 2**{self.bits} microseconds. The model"
                " is refused."
            )
        out = Interval(0, self.limit)
        held = Interval(0, self.most_us)
        return [out], [
            Bound(f"{self.name}.time", held, 64).check(),
            Bound(f"{self.name}.sum", held + Interval(0, LONGEST_US), 64).check(),
            Bound(self.name, out, 32).check(),
        ]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Raise NoRuleError: the error depends on the times between steps."""
        raise NoRuleError("elapsed time in ticks has no error rule yet")

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write the time, up to the limit."""
        time = w.minimum(w.add(state["time"], values[ELAPSED]), w.constant(self.most_us))
        return {"time": time}, w.round_shift(time, self.bits)

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write a time of 0."""
        return {"time": w.mul(w.column(values[CODES], 0), w.constant(0))}

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        return (StateField(64, f"{self.name}_time", comment="microseconds since the start"),)

    def express(self) -> str:
        """Return the time in C, moved on."""
        return f"zd_add_time(&s->{self.name}_time, span_us, {self.limit}, {self.bits}u)"

    def express_at_rest(self) -> str:
        """Return 0."""
        return "0"


def choose_tick(sample_period_s: float) -> int:
    """Return `bits` of the tick for logs of a period."""
    return max((count_us(sample_period_s) // TICKS_PER_PERIOD).bit_length() - 1, 0)


NODES = (IntegerElapsed,)
