"""The ONNX GRU operator and this project's GRU: the weights of one as those of the other.

ONNX orders the gates z, r, h; here they are r, u, n with u = 1 - z, so z changes its sign.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.config import MAX_HIDDEN
from zerodrift.operations.gru.cell import FloatGru

Attributes = Mapping[str, Any]
"""Of an ONNX node, by name."""
MAX_FEATURES = 256


def to_onnx_gates(gru: FloatGru) -> tuple[Array, Array, Array]:
    """Return W [3 H, I], R [3 H, H] and B [6 H] in ONNX's order z, r, h; z is 1 - u."""
    order, sign = (1, 0, 2), np.array([-1.0, 1.0, 1.0])
    w = sign[:, None, None] * gru.w_x[order, ...]
    r = sign[:, None, None] * gru.w_h[order, ...]
    outside = sign[:, None] * gru.bias[order, ...]
    inside = np.zeros_like(outside)
    if gru.reset == "after":
        inside[2] = gru.bias[3]
    hidden = gru.w_x.shape[1]
    b = np.concatenate([outside, inside]).reshape(6 * hidden)
    return w.reshape(3 * hidden, -1), r.reshape(3 * hidden, hidden), b


def from_onnx_gates(
    attributes: Attributes,
    w: NDArray[np.generic],
    r: NDArray[np.generic],
    b: NDArray[np.generic] | None,
) -> FloatGru:
    """Return the GRU of an ONNX GRU node.

    Args:
        attributes: the node's.
        w: [1, 3 H, I].
        r: [1, 3 H, H].
        b: [1, 6 H], or None for zeros.

    Raises:
        ValueError: another direction, other activations, clipping, or shapes that do not belong
            together; says what was found.
    """
    direction = attributes.get("direction", b"forward").decode()
    if direction != "forward":
        raise ValueError(f"it is {direction}; a sensor has only the past, so only forward is")
    activations = [a.decode().lower() for a in attributes.get("activations", [])]
    if activations and activations != ["sigmoid", "tanh"]:
        raise ValueError(f"it has the activations {activations}; sigmoid and tanh are supported")
    if attributes.get("clip"):
        raise ValueError("it clips its cells")
    if r.ndim != 3 or w.ndim != 3 or w.shape[0] != 1 or r.shape[0] != 1:
        raise ValueError(f"its weights have the shapes {w.shape} and {r.shape}")
    hidden, features = r.shape[2], w.shape[2]
    shapes = (w.shape[1:], r.shape[1:], (1, 6 * hidden) if b is None else b.shape)
    if shapes != ((3 * hidden, features), (3 * hidden, hidden), (1, 6 * hidden)):
        raise ValueError(f"its weights W, R, B have the shapes {shapes}, which do not fit together")
    if not (1 <= hidden <= MAX_HIDDEN and 1 <= features <= MAX_FEATURES):
        raise ValueError(
            f"it has {hidden} units on {features} features; up to {MAX_HIDDEN} each fit a chip"
        )
    bias = np.zeros(6 * hidden) if b is None else b[0].astype(np.float64)
    w_z, w_r, w_n = w[0].astype(np.float64).reshape(3, hidden, features)
    r_z, r_r, r_n = r[0].astype(np.float64).reshape(3, hidden, hidden)
    b_z, b_r, b_n, c_z, c_r, c_n = bias.reshape(6, hidden)
    after = bool(attributes.get("linear_before_reset", 0))
    return FloatGru(
        w_x=np.stack([w_r, -w_z, w_n]),
        w_h=np.stack([r_r, -r_z, r_n]),
        bias=np.stack(
            [
                b_r + c_r,
                -(b_z + c_z),
                b_n if after else b_n + c_n,
                c_n if after else np.zeros(hidden),
            ]
        ),
        reset="after" if after else "before",
    )
