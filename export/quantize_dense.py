"""Formats for a dense layer, the finest that are provably safe."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN, INT32_MAX, choose_exponent
from zerodrift.operations.dense import COPY_BITS, FloatDense, IntegerDense, IntegerFeatureDense
from zerodrift.operations.intervals import Interval
from zerodrift.operations.tables import TABLE_BITS

SHIFT_LIMIT = 30
Exponents = NDArray[np.int64]


def quantize_dense(
    layer: FloatDense,
    name: str,
    source: str,
    exponents: Exponents,
    inputs: Sequence[Interval],
    of_features: bool = False,
) -> tuple[IntegerDense, Exponents]:
    """Return a dense layer with the finest formats that are provably safe.

    A row of "clip" keeps the largest result that its inputs can give, so that int16 never
    saturates where the float layer would not.

    Args:
        layer: float weights.
        name: of the node.
        source: name of the node that it reads.
        exponents: [N] f with input = int16 copy * 2**-f.
        inputs: [N] range of the int16 copies.
        of_features: whether the layer reads the features themselves.

    Returns:
        The node, and [M] the exponents of its own int16 copies.

    Raises:
        CheckError: not finite, or no scale is safe.
    """
    if not (np.isfinite(layer.weight).all() and np.isfinite(layer.bias).all()):
        raise CheckError(f"{name}: a weight or bias is not finite; the model is refused")
    count = layer.weight.shape[0]
    rows = np.zeros(layer.weight.shape, dtype=np.int16)
    bias = np.zeros(count, dtype=np.int32)
    shifts, lows, highs = [], [], []
    own = np.full(count, COPY_BITS)
    magnitudes = np.array([x.magnitude for x in inputs], dtype=np.float64)
    for i in range(count):
        scaled = layer.weight[i] * 2.0 ** -exponents.astype(np.float64)
        reach = float(np.abs(scaled) @ magnitudes) + abs(float(layer.bias[i]))
        # the half of the shift, and half a unit of rounding per weight, beside the sum itself
        spare = int(magnitudes.sum()) // 2 + (1 << SHIFT_LIMIT >> 1)
        exponent = min(
            choose_exponent(float(np.abs(scaled).max()), INT16_MAX),
            choose_exponent(reach, INT32_MAX - spare) if spare < INT32_MAX else -1,
        )
        if layer.activation == "tanh":
            exponent = min(exponent, TABLE_BITS + SHIFT_LIMIT)
            shift = exponent - TABLE_BITS
        else:
            largest = min(reach, max(abs(layer.low), abs(layer.high)))
            own[i] = min(choose_exponent(largest, INT16_MAX), exponent)
            exponent = min(exponent, int(own[i]) + SHIFT_LIMIT)
            shift = exponent - int(own[i])
        if shift < 0:
            raise CheckError(
                f"{name}, row {i}: weights that reach {reach:.3g} leave no safe 32-bit format;"
                " the model is refused. Train with weight decay or clip that row."
            )
        rows[i] = np.round(scaled * 2.0**exponent)
        bias[i] = round(float(layer.bias[i]) * 2.0**exponent) + (1 << shift >> 1)
        shifts.append(shift)
        if layer.activation == "clip":
            unit = 2.0 ** float(own[i])
            lows.append(int(np.clip(np.round(layer.low * unit), INT16_MIN, INT16_MAX)))
            highs.append(int(np.clip(np.round(layer.high * unit), INT16_MIN, INT16_MAX)))
    node = (IntegerFeatureDense if of_features else IntegerDense)(
        name=name,
        inputs=(source,),
        weights=rows,
        bias=bias,
        shift=tuple(shifts),
        activation=layer.activation,
        low=tuple(lows),
        high=tuple(highs),
    )
    return node, own
