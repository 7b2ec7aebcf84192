"""How each run agrees with the others: what a fit of them leaves of it, and what it does to them.

Two figures, per output. The harm: how many times more a fit leaves of another run (the median of
them), left out of it, with this run among the fitted ones than without it. The misfit: what a fit
of the others leaves of this run, over the most that a fit without both leaves of any other. A run
of the same sensor adds to what is known, whatever it was for: its harm is about 1, whatever effect
the basis lacks and wherever its temperatures lie.

The fit is linear in a basis that most drifts lie in: powers of the temperature, its lags, start-up,
loads, inputs. A richer basis follows a missing effect, a poorer one reaches further beyond the
temperatures of the fit; a run disagrees only where it does so in each of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.operations.recursion import filter_recursively

BLOCKS = 240
"""Averages of a run that are fitted."""
FEWEST_ROWS = 50
"""Shorter runs are not looked at."""
FEWEST_RUNS = 4
"""Of three, one left out is predicted by a single other, whose own error then looks like harm."""
LAGS_S = (30.0, 120.0, 480.0)
RIDGE = 1e-4
"""Share of each column's square that holds its coefficient back."""
HARM = 2.0
"""A run disagrees if it doubles what is left of the others: then it does more harm than good in any
model, too. Simulated clean sets reach 1.4 in 99 of 100, ..."""
MISFIT = 6.0
"""... or if so many times more is left of it than of any other, in each basis; clean sets reach 3.4
in 99 of 100."""
MANY_WILD = 0.05
"""A run of which a larger share of the rows would be weighted is taken as it was measured."""
FEWEST_BLOCKS = 8


@dataclass(frozen=True)
class RunReading:
    """A stretch of a run as it is read now."""

    run: Run
    """With the columns as they are read."""
    kept: NDArray[np.bool_]
    """[n] rows that count."""
    later: NDArray[np.bool_] | None = None
    """[n] rows with a zero of their own; None: one zero."""

    @property
    def drift(self) -> Array:
        """[n, K], outliers weighed by how the run is read now."""
        wild = float((self.run.weights < 1.0).any(axis=1).mean())
        # What is wild all over is no outlier: a fast load in another column's place is.
        return self.run.drift if wild > MANY_WILD else self.run.steady_drift


def _read(run: Run, names: Sequence[str]) -> RunReading:
    """Return a stretch as it was logged, with some of its inputs."""
    inputs = {name: run.inputs[name] for name in names}
    return RunReading(replace(run, inputs=inputs), np.ones(len(run), dtype=np.bool_))


def _average(x: Array, kept: NDArray[np.bool_], blocks: int) -> Array:
    edges = np.linspace(0, x.shape[0], blocks + 1).astype(int)[:-1]
    counts = np.add.reduceat(kept.astype(np.float64), edges)
    total = np.add.reduceat(np.where(kept[:, None], x, 0.0), edges, axis=0)
    some = counts > 0.0
    return np.asarray(total[some] / counts[some][:, None])


def lag(x: Array, sample_period_s: float) -> list[Array]:
    """Return a signal [n] behind by each of LAGS_S, at rest at its first row."""
    lagged = []
    for tau_s in LAGS_S:
        share = -np.expm1(-sample_period_s / tau_s)
        state = np.array([(1.0 - share) * x[0]])
        lagged.append(filter_recursively([share], [1.0, share - 1.0], x, state))
    return lagged


def _build(course: RunReading, scales: Array, blocks: int) -> tuple[Array, Array]:
    """Return basis [b, J] and drift [b, K] of a stretch, with a column for a later zero, if any."""
    run = course.run
    load = run.reference / scales
    warm = (run.temperature_degC - 25.0) / 30.0
    elapsed = np.arange(len(run)) * run.sample_period_s
    columns = [warm, warm**2, *load.T, *(load * warm[:, None]).T]
    lagged = lag(warm, run.sample_period_s)
    started = [np.exp(-elapsed / (4.0 * tau_s)) for tau_s in LAGS_S]
    columns += [run.inputs[name] for name in sorted(run.inputs)]
    columns += [lagged[1], lagged[0], lagged[2], *started, warm**3, *(load**2).T]
    columns.append(2.0 ** (3.0 * np.clip(warm, -5.0, 5.0)))
    if course.later is not None:
        columns.append(course.later.astype(np.float64))
    table = np.stack(columns, axis=1)
    return _average(table, course.kept, blocks), _average(course.drift, course.kept, blocks)


