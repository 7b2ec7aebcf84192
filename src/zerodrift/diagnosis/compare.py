"""Compares a model with the measurements: run by run, output by output, and where it fails."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, OutlierCount, Run, tell_outliers
from zerodrift.diagnosis.baselines import explain_share, fit_constant
from zerodrift.diagnosis.floor import NoiseFloor, measure_floor
from zerodrift.diagnosis.held_out import NONE, TEST_LOGS, HeldOut
from zerodrift.diagnosis.run_errors import (
    FindUsable,
    RunError,
    collect_errors,
    pool_rmse,
    pool_steady_rmse,
)
from zerodrift.diagnosis.segments import MOST_SEGMENTS, Failures, find_failures
from zerodrift.diagnosis.summary import (
    ComparisonSummary,
    OutputSummary,
    PatternSummary,
    RunSummary,
    WorstSegment,
)

Predict = Callable[[Run], Array]


TEMPERATURE = "temperature_degC"
"""Beside the outputs of a run in `runs`: its range."""


@dataclass(frozen=True)
class ErrorSummary:
    """Errors of one output over some samples, in its unit."""

    rmse_uncompensated: float
    """Root mean square of measured minus reference."""
    rmse: float
    max_abs: float
    offset: float
    """The run's own offset that was subtracted, root mean square over runs; 0 without tare."""
    explained: float
    """Share of the squared error that is gone, beyond what a constant fitted to the training runs
    takes away; negative where the constant does better."""
    steady_rmse: float
    """RMSE with outliers by their weights; `rmse` where there are none."""


@dataclass(frozen=True)
class RunErrors:
    """One run: its errors per output, in the sample and out of it."""

    name: str
    use: str
    """train | test."""
    temperature_degc: tuple[float, float]
    """Lowest and highest of the thermometer."""
    in_sample: tuple[ErrorSummary, ...] | None
    """[K]; None for runs that the model did not learn from."""
    held_out: tuple[ErrorSummary, ...] | None
    """[K]; None for runs that were not held out."""

    @property
    def told(self) -> tuple[ErrorSummary, ...]:
        """The held-out errors where there are any."""
        return self.held_out or self.in_sample or ()


@dataclass(frozen=True)
class Comparison:
    """What `compare` found; arrays of outputs are in the order of the config."""

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    full_scale: tuple[float, ...]
    effects: tuple[str, ...]
    in_sample: tuple[ErrorSummary, ...]
    """[K] over all training runs."""
    held_out: tuple[ErrorSummary, ...] | None
    """[K] over all held-out runs; None where nothing was held out."""
    runs: tuple[RunErrors, ...]
    floor: NoiseFloor
    failures: Failures
    method: HeldOut
    tared: bool
    find_usable: FindUsable | None
    """Run -> [n, K] which samples count; None: all."""
    set_aside: float
    """Share of all samples that do not count: a converter stood at its rail."""
    outliers: OutlierCount
    """In the runs that the errors are of."""

    @property
    def told(self) -> tuple[ErrorSummary, ...]:
        """The held-out errors where there are any."""
        return self.held_out or self.in_sample

    def summarise(self) -> ComparisonSummary:
        """Return what the command prints, without the predictions behind it."""
        names = self.outputs
        return ComparisonSummary(
            outputs={name: _summarise_output(self, k) for k, name in enumerate(names)},
            runs={
                run.name: {
                    TEMPERATURE: run.temperature_degc,
                    **{name: _summarise_run(run, k) for k, name in enumerate(names)},
                }
                for run in self.runs
            },
            worst=tuple(
                WorstSegment(s.run, s.output, s.from_s, s.to_s, s.rmse, s.pattern, s.mean_error)
                for s in self.failures.worst
            ),
            patterns=tuple(
                PatternSummary(
                    names[p.output],
                    p.kind,
                    p.words,
                    p.share_of_error,
                    p.share_of_time,
                    p.runs_agreeing,
                    p.runs_checked,
                    p.mean_error,
                )
                for p in self.failures.patterns
            ),
            effects=self.effects,
            held_out=self.method.method,
            noise_floor_source=self.floor.source,
            tared=self.tared,
            set_aside=self.set_aside,
            outliers=self.outliers,
        )


def _summarise_output(comparison: Comparison, k: int) -> OutputSummary:
    told = comparison.told[k]
    held_out = comparison.held_out[k].rmse if comparison.held_out is not None else None
    is_test = comparison.method.method == TEST_LOGS
    percent = 100.0 / comparison.full_scale[k]
    return OutputSummary(
        unit=comparison.units[k],
        full_scale=comparison.full_scale[k],
        rmse_uncompensated=told.rmse_uncompensated,
        rmse=comparison.in_sample[k].rmse,
        rmse_left_out=None if is_test else held_out,
        rmse_test=held_out if is_test else None,
        max_abs=told.max_abs,
        rmse_pct_fs=percent * told.rmse,
        max_abs_pct_fs=percent * told.max_abs,
        noise_floor=float(comparison.floor.rms[k]),
        explained=told.explained,
        run_offset=told.offset,
        rmse_without_outliers=told.steady_rmse if comparison.outliers.rows else None,
    )


def _summarise_run(run: RunErrors, k: int) -> RunSummary:
    told = run.told[k]
    return RunSummary(
        rmse=told.rmse,
        rmse_uncompensated=told.rmse_uncompensated,
        max_abs=told.max_abs,
        explained=told.explained,
        run_offset=told.offset,
        rmse_in_sample=run.in_sample[k].rmse if run.in_sample is not None else None,
        held_out=run.held_out is not None,
        use=run.use,
    )


