"""What `add`, `remove` and `history` say, and the advice of `compare` and `diagnose`, as figures.

*left out* is an error on training runs, each predicted by a fit to the others. *test* is an error
on the test logs. The two never share a name.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from zerodrift.base.records import OPTIONAL
from zerodrift.dataset.runs import OutlierCount
from zerodrift.diagnosis.held_out import TEST_LOGS
from zerodrift.physics.summary import FittedCoefficient, FittedParameter

# The figures that `compare` prints and the report shows, without the predictions.


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


# What `add`, `remove` and `history` say, and the advice of `compare` and `diagnose`, as figures.

ByOutput = Mapping[str, float]
"""Output -> a value, in its unit where nothing else is said."""


WORSE_ON_TEST = 1.05
"""An error on the test logs over what it was, from which on that is said."""


@dataclass(frozen=True)
class HeldOutErrors:
    """RMSE per output, in its unit, on data that the model did not learn from."""

    ALIASES: ClassVar = ("rmse_heldout",)

    rmse_left_out: ByOutput | None
    """Of training runs left out in turn; null where the errors are those of the test logs."""
    rmse_test: ByOutput | None
    """Of the test logs; null where there are none, or where they were not kept."""
    rmse_without_outliers: ByOutput | None = field(default=None, metadata=OPTIONAL)
    """The same, outliers by their weights; not written where there are none."""

    @property
    def rmse_heldout(self) -> ByOutput:
        """Older name: `rmse_left_out`, or else `rmse_test`."""
        found = self.rmse_left_out if self.rmse_left_out is not None else self.rmse_test
        return found or {}


def sort_errors(
    method: str, errors: ByOutput, without_outliers: ByOutput | None = None
) -> HeldOutErrors:
    """Return errors under the name that says how they were measured.

    Args:
        method: test logs | leave one run out | blocks of one run.
        errors: output -> RMSE.
        without_outliers: the same without outliers; None where there are none.
    """
    left_out, test = (None, errors) if method == TEST_LOGS else (errors, None)
    return HeldOutErrors(left_out, test, without_outliers)


@dataclass(frozen=True)
class RevisionSummary:
    """A change of the model's effects, and what it did to the errors."""

    effect: str
    parameters: Mapping[str, FittedParameter]
    """Of the effect that was added."""
    before: HeldOutErrors
    after: HeldOutErrors
    noise_floor: ByOutput
    noise_floor_source: str
    """dwell | estimated."""
    units: Mapping[str, str]
    held_out: str
    """test logs | leave one run out | blocks of one run."""
    tared: bool
    """Whether each run's own offset is taken off the errors that are judged."""
    helps: bool
    """Whether the error is better by more than runs differ; for a removal, as good."""
    reason: str
    """Why, in a sentence."""
    effects: tuple[str, ...]
    """All effects after the change."""
    coefficients: tuple[FittedCoefficient, ...]
    """Of the effect that was added."""
    notes: tuple[str, ...]
    judged_before: HeldOutErrors | None = field(default=None, metadata=OPTIONAL)
    """As it is judged, with the offsets of the runs read as after the change; written where the
    models before and after read them differently."""
    judged_after: HeldOutErrors | None = field(default=None, metadata=OPTIONAL)
    """The same after the change."""

    def explain_test(self) -> str | None:
        """Return the errors on the test logs, which decide nothing; None where there are none."""
        if self.before.rmse_test is None or self.after.rmse_test is None:
            return None
        old, new = self.before.rmse_test, self.after.rmse_test
        told = ", ".join(f"{n} {old[n]:.4g} to {new[n]:.4g} {self.units[n]}" for n in new)
        worse = [n for n in new if new[n] > WORSE_ON_TEST * old[n]]
        if not worse:
            return f"on the test logs, which decide nothing here: {told}"
        return (
            f"on the test logs, which decide nothing here, the error of {', '.join(worse)} rises:"
            f" {told}. `firmware` will judge by them; look at why before you keep the change"
        )

    def explain_offsets(self) -> str | None:
        """Return what the runs' offsets were before and after, where the models differ in it."""
        if self.judged_before is None or self.judged_after is None:
            return None
        ways = ("count as drift", "are taken off")
        old, new = self.judged_before.rmse_heldout, self.judged_after.rmse_heldout
        told = ", ".join(f"{n} {old[n]:.4g} to {new[n]:.4g} {self.units[n]}" for n in new)
        return (
            f"one of the models takes the runs' offsets for a tare and the other does not; for the"
            f" judgement they {ways[self.tared]} in both: {told}"
        )


@dataclass(frozen=True)
class TimeConstantSummary:
    """A lag of the drift behind the chip's thermometer."""

    tau_s: float
    low_s: float
    """Between `low_s` and `high_s` the logs hardly tell one value from another."""
    high_s: float
    determined: bool


@dataclass(frozen=True)
class MemorySummary:
    """What the network remembers, and whether that is enough."""

    name: str
    span_s: float | None
    """null where it has no end."""
    rmse_ratio: float | None
    """Left-out RMSE with this memory over that with the lags found."""
    rmse_ratio_of_window_alone: float | None
    spans: bool | None
    """null where the drift has no lag."""


@dataclass(frozen=True)
class ProtocolSummary:
    """What to record, and why."""

    name: str
    instruction: str
    why: str


@dataclass(frozen=True)
class AdviceSummary:
    """What can and cannot be learnt from these logs."""

    time_constants: tuple[TimeConstantSummary, ...]
    rmse_ratio_without_memory: float
    """Left-out RMSE without memory over that with the lags found."""
    memory: MemorySummary
    heat_paths: str
    """several | perhaps | one | unknown: whether heat came in more ways than one."""
    runs: Mapping[str, float]
    """Run -> error of the lags that the other runs teach, over that of lags of its own."""
    untold_K: ByOutput
    """Further thermometer -> RMS in K of its part that the chip's temperature history does not
    explain."""
    next_protocols: tuple[ProtocolSummary, ...]
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class StepSummary:
    """A step of the staircase: a state of the model and its errors."""

    ALIASES: ClassVar = ("rmse_heldout",)

    step: str
    """start, `+ creep`, `~ creep` for other values, `- creep`, or what no command did."""
    effects: tuple[str, ...]
    rmse_left_out: ByOutput | None
    """Of training runs left out in turn; null where the errors are those of the test logs."""
    rmse_test: ByOutput | None
    """Of the test logs; null where the errors are those of runs left out."""
    noise_floor: ByOutput
    units: Mapping[str, str]
    ratio_to_floor: float | None
    """Root mean square over the outputs."""
    reason: str

    @property
    def rmse_heldout(self) -> ByOutput:
        """Older name: `rmse_left_out`, or else `rmse_test`."""
        return HeldOutErrors(self.rmse_left_out, self.rmse_test).rmse_heldout
