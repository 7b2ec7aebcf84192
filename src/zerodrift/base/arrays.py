"""What arrays are called, and arrays as the bytes of one npz file."""

import io
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def pack_arrays(arrays: Mapping[str, NDArray[np.generic]], *, compressed: bool) -> bytes:
    """Return the content of an npz file; the same arrays give the same bytes.

    Raises:
        MemoryError: there is no memory for it.
    """
    buffer = io.BytesIO()
    save = np.savez_compressed if compressed else np.savez
    try:
        save(buffer, allow_pickle=False, **arrays)
    except ValueError as error:
        # The archive is closed while a member is open, and complains of that instead.
        if isinstance(error.__context__, MemoryError):
            raise error.__context__ from None
        raise
    return buffer.getvalue()


# Medians and quantiles of one column without the detours that NumPy takes for all other cases.
#
# Their bits are those of `numpy.median` and `numpy.quantile`; on a few thousand values these spend
# more time on the form of the question than on the answer.


def find_median(values: Array) -> float:
    """Return the median of some values; NaN where one of them is, or where there are none.

    Args:
        values: [n], in any unit, which is the result's.
    """
    if values.size == 0:
        return math.nan
    half = values.size // 2
    places = (half, -1) if values.size % 2 else (half - 1, half, -1)
    ordered = np.partition(values, places)
    if math.isnan(ordered[-1]):
        return math.nan
    return float(ordered[half] if values.size % 2 else (ordered[half - 1] + ordered[half]) / 2.0)


def find_quantile(values: Array, share: float) -> float:
    """Return the value that a share of all lie below, linear between neighbours; NaN if one is.

    Args:
        values: [n], n > 0, in any unit, which is the result's.
        share: 0 .. 1.
    """
    place = (values.size - 1) * share
    below = min(math.floor(place), values.size - 1)
    above = min(below + 1, values.size - 1)
    ordered = np.partition(values, sorted({below, above, values.size - 1}))
    if math.isnan(ordered[-1]):
        return math.nan
    low, high, part = float(ordered[below]), float(ordered[above]), place - below
    rise = high - low
    return high - rise * (1.0 - part) if part >= 0.5 else low + rise * part
