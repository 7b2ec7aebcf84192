"""The recurrence of GRU and LSTM, of many networks at once, with gradients derived by hand.

Every array has the networks as one more axis, [time, network, channel, sequence]; one network is a
batch of one. Autograd over single steps spends its time on bookkeeping: for the small networks of a
sensor a hand-written backward pass is four to six times faster, and it serves both places of the
reset gate. The GRU's equations are those of `zerodrift.operations.gru`, gates in the order r, u, n:

    r = sigmoid(Wr x + Ur h + br)        u = sigmoid(Wu x + Uu h + bu)
    n = tanh(Wn x + bn + r * (Un h + cn))          reset "after"
    n = tanh(Wn x + bn + Un (r * h))               reset "before"
    h' = h + u * (n - h)

All steps are PyTorch's, so that they run wherever the tensors are.
"""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from zerodrift.operations.lstm.cell import SLOWEST
from zerodrift.operations.recurrent import RELAX_STEPS


@dataclass(frozen=True)
class GruWeights:
    """Weights of S GRUs as tensors, gates in the order r, u, n."""

    w_x: Tensor
    """[S, 3 H, I] weights of the features."""
    w_h: Tensor
    """[S, 3 H, H] weights of the state."""
    bias: Tensor
    """[S, 4, H]: r, u, n outside the reset product, n inside it (unused for reset "before")."""
    reset: str
    """"after" or "before" the recurrent product."""

    @property
    def hidden(self) -> int:
        """Number of hidden units H."""
        return int(self.w_h.shape[2])


@dataclass(frozen=True)
class GruTrace:
    """What the forward pass leaves for the backward pass."""

    states: Tensor
    """[T + 1, S, H, B] from the first state to the last."""
    gates: Tensor
    """[T, S, 2 H, B]: r, then u."""
    candidate: Tensor
    """[T, S, H, B]: n."""
    product: Tensor
    """[T, S, H, B]: reset "after": Un h + cn; reset "before": r * h."""


def run_forward(x: Tensor, h0: Tensor, weights: GruWeights) -> GruTrace:
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
    return GruTrace(states, gates, candidate, product)


@dataclass(frozen=True)
class GruGradients:
    """Gradients of a GRU's weights, and of what its gates read."""

    w_x: Tensor
    """[S, 3 H, I]."""
    w_h: Tensor
    """[S, 3 H, H]."""
    bias: Tensor
    """[S, 4, H]."""
    outside: Tensor
    """[T, S, 3 H, B] of the sums that the features enter."""


def run_backward(d_states: Tensor, x: Tensor, trace: GruTrace, weights: GruWeights) -> GruGradients:
    """Return the gradients of the weights.

    Args:
        d_states: [T, S, H, B] gradients of the states.
        x: [T, S, I, B] features.
        trace: what the forward pass left.
        weights: what it acted with; w_x is not read.
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
    return GruGradients(d_w_x, d_w_h, d_bias, d_outside)


def sum_outer(left: Tensor, right: Tensor) -> Tensor:
    """Return the sum over time and sequences of [T, S, A, B] times [T, S, C, B]: [S, A, C]."""
    return torch.matmul(left, right.transpose(2, 3)).sum(0)


class _Context(Protocol):
    """Where autograd keeps what `forward` leaves for `backward`."""

    trace: GruTrace
    reset: str
    saved_tensors: tuple[Tensor, ...]

    def save_for_backward(self, *tensors: Tensor) -> None:
        """Keep tensors."""


class _GruSequence(torch.autograd.Function):
    """The recurrence as one differentiable operation."""

    @staticmethod
    def forward(
        ctx: _Context, reset: str, x: Tensor, h0: Tensor, w_x: Tensor, w_h: Tensor, bias: Tensor
    ) -> Tensor:
        """Run the recurrence; see `run_gru`."""
        ctx.trace, ctx.reset = run_forward(x, h0, GruWeights(w_x, w_h, bias, reset)), reset
        ctx.save_for_backward(x, w_x, w_h, bias)
        return ctx.trace.states[1:]

    @staticmethod
    def backward(ctx: _Context, *grads: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of w_x, w_h and bias; features and first states are data."""
        x, w_x, w_h, bias = ctx.saved_tensors
        found = run_backward(grads[0], x, ctx.trace, GruWeights(w_x, w_h, bias, ctx.reset))
        return None, None, None, found.w_x, found.w_h, found.bias


