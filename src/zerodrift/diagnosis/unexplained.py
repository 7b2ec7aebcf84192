"""The part of the drift that no logged signal explains: the residual of a regression on all.

The noise floor must be one number for a project, before its first effect and after its last. So it
is not read from what a model leaves, but from what is left beside a regression rich enough for
anything smooth that follows temperature, loads, inputs and time, with memory of several lengths. It
predicts badly beyond the logs, and is used for nothing else.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.operations.recursion import filter_recursively
from zerodrift.physics.projection import invert_scaled

MEMORIES = (8.0, 64.0, 512.0, 4096.0)
"""Time constants of the memory that the regression has, samples."""
SAMPLES_PER_COLUMN = 20
"""Fewer samples than this per column, and the regression is left the simpler columns."""
MOST_KEPT = 1 << 21
"""Values of all runs' columns up to which they are kept; those of longer logs are built again."""


class Unexplained:
    """What a regression on all signals of the logs leaves of their drift."""

    def __init__(self, dataset: Dataset, piece: int | None) -> None:
        """Fit it to the training runs.

        Args:
            dataset: the runs.
            piece: samples of a piece whose mean does not count; None: each stretch is one.
        """
        runs = dataset.train
        self._plan = _Plan(dataset)
        samples = sum(len(run) for run in runs)
        most = max(samples // SAMPLES_PER_COLUMN, 1)
        self._tables: dict[int, tuple[Run, Array]] = {}
        first = self._plan.build(runs[0])
        self._count = min(first.shape[1], most)
        gram = np.zeros((self._count, self._count))
        right = np.zeros((self._count, len(dataset.outputs)))
        for number, run in enumerate(runs):
            whole = first if number == 0 else self._plan.build(run)
            if samples * self._count <= MOST_KEPT:
                self._tables[id(run)] = run, whole
            table = _level(whole[:, : self._count], piece)
            gram += table.T @ table
            right += table.T @ _level(run.steady_drift, piece)
        self._coefficients = invert_scaled(gram) @ right
        self._freedom = 1.0 - self._count / samples

    def _build(self, run: Run) -> Array:
        kept = self._tables.get(id(run))
        return (self._plan.build(run) if kept is None else kept[1])[:, : self._count]

    def leave(self, run: Run) -> Array:
        """Return what is left of a run's drift [n, K], but for its mean."""
        return np.asarray(run.steady_drift - self._build(run) @ self._coefficients)

    def leave_honestly(self, run: Run) -> Array:
        """Return the same [n, K], made larger by what the fit takes of pure noise."""
        return np.asarray(self.leave(run) / np.sqrt(self._freedom))


class _Plan:
    """Which signals there are, and their scales."""

    def __init__(self, dataset: Dataset) -> None:
        runs = dataset.train
        everywhere = (*runs, *dataset.dwell)
        self._inputs = [
            name for name in runs[0].inputs if all(name in run.inputs for run in everywhere)
        ]
        self._loads = [
            k
            for k in range(len(dataset.outputs))
            if any(float(np.ptp(run.reference[:, k])) > 0.0 for run in runs)
        ]
        self._scales = [
            _find_scale([self._list(run)[i] for run in runs])
            for i in range(len(self._list(runs[0])))
        ]

    def _list(self, run: Run) -> list[Array]:
        """Return temperature, loads and inputs [n]."""
        loads = [run.reference[:, k] for k in self._loads]
        return [run.temperature_degC, *loads, *(run.inputs[name] for name in self._inputs)]

    def build(self, run: Run) -> Array:
        """Return the columns [n, P], the simplest first."""
        signals = [
            (x - middle) / spread
            for x, (middle, spread) in zip(self._list(run), self._scales, strict=True)
        ]
        return np.stack([*self._give(run, signals)], axis=1)

    def _give(self, run: Run, signals: Sequence[Array]) -> Iterator[Array]:
        temperature, others = signals[0], signals[1:]
        time_s = run.time_s - (run.time_s[0] if run.start_s is None else run.start_s)
        elapsed = time_s / run.sample_period_s
        yield from signals
        yield elapsed / MEMORIES[-1]
        yield from (temperature**2, temperature**3)
        yield from (_lag(temperature, tau) for tau in MEMORIES)
        yield _step(temperature)
        yield from (np.exp(-np.maximum(elapsed, 0.0) / tau) for tau in MEMORIES[1:])
        for x in others:
            yield from (x**2, x * temperature, _lag(x, MEMORIES[1]), _lag(x, MEMORIES[2]), _step(x))


def _find_scale(parts: Sequence[Array]) -> tuple[float, float]:
    """Return the middle of a signal's range and half of it; a spread of 1 where it stands still."""
    low, high = min(float(x.min()) for x in parts), max(float(x.max()) for x in parts)
    return 0.5 * (low + high), 0.5 * (high - low) or 1.0


def _lag(x: Array, tau: float) -> Array:
    """Return a signal [n] behind a first-order lag of `tau` samples, at rest at the start."""
    a = float(np.exp(-1.0 / tau))
    return np.asarray(x[0] + filter_recursively([1.0 - a], [1.0, -a], x - x[0]))


def _step(x: Array) -> Array:
    return np.asarray(np.diff(x, prepend=x[0]))


def _level(table: Array, piece: int | None) -> Array:
    """Return the columns [n, P] without the mean of each piece; a rest of a piece is one too."""
    length = table.shape[0]
    size = length if piece is None else min(piece, length)
    edges = np.arange(0, length, size)
    means = np.add.reduceat(table, edges, axis=0) / np.diff(np.append(edges, length))[:, None]
    whole = length // size
    levelled = np.empty(table.shape)
    pieces = table[: whole * size].reshape(whole, size, -1)
    np.subtract(pieces, means[:whole, None], out=levelled[: whole * size].reshape(pieces.shape))
    levelled[whole * size :] = table[whole * size :] - means[whole:]
    return levelled
