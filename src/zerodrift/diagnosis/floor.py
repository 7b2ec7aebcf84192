"""The noise floor: what no compensation can take away, measured on a dwell or else estimated."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.remember import remember_last
from zerodrift.dataset.runs import Dataset, Run, share_resolution
from zerodrift.diagnosis.noise import describe_noise, measure_noise
from zerodrift.operations.recursion import filter_recursively
from zerodrift.physics.live import find_live
from zerodrift.physics.reduction import cut_octaves
from zerodrift.physics.search import invert_scaled

# The part of the drift that no logged signal explains: the residual of a regression on all.
#
# The noise floor must be one number for a project, before its first effect and after its last. So
# it is not read from what a model leaves, but from what is left beside a regression rich enough for
# anything smooth that follows temperature, loads, inputs and time, with memory of several lengths.
# It predicts badly beyond the logs, and is used for nothing else.

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


# The noise floor: what no compensation can take away, measured on a dwell or else estimated.

DWELL = "dwell"
ESTIMATED = "estimated"
ISOTHERMAL_K = 1.0
"""A dwell in which the temperature moves by more is doubted."""
PIECE = 64
"""Without a dwell, noise is read within pieces of this many samples: over longer times noise and
drift look alike."""
COARSE = 2.0
"""An output measured in steps of so many times its RMS in the dwell shows more of where it stands
between two steps than of its noise."""
SECTIONS_PER_RUN = 8
MOST_GROWTH = 2.0
"""From one octave to the next, for the variance of noise."""
FASTER = 1.3
"""The same, against the growth one octave before."""


@dataclass(frozen=True)
class NoiseFloor:
    """The RMS of the noise within a run, per output."""

    rms: Array
    """[K] in the outputs' units."""
    source: str
    """dwell | estimated."""
    span_s: float
    """Length of the run that the figures are for."""
    slowest_s: float
    """The slowest noise that could be seen; slower noise is not in the figures."""
    moved_K: float = 0.0
    """By how much the temperature moved in the dwell logs."""
    silent: tuple[str, ...] = ()
    """Outputs that move in the runs but not in the dwell: their floor is estimated."""
    coarse: tuple[str, ...] = ()
    """Outputs measured in steps above the noise: a dwell stands somewhere between two of them, so
    that their floor is that of runs that go through many."""

    def explain(self) -> str:
        """Return where the floor comes from and what it is worth, in a sentence."""
        if self.source == DWELL:
            doubt = ""
            if self.moved_K > ISOTHERMAL_K:
                doubt = (
                    f"; the temperature moves by {self.moved_K:.1f} K in them, so part of it may "
                    "be drift"
                )
            if self.silent:
                doubt += f"; {', '.join(self.silent)} never moves in them, so it is estimated there"
            if self.coarse:
                doubt += (
                    f"; {', '.join(self.coarse)} is measured in steps above its noise, so it is "
                    "estimated there from runs that go through many steps"
                )
            span = f"for a run of {self.span_s:.0f} s"
            return f"the noise floor is that of the dwell logs, {span}{doubt}"
        return (
            "the noise floor is estimated from what follows no signal in the training logs, as "
            "there is no dwell log: "
            f"only noise faster than about {self.slowest_s:.0f} s counts, so the true floor may be "
            "higher. Log an isothermal, unloaded dwell and name it in [logs] dwell"
        )


@remember_last
def measure_floor(dataset: Dataset) -> NoiseFloor:
    """Return the floor from the dwell logs, or from the training runs where there are none.

    It depends on the logs alone: the same number for every model, in every command. What follows
    the logs' signals is no noise, be it in the model or not: it is taken out by a regression on
    all of them (see `Unexplained`), in the dwell where that leaves less.

    Args:
        dataset: the runs; the floor is for a training run of their median length.
    """
    runs = dataset.train
    period_s = runs[0].sample_period_s
    span = int(np.median([len(run) for run in runs]))
    if not dataset.dwell:
        rms = _estimate_by_regression(dataset, span)
        return NoiseFloor(rms, ESTIMATED, span * period_s, PIECE * period_s)
    beside = Unexplained(dataset, None)
    rms = np.minimum(
        measure_noise([run.steady_drift for run in dataset.dwell], DWELL).rms(span),
        measure_noise([beside.leave(run) for run in dataset.dwell], DWELL).rms(span),
    )
    silent = find_live(runs) & (rms == 0.0)
    steps = share_resolution(runs)
    coarse = ~silent & (steps > COARSE * rms)
    if silent.any() or coarse.any():
        moving = _estimate_by_regression(dataset, span)
        rms[silent] = moving[silent]
        coarse &= moving > rms
        rms[coarse] = moving[coarse]
    longest = max(len(run) for run in dataset.dwell)
    moved = max(float(np.ptp(run.temperature_degC)) for run in dataset.dwell)
    names = np.array(dataset.outputs)
    return NoiseFloor(
        rms,
        DWELL,
        span * period_s,
        longest * period_s,
        moved,
        silent=tuple(names[silent].tolist()),
        coarse=tuple(names[coarse].tolist()),
    )