def run_gru(x: Tensor, h0: Tensor, weights: GruWeights) -> Tensor:
    """Return the states [T, S, H, B] of S GRUs over B sequences, differentiable in the weights.

    Args:
        x: [T, S, I, B] features.
        h0: [S, H, B] first states.
        weights: of the S networks.
    """
    w_x, w_h, bias = weights.w_x, weights.w_h, weights.bias
    states: Tensor = _GruSequence.apply(weights.reset, x, h0, w_x, w_h, bias)  # type: ignore[no-untyped-call]  # torch leaves apply untyped
    return states


def settle(x: Tensor, weights: GruWeights) -> Tensor:
    """Return the states at rest [S, H, B] under constant features x [S, I, B], float64 inside.

    The relaxation is that of the chip's `settle`.
    """
    with torch.no_grad():
        hidden = weights.hidden
        w_x, w_h, bias = (w.double() for w in (weights.w_x, weights.w_h, weights.bias))
        kept = torch.ones(4, 1, dtype=torch.float64, device=x.device)
        kept[1] = 0.0  # the update gate is sigmoid(0) = 1/2
        rows = kept[:3].repeat_interleave(hidden, dim=0)
        held = GruWeights(w_x * rows, w_h * rows, bias * kept, weights.reset)
        start = x.new_zeros(len(x), hidden, x.shape[2], dtype=torch.float64)
        steady = x.double().expand(RELAX_STEPS, -1, -1, -1)
        return run_forward(steady, start, held).states[-1].to(x.dtype)


# The recurrence of the LSTM, of many networks at once, with gradients derived by hand.
#
# As `zerodrift.train.recurrence` does it for the GRU, with the equations of
# `zerodrift.operations.lstm`, gates in the order i, f, g, o:
#
#     i, f, o = sigmoid(W x + U h + b)     g = tanh(Wg x + Ug h + bg)
#     c' = f c + i g                       h' = o tanh(c')
#
# The state of a network is h beside c, [2 H].


@dataclass(frozen=True)
class LstmWeights:
    """Weights of S LSTMs as tensors, gates in the order i, f, g, o."""

    w_x: Tensor
    """[S, 4 H, I] weights of the features."""
    w_h: Tensor
    """[S, 4 H, H] weights of the output before."""
    bias: Tensor
    """[S, 4, H]."""


@dataclass(frozen=True)
class LstmTrace:
    """What the forward pass leaves for the backward pass."""

    states: Tensor
    """[T + 1, S, 2 H, B]: h beside c, from the first state to the last."""
    gates: Tensor
    """[T, S, 4 H, B]: i, f, g, o."""
    bend: Tensor
    """[T, S, H, B]: tanh of c after each step."""


def run_lstm_forward(
    x: Tensor, start: Tensor, weights: LstmWeights, relaxing: bool = False
) -> LstmTrace:
    """Return all states of S LSTMs over B sequences each.

    Args:
        x: [T, S, I, B] features.
        start: [S, 2 H, B] first states.
        weights: of the S networks.
        relaxing: towards rest under constant features, rather than in time.
    """
    steps, sensors, _, batch = x.shape
    hidden = int(weights.w_h.shape[2])
    outside = torch.matmul(weights.w_x, x)
    outside += weights.bias.reshape(sensors, 4 * hidden, 1)
    states = x.new_empty(steps + 1, sensors, 2 * hidden, batch)
    states[0] = start
    gates = x.new_empty(steps, sensors, 4 * hidden, batch)
    bend = x.new_empty(steps, sensors, hidden, batch)
    for t in range(steps):
        h, c = states[t, :, :hidden], states[t, :, hidden:]
        a = gates[t]
        torch.baddbmm(outside[t], weights.w_h, h, out=a)
        i, f, g, o = a.chunk(4, dim=1)
        a[:, : 2 * hidden].sigmoid_()
        g.tanh_()
        o.sigmoid_()
        after = states[t + 1, :, hidden:]
        if relaxing:
            forget = 1.0 - f
            doublings = torch.clamp(torch.ceil(-torch.log2(forget)) - 1.0, 0.0, SLOWEST)
            after.copy_(c + torch.exp2(doublings - 1.0) * (i * g - forget * c))
        else:
            torch.mul(f, c, out=after)
            after.addcmul_(i, g)
        torch.tanh(after, out=bend[t])
        torch.mul(o, bend[t], out=states[t + 1, :, :hidden])
    return LstmTrace(states, gates, bend)


