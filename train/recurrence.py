"""The recurrence of the GRU over a whole batch of sequences, with gradients derived by hand.

Autograd over single steps spends its time on bookkeeping: for the small networks of a sensor a
hand-written backward pass is four to six times faster, and it serves both places of the reset gate.
The equations are those of `zerodrift.operations.gru`, gates in the order r, u, n:

    r = sigmoid(Wr x + Ur h + br)        u = sigmoid(Wu x + Uu h + bu)
    n = tanh(Wn x + bn + r * (Un h + cn))          reset "after"
    n = tanh(Wn x + bn + Un (r * h))               reset "before"
    h' = h + u * (n - h)

Arrays run [time, channel, sequence], so that the rows of one gate lie side by side in memory.
Matrix products are PyTorch's, which keeps to one thread and so to one order of summation; the
elementwise steps are NumPy's, whose calls cost a microsecond less.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array32 = NDArray[np.float32]


class GruWeights(NamedTuple):
    """Weights of a GRU as tensors, gates in the order r, u, n."""

    w_x: Tensor
    """[3, H, I] weights of the features."""
    w_h: Tensor
    """[3, H, H] weights of the state."""
    bias: Tensor
    """[4, H]: r, u, n outside the reset product, n inside it (unused for reset "before")."""


@dataclass(frozen=True)
class Trace:
    """What the forward pass leaves for the backward pass."""

    states: Array32
    """[T + 1, H, B] from the first state to the last."""
    gates: Array32
    """[T, 2 H, B]: r, then u."""
    candidate: Array32
    """[T, H, B]: n."""
    product: Array32
    """[T, H, B]: reset "after": Un h + cn; reset "before": r * h."""


def _sigmoid_in_place(x: Array32) -> None:
    """Replace x by sigmoid(x), through tanh, which NumPy vectorises and which cannot overflow."""
    x *= np.float32(0.5)
    np.tanh(x, out=x)
    x += np.float32(1.0)
    x *= np.float32(0.5)


def _run_forward(x: Tensor, h0: Tensor, weights: GruWeights, reset: str) -> Trace:
    w_x, w_h, bias = weights
    steps, _, batch = x.shape
    hidden = h0.shape[0]
    outside = torch.matmul(w_x.reshape(3 * hidden, -1), x)
    outside += bias[:3].reshape(3 * hidden, 1)
    a = outside.numpy()
    states_t = torch.empty(steps + 1, hidden, batch)
    states_t[0] = h0
    product_t = torch.empty(steps, hidden, batch)
    states, product = states_t.numpy(), product_t.numpy()
    gates = np.empty((steps, 2 * hidden, batch), np.float32)
    candidate = np.empty((steps, hidden, batch), np.float32)
    inside_bias = np.repeat(bias[3].numpy()[:, None], batch, axis=1)

    w_all = w_h.reshape(3 * hidden, hidden)
    w_gates, w_candidate = w_all[: 2 * hidden], w_all[2 * hidden :]
    recurrent_t = torch.empty(3 * hidden, batch)
    gate_part_t, candidate_part_t = recurrent_t[: 2 * hidden], recurrent_t[2 * hidden :]
    gate_part, candidate_part = gate_part_t.numpy(), candidate_part_t.numpy()

    after = reset == "after"
    for t, (h_t, p_t) in enumerate(zip(states_t.unbind(0), product_t.unbind(0), strict=False)):
        h, g, n, p = states[t], gates[t], candidate[t], product[t]
        if after:
            torch.mm(w_all, h_t, out=recurrent_t)
        else:
            torch.mm(w_gates, h_t, out=gate_part_t)
        np.add(a[t, : 2 * hidden], gate_part, out=g)
        _sigmoid_in_place(g)
        r, u = g[:hidden], g[hidden:]
        if after:
            np.add(candidate_part, inside_bias, out=p)
            np.multiply(r, p, out=n)
        else:
            np.multiply(r, h, out=p)
            torch.mm(w_candidate, p_t, out=candidate_part_t)
            n[...] = candidate_part
        n += a[t, 2 * hidden :]
        np.tanh(n, out=n)
        following = states[t + 1]
        np.subtract(n, h, out=following)
        following *= u
        following += h
    return Trace(states, gates, candidate, product)


def propagate_back(
    d_states: Array32, trace: Trace, w_h: Tensor, reset: str
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the gradients of the pre-activations, outside and inside the reset, and of h0.

    Args:
        d_states: [T, H, B] gradients of the states.
        trace: what the forward pass left.
        w_h: [3, H, H] recurrent weights that the forward pass acted with.
        reset: "after" or "before" the recurrent product.

    Returns:
        [T, 3 H, B], [T, 3 H, B], [H, B]. With reset "before" the second differs from the first
    nowhere and is the same tensor.
    """
    steps, hidden, batch = trace.candidate.shape
    r, u, n = trace.gates[:, :hidden], trace.gates[:, hidden:], trace.candidate
    h = trace.states[:-1]
    # d h' / d (pre-activation of n, u), and the slope of r, for all steps at once.
    slope_n = u * (1 - n * n)
    slope_u = (n - h) * (u * (1 - u))
    slope_r = r * (1 - r)
    keep = 1 - u
    after = reset == "after"
    slope_r *= trace.product if after else h

    d_outside_t = torch.empty(steps, 3 * hidden, batch)
    d_inside_t = torch.empty(steps, 3 * hidden, batch) if after else d_outside_t
    d_outside, d_inside = d_outside_t.numpy(), d_inside_t.numpy()
    dh = np.zeros((hidden, batch), np.float32)
    back_t = torch.empty(hidden, batch)
    back = back_t.numpy()
    w_all_t = w_h.reshape(3 * hidden, hidden).T.contiguous()
    w_gates_t, w_candidate_t = w_all_t[:, : 2 * hidden], w_all_t[:, 2 * hidden :]
    inside_steps = d_inside_t.unbind(0)
    for t in range(steps - 1, -1, -1):
        dh += d_states[t]
        d, v = d_outside[t], d_inside[t]
        d_n = d[2 * hidden :]
        np.multiply(dh, slope_n[t], out=d_n)
        np.multiply(dh, slope_u[t], out=d[hidden : 2 * hidden])
        dh *= keep[t]
        if after:
            np.multiply(d_n, slope_r[t], out=d[:hidden])
            v[: 2 * hidden] = d[: 2 * hidden]
            np.multiply(d_n, r[t], out=v[2 * hidden :])
            torch.mm(w_all_t, inside_steps[t], out=back_t)
        else:
            torch.mm(w_candidate_t, inside_steps[t][2 * hidden :], out=back_t)
            np.multiply(back, slope_r[t], out=d[:hidden])
            back *= r[t]
            dh += back
            torch.mm(w_gates_t, inside_steps[t][: 2 * hidden], out=back_t)
        dh += back
    return d_outside_t, d_inside_t, torch.from_numpy(dh)


