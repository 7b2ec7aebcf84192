"""One sensor's errors held out, beside its noise floor, and the values it is compared by."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.diagnosis.held_out import TEST_LOGS, HeldOut, hold_out
from zerodrift.diagnosis.run_errors import collect_errors, pool_rmse
from zerodrift.fleet.result import OutputResult, ParameterResult
from zerodrift.train.compensator import Compensator
from zerodrift.train.scores import Trained
from zerodrift.verify.chip_error import ChipReplay


@dataclass(frozen=True)
class Figures:
    """Errors of one sensor by output, and what they mean."""

    outputs: dict[str, OutputResult]
    held_out: str
    floor: str


def assess(
    trained: Trained,
    dataset: Dataset,
    replay: ChipReplay | None = None,
) -> Figures:
    """Return the held-out errors of a sensor.

    Args:
        trained: its compensator, and the errors that training measured.
        dataset: its logs.
        replay: the firmware over the test runs, or the training runs where there are none; None
            without firmware.
    """
    compensator = trained.compensator
    tared, usable = compensator.tared, compensator.physics.find_usable
    runs = [*dataset.train, *dataset.test]
    floor = measure_floor(dataset)
    scores = trained.scores
    held_out = _hold_out(compensator, dataset)
    if held_out is None:
        rmse, none = scores.held_out.compensated, scores.held_out.uncompensated
        method = scores.explanation
    else:
        predictions = held_out.predictions
        zeros = {name: np.zeros_like(p) for name, p in predictions.items()}
        rmse, none = (
            pool_rmse(list(collect_errors(runs, p, tared, usable).values()))
            for p in (predictions, zeros)
        )
        method = held_out.explain()
    outputs = {
        name: OutputResult(
            dataset.units[k], float(none[k]), float(rmse[k]), None, float(floor.rms[k])
        )
        for k, name in enumerate(dataset.outputs)
    }
    if replay is not None:
        outputs = add_firmware(outputs, compensator, dataset, replay)
    return Figures(outputs, method, floor.source)


def add_firmware(
    outputs: Mapping[str, OutputResult],
    compensator: Compensator,
    dataset: Dataset,
    replay: ChipReplay,
) -> dict[str, OutputResult]:
    """Return the errors of a sensor with those of its firmware beside them.

    Args:
        outputs: by name, without firmware.
        compensator: the sensor's.
        dataset: its logs.
        replay: the firmware over the test runs, or the training runs where there are none.
    """
    of_integer: list[float | None] = [None] * len(dataset.outputs)
    if dataset.test:
        integer = {replayed.run.name: replayed.chip for replayed in replay.runs}
        tared, usable = compensator.tared, compensator.physics.find_usable
        errors = collect_errors(dataset.test, integer, tared, usable)
        of_integer = [float(x) for x in pool_rmse(list(errors.values()))]
    return {
        name: replace(outputs[name], rmse_integer=own, chip_error=asdict(causes))
        for name, own, causes in zip(dataset.outputs, of_integer, replay.split(), strict=True)
    }


def _hold_out(compensator: Compensator, dataset: Dataset) -> HeldOut | None:
    """Return held-out predictions; None where only training itself could make them."""
    if dataset.test:
        predictions = {run.name: compensator.predict(run) for run in dataset.test}
        return HeldOut(TEST_LOGS, predictions)
    if compensator.front_end is not None:
        return None
    return hold_out(compensator.physics, dataset)


def describe_parameters(compensator: Compensator) -> dict[str, ParameterResult]:
    """Return the fitted values by which sensors of one design are compared.

    A choice, such as an order, and a value held by the user are the design's and not among them.
    """
    physics = compensator.physics
    found = {}
    for fitted in physics.terms:
        for parameter in fitted.term.free:
            name = parameter.name
            found[f"{fitted.term.name}.{name}"] = ParameterResult(
                float(fitted.term.values[name]),
                float(fitted.std_errors.get(name, 0.0)),
                parameter.unit,
                parameter.scale == "log",
            )
    for j, feature in enumerate(physics.feature_names):
        for k, output in enumerate(physics.outputs):
            found[f"{output} {feature}"] = ParameterResult(
                float(physics.coefficients[j, k]),
                float(physics.std_errors[j, k]),
                _divide(physics.units[k], physics.feature_units[j]),
            )
    return found


def _divide(unit: str, by: str) -> str:
    """Return the unit of a coefficient."""
    if by in ("", "1"):
        return unit
    return f"{unit}/{by}" if by.isalnum() else f"{unit}/({by})"
