"""The recurrence of the LSTM, of many networks at once, with gradients derived by hand.

As `zerodrift.train.recurrence` does it for the GRU, with the equations of
`zerodrift.operations.lstm`, gates in the order i, f, g, o:

    i, f, o = sigmoid(W x + U h + b)     g = tanh(Wg x + Ug h + bg)
    c' = f c + i g                       h' = o tanh(c')

The state of a network is h beside c, [2 H].
"""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from zerodrift.operations.gru.cell import RELAX_STEPS
from zerodrift.operations.lstm.cell import SLOWEST
from zerodrift.train.recurrence import sum_outer


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