def sum_outer(left: Tensor, right: Tensor) -> Tensor:
    """Return the sum over time and sequences of left [T, A, B] times right [T, C, B]: [A, C]."""
    return torch.matmul(left, right.transpose(1, 2)).sum(0)


class _GruSequence(torch.autograd.Function):
    """The recurrence as one differentiable operation."""

    @staticmethod
    def forward(ctx: Any, reset: str, x: Tensor, h0: Tensor, *weights: Tensor) -> Tensor:
        """Run the recurrence; see `run_gru`."""
        bundle = GruWeights(*weights)
        trace = _run_forward(x, h0, bundle, reset)
        ctx.trace, ctx.reset = trace, reset
        ctx.save_for_backward(x, bundle.w_x, bundle.w_h)
        return torch.from_numpy(trace.states[1:])

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of h0, w_x, w_h and bias; features are data and get none."""
        x, w_x, w_h = ctx.saved_tensors
        trace: Trace = ctx.trace
        d_states = grads[0].contiguous().numpy()
        d_outside, d_inside, d_h0 = propagate_back(d_states, trace, w_h, ctx.reset)
        hidden = w_h.shape[1]
        h = torch.from_numpy(trace.states[:-1])
        d_w_x = sum_outer(d_outside, x).reshape(w_x.shape)
        d_bias = torch.zeros(4, hidden)
        d_bias[:3] = d_outside.sum((0, 2)).reshape(3, hidden)
        if ctx.reset == "after":
            d_w_h = sum_outer(d_inside, h)
            d_bias[3] = d_inside[:, 2 * hidden :].sum((0, 2))
        else:
            reset_h = torch.from_numpy(trace.product)
            d_w_h = torch.cat(
                (
                    sum_outer(d_inside[:, : 2 * hidden], h),
                    sum_outer(d_inside[:, 2 * hidden :], reset_h),
                )
            )
        return None, None, d_h0, d_w_x, d_w_h.reshape(w_h.shape), d_bias


def run_gru(x: Tensor, h0: Tensor, weights: GruWeights, reset: str) -> Tensor:
    """Return the hidden states [T, H, B] of a GRU over B sequences, differentiable in all but x.

    Args:
        x: [T, I, B] features, float32.
        h0: [H, B] first state.
        weights: the GRU's weights.
        reset: "after" or "before" the recurrent product.
    """
    states: Tensor = _GruSequence.apply(reset, x, h0, *weights)  # type: ignore[no-untyped-call]  # torch leaves apply untyped
    return states