def _estimate_by_regression(dataset: Dataset, span: int) -> Array:
    """Return the RMS [K] of the fast noise beside what all signals explain within pieces."""
    beside = Unexplained(dataset, PIECE)
    return estimate_fast_noise([beside.leave_honestly(run) for run in dataset.train], span)


def estimate_fast_noise(residuals: Sequence[Array], span: int) -> Array:
    """Return the RMS [K] within `span` samples of the noise that shows within a piece.

    Each octave's variance is the median over sections of runs, so that steps of the load, and what
    the model misses now and then, do not count as noise.
    """
    means: dict[int, list[Array]] = {}
    counts: dict[int, int] = {}
    for residual in residuals:
        for number, of_sections, count in _square_by_section(residual):
            means.setdefault(number, []).append(of_sections)
            counts[number] = counts.get(number, 0) + count
    # The longest halves are as slow as the piece: drift, more often than noise.
    numbers = sorted(means)[:-1] or sorted(means)
    pooled = [np.concatenate(means[o]) for o in numbers]
    variances = np.stack([np.median(each, axis=0) for each in pooled])
    # A coarse converter stands still in most sections.
    mostly_still = variances.max(axis=0) == 0.0
    variances[:, mostly_still] = np.stack([each.mean(axis=0) for each in pooled])[:, mostly_still]
    _limit_growth(variances)
    rms = np.zeros(variances.shape[1])
    alive = variances.max(axis=0) > 0.0
    if alive.any():
        octaves = np.array(numbers, dtype=np.int64)
        weights = np.array([float(counts[o]) for o in numbers])
        rms[alive] = describe_noise(octaves, variances[:, alive], weights, ESTIMATED).rms(span)
    return rms


def _square_by_section(residual: Array) -> list[tuple[int, Array, int]]:
    """Return, per octave, its number, the mean squares [S, K] of each section, and their count.

    Args:
        residual: [n, K] of one run, cut into pieces of at most PIECE samples.
    """
    piece = min(PIECE, residual.shape[0])
    count = residual.shape[0] // piece
    octaves = cut_octaves(np.array([piece], dtype=np.int64), 1)
    levelled = residual[: count * piece] - residual.mean(axis=0)
    running = np.zeros((count, piece + 1, residual.shape[1]))
    np.cumsum(levelled.reshape(count, piece, -1), axis=1, out=running[:, 1:])
    edges = np.searchsorted(np.arange(count) * SECTIONS_PER_RUN // count, range(SECTIONS_PER_RUN))
    edges = np.unique(np.append(edges, count))
    found = []
    for number in np.unique(octaves.octave[octaves.octave >= 0]).tolist():
        here = np.flatnonzero(octaves.octave == number)
        middle = running[:, octaves.middle[here]]
        left = (middle - running[:, octaves.start[here]]) * octaves.left[here, None]
        right = (running[:, octaves.stop[here]] - middle) * octaves.right[here, None]
        squares = np.mean((left - right) ** 2, axis=1)
        of_sections = np.add.reduceat(squares, edges[:-1], axis=0) / np.diff(edges)[:, None]
        found.append((number, of_sections, count * here.size))
    return found


def _limit_growth(variances: Array) -> None:
    """Lower variances [L, K] of octaves, fine to coarse, to what noise can have.

    From octave to octave flicker doubles, and noise of any colour grows steadily or ever less;
    what a model misses grows eightfold once it shows, so growth that gathers pace is drift.
    """
    growth = np.full(variances.shape[1], MOST_GROWTH)
    for row in range(1, variances.shape[0]):
        finer = np.maximum(variances[row - 1], 1e-300)
        variances[row] = np.minimum(variances[row], growth * finer)
        reached = np.maximum(variances[row] / finer, 1.0)
        growth = np.minimum(MOST_GROWTH, FASTER * reached)
