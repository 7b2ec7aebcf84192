"""Two models' errors on the same rows: whether one is larger, and by more than chance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

Array = NDArray[np.float64]

WORSE = 0.05
"""Share by which the squared error may exceed that of no compensation, or of physics alone."""
STANDARD_ERRORS = 2.0
"""And the difference must be beyond this many of its standard errors; of few runs or blocks, beyond
as many as leave the same chance by Student's distribution: 4.5 of three, 2.9 of five."""
GROSS = 4.0
"""A squared error that exceeds the other's by this factor, over all runs or in most of them, counts
whatever the standard error is: runs that are far worse by unlike amounts have a large one."""
FEWEST_RUNS = 3
"""Runs, or blocks, from which a standard error is taken."""
UNCORRELATED = 0.05
"""The residual's correlation is summed up to the lag at which it falls below this."""


@dataclass(frozen=True)
class Contrast:
    """Two models' errors on the same rows."""

    worse: bool
    """Whether our squared error is larger by more than WORSE."""
    beyond_chance: bool | None
    """Whether it is larger by `STANDARD_ERRORS`, or `GROSS`; None: too few parts to tell."""

    @property
    def counts(self) -> bool:
        """Whether this counts against our model; the share alone decides where chance is not
        known."""
        return self.worse and self.beyond_chance is not False


def contrast_errors(
    ours: Sequence[Array], theirs: Sequence[Array], lengths: Sequence[int] | None = None
) -> Contrast:
    """Return whether our squared error is larger, and whether by more than chance.

    The standard error is taken over runs, or over blocks longer than the residual's correlation
    where there are fewer than three runs.

    Args:
        ours: errors [n] per run.
        theirs: errors [n] of the same rows.
        lengths: what `measure_correlation` says of ours, where it is known.
    """
    square = sum(float(np.sum(e**2)) for e in ours)
    other = sum(float(np.sum(e**2)) for e in theirs)
    worse = square > (1.0 + WORSE) * other
    gross = sum(
        float(np.sum(a**2)) > GROSS * float(np.sum(b**2)) for a, b in zip(ours, theirs, strict=True)
    )
    if square > GROSS * other or 2 * gross > len(ours):
        return Contrast(worse, True)
    parts = [a**2 - b**2 for a, b in zip(ours, theirs, strict=True)]
    if len(parts) >= FEWEST_RUNS:
        lengths = [part.size for part in parts]
    elif lengths is None:
        lengths = [measure_correlation(own) for own in ours]
    blocks = [_sum_blocks(part, n) for part, n in zip(parts, lengths, strict=True)]
    sums = np.concatenate([np.zeros(0), *(own for own, _ in blocks)])
    sizes = np.concatenate([np.zeros(0), *(own for _, own in blocks)])
    if sums.size < FEWEST_RUNS:
        return Contrast(worse, None)
    mean = sums.sum() / sizes.sum()
    left = sums - mean * sizes
    count = sums.size
    error = math.sqrt(count / (count - 1.0) * float(left @ left)) / sizes.sum()
    return Contrast(worse, bool(mean > find_quantile(count) * error))


def find_quantile(count: int) -> float:
    """Return how many standard errors, taken over so many parts, a difference must be beyond."""
    return float(stdtrit(count - 1, ndtr(STANDARD_ERRORS)))


def measure_correlation(residual: Array) -> int:
    """Return a length in samples beyond which a residual [n] is no longer correlated with itself.

    It is twice the sum of the autocorrelation on both sides, up to where that is lost in noise.
    """
    x = residual - residual.mean()
    count = x.size
    power = float(x @ x)
    if count < 2 or power == 0.0:
        return max(int(count), 1)
    spectrum = np.fft.rfft(x, 2 * count)
    lags = np.fft.irfft(spectrum * np.conj(spectrum))[:count] / power
    below = np.flatnonzero(lags < UNCORRELATED)
    end = int(below[0]) if below.size else count
    return min(int(count), math.ceil(2.0 * (1.0 + 2.0 * float(lags[1:end].sum()))))


def _sum_blocks(part: Array, length: int) -> tuple[Array, Array]:
    """Return the sums and the sizes of equal blocks of at least `length` samples.

    Fewer samples than two blocks are one. The first blocks have one sample more than the others
    where they cannot all be equal, as `numpy.array_split` cuts them.
    """
    count = max(1, part.size // max(length, 1))
    size, longer = divmod(part.size, count)
    end = longer * (size + 1)
    sums = [part[:end].reshape(longer, size + 1).sum(axis=1)] if longer else []
    sums.append(part[end:].reshape(count - longer, size).sum(axis=1))
    sizes = np.repeat(np.array([size + 1.0, size]), [longer, count - longer])
    return np.concatenate(sums), sizes