def run_lstm_backward(
    d_states: Tensor, x: Tensor, trace: LstmTrace, weights: LstmWeights
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the gradients of w_x, w_h and bias.

    Args:
        d_states: [T, S, 2 H, B] gradients of the states.
        x: [T, S, I, B] features.
        trace: what the forward pass left.
        weights: what it acted with; w_x is not read.
    """
    steps, sensors, hidden, batch = trace.bend.shape
    d_gates = torch.empty_like(trace.gates)
    w_h_t = weights.w_h.transpose(1, 2).contiguous()
    d_h, d_c = (x.new_zeros(sensors, hidden, batch) for _ in range(2))
    for t in range(steps - 1, -1, -1):
        i, f, g, o = trace.gates[t].chunk(4, dim=1)
        d_i, d_f, d_g, d_o = d_gates[t].chunk(4, dim=1)
        c, bend = trace.states[t, :, hidden:], trace.bend[t]
        d_h = d_h + d_states[t, :, :hidden]
        d_c = d_c + d_states[t, :, hidden:] + d_h * o * (1.0 - bend * bend)
        d_o.copy_(d_h * bend * o * (1.0 - o))
        d_i.copy_(d_c * g * i * (1.0 - i))
        d_f.copy_(d_c * c * f * (1.0 - f))
        d_g.copy_(d_c * i * (1.0 - g * g))
        d_c = d_c * f
        d_h = torch.bmm(w_h_t, d_gates[t])
    d_bias = d_gates.sum((0, 3)).reshape(sensors, 4, hidden)
    return sum_outer(d_gates, x), sum_outer(d_gates, trace.states[:-1, :, :hidden]), d_bias


class _LstmContext(Protocol):
    """Where autograd keeps what `forward` leaves for `backward`."""

    trace: LstmTrace
    saved_tensors: tuple[Tensor, ...]

    def save_for_backward(self, *tensors: Tensor) -> None:
        """Keep tensors."""


class _LstmSequence(torch.autograd.Function):
    """The recurrence as one differentiable operation."""

    @staticmethod
    def forward(
        ctx: _LstmContext, x: Tensor, start: Tensor, w_x: Tensor, w_h: Tensor, bias: Tensor
    ) -> Tensor:
        """Run the recurrence; see `run_lstm`."""
        ctx.trace = run_lstm_forward(x, start, LstmWeights(w_x, w_h, bias))
        ctx.save_for_backward(x, w_x, w_h, bias)
        return ctx.trace.states[1:]

    @staticmethod
    def backward(ctx: _LstmContext, *grads: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of w_x, w_h and bias; features and first states are data."""
        x, w_x, w_h, bias = ctx.saved_tensors
        found = run_lstm_backward(grads[0], x, ctx.trace, LstmWeights(w_x, w_h, bias))
        return None, None, *found


def run_lstm(x: Tensor, start: Tensor, weights: LstmWeights) -> Tensor:
    """Return the states [T, S, 2 H, B] of S LSTMs over B sequences, differentiable in the weights.

    Args:
        x: [T, S, I, B] features.
        start: [S, 2 H, B] first states.
        weights: of the S networks.
    """
    states: Tensor = _LstmSequence.apply(x, start, weights.w_x, weights.w_h, weights.bias)  # type: ignore[no-untyped-call]  # torch leaves apply untyped
    return states


def settle_lstm(x: Tensor, weights: LstmWeights) -> Tensor:
    """Return the states at rest [S, 2 H, B] under constant features x [S, I, B], float64 inside.

    The relaxation is that of the chip's `settle`.
    """
    with torch.no_grad():
        w_x, w_h, bias = (w.double() for w in (weights.w_x, weights.w_h, weights.bias))
        held = LstmWeights(w_x, w_h, bias)
        start = x.new_zeros(len(x), 2 * w_h.shape[2], x.shape[2], dtype=torch.float64)
        steady = x.double().expand(RELAX_STEPS, -1, -1, -1)
        return run_lstm_forward(steady, start, held, relaxing=True).states[-1].to(x.dtype)
