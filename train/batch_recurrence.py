"""The recurrence of many GRUs at once, each with its own weights, with gradients derived by hand.

The equations and the order of the gates are those of `zerodrift.train.recurrence`; here every array
has the sensors as one more axis, [time, sensor, channel, sequence], and the products over it are
batched. All steps are PyTorch's, so that they run wherever the tensors are.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from zerodrift.operations.gru.cell import RELAX_STEPS


@dataclass(frozen=True)
class BatchWeights:
    """Weights of S GRUs and their heads, gates in the order r, u, n."""

    w_x: Tensor
    """[S, 3 H, I] weights of the features."""
    w_h: Tensor
    """[S, 3 H, H] weights of the state."""
    bias: Tensor
    """[S, 4, H]: r, u, n outside the reset product, n inside it (unused for reset "before")."""
    head: Tensor
    """[S, K, H]."""
    head_bias: Tensor
    """[S, K]."""
    reset: str
    """"after" or "before" the recurrent product."""

    @property
    def hidden(self) -> int:
        """Number of hidden units H."""
        return int(self.w_h.shape[2])

    def take(self, part: slice) -> "BatchWeights":
        """Return the weights of some of the GRUs."""
        return BatchWeights(
            self.w_x[part],
            self.w_h[part],
            self.bias[part],
            self.head[part],
            self.head_bias[part],
            self.reset,
        )


@dataclass(frozen=True)
class BatchTrace:
    """What the forward pass leaves for the backward pass."""

    states: Tensor
    """[T + 1, S, H, B] from the first state to the last."""
    gates: Tensor
    """[T, S, 2 H, B]: r, then u."""
    candidate: Tensor
    """[T, S, H, B]: n."""
    product: Tensor
    """[T, S, H, B]: reset "after": Un h + cn; reset "before": r * h."""


def run_forward(x: Tensor, h0: Tensor, weights: BatchWeights) -> BatchTrace:
    """Return all states of S GRUs over B sequences each.

    Args:
        x: [T, S, I, B] features.
        h0: [S, H, B] first states.
        weights: of the S networks.
    """
    steps, sensors, _, batch = x.shape
    hidden = weights.hidden
    outside = torch.matmul(weights.w_x, x)
    outside += weights.bias[:, :3].reshape(sensors, 3 * hidden, 1)
    a_gates, a_candidate = outside[:, :, : 2 * hidden], outside[:, :, 2 * hidden :]
    states = x.new_empty(steps + 1, sensors, hidden, batch)
    states[0] = h0
    gates = x.new_empty(steps, sensors, 2 * hidden, batch)
    candidate = x.new_empty(steps, sensors, hidden, batch)
    product = x.new_empty(steps, sensors, hidden, batch)
    w_gates, w_candidate = weights.w_h[:, : 2 * hidden], weights.w_h[:, 2 * hidden :]
    inside = weights.bias[:, 3, :, None].expand(sensors, hidden, batch)
    after = weights.reset == "after"
    for t in range(steps):
        h, g, n, p = states[t], gates[t], candidate[t], product[t]
        torch.baddbmm(a_gates[t], w_gates, h, out=g)
        g.sigmoid_()
        r, u = g[:, :hidden], g[:, hidden:]
        if after:
            torch.baddbmm(inside, w_candidate, h, out=p)
            torch.addcmul(a_candidate[t], r, p, out=n)
        else:
            torch.mul(r, h, out=p)
            torch.baddbmm(a_candidate[t], w_candidate, p, out=n)
        n.tanh_()
        torch.lerp(h, n, u, out=states[t + 1])
    return BatchTrace(states, gates, candidate, product)


def run_backward(
    d_states: Tensor, x: Tensor, trace: BatchTrace, weights: BatchWeights
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the gradients of w_x [S, 3 H, I], w_h [S, 3 H, H] and bias [S, 4, H].

    Args:
        d_states: [T, S, H, B] gradients of the states.
        x: [T, S, I, B] features.
        trace: what the forward pass left.
        weights: what it acted with.
    """
    steps, sensors, hidden, batch = trace.candidate.shape
    after = weights.reset == "after"
    d_outside = x.new_empty(steps, sensors, 3 * hidden, batch)
    d_inside = x.new_empty(steps, sensors, hidden, batch)  # of the candidate's product
    w_gates_t = weights.w_h[:, : 2 * hidden].transpose(1, 2).contiguous()
    w_candidate_t = weights.w_h[:, 2 * hidden :].transpose(1, 2).contiguous()
    dh, moved, rest = (x.new_zeros(sensors, hidden, batch) for _ in range(3))
    for t in range(steps - 1, -1, -1):
        h, n, p = trace.states[t], trace.candidate[t], trace.product[t]
        r, u = trace.gates[t, :, :hidden], trace.gates[t, :, hidden:]
        d, v = d_outside[t], d_inside[t]
        d_r, d_u, d_n = d[:, :hidden], d[:, hidden : 2 * hidden], d[:, 2 * hidden :]
        dh += d_states[t]
        torch.mul(dh, u, out=moved)
        dh -= moved
        # d_n = dh u (1 - n n), d_u = dh (n - h) u (1 - u)
        torch.mul(moved, n, out=rest)
        torch.addcmul(moved, rest, n, value=-1.0, out=d_n)
        torch.sub(n, h, out=rest)
        rest *= moved
        torch.addcmul(rest, rest, u, value=-1.0, out=d_u)
        if after:
            # v = d_n r, d_r = v p (1 - r)
            torch.mul(d_n, r, out=v)
            torch.mul(v, p, out=rest)
            torch.addcmul(rest, rest, r, value=-1.0, out=d_r)
            dh.baddbmm_(w_candidate_t, v)
        else:
            # v = d_n; back = Un' d_n, d_r = back h r (1 - r)
            v.copy_(d_n)
            back = torch.bmm(w_candidate_t, d_n)
            back *= r
            torch.mul(back, h, out=rest)
            torch.addcmul(rest, rest, r, value=-1.0, out=d_r)
            dh += back
        dh.baddbmm_(w_gates_t, d[:, : 2 * hidden])
    h = trace.states[:-1]
    d_w_x = sum_outer(d_outside, x)
    d_w_h = torch.cat(
        (
            sum_outer(d_outside[:, :, : 2 * hidden], h),
            sum_outer(d_inside, h if after else trace.product),
        ),
        dim=1,
    )
    d_bias = x.new_zeros(sensors, 4, hidden)
    d_bias[:, :3] = d_outside.sum((0, 3)).reshape(sensors, 3, hidden)
    if after:
        d_bias[:, 3] = d_inside.sum((0, 3))
    return d_w_x, d_w_h, d_bias


