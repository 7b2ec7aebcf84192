"""Logs as uninterrupted stretches at one sample period, with units in the names."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array, Mask
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


# A run with gaps as one stretch: straight lines fill the gaps.


@dataclass(frozen=True)
class Chain:
    """The stretches of a run, from its first one on, and the samples that fill its gaps."""

    stretches: tuple[Run, ...]
    bridges: tuple[int, ...]
    """Samples that fill each gap."""
    places: tuple[tuple[int, int], ...]
    """(stretch of those asked for, its first sample in the whole), in the order of time."""


def list_chain(run: Run) -> list[Run]:
    """Return the stretches of a run up to this one, the first one first."""
    chain = [run]
    while chain[0].before is not None:
        chain.insert(0, chain[0].before)
    return chain


def plan_bridges(chain: Sequence[Run], block: int = 1) -> tuple[list[int], list[int]]:
    """Return the samples of each bridge, and the first sample of each stretch once they are in
    place.

    Args:
        chain: a run's stretches.
        block: each stretch begins at a multiple of so many samples.
    """
    return plan_spans([run.time_s for run in chain], chain[0].sample_period_s, block)


def plan_spans(
    times_s: Sequence[Array], sample_period_s: float, block: int = 1
) -> tuple[list[int], list[int]]:
    """Return the samples of each bridge, and the first sample of each stretch once they are in
    place.

    A bridge has as many samples as the gap, but no more than all stretches before it: by then the
    model's state hardly depends on the length of the gap.

    Args:
        times_s: times [n] in s of each stretch of a run.
        sample_period_s: their period in s.
        block: each stretch begins at a multiple of so many samples.
    """
    bridges, starts = [], [0]
    for before_s, after_s in pairwise(times_s):
        end = starts[-1] + before_s.size
        gap_s = float(after_s[0] - before_s[-1])
        missing = min(max(round(gap_s / sample_period_s) - 1, 0), end)
        missing += -(end + missing) % block
        bridges.append(missing)
        starts.append(end + missing)
    return bridges, starts


def lay(values: Sequence[Array], bridges: Sequence[int]) -> Array:
    """Return the stretches' values [n] or [n, K] end to end, with straight lines in the gaps."""
    pieces = [values[0]]
    for now, missing in zip(values[1:], bridges, strict=True):
        line = np.linspace(pieces[-1][-1], now[0], missing + 2)[1:-1]
        pieces += [line, now]
    return np.concatenate(pieces)


def predict_along(predict: Callable[[Run], Array], run: Run) -> Array:
    """Return the prediction [n, K] for a stretch, started at the first stretch of its run."""
    if run.before is None:
        return predict(run)
    chain = list_chain(run)
    bridges, starts = plan_bridges(chain)
    return predict(_lay_run(chain, bridges))[starts[-1] :]


def join_stretches(runs: Sequence[Run]) -> tuple[list[Run], list[Mask]]:
    """Return runs in one piece each, and which samples [n] of each are those of `runs`.

    Args:
        runs: whole runs or stretches of them. Earlier stretches that are not among them are joined
            too, but not marked.
    """
    joined, logged = [], []
    for chain in find_chains(runs):
        whole = _lay_run(chain.stretches, chain.bridges)
        marks = np.zeros(len(whole), dtype=bool)
        for i, start in chain.places:
            marks[start : start + len(runs[i])] = True
        joined.append(whole)
        logged.append(marks)
    return joined, logged


def predict_all(predict: Callable[[Run], Array], runs: Sequence[Run]) -> list[Array]:
    """Return `predict_along` [n, K] of every run; each chain of stretches is predicted once."""
    answers = [np.zeros((0, 0))] * len(runs)
    for chain in find_chains(runs):
        answer = predict(_lay_run(chain.stretches, chain.bridges))
        for i, start in chain.places:
            answers[i] = answer[start : start + len(runs[i])]
    return answers


def find_chains(runs: Sequence[Run], block: int = 1) -> list[Chain]:
    """Return the chains that the stretches `runs` lie in; a run without a gap is one by itself.

    Args:
        runs: stretches; earlier stretches of the same run need not be among them.
        block: each stretch begins at a multiple of so many samples.
    """
    index = {(run.group, run.part): i for i, run in enumerate(runs)}
    laid: set[int] = set()
    chains = []
    for i in sorted(range(len(runs)), key=lambda i: -runs[i].part):
        if i in laid:
            continue
        stretches = list_chain(runs[i])
        bridges, starts = plan_bridges(stretches, block)
        places = []
        for run, start in zip(stretches, starts, strict=True):
            # A stretch may stand alone, without those before it.
            at = i if run is runs[i] else index.get((run.group, run.part))
            if at is not None and at not in laid and len(runs[at]) == len(run):
                places.append((at, start))
                laid.add(at)
        chains.append(Chain(tuple(stretches), tuple(bridges), tuple(places)))
    return sorted(chains, key=lambda chain: chain.places[0])


def _lay_run(chain: Sequence[Run], bridges: Sequence[int]) -> Run:
    """Return the stretches of a run as one, at rest before it."""
    if len(chain) == 1:
        return chain[0]
    return replace(
        chain[0],
        time_s=lay([part.time_s for part in chain], bridges),
        temperature_degC=lay([part.temperature_degC for part in chain], bridges),
        measured=lay([part.measured for part in chain], bridges),
        reference=lay([part.reference for part in chain], bridges),
        inputs={
            name: lay([part.inputs[name] for part in chain], bridges) for name in chain[0].inputs
        },
    )
