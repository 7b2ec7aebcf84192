"""The figures that `compare` prints and the report shows, without the predictions."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from zerodrift.base.records import OPTIONAL
from zerodrift.dataset.runs import OutlierCount


@dataclass(frozen=True)
class OutputSummary:
    """Errors of one output over all runs, in its unit; on held-out data where there are any."""

    ALIASES: ClassVar = ("rmse_heldout",)

    unit: str
    full_scale: float
    rmse_uncompensated: float
    rmse: float
    """In the sample."""
    rmse_left_out: float | None
    """Of training runs left out in turn; null where that was not measured."""
    rmse_test: float | None
    """Of the test logs; null where there are none."""
    max_abs: float
    rmse_pct_fs: float
    max_abs_pct_fs: float
    noise_floor: float
    explained: float
    """1 - error² / error of a constant²: the constant is the mean drift of the training runs, and
    each run's own offset is apart where logs are tared. Negative where the constant does better."""
    run_offset: float
    """The runs' own offsets that were subtracted, root mean square; 0 without tare."""
    rmse_without_outliers: float | None = field(default=None, metadata=OPTIONAL)
    """Of the same rows as `rmse_heldout`, outliers by their weights; None where there are none."""

    @property
    def rmse_heldout(self) -> float | None:
        """Older name: `rmse_test`, or else `rmse_left_out`."""
        return self.rmse_test if self.rmse_test is not None else self.rmse_left_out


@dataclass(frozen=True)
class RunSummary:
    """Errors of one output in one run, in its unit."""

    rmse: float
    rmse_uncompensated: float
    max_abs: float
    explained: float
    run_offset: float
    rmse_in_sample: float | None
    held_out: bool
    use: str
    """train | test."""


@dataclass(frozen=True)
class WorstSegment:
    """A stretch of one run in which the error of one output is large."""

    run: str
    output: str
    from_s: float
    """On the log's own clock."""
    to_s: float
    rmse: float
    pattern: str
    """The operating conditions, in words."""
    mean_error: float


@dataclass(frozen=True)
class PatternSummary:
    """Where an output's error is concentrated."""

    output: str
    kind: str
    """concentrated | signed."""
    pattern: str
    """In words."""
    share_of_error: float
    share_of_time: float
    runs_agreeing: int
    runs_checked: int
    mean_error: float


@dataclass(frozen=True)
class ComparisonSummary:
    """The comparison of a model with the measurements."""

    outputs: Mapping[str, OutputSummary]
    runs: Mapping[str, Mapping[str, RunSummary | tuple[float, float]]]
    """Run -> output -> its errors; beside them `temperature_degC`, the run's range."""
    worst: tuple[WorstSegment, ...]
    patterns: tuple[PatternSummary, ...]
    effects: tuple[str, ...]
    held_out: str
    """How runs were held out, `none` where they were not."""
    noise_floor_source: str
    """dwell | estimated."""
    tared: bool
    set_aside: float
    """Share of all samples that do not count: a converter stood at its rail."""
    outliers: OutlierCount = field(default_factory=lambda: OutlierCount(0, {}))
    """In the runs that the errors are of."""

    @property
    def errors(self) -> dict[str, dict[str, RunSummary]]:
        """Run -> output -> its errors alone."""
        return {
            run: {name: one for name, one in told.items() if isinstance(one, RunSummary)}
            for run, told in self.runs.items()
        }
