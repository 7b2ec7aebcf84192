"""The orders in which the kernels read an LSTM's weights; laid out once, here."""

from collections.abc import Callable

import numpy as np

from zerodrift.operations.gru.layouts import fill_rows, order_rows, pack_fours, pack_pairs
from zerodrift.operations.lstm.cell import IntegerLstm

MOST_INPUTS, MOST_UNITS = 32, 128
"""What the assembly is written for: its stack and its offsets."""


def has_fast_kernel(lstm: IntegerLstm) -> bool:
    """Tell whether there is assembly for a layer: not too many weights, short multipliers."""
    short = lstm.multiplier is None or max(lstm.multiplier_shift) < 32
    return short and lstm.inputs <= MOST_INPUTS and lstm.hidden <= MOST_UNITS


def lay_out_pairs(lstm: IntegerLstm) -> list[int]:
    """Return the stream of the assembly, [H][4 + 4 (X + R)] with X = ceil(I/2), R = ceil(H/2).

    Unit by unit: biases i, f, g, o; then blocks of two pairs of features, each block i i f f g g
    o o, a last odd one i f g o; then the same of the output.
    """
    words: list[int] = []
    w_x, w_h = pack_pairs(lstm.w_x), pack_pairs(lstm.w_h)  # [4, H, pairs]
    for unit in range(lstm.hidden):
        words += [int(b) for b in lstm.bias[:, unit]]
        for rows in (w_x[:, unit], w_h[:, unit]):
            for first in range(0, rows.shape[1], 2):
                words += [int(w) for w in rows[:, first : first + 2].ravel()]
    return words


def lay_out_bytes(lstm: IntegerLstm) -> list[int]:
    """Return the stream with recurrent weights of 8 bits, [H][8 + 4 (F + X)], F = ceil(H/4).

    Unit by unit: for each four of the output a word of i, f, g, o, whose bytes are the first,
    third, second and fourth weight; biases i, f, g, o and their multipliers; blocks of features as
    `lay_out_pairs`.
    """
    if lstm.multiplier is None:
        raise ValueError("weights of 16 bits")
    words: list[int] = []
    fours, w_x = pack_fours(lstm.w_h), pack_pairs(lstm.w_x)  # [4, H, F], [4, H, X]
    for unit in range(lstm.hidden):
        words += [int(w) for w in fours[:, unit].T.ravel()]
        words += [int(n) for part in (lstm.bias, lstm.multiplier) for n in part[:, unit]]
        for first in range(0, w_x.shape[2], 2):
            words += [int(w) for w in w_x[:, unit, first : first + 2].ravel()]
    return words


def lay_out_rows(lstm: IntegerLstm) -> list[int]:
    """Return the weights of 16 bits of the rows kernel, [U][4][8 X + 8 R].

    X = ceil(I/8), R = ceil(H/8); U is H filled up to a multiple of four. With 8-bit recurrent
    weights it is [U][4][8 X].
    """
    wide = (lstm.w_x, lstm.w_h) if lstm.multiplier is None else (lstm.w_x,)
    return order_rows(fill_rows(*wide))


def lay_out_row_bytes(lstm: IntegerLstm) -> list[int]:
    """Return the recurrent weights of 8 bits of the rows kernel, [U][4][8 R]."""
    return order_rows(fill_rows(lstm.w_h))


def arrange_by_unit(lstm: IntegerLstm, field: str) -> list[int]:
    """Return an array in the order of the C: unit by unit, within a unit gate by gate.

    [4, H, n] becomes [H][4][n], [4, H] becomes [H][4].
    """
    array = np.asarray(getattr(lstm, field))
    return [int(v) for v in np.moveaxis(array, 1, 0).ravel()]


FILTERS: dict[str, Callable[..., object]] = {
    "lstm_by_unit": arrange_by_unit,
    "lstm_has_fast_kernel": has_fast_kernel,
    "lay_out_lstm_pairs": lay_out_pairs,
    "lay_out_lstm_bytes": lay_out_bytes,
    "lay_out_lstm_rows": lay_out_rows,
    "lay_out_lstm_row_bytes": lay_out_row_bytes,
}
"""What the templates of an LSTM call."""
