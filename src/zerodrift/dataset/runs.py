"""Logs as uninterrupted stretches at one sample period, with units in the names."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.outliers import Outliers, weigh_samples
from zerodrift.dataset.resolution import measure_resolution

MOST_TOLD = 3
"""Runs that a sentence names."""


@dataclass(frozen=True)
class Run:
    """One uninterrupted stretch of one run, resampled to the firmware's period.

    A gap in a log ends a stretch: the parts share `group` (what is held out together, and what a
    per-run offset belongs to) and differ in `part`. All arrays have the same length n.
    """

    name: str
    """Unique name: the group, and `#2`, `#3`, ... for the parts after a gap."""
    group: str
    """The run as the user knows it: the file's stem, or the value of the `run` column."""
    part: int
    """0 for the first stretch of the run, then 1, 2, ..."""
    source: Path
    """The log it was read from."""
    sample_period_s: float
    time_s: Array
    """[n] uniform, seconds on the log's own clock."""
    temperature_degC: Array
    """[n] what the chip's thermometer reported."""
    measured: Array
    """[n, K] the outputs before compensation, each in its unit, in the order of the config.

    Stored output by output (Fortran order), as is `reference`.
    """
    reference: Array
    """[n, K] what the outputs should have been; zero where the config names no reference."""
    inputs: Mapping[str, Array] = field(default_factory=dict)
    """Optional channels [n] by the name that effects use: supply, humidity, clock, ..."""
    start_s: float | None = None
    """The log's own clock at the first row of the whole run; None: at this stretch's first."""
    before: "Run | None" = field(default=None, repr=False, compare=False)
    """The stretch of the same run before the gap; None for the first, or to begin at rest."""
    explained: Array | None = field(default=None, repr=False, compare=False)
    """[n, K] drift that is known to have a cause, so that outliers show beside it; None: none."""
    tared: bool | None = None
    """Whether the run was zeroed by itself, as `[logs] tared` says; None: decided from the logs."""
    files: tuple[Path, ...] = ()
    """The files that `source` joins; empty: `source` is the one."""
    output_steps: Array | None = field(default=None, repr=False, compare=False)
    """[K] the step in which each output was measured, in its unit, 0 where it shows none; None: as
    this stretch tells."""

    def at_rest(self) -> "Run":
        """Return the stretch as if nothing had been before it, as a chip takes it."""
        return self if self.before is None else replace(self, before=None)

    def take(self, rows: slice) -> "Run":
        """Return some of the stretch's samples, one after the other."""
        return replace(
            self,
            time_s=self.time_s[rows],
            temperature_degC=self.temperature_degC[rows],
            measured=self.measured[rows],
            reference=self.reference[rows],
            inputs={name: values[rows] for name, values in self.inputs.items()},
            explained=None if self.explained is None else self.explained[rows],
        )

    @property
    def drift(self) -> Array:
        """[n, K] measured minus reference: what the compensator has to predict."""
        return self.measured - self.reference

    @cached_property
    def resolution(self) -> Array:
        """[K] the step in which each output was measured, in its unit; 0 where it shows none."""
        if self.output_steps is not None:
            return self.output_steps
        return np.array([measure_resolution(column) for column in self.measured.T])

    @cached_property
    def outliers(self) -> Outliers | None:
        """The weights of its samples; None where all of them are 1."""
        signals = (self.temperature_degC, self.reference, self.inputs)
        resolution = self.resolution
        if self.explained is None:
            return weigh_samples(self.drift, *signals, resolution)
        beside = weigh_samples(self.drift - self.explained, *signals, resolution)
        return None if beside is None else replace(beside, drift=beside.drift + self.explained)

    @property
    def steady_drift(self) -> Array:
        """[n, K] the drift that is fitted: outliers count by their weights, `drift` without any."""
        return self.drift if self.outliers is None else self.outliers.drift.copy()

    @property
    def weights(self) -> Array:
        """[n, K] of the samples, from 0 (an outlier) to 1; not to be written to."""
        if self.outliers is None:
            return np.broadcast_to(1.0, self.measured.shape)
        return self.outliers.weights

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.time_s.size)


def share_resolution(runs: Sequence[Run]) -> Array:
    """Return the step [K] in which each output was measured, as most of the runs show it.

    All are of one sensor and one converter, whose step a run that hardly moves does not show.
    """
    found = np.array([run.resolution for run in runs])
    shown = np.where(found > 0.0, found, np.nan)
    usual = [np.nanmedian(column) if (column > 0.0).any() else 0.0 for column in shown.T]
    return np.array(usual)


@dataclass(frozen=True)
class Dataset:
    """All runs of a project by their use."""

    train: tuple[Run, ...]
    test: tuple[Run, ...]
    """Empty when the config names no test logs: then runs are left out one at a time."""
    dwell: tuple[Run, ...]
    """Isothermal, unloaded; sets the noise floor. May be empty."""
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    full_scale: tuple[float, ...]
    notes: tuple[str, ...] = ()
    """What the user should know of the logs: gaps, rows left out, odd units."""


@dataclass(frozen=True)
class OutlierCount:
    """How many rows hold a sample that is far off from its neighbours for no logged reason."""

    rows: int
    runs: Mapping[str, int]
    """Run -> rows; runs without any are left out."""

    def explain(self) -> str:
        """Return it in a sentence; empty without any."""
        if not self.rows:
            return ""
        most = sorted(self.runs, key=lambda run: -self.runs[run])
        where = ", ".join(f"{run}: {self.runs[run]}" for run in most[:MOST_TOLD])
        more = f" and {len(most) - MOST_TOLD} more runs" if len(most) > MOST_TOLD else ""
        return (
            f"{self.rows} row{'s are' if self.rows > 1 else ' is'} far off from the rows before "
            f"and behind, with no cause in the logs ({where}{more}): outliers, which hardly count "
            "in fits, floor and verdict"
        )


def tell_outliers(runs: Sequence[Run]) -> OutlierCount:
    """Return how many rows of each run hold an outlier."""
    counts: dict[str, int] = {}
    for run in runs:
        count = count_outliers((run,))
        if count:
            counts[run.group] = counts.get(run.group, 0) + count
    return OutlierCount(sum(counts.values()), counts)


def count_outliers(runs: Sequence[Run]) -> int:
    """Return how many rows of the runs hold an outlier in some output."""
    return sum(int(run.outliers.rows.sum()) for run in runs if run.outliers is not None)
