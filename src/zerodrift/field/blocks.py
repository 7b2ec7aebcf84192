"""Samples become means over blocks of time; a spike does not move a mean."""

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.field.watch import BlockMeans

FAR = 4.0
"""Standard deviations of its block's samples beyond which a sample counts as that far off."""
MAD = 1.4826
"""Of a normal distribution: standard deviation over median absolute deviation."""
FEWEST = 8
"""Samples in a block from which its own spread tells a spike."""


def make_blocks(time_s: Array, residual: Array, temperature: Array, block_s: float) -> BlockMeans:
    """Return the means over blocks.

    Args:
        time_s: [n] since 1970, rising.
        residual: [n] compensated less true value, in the output's unit; finite.
        temperature: [n] as a share of the calibrated range.
        block_s: length of a block.
    """
    if not time_s.size:
        return BlockMeans(np.zeros(0, dtype=np.int64), *(np.zeros(0) for _ in range(3)))
    number = np.floor(time_s / block_s).astype(np.int64)
    place, begin, count = np.unique(number, return_index=True, return_counts=True)
    column = np.arange(time_s.size) - np.repeat(begin, count)
    row = np.repeat(np.arange(place.size), count)
    table = np.full((place.size, int(count.max())), np.inf)
    table[row, column] = residual
    middle = _take_median(table, count)
    away = np.full(table.shape, np.inf)
    away[row, column] = np.abs(residual - middle[row])
    spread = FAR * MAD * _take_median(away, count)
    spread[count < FEWEST] = np.inf
    clipped = np.clip(residual, (middle - spread)[row], (middle + spread)[row])
    means = [np.add.reduceat(values, begin) / count for values in (clipped, temperature)]
    return BlockMeans(place, count.astype(np.float64), means[0], means[1])


def join_blocks(older: BlockMeans, newer: BlockMeans) -> BlockMeans:
    """Return two lists of blocks as one; blocks that both have are averaged by their samples."""
    place = np.concatenate([older.place, newer.place])
    count = np.concatenate([older.count, newer.count])
    places, index = np.unique(place, return_inverse=True)
    counts = np.bincount(index, weights=count).astype(np.float64)

    def average(own: Array, other: Array) -> Array:
        values = np.concatenate([own, other])
        return np.asarray(np.bincount(index, weights=values * count) / counts)

    return BlockMeans(
        places,
        counts,
        average(older.residual, newer.residual),
        average(older.temperature, newer.temperature),
    )


def _take_median(table: Array, count: NDArray[np.int64]) -> Array:
    """Return the median of the first `count` values of each row; the others are infinite."""
    ranked = np.sort(table, axis=1)
    rows = np.arange(len(table))
    return 0.5 * (ranked[rows, (count - 1) // 2] + ranked[rows, count // 2])
