"""Formats for gates and for a head, chosen from the weights so that no accumulator can overflow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import INT16_MAX, INT32_MAX, choose_exponent
from zerodrift.operations.gru.cell import GATES, FloatGru, IntegerGru
from zerodrift.operations.lstm.cell import FloatLstm

SHIFT_LIMIT = 30
"""Largest shift from an accumulator to the table; weights so small gain nothing from more."""

LOWEST_EXPONENT = 17
"""The accumulator of every gate keeps at least the bits that the table reads."""


@dataclass(frozen=True)
class GateRows:
    """One gate of a recurrent layer in float."""

    name: str
    """For messages, such as "GRU gate r"."""
    w_x: Array  # [H, I]
    w_h: Array  # [H, H]
    bias: Array  # [H]
    table_bits: int
    """Fractional bits of the table's argument in the gate's own: 16, 15 for a sigmoid, which reads
    the table at half its argument."""
    inside: Array | None = None
    """[H] the bias inside the product of a gate whose recurrent part is multiplied by another."""


@dataclass(frozen=True)
class GateFormat:
    """Integer rows of one gate at scale 2**exponent (the n gate's features at one bit less)."""

    w_x: NDArray[np.int64]
    w_h: NDArray[np.int64]
    bias: NDArray[np.int64]  # outside the reset product
    bias_inside: NDArray[np.int64]
    shift: int
    multiplier: NDArray[np.int64] | None
    multiplier_shift: int

    def fits(self, inside: bool) -> bool:
        """Tell whether every int32 accumulator holds for any int16 features and any state.

        Args:
            inside: True for the n gate with the reset after the recurrent product.
        """
        product = np.abs(self.w_h).sum(axis=1) * 32767
        if self.multiplier is not None:
            product = (product * self.multiplier >> self.multiplier_shift) + 1
        from_x = np.abs(self.w_x).sum(axis=1) * 32768 + np.abs(self.bias)
        if inside:
            product = product + np.abs(self.bias_inside)
            if product.max() > INT32_MAX:
                return False
            product = product // 2 + 1
        largest = max(int(np.abs(self.w_x).max(initial=0)), int(np.abs(self.w_h).max()))
        return largest <= INT16_MAX and int((from_x + product).max()) <= INT32_MAX


def quantize_gru(gru: FloatGru, feature_exponents: NDArray[np.int64], weights: str) -> IntegerGru:
    """Return the integer GRU with the finest power-of-two scale per gate that is provably safe.

    Args:
        gru: float weights.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights with a multiplier per row (the
            feature weights stay int16: they are few, and one row scale for both would cost the
            recurrent ones up to three bits).

    Raises:
        CheckError: a gate's weights are so large that no scale is safe, or not finite.
    """
    refuse_not_finite("GRU", gru)
    formats = [
        choose_gate(
            GateRows(
                f"GRU gate {name}",
                gru.w_x[gate],
                gru.w_h[gate],
                gru.bias[gate],
                16 if name == "n" else 15,
                gru.bias[3] if name == "n" and gru.reset == "after" else None,
            ),
            feature_exponents,
            weights,
        )
        for gate, name in enumerate(GATES)
    ]
    multiplier = None
    if weights == "int8":
        stacked = [f.multiplier for f in formats if f.multiplier is not None]
        multiplier = np.stack(stacked).astype(np.int32)
    bias = np.stack([f.bias for f in formats] + [formats[2].bias_inside]).astype(np.int32)
    w_h = np.stack([f.w_h for f in formats])
    return IntegerGru(
        w_x=np.stack([f.w_x for f in formats]).astype(np.int16),
        w_h=w_h.astype(np.int16) if weights == "int16" else w_h.astype(np.int8),
        bias=bias,
        shift=(formats[0].shift, formats[1].shift, formats[2].shift),
        reset=gru.reset,
        multiplier=multiplier,
        multiplier_shift=(
            formats[0].multiplier_shift,
            formats[1].multiplier_shift,
            formats[2].multiplier_shift,
        ),
    )


def refuse_not_finite(kind: str, layer: FloatGru | FloatLstm) -> None:
    """Raise CheckError where a weight of a layer is infinite or no number.

    Args:
        kind: for the message: "GRU", "LSTM".
        layer: its weights in float.
    """
    for name, array in (("w_x", layer.w_x), ("w_h", layer.w_h), ("bias", layer.bias)):
        if not np.isfinite(array).all():
            at = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            raise CheckError(f"{kind} {name}{list(at)} is not finite; the model is refused")


def choose_gate(gate: GateRows, feature_exponents: NDArray[np.int64], weights: str) -> GateFormat:
    """Return a gate's rows at the finest scale that is provably safe.

    Args:
        gate: its rows in float.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights with a multiplier per row.

    Raises:
        CheckError: the weights are so large that no scale is safe; names gate and row.
    """
    for exponent in range(15 + SHIFT_LIMIT, LOWEST_EXPONENT - 1, -1):
        with np.errstate(over="ignore"):  # infinite is too large as well
            candidate = _format_gate(gate, feature_exponents, weights, exponent)
        if candidate is not None and candidate.fits(gate.inside is not None):
            return candidate
    rows = np.abs(gate.w_x).sum(axis=1) + np.abs(gate.w_h).sum(axis=1)
    worst = int(rows.argmax())
    raise CheckError(
        f"{gate.name}, row {worst}: weights with a sum of {rows[worst]:.3g} leave no"
        " safe 32-bit format; the model is refused. Train with weight decay or clip that row."
    )


def _format_gate(
    gate: GateRows, feature_exponents: NDArray[np.int64], weights: str, exponent: int
) -> GateFormat | None:
    """Return the gate's rows with its accumulator at 2**exponent, or None if one cannot fit."""
    inside = gate.inside
    outer = exponent if inside is None else exponent - 1  # mul_high by r halves the inner sum
    shift = outer - gate.table_bits
    half = 1 << shift >> 1
    bias_int = np.round(gate.bias * 2.0**outer) + half
    inside_int = np.zeros_like(bias_int) if inside is None else np.round(inside * 2.0**exponent)
    if max(np.abs(bias_int).max(), np.abs(inside_int).max()) > INT32_MAX:
        return None
    from_x = np.round(gate.w_x * 2.0 ** (outer - feature_exponents))
    recurrent = _format_recurrent(gate.w_h, exponent - 15, weights)
    if np.abs(from_x).max(initial=0.0) > INT16_MAX or recurrent is None:
        return None
    rows, multiplier, multiplier_shift = recurrent
    return GateFormat(
        w_x=from_x.astype(np.int64),
        w_h=rows,
        bias=bias_int.astype(np.int64),
        bias_inside=inside_int.astype(np.int64),
        shift=shift,
        multiplier=multiplier,
        multiplier_shift=multiplier_shift,
    )


def _format_recurrent(
    w_h: Array, exponent: int, weights: str
) -> tuple[NDArray[np.int64], NDArray[np.int64] | None, int] | None:
    """Return integer rows, and for int8 the multipliers and their shift; None if one cannot fit."""
    if weights == "int16":
        scaled = np.round(w_h * 2.0**exponent)
        return None if np.abs(scaled).max() > INT16_MAX else (scaled.astype(np.int64), None, 0)
    step = np.abs(w_h).max(axis=1, keepdims=True) / 127.0
    rows = np.round(np.divide(w_h, step, out=np.zeros_like(w_h), where=step > 0.0))
    scale = step[:, 0] * 2.0**exponent
    shift = min(choose_exponent(float(scale.max()), INT32_MAX), 31)
    if shift < 0:
        return None
    return rows.astype(np.int64), np.round(scale * 2.0**shift).astype(np.int64), shift


def quantize_head(weights: Array) -> tuple[NDArray[np.int16], NDArray[np.int64]]:
    """Return int16 rows [K, H] for the head and the exponent of each row's 32-bit sum.

    Args:
        weights: [K, H] in output units per unit of hidden state.

    Returns:
        rows and exponents e: real = sum * 2**-e.
    """
    rows = np.zeros(weights.shape, dtype=np.int16)
    exponents = np.zeros(weights.shape[0], dtype=np.int64)
    for k, row in enumerate(weights):
        limit = min(
            choose_exponent(float(np.abs(row).max()), INT16_MAX - 1),
            choose_exponent(float(np.abs(row).sum()), INT32_MAX // 32768 - row.size),
        )
        exponent = min(limit, 40)
        rows[k] = np.round(row * 2.0**exponent).astype(np.int16)
        exponents[k] = exponent + 15
    return rows, exponents
