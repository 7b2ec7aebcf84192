"""Formats for an LSTM, chosen from the weights so that no accumulator can overflow."""

import numpy as np
from numpy.typing import NDArray

from zerodrift.export.quantize_gru import GateRows, choose_gate, refuse_not_finite
from zerodrift.operations.lstm.cell import (
    CELL_BITS,
    CELL_LIMIT,
    GATES,
    FloatLstm,
    IntegerLstm,
)

LARGEST_CODE = 32768.0


def quantize_lstm(
    lstm: FloatLstm, feature_exponents: NDArray[np.int64], weights: str
) -> IntegerLstm:
    """Return the integer LSTM with the finest power-of-two scale per gate that is provably safe.

    Args:
        lstm: float weights.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights with a multiplier per row.

    Raises:
        CheckError: a gate's weights are so large that no scale is safe, or not finite.
    """
    refuse_not_finite("LSTM", lstm)
    formats = [
        choose_gate(
            GateRows(
                f"LSTM gate {name}",
                lstm.w_x[gate],
                lstm.w_h[gate],
                lstm.bias[gate],
                16 if name == "g" else 15,
            ),
            feature_exponents,
            weights,
        )
        for gate, name in enumerate(GATES)
    ]
    w_h = np.stack([f.w_h for f in formats])
    multipliers = [f.multiplier for f in formats if f.multiplier is not None]
    i, f, g, o = formats
    return IntegerLstm(
        w_x=np.stack([f.w_x for f in formats]).astype(np.int16),
        w_h=w_h.astype(np.int16) if weights == "int16" else w_h.astype(np.int8),
        bias=np.stack([f.bias for f in formats]).astype(np.int32),
        shift=(i.shift, f.shift, g.shift, o.shift),
        cell_bits=choose_cell_bits(lstm, feature_exponents),
        multiplier=np.stack(multipliers).astype(np.int32) if multipliers else None,
        multiplier_shift=(
            i.multiplier_shift,
            f.multiplier_shift,
            g.multiplier_shift,
            o.multiplier_shift,
        ),
    )


def choose_cell_bits(lstm: FloatLstm, feature_exponents: NDArray[np.int64]) -> int:
    """Return the fractional bits of the cell state: as many as its proven range leaves, 24 to 27.

    |c| is at most i g / (1 - f) with the largest i, g and f that features of 16 bits and |h| <= 1
    can give: a sum that c never passes, since c' = f c + i g.
    """
    most = np.abs(lstm.w_x) @ (LARGEST_CODE * 2.0 ** -feature_exponents.astype(np.float64))
    most = np.minimum(most + np.abs(lstm.w_h).sum(axis=2), 700.0)
    reach = np.minimum(lstm.bias + most, 700.0)
    i, f = (1.0 / (1.0 + np.exp(-reach[k])) for k in (0, 1))
    largest = float(np.max(i / np.maximum(1.0 - f, 2.0**-16)))
    least, bits = CELL_BITS
    while bits > least and 1.01 * largest * 2.0**bits > CELL_LIMIT:
        bits -= 1
    return bits
