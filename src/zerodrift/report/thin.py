"""Reduces lines of many samples to few points: least and largest value of each step."""

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array

MOST_POINTS = 1200
"""Points of a line; more samples than that are drawn as the least and largest of each step."""


def pick_rows(y: Array, start: int, stop: int, most: int = MOST_POINTS) -> NDArray[np.int64]:
    """Return the rows of y[start:stop] that make a line of at most `most` points look the same.

    Args:
        y: [n] the line.
        start: first row.
        stop: one past the last row.
        most: points that may be kept; at least 4.

    Returns:
        Rows in order, the first and the last among them. Where all fit, all of them; else for each
        step that of the least and that of the largest value, so that no peak is lost.
    """
    count = stop - start
    if count <= most:
        return np.arange(start, stop)
    steps = max((most - 2) // 2, 1)
    size = -(-count // steps)
    whole = count // size
    blocks = np.asarray(y[start : start + whole * size]).reshape(whole, size)
    base = start + size * np.arange(whole)
    rows = [base + blocks.argmin(axis=1), base + blocks.argmax(axis=1), [start, stop - 1]]
    if whole * size < count:
        tail = np.asarray(y[start + whole * size : stop])
        first = start + whole * size
        rows.append([first + int(tail.argmin()), first + int(tail.argmax())])
    return np.unique(np.concatenate([np.asarray(r, dtype=np.int64) for r in rows]))


def pick_spread(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` rows out of `count`, evenly spread, for clouds of points."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.int64)
