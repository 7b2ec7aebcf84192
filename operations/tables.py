"""The one activation table: tanh by 513 nodes with lines between them; sigmoid from the same.

Input of tanh is `t_q16`, a 20-bit signed number in Q3.16, so that the table spans -8 .. 8; sigmoid
reads the same table at half its argument and so spans -16 .. 16. The interpolated value keeps all
of its bits: Q0.26 for tanh, Q0.27 for sigmoid.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.arithmetic import IntArray, saturate

Int32Array = NDArray[np.int32]

NODES = 513
STEP_BITS = 11  # 2**11 inputs between two nodes
T_MAX = 2**19 - 1
T_MIN = -(2**19)
_CANDIDATES = np.arange(-1, 2)


@cache
def tanh_nodes() -> NDArray[np.int16]:
    """Return the 513 nodes in Q0.15, odd-symmetric and monotone.

    A chord of tanh lies on one side of the curve, so nodes on the curve would be biased. The nodes
    minimise the eighth power of the *interpolated* curve's error (nearly the worst error), chosen
    jointly by dynamic programming over integer candidates around the pointwise best value.

    Limits: worst error of the interpolated tanh 2.04 LSB of Q0.15, of the sigmoid 1.02.
    """
    half = (NODES - 1) // 2
    positions = np.arange(half + 1) / 32.0
    curve = np.tanh(positions)
    bend = -2.0 * curve * (1.0 - curve**2)  # second derivative of tanh
    ideal = (curve - bend / 32.0**2 / 16.0) * 2.0**15
    base = np.minimum(np.floor(ideal + 0.5), 32767).astype(np.int64)
    fractions = (np.arange(64) + 0.5) / 64.0
    best: NDArray[np.float64] = np.where(_CANDIDATES == 0, 0.0, np.inf)  # tanh(0) = 0 exactly
    choices = np.zeros((half + 1, _CANDIDATES.size), dtype=np.int64)
    base[0] = 0
    for i in range(half):
        left = np.minimum(base[i] + _CANDIDATES, 32767)
        right = np.minimum(base[i + 1] + _CANDIDATES, 32767)
        truth = np.tanh((i + fractions) / 32.0) * 2.0**15
        chord = left[:, None, None] + (right - left[:, None])[:, :, None] * fractions
        cost = ((chord - truth) ** 8).sum(axis=2) + best[:, None]
        cost = np.where(right[None, :] >= left[:, None], cost, np.inf)  # monotone
        choices[i + 1] = cost.argmin(axis=0)
        best = cost.min(axis=0)
    pick = int(best.argmin())
    positive = np.empty(half + 1, dtype=np.int64)
    for i in range(half, -1, -1):
        positive[i] = min(int(base[i] + _CANDIDATES[pick]), 32767)
        pick = int(choices[i][pick])
    return np.concatenate([-positive[:0:-1], positive]).astype(np.int16)


@cache
def _starts_and_slopes() -> tuple[Int32Array, Int32Array]:
    """Return the left node of each of the 512 intervals in Q0.26, and its rise in Q0.15."""
    nodes = tanh_nodes().astype(np.int32)
    return nodes[:-1] << STEP_BITS, np.diff(nodes)


def tanh_q26(t_q16: NDArray[np.int32] | IntArray) -> Int32Array:
    """Return tanh(t) in Q0.26 for t in Q3.16, saturating outside -8 .. 8.

    No rounding takes place, hence tanh_q26(-t) = -tanh_q26(t) exactly.
    """
    starts, slopes = _starts_and_slopes()
    position = saturate(t_q16, T_MIN, T_MAX).astype(np.int32, copy=False) - T_MIN
    index = position >> STEP_BITS
    fraction = position & (2**STEP_BITS - 1)
    # 0 <= index < 512 by the saturation above; mode "clip" only leaves out numpy's own check
    return np.asarray(starts.take(index, mode="clip") + slopes.take(index, mode="clip") * fraction)


def sigmoid_q27(half_t_q16: NDArray[np.int32] | IntArray) -> Int32Array:
    """Return sigmoid(2 t) = (1 + tanh(t)) / 2 in Q0.27 for t in Q3.16.

    Limits: between 2**11 and 2**27 - 2**11; sigmoid_q27(-t) = 2**27 - sigmoid_q27(t) exactly.
    """
    return np.asarray((1 << 26) + tanh_q26(half_t_q16))
