"""The orders in which the kernels read a GRU's weights; one array each, laid out once, here.

Two neighbouring 16-bit numbers are a *pair*: one 32-bit number, the first in its lower half. An odd
row is filled up with a zero.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import IntArray
from zerodrift.operations.gru.cell import IntegerGru

COLUMN_UNITS = 8
"""Units that one vector of the columns kernel holds (AVX2: 256 bits)."""
ROW_NUMBERS = 8
"""16-bit numbers that one vector of the rows kernel holds (MVE: 128 bits)."""
MOST_INPUTS, MOST_UNITS, MOST_UNITS_BEFORE = 32, 128, 64
"""What the assembly is written for; the last: units with the reset before the product."""
ROW_UNITS = 4
"""Units whose activations the rows kernels take at once."""


def has_fast_kernels(gru: IntegerGru) -> bool:
    """Tell whether the layouts below exist: reset after the product, 16-bit weights."""
    return gru.reset == "after" and gru.multiplier is None


def has_before_kernel(gru: IntegerGru) -> bool:
    """Tell whether there is assembly for a reset before the product: 16-bit weights, few."""
    before = gru.reset == "before" and gru.multiplier is None
    return before and gru.inputs <= MOST_INPUTS and gru.hidden <= MOST_UNITS_BEFORE


def has_bytes_kernel(gru: IntegerGru) -> bool:
    """Tell whether there is assembly for recurrent weights of 8 bits: reset after the product."""
    few = gru.inputs <= MOST_INPUTS and gru.hidden <= MOST_UNITS
    short = max(gru.multiplier_shift) < 32
    return gru.reset == "after" and gru.multiplier is not None and few and short


def pack_pairs(rows: NDArray[np.int16] | NDArray[np.int8]) -> IntArray:
    """Return int16 [..., n] as signed 32-bit pairs [..., (n + 1) // 2].

    Example:
        >>> pack_pairs(np.array([1, -1, 2], dtype=np.int16)).tolist()
        [-65535, 2]
    """
    odd = rows.shape[-1] % 2
    even = np.pad(rows.astype(np.int64), [(0, 0)] * (rows.ndim - 1) + [(0, odd)])
    words = (even[..., 0::2] & 0xFFFF) | ((even[..., 1::2] & 0xFFFF) << 16)
    return np.where(words >= 2**31, words - 2**32, words)


def pack_fours(rows: NDArray[np.int16] | NDArray[np.int8]) -> IntArray:
    """Return weights of 8 bits [..., n] as signed 32-bit words of four [..., (n + 3) // 4].

    A word's bytes, the lowest first, are the first, third, second and fourth weight.

    Example:
        >>> [hex(word) for word in pack_fours(np.array([1, 2, 3, 4, 5], dtype=np.int8))]
        ['0x4020301', '0x5']
    """
    fill = -rows.shape[-1] % 4
    filled = np.pad(rows.astype(np.int64), [(0, 0)] * (rows.ndim - 1) + [(0, fill)])
    fours = filled.reshape(*rows.shape[:-1], -1, 4)[..., [0, 2, 1, 3]] & 0xFF
    words: IntArray = (fours << np.array([0, 8, 16, 24])).sum(axis=-1)
    return np.where(words >= 2**31, words - 2**32, words)


def lay_out_pairs(gru: IntegerGru) -> list[int]:
    """Return the stream of the pairs kernel, [H][4 + 3 (X + R)] with X = ceil(I/2), R = ceil(H/2).

    Unit by unit: biases r, u, n outside, n inside; then blocks of two pairs of features, each block
    r r u u n n, a last odd one r u n; then the same of the state.
    """
    words: list[int] = []
    w_x, w_h = pack_pairs(gru.w_x), pack_pairs(gru.w_h)  # [3, H, pairs]
    for unit in range(gru.hidden):
        words += [int(b) for b in gru.bias[:, unit]]
        for rows in (w_x[:, unit], w_h[:, unit]):
            for first in range(0, rows.shape[1], 2):
                words += [int(w) for w in rows[:, first : first + 2].ravel()]
    return words


def find_pairs(pairs: int) -> IntArray:
    """Return where the words of a row of pairs lie in the stream of the pairs kernel, [3, pairs].

    Blocks of two pairs, r r u u n n, and a last odd one, r u n.

    Example:
        >>> find_pairs(3).tolist()
        [[0, 1, 6], [2, 3, 7], [4, 5, 8]]
    """
    pair, gate = np.arange(pairs), np.arange(3)[:, None]
    wide = np.where((pair | 1) < pairs, 2, 1)
    return np.asarray(6 * (pair // 2) + wide * gate + pair % 2)


def lay_out_before(gru: IntegerGru) -> list[int]:
    """Return the stream of a reset before the product, [H][2 + 2 (X + R)] and [H][1 + X + R].

    First r and u: unit by unit two biases, then blocks of two pairs of features, each r r u u, a
    last odd one r u; then the same of the state. Then n alone in the same order, of r h.
    """
    words: list[int] = []
    w_x, w_h = pack_pairs(gru.w_x), pack_pairs(gru.w_h)  # [3, H, pairs]
    for gates in (slice(0, 2), slice(2, 3)):
        for unit in range(gru.hidden):
            words += [int(b) for b in gru.bias[gates, unit]]
            for rows in (w_x[gates, unit], w_h[gates, unit]):
                for first in range(0, rows.shape[1], 2):
                    words += [int(w) for w in rows[:, first : first + 2].ravel()]
    return words


def lay_out_bytes(gru: IntegerGru) -> list[int]:
    """Return the stream with recurrent weights of 8 bits, [H][7 + 3 (X + F)], F = ceil(H/4).

    Unit by unit: biases r, u, n outside; blocks of features as `lay_out_pairs`; for each four of
    the state a word of r, u, n, whose bytes are the first, third, second and fourth weight; then
    the bias of n inside and the multipliers of r, u, n.
    """
    if gru.multiplier is None:
        raise ValueError("weights of 16 bits")
    words: list[int] = []
    w_x, packed = pack_pairs(gru.w_x), pack_fours(gru.w_h)  # [3, H, X], [3, H, F]
    for unit in range(gru.hidden):
        words += [int(b) for b in gru.bias[:3, unit]]
        for first in range(0, w_x.shape[2], 2):
            words += [int(w) for w in w_x[:, unit, first : first + 2].ravel()]
        words += [int(w) for w in packed[:, unit].T.ravel()]
        words += [int(gru.bias[3, unit]), *(int(m) for m in gru.multiplier[:, unit])]
    return words


def lay_out_columns(gru: IntegerGru) -> list[int]:
    """Return the stream of the columns kernel, [ceil(H/8)][4 + 3 (X + R)][8].

    Eight units side by side; missing ones are zeros. First the four biases; then for each pair of
    features r, u, n; then the same of the state.
    """
    units = -(-gru.hidden // COLUMN_UNITS) * COLUMN_UNITS
    wide = [(0, 0), (0, units - gru.hidden)]
    bias = np.pad(gru.bias.astype(np.int64), wide)
    w_x, w_h = (np.pad(pack_pairs(w), [*wide, (0, 0)]) for w in (gru.w_x, gru.w_h))
    words: list[int] = []
    for first in range(0, units, COLUMN_UNITS):
        some = slice(first, first + COLUMN_UNITS)
        words += [int(b) for b in bias[:, some].ravel()]
        for rows in (w_x, w_h):
            words += [int(w) for w in rows[:, some].transpose(2, 0, 1).ravel()]
    return words


def fill_rows(*weights: NDArray[np.int16] | NDArray[np.int8]) -> IntArray:
    """Return [G, H, n] side by side as the rows kernels read them: whole vectors, fours of units.

    H is filled up to a multiple of four and each n to one of eight, with zeros.

    Example:
        >>> fill_rows(np.ones((3, 5, 2), np.int16), np.ones((3, 5, 5), np.int16)).shape
        (3, 8, 16)
    """
    parts = []
    for some in weights:
        units, fill = -some.shape[1] % ROW_UNITS, -some.shape[2] % ROW_NUMBERS
        parts.append(np.pad(some.astype(np.int64), [(0, 0), (0, units), (0, fill)]))
    return np.concatenate(parts, axis=2)


def order_rows(rows: IntArray) -> list[int]:
    """Return [G, U, n] unit by unit, within a unit gate by gate."""
    return [int(w) for w in np.moveaxis(rows, 1, 0).ravel()]


def order_fours(numbers: NDArray[np.int32]) -> list[int]:
    """Return a number per row [G, H] as [U / 4][G][4], U being H filled up to a multiple of 4.

    Example:
        >>> order_fours(np.array([[1, 2], [3, 4]], dtype=np.int32))
        [1, 2, 0, 0, 3, 4, 0, 0]
    """
    filled = np.pad(numbers, [(0, 0), (0, -numbers.shape[1] % ROW_UNITS)])
    fours = filled.reshape(len(numbers), -1, ROW_UNITS)
    return [int(n) for n in fours.transpose(1, 0, 2).ravel()]


def lay_out_rows(gru: IntegerGru) -> list[int]:
    """Return the weights of 16 bits of the rows kernel, [U][3][8 X + 8 R].

    X = ceil(I/8), R = ceil(H/8); U is H filled up to a multiple of four. With 8-bit recurrent
    weights it is [U][3][8 X]. With the reset before the product it is r and u of all units, then n.
    """
    wide = (gru.w_x, gru.w_h) if gru.multiplier is None else (gru.w_x,)
    return _order_passes(gru, fill_rows(*wide))


def lay_out_row_bytes(gru: IntegerGru) -> list[int]:
    """Return the recurrent weights of 8 bits of the rows kernel, [U][3][8 R], as `lay_out_rows`."""
    return _order_passes(gru, fill_rows(gru.w_h))


def _order_passes(gru: IntegerGru, rows: IntArray) -> list[int]:
    passes = (rows,) if gru.reset == "after" else (rows[:2], rows[2:])
    return [number for gates in passes for number in order_rows(gates)]


def arrange_by_unit(gru: IntegerGru, field: str) -> list[int]:
    """Return a GRU array in the order of the C: unit by unit, within a unit gate by gate.

    [3, H, n] becomes [H][3][n], [4, H] and [3, H] become [H][4] and [H][3].
    """
    array = np.asarray(getattr(gru, field))
    return [int(v) for v in np.moveaxis(array, 1, 0).ravel()]


FILTERS: dict[str, Callable[..., object]] = {
    "has_fast_kernels": has_fast_kernels,
    "has_before_kernel": has_before_kernel,
    "has_bytes_kernel": has_bytes_kernel,
    "by_unit": arrange_by_unit,
    "lay_out_pairs": lay_out_pairs,
    "lay_out_before": lay_out_before,
    "lay_out_bytes": lay_out_bytes,
    "lay_out_columns": lay_out_columns,
    "lay_out_rows": lay_out_rows,
    "lay_out_row_bytes": lay_out_row_bytes,
    "order_fours": order_fours,
}
"""What the templates of a GRU call."""
