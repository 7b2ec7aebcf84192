"""A lag bank over every signal: levels, lags and products, solved by least squares in seconds.

Of each signal the bank has the level and its low-passes. Of one signal or of two it has all
products of two of these and their cubes; of all signals together the powers alone, for there would
be more products than rows. Which of these banks is taken, and how strongly its coefficients are
held towards zero, is decided for each part of the runs without that part.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve

from zerodrift.base.arrays import Array
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.black_box.signals import (
    ELAPSED,
    Lesson,
    average,
    choose_block,
    measure_unit,
)
from zerodrift.train.refits import split_parts

MOST_ROWS = 6_000
"""Block means of all runs together that a bank is fitted to."""
LAGS = 5
"""Low-passes of each signal."""
SHORTEST_STEPS = 5.0
LONGEST_SHARE = 0.25
"""The longest time constant, of the longest run."""
RIDGES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Of the mean square of a column."""
KEPT = 1e-9
"""Ridge of the constant, which is not held."""


@dataclass(frozen=True)
class _Trial:
    """One bank and ridge."""

    picked: tuple[int, ...]
    """Numbers of the signals; empty: all, without products."""
    ridge: float
    squares: Array
    """[G, G] mean squared error of part h when it is left out together with part g."""


@dataclass(frozen=True)
class LearntBank:
    """The predictions that banks add to a model in runs that they did not learn from."""

    added: Mapping[str, Array]
    """Run's name -> [n, K]."""
    sees: str
    """The signals of the bank that most runs are given."""


def learn_bank(lesson: Lesson) -> LearntBank:
    """Return what is learnt of each part of the runs from the others, choice of the bank included.

    Args:
        lesson: what to learn, from three runs or more.
    """
    parts = split_parts(lesson.runs)
    owner = [next(g for g, part in enumerate(parts) if run.group in part) for run in lesson.runs]
    views = [_view(signals, lesson) for signals in lesson.signals]
    block = choose_block(lesson.runs, MOST_ROWS)
    reduced = [[average(x, block) for x in run] for run in views]
    unit = measure_unit(lesson)
    targets = [average(rest / unit, block) for rest in lesson.rests]
    trials: list[_Trial] = []
    for picked in _list_banks(lesson.names):
        solver = _Solver([_expand(run, picked) for run in reduced], targets, owner, lesson)
        trials += [_Trial(picked, ridge, solver.measure_pairs(ridge)) for ridge in RIDGES]
    squares = np.stack([trial.squares for trial in trials])
    chosen = [trials[int(np.argmin(squares[:, g].sum(axis=1)))] for g in range(len(parts))]
    added = {}
    for g, trial in enumerate(chosen):
        columns = [_expand(run, trial.picked) for run in reduced]
        solver = _Solver(columns, targets, owner, lesson)
        coefficients = solver.solve((g,), trial.ridge)
        for run, view, part in zip(lesson.runs, views, owner, strict=True):
            if part == g:
                x = solver.scale(_expand(view, trial.picked))
                added[run.name] = x @ coefficients * unit
    most = max(chosen, key=lambda one: sum(other.picked == one.picked for other in chosen))
    sees = " and ".join(lesson.names[s] for s in most.picked)
    return LearntBank(added, sees or "all signals")


def _view(signals: Array, lesson: Lesson) -> list[Array]:
    """Return the level and lags [n, V] of each signal [n, S] of a run."""
    period_s = lesson.runs[0].sample_period_s
    longest_s = period_s * max(len(run) for run in lesson.runs)
    taus_s = np.geomspace(SHORTEST_STEPS * period_s, LONGEST_SHARE * longest_s, LAGS)
    return [
        x[:, None]
        if name == ELAPSED
        else np.stack([x, *(lowpass(x, period_s, float(tau)) for tau in taus_s)], axis=1)
        for name, x in zip(lesson.names, signals.T, strict=True)
    ]


def _list_banks(names: Sequence[str]) -> Iterator[tuple[int, ...]]:
    yield ()
    for count in (1, 2):
        yield from itertools.combinations(range(len(names)), count)


def _expand(views: Sequence[Array], picked: tuple[int, ...]) -> Array:
    """Return the bank's columns [n, J], the constant first."""
    z = np.concatenate([views[s] for s in picked] if picked else list(views), axis=1)
    if picked:
        first, second = np.triu_indices(z.shape[1])
        squares = z[:, first] * z[:, second]
    else:
        squares = z**2
    return np.concatenate([np.ones((len(z), 1)), z, squares, z**3], axis=1)


class _Solver:
    """Sums of products of a bank's columns, so that any part can be left out.

    Args:
        columns: [n, J] per run.
        targets: [n, K] per run.
        owner: part of each run.
        lesson: whose runs they are.
    """

    def __init__(
        self,
        columns: Sequence[Array],
        targets: Sequence[Array],
        owner: Sequence[int],
        lesson: Lesson,
    ) -> None:
        together = np.concatenate(columns)
        self._mean = together.mean(axis=0)
        self._rms = np.maximum(together.std(axis=0), 1e-9)
        self._mean[0], self._rms[0] = 0.0, 1.0
        self._parts = []
        for g in range(max(owner) + 1):
            rows = []
            for group in lesson.name_groups():
                own = [
                    np.concatenate([self.scale(x), y], axis=1)
                    for x, y, run, part in zip(columns, targets, lesson.runs, owner, strict=True)
                    if part == g and run.group == group
                ]
                if own:
                    joined = np.concatenate(own)
                    rows.append(joined - joined.mean(axis=0) if lesson.tared else joined)
            self._parts.append(np.concatenate(rows))
        self._width = columns[0].shape[1]
        self._sums = np.stack([rows.T @ rows for rows in self._parts])
        self._rows = np.array([len(rows) for rows in self._parts])

    def scale(self, x: Array) -> Array:
        """Return columns at mean 0 and RMS 1, the constant as it is."""
        return np.asarray((x - self._mean) / self._rms)

    def solve(self, without: tuple[int, ...], ridge: float) -> Array:
        """Return the coefficients [J, K] of a fit to all parts but some."""
        others = [g for g in range(len(self._parts)) if g not in without]
        total, j = self._sums[others].sum(axis=0), self._width
        held = np.full(j, ridge)
        held[0] = KEPT
        normal = total[:j, :j] + self._rows[others].sum() * np.diag(held)
        return np.asarray(solve(normal, total[:j, j:], assume_a="pos"))

    def measure_pairs(self, ridge: float) -> Array:
        """Return [G, G] the mean squared error of part h when g is left out with it; 0 for g."""
        count, j = len(self._parts), self._width
        found = np.zeros((count, count))
        for g, h in itertools.combinations(range(count), 2):
            coefficients = self.solve((g, h), ridge)
            for one, other in ((g, h), (h, g)):
                rows = self._parts[other]
                found[one, other] = np.mean((rows[:, j:] - rows[:, :j] @ coefficients) ** 2)
        return found