@dataclass(frozen=True)
class RunSums:
    """A run's block averages, their means taken off, and the sums of their products."""

    design: Array
    """[b, J], each column over its size."""
    drift: Array
    """[b, K]."""
    normal: Array
    """[J, J] per block."""
    shared: Array
    """[J, K] per block."""

    def measure(self, factors: Array) -> Array:
        """Return the RMS [K] that some factors of the first columns leave of the drift."""
        error = self.drift - self.design[:, : len(factors)] @ factors
        return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


@dataclass(frozen=True)
class RunAgreement:
    """How one run stands to the others, per output."""

    harm: Array
    """[K] what is left of another run with it among the fitted, over what is left without."""
    misfit: Array
    """[L, K] what is left of it over the most that is left of any other, in each basis."""

    @property
    def doubt(self) -> Array:
        """[K] from 1 on the run disagrees."""
        return np.asarray(np.maximum(self.harm / HARM, self.misfit.min(axis=0) / MISFIT))

    @property
    def error(self) -> float:
        """What is left at the worst output, over what is usual: mean over the bases."""
        return float(np.exp(np.log(np.maximum(self.misfit.max(axis=1), 1e-12)).mean()))


class Bench:
    """The runs of a data set, each of which can be held against the others."""

    def __init__(self, runs: Sequence[Run], outputs: Sequence[str], scales: Array) -> None:
        self.outputs, self.scales = tuple(outputs), scales
        shared = set(runs[0].inputs).intersection(*(run.inputs for run in runs))
        names = sorted(shared - {"clock"})
        self.groups = tuple(dict.fromkeys(run.group for run in runs))
        self.courses = [
            [_read(run, names) for run in runs if run.group == group] for group in self.groups
        ]
        short = 2 + 2 * len(self.outputs)
        tables = [self._stack(courses) for courses in self.courses]
        self.levels = (short, short + len(names) + 1, tables[0][0].shape[1])
        spread = np.stack([np.sqrt(np.mean(design**2, axis=0)) for design, _ in tables])
        usual, largest = np.median(spread, axis=0), spread.max(axis=0)
        # A column that hardly moves in most runs keeps the size that it has where it moves.
        sizes = np.where(usual > 1e-3 * largest, usual, largest)
        self.sizes = np.where(sizes > 0.0, sizes, 1.0)
        self.blocks = [self._sum(*table) for table in tables]
        self._pairs: dict[tuple[int, frozenset[int]], Array] = {}

    def _stack(self, courses: Sequence[RunReading]) -> tuple[Array, Array]:
        """Return basis [b, J] and drift [b, K] of a run's stretches, which share one zero."""
        rows = sum(len(course.run) for course in courses)
        tables = [
            _build(course, self.scales, max(1, round(BLOCKS * len(course.run) / rows)))
            for course in courses
            if course.kept.any()
        ]
        design, drift = (np.concatenate(parts) for parts in zip(*tables, strict=True))
        design, drift = design - design.mean(axis=0), drift - drift.mean(axis=0)
        if courses[0].later is not None:
            later = design[:, -1:]
            power = max(float(np.sum(later**2)), 1e-300)
            design, drift = design[:, :-1], drift - later * (later.T @ drift) / power
            design = design - later * (later.T @ design) / power
        return design, drift

    def _sum(self, design: Array, drift: Array) -> RunSums:
        design = design / self.sizes
        count = len(design)
        return RunSums(design, drift, design.T @ design / count, design.T @ drift / count)

    def fit(self, members: Sequence[RunSums], level: int = -1) -> Array:
        """Return the factors [J, K] of a basis that fit some runs, each of which counts as one."""
        count = self.levels[level]
        normal = np.mean([m.normal[:count, :count] for m in members], axis=0)
        shared = np.mean([m.shared[:count] for m in members], axis=0)
        return np.asarray(np.linalg.solve(normal + RIDGE * np.eye(count), shared))

    def _leave_both(self, i: int, rest: frozenset[int]) -> Array:
        """Return what is left [n - 1, L, K] of each other run, fitted without it and run i."""
        if (i, rest) not in self._pairs:
            others = sorted(rest - {i})
            found = [
                [
                    self.blocks[j].measure(
                        self.fit([self.blocks[m] for m in others if m != j], level)
                    )
                    for level in range(len(self.levels))
                ]
                for j in others
            ]
            self._pairs[i, rest] = np.maximum(np.array(found), 1e-9 * self.scales)
        return self._pairs[i, rest]

    def assess(
        self, i: int, rest: frozenset[int], courses: Sequence[RunReading] | None = None
    ) -> RunAgreement | None:
        """Return how a run stands to the others; None where it is read so that little is left.

        Args:
            i: its place in `groups`.
            rest: places of the runs that count, itself included; three at least.
            courses: the run as it is read another way.
        """
        others = sorted(rest - {i})
        own = self.blocks[i]
        if courses is not None:
            if sum(int(course.kept.sum()) for course in courses) < FEWEST_ROWS:
                return None
            own = self._sum(*self._stack(courses))
            if len(own.design) < FEWEST_BLOCKS or not np.isfinite(own.normal).all():
                return None
        without = self._leave_both(i, rest)
        known = [self.blocks[j] for j in others]
        left = np.stack([own.measure(self.fit(known, level)) for level in range(len(self.levels))])
        with_it = np.stack(
            [
                self.blocks[j].measure(self.fit([own, *(self.blocks[m] for m in others if m != j)]))
                for j in others
            ]
        )
        # The median: what is left of another wrong run says nothing of this one.
        harm = np.quantile(with_it / without[:, -1], 0.5, axis=0, method="lower")
        return RunAgreement(harm, left / without.max(axis=0))

    def expect(
        self, i: int, rest: frozenset[int], courses: Sequence[RunReading]
    ) -> tuple[Array, Array]:
        """Return [b, K] what a fit of the others expects of a run's drift, and what it is."""
        own = self._sum(*self._stack(courses))
        return own.design @ self.fit([self.blocks[j] for j in sorted(rest - {i})]), own.drift

    def find_worst(self, rest: frozenset[int]) -> int | None:
        """Return the run that disagrees most with the others; None where all agree.

        It does so at temperatures where others have been, too, if it has been there at all: how a
        drift goes on beyond them, no fit of the others knows.
        """
        if len(rest) < FEWEST_RUNS:
            return None
        doubts = {}
        for i in sorted(rest):
            standings = [self.assess(i, rest), self.assess(i, rest, self._stay_among(i, rest))]
            doubts[i] = min(0.0 if s is None else float(s.doubt.max()) for s in standings)
        worst = max(doubts, key=lambda i: doubts[i])
        return worst if doubts[worst] >= 1.0 else None

    def _stay_among(self, i: int, rest: frozenset[int]) -> list[RunReading]:
        """Return a run without the rows that are warmer or colder than all other runs."""
        others = [c.run.temperature_degC for j in rest - {i} for c in self.courses[j]]
        low, high = min(map(np.min, others)), max(map(np.max, others))
        warm = [course.run.temperature_degC for course in self.courses[i]]
        return [
            replace(course, kept=course.kept & (low <= t) & (t <= high))
            for course, t in zip(self.courses[i], warm, strict=True)
        ]

    def agrees(self, group: str, output: str, rest: frozenset[int]) -> bool:
        """Return whether no more is left of an output of a run than of the others."""
        i = self.groups.index(group)
        if len(rest | {i}) < FEWEST_RUNS:
            return False
        standing = self.assess(i, rest | {i})
        return standing is not None and bool(standing.misfit[-1, self.outputs.index(output)] <= 1.0)
