"""Two models' errors on the same rows: whether one is worse, or shown to be better.

What is compared is, run by run, the contrast of two squared errors: their difference over their
sum, from -1 (ours is nothing beside theirs) over 0 (alike) to 1. Where our model errs like the
other, either sign is as likely, and Student's distribution tells by how much the mean contrast may
differ from 0. A squared error itself would not do: one run with a large drift would be most of its
mean and of its spread.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from zerodrift.base.arrays import Array

LEVEL = 0.05
"""Chance that is taken of refusing a firmware that errs like all baselines, or of calling one
better that errs like them: the usual level of a test."""
WORSE = 0.05
"""Share by which the squared error has to exceed the other's, all rows together, to be worth a
refusal: 2.5 % of the error itself."""
FEWEST_RUNS = 3
"""Runs from which they themselves say whether the error is larger; of fewer, blocks of them do."""
UNCORRELATED = 0.05
"""The residual's correlation is summed up to the lag at which it falls below this."""


@dataclass(frozen=True)
class Contrast:
    """Two models' errors on the same rows."""

    ratio: float
    """Our squared error over theirs, all rows together."""
    chance_if_alike: float
    """Probability of a mean contrast so large where our model errs like the other."""
    chance_of_better: float
    """Probability of a mean contrast so small where it does, by runs alone."""
    runs: int
    runs_worse: int
    """In which our squared error is the larger one."""

    @property
    def is_worse(self) -> bool:
        """Whether our squared error exceeds theirs by more than WORSE."""
        return self.ratio > 1.0 + WORSE

    @property
    def is_shown_better(self) -> bool:
        """Whether ours is smaller over all rows, and by more than chance in the runs."""
        return self.ratio < 1.0 and self.chance_of_better <= LEVEL


def contrast_errors(
    ours: Sequence[Array], theirs: Sequence[Array], lengths: Sequence[int] | None = None
) -> Contrast:
    """Return how our errors differ from another model's.

    To be worse on the very runs that were held out is enough: where there are fewer than three of
    them, blocks longer than the residual's correlation speak for these runs. To be better is said
    of runs to come: only whole runs count for it.

    Args:
        ours: errors [n] per run, n > 0.
        theirs: errors [n] of the same rows.
        lengths: what `measure_correlation` says of ours, where it is known.
    """
    squares = [(float(a @ a), float(b @ b)) for a, b in zip(ours, theirs, strict=True)]
    own, other = (sum(part) for part in zip(*squares, strict=True))
    by_run = np.array([_contrast(a, b) for a, b in squares])
    units = by_run
    if len(ours) < FEWEST_RUNS:
        if lengths is None:
            lengths = [measure_correlation(e) for e in ours]
        units = np.concatenate(
            [_contrast_blocks(*parts) for parts in zip(ours, theirs, lengths, strict=True)]
        )
    return Contrast(
        ratio=own / other if other > 0.0 else (math.inf if own > 0.0 else 1.0),
        chance_if_alike=find_chance(units),
        chance_of_better=find_chance(-by_run),
        runs=len(ours),
        runs_worse=int((by_run > 0.0).sum()),
    )


def find_chance(contrasts: Array) -> float:
    """Return the chance of a mean so large among contrasts [n] of models that err alike.

    Of two contrasts or more by Student's distribution of n - 1 degrees of freedom. A single one has
    no spread; its two squares count as one degree of freedom each, whose ratio follows Fisher's
    F(1, 1): errors 13 times as large, squares 161 times, come by a chance of 5 %.
    """
    count = contrasts.size
    mean = float(contrasts.mean())
    if count == 1:
        bounded = min(max(mean, -1.0), 1.0)
        root = math.sqrt((1.0 + bounded) / (1.0 - bounded)) if bounded < 1.0 else math.inf
        return 1.0 - 2.0 / math.pi * math.atan(root)
    error = float(contrasts.std(ddof=1)) / math.sqrt(count)
    if error == 0.0:
        return 0.0 if mean > 0.0 else 1.0
    return float(stdtr(count - 1, -mean / error))


def hold_jointly(chances: Sequence[float]) -> list[bool]:
    """Return which of several hypotheses fall, at most LEVEL being the chance that a true one does.

    The smallest chance is held against LEVEL over their number, the next against LEVEL over one
    less, and so on up to the first that stands, however they depend on each other.

    Source: Holm, Scandinavian Journal of Statistics 6 (1979) 65.
    """
    falls = [False] * len(chances)
    for place, i in enumerate(sorted(range(len(chances)), key=lambda i: chances[i])):
        if chances[i] > LEVEL / (len(chances) - place):
            break
        falls[i] = True
    return falls


def measure_correlation(residual: Array) -> int:
    """Return a length in samples beyond which a residual [n] is no longer correlated with itself.

    It is twice the sum of the autocorrelation on both sides, up to where that is lost in noise. The
    mean stays in: an offset lasts as long as the run.
    """
    x, count = residual, residual.size
    power = float(x @ x)
    if count < 2 or power == 0.0:
        return max(int(count), 1)
    spectrum = np.fft.rfft(x, 2 * count)
    lags = np.fft.irfft(spectrum * np.conj(spectrum))[:count] / power
    below = np.flatnonzero(lags < UNCORRELATED)
    end = int(below[0]) if below.size else count
    return min(int(count), math.ceil(2.0 * (1.0 + 2.0 * float(lags[1:end].sum()))))


def _contrast(own: float, other: float) -> float:
    """Return the difference of two squared errors over their sum."""
    return (own - other) / (own + other) if own + other > 0.0 else 0.0


def _contrast_blocks(ours: Array, theirs: Array, length: int) -> Array:
    """Return the contrasts [B] of equal blocks of at least `length` samples.

    Fewer samples than two blocks are one. The first blocks have one sample more than the others
    where they cannot all be equal, as `numpy.array_split` cuts them.
    """
    own, other = (_sum_blocks(e**2, length) for e in (ours, theirs))
    return np.array([_contrast(a, b) for a, b in zip(own, other, strict=True)])


def _sum_blocks(part: Array, length: int) -> Array:
    """Return the sums over the blocks of a part [n]."""
    count = max(1, part.size // max(length, 1))
    size, longer = divmod(part.size, count)
    starts = np.arange(count) * size + np.minimum(np.arange(count), longer)
    return np.asarray(np.add.reduceat(part, starts))
