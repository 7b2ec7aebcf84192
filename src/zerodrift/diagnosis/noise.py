"""The noise floor: its variance octave by octave, from a dwell or, less surely, from residuals.

A dwell's Allan variance is described by white noise and first-order noises of all time constants,
two octaves apart, each with a weight that is not negative. That smooths it, and carries it on to
octaves that the dwell is too short to show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.physics.reduction import MEANS, WITHIN_BLOCKS, cut_octaves

PRIOR_COUNT = 2.0
"""Coefficients that the mean over all octaves counts for, at the start of the fit."""
SPACING = 4.0
"""Ratio of neighbouring time constants."""


@dataclass(frozen=True)
class Noise:
    """Noise of K outputs as a mixture of first-order noises."""

    weights: Array
    """[D, K] variances of white noise and of each first-order noise."""
    tau_samples: Array
    """[D] time constants in samples; 0 is white."""
    source: str
    """dwell | residual: where it was measured."""
    uncertainty: float = 0.0
    """Standard error of the RMS, pooled over outputs, as a share of it: a short record of slow
    noise says little about it."""

    def variance(self, octaves: NDArray[np.int64], longest: int, block: int = 1) -> Array:
        """Return the variance of an orthonormal coefficient of each octave, [L, K].

        Args:
            octaves: log2 of the half-length in samples; MEANS for a piece's mean, WITHIN_BLOCKS
                for deviations within blocks.
            longest: samples of a piece, for its mean.
            block: samples in a block.
        """
        rows = []
        for octave in octaves.tolist():
            if octave == WITHIN_BLOCKS:
                inside = np.arange(max(round(np.log2(block)), 1))
                share = 2.0**-inside / (2.0**-inside).sum()
                rows.append(share @ _detail_variance(2.0**inside, self.tau_samples))
            elif octave == MEANS:
                rows.append(_mean_variance(float(longest), self.tau_samples))
            else:
                rows.append(_detail_variance(np.array([2.0**octave]), self.tau_samples)[0])
        return np.stack(rows) @ self.weights

    def rms(self, longest: int) -> Array:
        """Return the RMS [K] within a run of `longest` samples, its mean removed."""
        return np.sqrt(
            np.maximum(
                (1.0 - _mean_variance(float(longest), self.tau_samples) / longest) @ self.weights,
                0.0,
            )
        )

    def measure_growth(self, longest: int) -> float:
        """Return the power of time by which variance grows up to a fourth of `longest` samples.

        White noise has 0, flicker 1, a random walk 2; outputs are pooled.
        """
        half = longest / 4.0 * np.array([1.0, 0.25])
        late, early = _detail_variance(half, self.tau_samples) @ self.weights
        return float(np.log2(np.mean(late / np.maximum(early, 1e-300)))) / 2.0


def measure_noise(columns: Sequence[Array], source: str) -> Noise:
    """Return the noise in records [n, K] of nothing else, such as dwells."""
    lengths = np.array([record.shape[0] for record in columns], dtype=np.int64)
    octaves = cut_octaves(lengths, 1)
    stacked = np.concatenate(list(columns))
    details = np.stack(
        [octaves.transform(stacked[:, k] - stacked[:, k].mean()) for k in range(stacked.shape[1])],
        axis=1,
    )
    numbers = np.unique(octaves.octave[octaves.octave >= 0])
    squares = np.stack([(details[octaves.octave == o] ** 2).sum(axis=0) for o in numbers])
    counts = np.array([float((octaves.octave == o).sum()) for o in numbers])
    noise = describe_noise(numbers, squares / counts[:, None], counts, source)
    return replace(noise, uncertainty=_measure_uncertainty(squares, counts))


def _measure_uncertainty(squares: Array, counts: Array) -> float:
    """Return the relative standard error of the pooled RMS.

    A sum of n squares scatters by sqrt(2/n) of itself; the RMS by half of what its square does.
    """
    shares = squares / np.maximum(squares.sum(axis=0), 1e-300)
    of_squares = (shares**2 * (2.0 / counts)[:, None]).sum(axis=0)
    return float(0.5 * np.sqrt(of_squares.mean() / of_squares.size))


def describe_noise(
    octaves: NDArray[np.int64], variances: Array, counts: Array, source: str
) -> Noise:
    """Return the mixture of first-order noises nearest to measured variances.

    Args:
        octaves: [L] log2 of the half-length in samples.
        variances: [L, K] mean squares of the coefficients.
        counts: [L] coefficients behind each.
        source: dwell | residual.
    """
    coarsest = float(2.0 ** octaves.max())
    taus = [0.0]
    while not taus[1:] or taus[-1] * SPACING <= coarsest:
        taus.append(2.0 if len(taus) == 1 else taus[-1] * SPACING)
    tau_samples = np.array(taus)
    dictionary = _detail_variance(2.0 ** octaves.astype(float), tau_samples)
    weights = np.zeros((tau_samples.size, variances.shape[1]))
    for k in np.flatnonzero(variances.max(axis=0) > 0.0):
        measured = np.maximum(variances[:, k], 1e-12 * float(variances[:, k].max()))
        # The few coarse coefficients may be next to nothing by chance: what is expected of them
        # starts from all octaves.
        mean = float(np.average(measured, weights=counts))
        model = (counts * measured + PRIOR_COUNT * mean) / (counts + PRIOR_COUNT)
        least = 1e-3 * model
        for _ in range(4):
            # A mean square of n coefficients scatters by sqrt(2/n) of itself.
            trust = np.sqrt(counts) / model
            weights[:, k] = _fit_positive(dictionary * trust[:, None], measured * trust)
            model = np.maximum(dictionary @ weights[:, k], least)
    return Noise(weights, tau_samples, source)


def _fit_positive(matrix: Array, right: Array) -> Array:
    """Return the least-squares answer that has no negative part."""
    from scipy.optimize import lsq_linear, nnls

    try:
        return np.asarray(nnls(matrix, right)[0])
    except RuntimeError:
        # Columns that are nearly alike can make the active set go round in circles.
        return np.asarray(lsq_linear(matrix, right, bounds=(0.0, np.inf)).x)


def _sum_variance(length: Array, tau_samples: Array) -> Array:
    """Return the variance of the sum of `length` samples of unit noise, [..., D]."""
    ratio = np.exp(-1.0 / np.maximum(tau_samples, 1e-2))
    ratio = np.where(tau_samples == 0.0, 0.0, ratio)
    n = np.asarray(length, dtype=np.float64)[..., None]
    return np.asarray((n * (1.0 - ratio**2) - 2.0 * ratio * (1.0 - ratio**n)) / (1.0 - ratio) ** 2)


def _detail_variance(half: Array, tau_samples: Array) -> Array:
    """Return the variance of a Haar coefficient with halves of `half` samples, [..., D]."""
    one, two = _sum_variance(half, tau_samples), _sum_variance(2.0 * half, tau_samples)
    return np.asarray((4.0 * one - two) / (2.0 * half[..., None]))


def _mean_variance(length: float, tau_samples: Array) -> Array:
    """Return the variance of sqrt(n) times the mean of n samples, [D]."""
    return np.asarray(_sum_variance(np.array(length), tau_samples) / length)
