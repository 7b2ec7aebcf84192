"""The noise floor: what no compensation can take away, measured on a dwell or else estimated."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Dataset
from zerodrift.physics.noise import describe_noise, measure_noise
from zerodrift.physics.octaves import cut_octaves

Array = NDArray[np.float64]

DWELL = "dwell"
ESTIMATED = "estimated"
ISOTHERMAL_K = 1.0
"""A dwell in which the temperature moves by more is doubted."""
PIECE = 64
"""Without a dwell, noise is read within pieces of this many samples: over longer times noise and
drift look alike."""
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

    def explain(self) -> str:
        """Return where the floor comes from and what it is worth, in a sentence."""
        if self.source == DWELL:
            doubt = ""
            if self.moved_K > ISOTHERMAL_K:
                doubt = (
                    f"; the temperature moves by {self.moved_K:.1f} K in them, so part of it may "
                    "be drift"
                )
            span = f"for a run of {self.span_s:.0f} s"
            return f"the noise floor is that of the dwell logs, {span}{doubt}"
        return (
            "the noise floor is estimated from what the model leaves, as there is no dwell log: "
            f"only noise faster than about {self.slowest_s:.0f} s counts, so the true floor may be "
            "higher. Log an isothermal, unloaded dwell and name it in [logs] dwell"
        )


def measure_floor(dataset: Dataset, residuals: Sequence[Array]) -> NoiseFloor:
    """Return the floor from the dwell logs, or from the residuals where there are none.

    Args:
        dataset: the runs; the floor is for one of their median length.
        residuals: [n, K] of runs, drift beyond the model; used only without a dwell.
    """
    runs = dataset.test or dataset.train
    period_s = runs[0].sample_period_s
    span = int(np.median([len(run) for run in runs]))
    if dataset.dwell:
        records = [run.drift for run in dataset.dwell]
        # A channel that is not connected has no noise to describe.
        alive = np.any([np.ptp(record, axis=0) > 0.0 for record in records], axis=0)
        rms = np.zeros(alive.size)
        if alive.any():
            rms[alive] = measure_noise([record[:, alive] for record in records], DWELL).rms(span)
        longest = max(len(run) for run in dataset.dwell)
        moved = max(float(np.ptp(run.temperature_degC)) for run in dataset.dwell)
        return NoiseFloor(rms, DWELL, span * period_s, longest * period_s, moved)
    rms = estimate_fast_noise(residuals, span)
    return NoiseFloor(rms, ESTIMATED, span * period_s, PIECE * period_s)


def estimate_fast_noise(residuals: Sequence[Array], span: int) -> Array:
    """Return the RMS [K] within `span` samples of the noise that shows within a piece.

    Each octave's variance is the median over sections of runs, so that steps of the load, and what
    the model misses now and then, do not count as noise.
    """
    lengths: list[int] = []
    section: list[int] = []
    kept = []
    for number, residual in enumerate(residuals):
        piece = min(PIECE, residual.shape[0])
        count = residual.shape[0] // piece
        lengths += [piece] * count
        section += [number * SECTIONS_PER_RUN + i * SECTIONS_PER_RUN // count for i in range(count)]
        kept.append(residual[: count * piece])
    octaves = cut_octaves(np.array(lengths, dtype=np.int64), 1)
    stacked = np.concatenate(kept)
    stacked = stacked - stacked.mean(axis=0)
    squares = np.stack([octaves.transform(column) ** 2 for column in stacked.T], axis=1)
    # The longest halves are as slow as the piece: drift, more often than noise.
    numbers = np.unique(octaves.octave[octaves.octave >= 0])
    numbers = numbers[:-1] if numbers.size > 1 else numbers
    owner = np.array(section)[octaves.piece]
    variances = np.empty((numbers.size, stacked.shape[1]))
    counts = np.empty(numbers.size)
    for row, number in enumerate(numbers):
        here = octaves.octave == number
        sections, place = np.unique(owner[here], return_inverse=True)
        each = np.stack([squares[here][place == s].mean(axis=0) for s in range(sections.size)])
        variances[row] = np.median(each, axis=0)
        counts[row] = float(here.sum())
    _limit_growth(variances)
    rms = np.zeros(stacked.shape[1])
    alive = variances.max(axis=0) > 0.0
    if alive.any():
        rms[alive] = describe_noise(numbers, variances[:, alive], counts, ESTIMATED).rms(span)
    return rms


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
