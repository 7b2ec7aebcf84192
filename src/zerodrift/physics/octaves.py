"""Haar octaves: a run is cut in halves repeatedly, which separates slow from fast parts.

Each coefficient is the scaled difference between the means of two neighbouring pieces of a run. The
coefficients of one run are an orthonormal change of basis: squared errors add up to the same
number, octave by octave. Their variance per octave is the Allan variance (times the piece's
length), in which white noise is flat, flicker noise grows in proportion to the length and a random
walk with its square. Coefficients of coloured noise are nearly uncorrelated, so weighting
each octave by its noise is generalised least squares without any filter.

Source: D. B. Percival, Biometrika 82 (1995); D. W. Allan, Proc. IEEE 54 (1966).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array

IntArray = NDArray[np.int64]

MEANS = -1
"""The octave's number of a piece's mean."""
WITHIN_BLOCKS = -2
"""The octave's number of deviations within blocks of samples."""
MOST_KEPT = 1 << 14
"""Rows of a change of basis that is kept for the next runs of these lengths: 1 MB at most."""


@dataclass(frozen=True)
class Octaves:
    """The change of basis for several pieces of time laid end to end.

    Rows of the result are sorted by piece, then by octave, from fine to coarse; each piece's last
    row is its mean times the square root of its length.
    """

    start: IntArray
    """[M] where the left half begins, in the running sum."""
    middle: IntArray
    stop: IntArray
    left: Array
    """[M] factor of the left half's sum; the right half has minus `right`."""
    right: Array
    octave: IntArray
    """[M] log2 of the halves' length in samples, rounded; MEANS for a piece's mean."""
    piece: IntArray
    """[M] index of the piece."""

    def transform(self, x: Array) -> Array:
        """Return the coefficients [M] of a column [n] over all pieces."""
        running = np.empty(x.size + 1)
        running[0] = 0.0
        np.cumsum(x, out=running[1:])
        at_middle = running.take(self.middle)
        left, right = running.take(self.start), running.take(self.stop)
        np.subtract(at_middle, left, out=left)
        np.subtract(right, at_middle, out=right)
        left *= self.left
        right *= self.right
        left -= right
        return left


def cut_octaves(lengths: IntArray, samples_per_row: int) -> Octaves:
    """Return the change of basis for pieces of these lengths.

    Args:
        lengths: [G] rows of each piece.
        samples_per_row: samples that each row is the mean of.
    """
    sizes = tuple(int(n) for n in lengths)
    return (_cut if sum(sizes) > MOST_KEPT else _cut_once)(sizes, samples_per_row)


def _cut(lengths: tuple[int, ...], samples_per_row: int) -> Octaves:
    parts: list[tuple[IntArray, IntArray, IntArray, IntArray, int]] = []
    offset = 0
    for index, length in enumerate(lengths):
        levels = []
        depth = 0
        while (1 << depth) < length:
            edges = np.round(np.linspace(0, length, 2 ** (depth + 1) + 1)).astype(np.int64)
            start, middle, stop = edges[0:-2:2], edges[1:-1:2], edges[2::2]
            whole = (middle > start) & (stop > middle)
            start, middle, stop = start[whole], middle[whole], stop[whole]
            half = 0.5 * (stop - start) * samples_per_row
            levels.append((start, middle, stop, np.round(np.log2(half)).astype(np.int64)))
            depth += 1
        for start, middle, stop, octave in reversed(levels):
            parts.append((start + offset, middle + offset, stop + offset, octave, index))
        mean = np.array([offset], dtype=np.int64)
        parts.append((mean, mean + length, mean + length, np.array([MEANS], dtype=np.int64), index))
        offset += length
    start = np.concatenate([p[0] for p in parts])
    middle = np.concatenate([p[1] for p in parts])
    stop = np.concatenate([p[2] for p in parts])
    octave = np.concatenate([p[3] for p in parts])
    piece = np.concatenate([np.full(p[0].size, p[4], dtype=np.int64) for p in parts])
    one, two = (middle - start).astype(np.float64), (stop - middle).astype(np.float64)
    is_mean = octave == MEANS
    safe = np.where(is_mean, 1.0, two)
    factor = np.sqrt(one * safe / (one + safe))
    left = np.where(is_mean, 1.0 / np.sqrt(one), factor / one)
    right = np.where(is_mean, 0.0, factor / safe)
    # Within a piece the octaves of different depths may share a number; sort to make slices.
    rank = np.where(is_mean, np.int64(1 << 30), octave)
    order = np.lexsort((rank, piece))
    found = Octaves(
        start[order],
        middle[order],
        stop[order],
        left[order],
        right[order],
        octave[order],
        piece[order],
    )
    for array in (found.start, found.middle, found.stop, found.octave, found.piece):
        array.flags.writeable = False  # several may have it
    found.left.flags.writeable = found.right.flags.writeable = False
    return found


_cut_once = lru_cache(maxsize=8)(_cut)
