"""Formats for a layer normalisation, the finest that are provably safe."""

import math

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import CheckError
from zerodrift.operations.arithmetic import INT16_MAX, choose_exponent
from zerodrift.operations.dense import COPY_BITS
from zerodrift.operations.layer_norm import (
    EPSILON_LIMIT,
    MOST_WIDTH,
    PART_BITS,
    RAISED_BITS,
    FloatLayerNorm,
    IntegerLayerNorm,
)

GAIN_LIMIT = 2**30
SHIFT_LIMIT = 62
FINEST = 24
"""Most fractional bits of a copy: those of a layer that gives next to nothing."""
Exponents = NDArray[np.int64]


def quantize_layer_norm(
    layer: FloatLayerNorm, name: str, source: str, exponents: Exponents
) -> tuple[IntegerLayerNorm, Exponents]:
    """Return a layer normalisation with the finest formats that are provably safe.

    Args:
        layer: float gain and bias.
        name: of the node.
        source: name of the layer's node that it reads.
        exponents: [M] f with input = int16 copy * 2**-f.

    Returns:
        The node, and [M] the exponents of its own int16 copies.

    Raises:
        CheckError: too wide, not finite, without a positive epsilon, or no scale is safe.
    """
    width = layer.gain.size
    if width > MOST_WIDTH:
        raise CheckError(
            f"{name}: normalises {width} values; up to {MOST_WIDTH} can be. Train a narrower layer."
        )
    if not (np.isfinite(layer.gain).all() and np.isfinite(layer.bias).all()):
        raise CheckError(f"{name}: a gain or bias is not finite; the model is refused")
    if not 0.0 < layer.epsilon < math.inf:
        raise CheckError(
            f"{name}: epsilon is {layer.epsilon:g}; expected one above 0, since equal values would"
            " be divided by 0. Train with the usual 1e-5."
        )
    common = int(exponents.min()) + RAISED_BITS
    while width * layer.epsilon * 4.0**common > EPSILON_LIMIT:
        common -= 1
    align = exponents + RAISED_BITS - common
    if align.max() > SHIFT_LIMIT:
        raise CheckError(
            f"{name}: its values have scales {int(np.ptp(exponents))} bits apart, or epsilon"
            f" {layer.epsilon:g} is far above their squares; the model is refused."
        )
    gains, biases, shifts = [], [], []
    own = np.zeros(width, dtype=np.int64)
    for i, (gain, bias) in enumerate(zip(layer.gain, layer.bias, strict=True)):
        largest = abs(float(gain)) * math.sqrt(width) + abs(float(bias))
        of_gain = choose_exponent(abs(float(gain)), GAIN_LIMIT)
        finest = choose_exponent(largest, INT16_MAX - 1)
        own[i] = min(finest, FINEST, of_gain + PART_BITS - COPY_BITS)
        of_gain = min(of_gain, int(own[i]) + COPY_BITS - PART_BITS + SHIFT_LIMIT)
        gains.append(round(float(gain) * 2.0**of_gain))
        biases.append(round(float(bias) * 2.0 ** float(own[i] + COPY_BITS)))
        shifts.append(PART_BITS + of_gain - int(own[i]) - COPY_BITS)
    node = IntegerLayerNorm(
        name=name,
        inputs=(source,),
        align=tuple(int(a) for a in align),
        gain=np.array(gains, dtype=np.int32),
        shift=tuple(shifts),
        bias=np.array(biases, dtype=np.int32),
        epsilon=max(1, round(width * layer.epsilon * 4.0**common)),
    )
    return node, own