@dataclass(frozen=True)
class Labels:
    """Names and units for the report, which do not affect the comparison."""

    effects: tuple[str, ...] = ()
    """Names of the model's effects."""
    channel_units: Mapping[str, str] = field(default_factory=dict)
    """Units of the input channels."""


def compare(
    dataset: Dataset,
    predict: Predict,
    *,
    held_out: HeldOut | None = None,
    floor: NoiseFloor | None = None,
    tared: bool = False,
    find_usable: FindUsable | None = None,
    labels: Labels | None = None,
    most: int = MOST_SEGMENTS,
) -> Comparison:
    """Compare any model with the runs.

    Args:
        dataset: the runs.
        predict: the model fitted to the training runs: run -> [n, K] drift.
        held_out: predictions for what the model did not learn from; by default those of the test
            logs, and none where there are no test logs.
        floor: the noise floor; by default from the dwell logs, or estimated.
        tared: each log is zeroed on its own, so that a run's mean error says nothing about the
            model and is taken off.
        find_usable: run -> [n, K] which samples count; by default all.
        labels: names and units, for the report.
        most: how many of the worst segments to list.
    """
    labels = labels or Labels()
    if held_out is None:
        predictions = {run.name: predict(run) for run in dataset.test}
        held_out = HeldOut(TEST_LOGS if dataset.test else NONE, predictions)
    fitted = {run.name: predict(run) for run in dataset.train}
    inside = collect_errors(dataset.train, fitted, tared, find_usable)
    runs = [*dataset.train, *dataset.test]
    outside = collect_errors(runs, held_out.predictions, tared, find_usable)
    constant = fit_constant(dataset, tared=tared)
    plain_inside, plain_outside = (
        _sum_squares(runs, predictions, tared, find_usable)
        for predictions in (constant.fitted, {**constant.fitted, **constant.held_out})
    )
    del constant
    if floor is None:
        floor = measure_floor(dataset)
    told = {**inside, **outside}
    failures = find_failures(
        [e.runs for e in told.values()],
        [e.stretches for e in told.values()],
        floor.rms,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        channel_units=labels.channel_units,
        most=most,
    )
    tested = {run.group for run in dataset.test}
    return Comparison(
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        effects=labels.effects,
        in_sample=_summarise(inside, plain_inside),
        held_out=_summarise(outside, plain_outside) if outside else None,
        runs=tuple(
            RunErrors(
                group,
                "test" if group in tested else "train",
                _find_range(told[group].runs),
                _summarise({group: inside[group]}, plain_inside) if group in inside else None,
                _summarise({group: outside[group]}, plain_outside) if group in outside else None,
            )
            for group in told
        ),
        floor=floor,
        failures=failures,
        method=held_out,
        tared=tared,
        find_usable=find_usable,
        set_aside=_share_set_aside(list(told.values())),
        outliers=tell_outliers([run for e in told.values() for run in e.runs]),
    )


def _find_range(runs: Sequence[Run]) -> tuple[float, float]:
    """Return the lowest and the highest temperature of a run's stretches, degC."""
    low = min(float(run.temperature_degC.min()) for run in runs)
    return low, max(float(run.temperature_degC.max()) for run in runs)


def _share_set_aside(errors: Sequence[RunError]) -> float:
    """Return the share of all samples that do not count."""
    return 1.0 - sum(float(e.usable.sum()) for e in errors) / sum(e.usable.size for e in errors)


def _summarise(
    found: Mapping[str, RunError], constant: Mapping[str, Array]
) -> tuple[ErrorSummary, ...]:
    """Return the errors [K] over all samples of some runs.

    Args:
        found: run -> what the model leaves.
        constant: run -> [K] squared error of a constant, of these runs and perhaps of more.
    """
    errors = list(found.values())
    drift = _root_mean_square([e.drift for e in errors])
    left, steady = pool_rmse(errors), pool_steady_rmse(errors)
    largest = np.max([np.abs(e.error).max(axis=0) for e in errors], axis=0)
    offset = np.sqrt(np.mean([e.offset**2 for e in errors], axis=0))
    squares = np.sum([np.sum(e.error**2, axis=0) for e in errors], axis=0)
    explained = explain_share(squares, np.sum([constant[group] for group in found], axis=0))
    return tuple(
        ErrorSummary(*(float(x[k]) for x in (drift, left, largest, offset, explained, steady)))
        for k in range(drift.size)
    )


def _sum_squares(
    runs: Sequence[Run],
    predictions: Mapping[str, Array],
    tared: bool,
    find_usable: FindUsable | None,
) -> dict[str, Array]:
    """Return the squared error [K] that predictions leave of each run, one run at a time."""
    squares = {}
    for group in dict.fromkeys(run.group for run in runs if run.name in predictions):
        own = [run for run in runs if run.group == group]
        (found,) = collect_errors(own, predictions, tared, find_usable).values()
        squares[group] = np.sum(found.error**2, axis=0)
    return squares


def _root_mean_square(parts: Sequence[Array]) -> Array:
    """Return the root mean square [K] over all samples of parts [n, K]."""
    squares = np.sum([np.sum(part**2, axis=0) for part in parts], axis=0)
    return np.asarray(np.sqrt(squares / sum(part.shape[0] for part in parts)))
