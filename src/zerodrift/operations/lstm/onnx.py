"""The ONNX LSTM operator and this project's LSTM: the weights of one as those of the other.

ONNX orders the gates i, o, f, c; here they are i, f, g, o.
"""

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.config import MAX_HIDDEN
from zerodrift.operations.gru.onnx import MAX_FEATURES, Attributes
from zerodrift.operations.lstm.cell import FloatLstm

FROM_ONNX = (0, 2, 3, 1)
TO_ONNX = (0, 3, 1, 2)


def to_onnx_gates(lstm: FloatLstm) -> tuple[Array, Array, Array]:
    """Return W [4 H, I], R [4 H, H] and B [8 H] in ONNX's order i, o, f, c."""
    hidden = lstm.hidden
    w, r = (a[TO_ONNX, ...].reshape(4 * hidden, -1) for a in (lstm.w_x, lstm.w_h))
    return w, r, np.concatenate([lstm.bias[TO_ONNX, ...].ravel(), np.zeros(4 * hidden)])


def from_onnx_gates(
    attributes: Attributes,
    w: NDArray[np.generic],
    r: NDArray[np.generic],
    b: NDArray[np.generic] | None,
    p: NDArray[np.generic] | None = None,
) -> FloatLstm:
    """Return the LSTM of an ONNX LSTM node.

    Args:
        attributes: the node's.
        w: [1, 4 H, I].
        r: [1, 4 H, H].
        b: [1, 8 H], or None for zeros.
        p: [1, 3 H] peepholes, or None for zeros.

    Raises:
        ValueError: another direction, other activations, clipping, peepholes, coupled gates, or
            shapes that do not belong together; says what was found.
    """
    direction = attributes.get("direction", b"forward").decode()
    if direction != "forward":
        raise ValueError(f"it is {direction}; a sensor has only the past, so only forward is")
    activations = [a.decode().lower() for a in attributes.get("activations", [])]
    if activations and activations != ["sigmoid", "tanh", "tanh"]:
        raise ValueError(f"it has the activations {activations}; sigmoid, tanh, tanh are supported")
    if attributes.get("clip"):
        raise ValueError("it clips its cells")
    if attributes.get("input_forget"):
        raise ValueError("its input and forget gates are coupled (input_forget)")
    if p is not None and np.asarray(p, dtype=np.float64).any():
        raise ValueError("it has peepholes (input P); train it without")
    if r.ndim != 3 or w.ndim != 3 or w.shape[0] != 1 or r.shape[0] != 1:
        raise ValueError(f"its weights have the shapes {w.shape} and {r.shape}")
    hidden, features = r.shape[2], w.shape[2]
    shapes = (w.shape[1:], r.shape[1:], (1, 8 * hidden) if b is None else b.shape)
    if shapes != ((4 * hidden, features), (4 * hidden, hidden), (1, 8 * hidden)):
        raise ValueError(f"its weights W, R, B have the shapes {shapes}, which do not fit together")
    if not (1 <= hidden <= MAX_HIDDEN and 1 <= features <= MAX_FEATURES):
        raise ValueError(
            f"it has {hidden} units on {features} features; up to {MAX_HIDDEN} each fit a chip"
        )
    bias = np.zeros(8 * hidden) if b is None else b[0].astype(np.float64)
    outside, inside = bias.reshape(2, 4, hidden)
    return FloatLstm(
        w_x=w[0].astype(np.float64).reshape(4, hidden, features)[FROM_ONNX, ...],
        w_h=r[0].astype(np.float64).reshape(4, hidden, hidden)[FROM_ONNX, ...],
        bias=(outside + inside)[FROM_ONNX, ...],
    )