def sum_outer(left: Tensor, right: Tensor) -> Tensor:
    """Return the sum over time and sequences of [T, S, A, B] times [T, S, C, B]: [S, A, C]."""
    return torch.matmul(left, right.transpose(2, 3)).sum(0)


def settle(x: Tensor, weights: BatchWeights) -> Tensor:
    """Return the states at rest [S, H, B] under constant features x [S, I, B], float64 inside.

    The relaxation is that of the chip's `settle`.
    """
    hidden = weights.hidden
    w_x, w_h, bias = weights.w_x.double(), weights.w_h.double(), weights.bias.double()
    outside = torch.matmul(w_x, x.double()) + bias[:, :3].reshape(len(x), 3 * hidden, 1)
    a_r, a_n = outside[:, :hidden], outside[:, 2 * hidden :]
    w_r, w_n = w_h[:, :hidden], w_h[:, 2 * hidden :]
    h = x.new_zeros(len(x), hidden, x.shape[2], dtype=torch.float64)
    for _ in range(RELAX_STEPS):
        r = torch.sigmoid(a_r + torch.bmm(w_r, h))
        if weights.reset == "after":
            n = torch.tanh(a_n + r * (torch.bmm(w_n, h) + bias[:, 3, :, None]))
        else:
            n = torch.tanh(a_n + torch.bmm(w_n, r * h))
        h = h + 0.5 * (n - h)
    return h.to(x.dtype)
