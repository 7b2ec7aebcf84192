"""A GRU whose forward pass is the chip's, bit for bit, and whose gradients are those of its floats.

Rounding has no useful gradient. Forwards the integers of `zerodrift.operations.gru` run, from the
quantized weights; backwards every rounding counts as the identity (straight-through), so that the
gradients are those of the float cell at the values that the integers took.
Source: Bengio, Leonard and Courville, "Estimating or propagating gradients through stochastic
neurons", 2013.

States are float64 tensors that hold h_q30 / 2^30 exactly; features are float32 tensors of int16
counts. Arrays run [time, channel, sequence].
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.operations.arithmetic import IntArray, round_shift
from zerodrift.operations.gru import FloatGru, IntegerGru
from zerodrift.train.networks import Network
from zerodrift.train.recurrence import Trace, propagate_back, sum_outer

Array = NDArray[np.float64]

Quantizer = Callable[[FloatGru], IntegerGru]
"""What turns the weights in training into those of the chip."""
STATE_ONE = 2.0**30


class IntegerHead:
    """The chip's linear output layer: int16 rows and the exponent of each row's sum."""

    def __init__(self, rows: NDArray[np.int16], exponents: NDArray[np.int64]) -> None:
        self.rows = rows.astype(np.float64)  # [K, H]
        self.scale = 2.0 ** -exponents.astype(np.float64)  # [K]


class IntegerGruNetwork(Network):
    """A GRU in training as the chip will run it; the head is held."""

    def __init__(
        self,
        gru: FloatGru,
        quantize: Quantizer,
        count: Array,
        head: IntegerHead,
        scale: Array,
    ) -> None:
        """Start from trained weights.

        Args:
            gru: the float weights; features in their own units.
            quantize: gives the chip's weights; what it raises ends the training.
            count: [I] a feature's value per count.
            head: the output layer.
            scale: [K] size of each output, by which the answers are divided.
        """
        super().__init__()
        self.reset = gru.reset
        self.w_x, self.w_h, self.bias = (
            torch.nn.Parameter(torch.from_numpy(w.astype(np.float32)))
            for w in (gru.w_x, gru.w_h, gru.bias)
        )
        self._quantize, self.head, self._scale = quantize, head, scale
        self._count = torch.from_numpy(count.astype(np.float32))

    def to_float(self) -> FloatGru:
        """Return the weights in training, as the float network's file will hold them."""
        w_x, w_h, bias = (
            w.detach().numpy().astype(np.float64) for w in (self.w_x, self.w_h, self.bias)
        )
        return FloatGru(w_x=w_x, w_h=w_h, bias=bias, reset=self.reset)

    def to_integer(self) -> IntegerGru:
        """Return the chip's weights."""
        return self._quantize(self.to_float())

    def forward(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the head's answer [T, K, B] over `scale`, and the states [T, H, B].

        Args:
            x: [T, I, B] counts of the features.
            state: [H, B] before the first sample.
        """
        integer = self.to_integer()
        states: Tensor = _IntegerSequence.apply(  # type: ignore[no-untyped-call]  # torch leaves apply untyped
            integer, self._count, x, state, self.w_x, self.w_h, self.bias
        )
        sums: Tensor = _IntegerHead.apply(self.head, states)  # type: ignore[no-untyped-call]  # as above
        weight = torch.from_numpy(self.head.scale / self._scale)
        return sums * weight[:, None], states

    def rest(self, x: Tensor) -> Tensor:
        """Return the state [H, B] that the chip's `settle` reaches under features x [I, B]."""
        counts = x.numpy().T.astype(np.int64)
        return _to_state(self.to_integer().settle(counts))

    def cold(self, batch: int) -> Tensor:
        """Return zeros [H, B]."""
        return torch.zeros(self.w_h.shape[1], batch, dtype=torch.float64)


def _to_state(h_q30: IntArray) -> Tensor:
    """Return integer states [B, H] as a tensor [H, B]; 31 bits fit a float64 exactly."""
    return torch.from_numpy(np.ascontiguousarray(h_q30.T / STATE_ONE))


def run_integers(gru: IntegerGru, x: IntArray, h_q30: IntArray) -> tuple[Trace, NDArray[Any]]:
    """Return what the backward pass needs, and the states [T, H, B] as exact float64.

    Args:
        gru: the chip's weights.
        x: [T, B, I] counts of the features.
        h_q30: [B, H] first state.
    """
    steps, batch, _ = x.shape
    hidden = gru.hidden
    exact = np.empty((steps + 1, hidden, batch))
    gates = np.empty((steps, 2 * hidden, batch), np.float32)
    candidate = np.empty((steps, hidden, batch), np.float32)
    product = np.empty((steps, hidden, batch), np.float32)
    product_scale = gru.inside_scale if gru.reset == "after" else 2.0**-15
    exact[0] = h_q30.T / STATE_ONE
    for t in range(steps):
        found = gru.gates(x[t], h_q30)
        gates[t, :hidden] = found.r_q31.T * 2.0**-31
        gates[t, hidden:] = found.u_q31.T * 2.0**-31
        candidate[t] = found.n_q30.T / STATE_ONE
        product[t] = found.product.T * product_scale
        h_q30 = gru.move(found, h_q30)
        exact[t + 1] = h_q30.T / STATE_ONE
    return Trace(exact.astype(np.float32), gates, candidate, product), exact[1:]


class _IntegerSequence(torch.autograd.Function):
    """The integer recurrence with the float cell's gradients."""

    @staticmethod
    def forward(
        ctx: Any, gru: IntegerGru, count: Tensor, x: Tensor, state: Tensor, *_: Tensor
    ) -> Tensor:
        """Run the recurrence; see `run_integers`. The float weights only take their gradients."""
        counts = np.ascontiguousarray(x.numpy().transpose(0, 2, 1)).astype(np.int64)
        h_q30 = np.ascontiguousarray((state.numpy() * STATE_ONE).T).astype(np.int64)
        trace, exact = run_integers(gru, counts, h_q30)
        ctx.trace, ctx.gru = trace, gru
        ctx.save_for_backward(x, count)
        return torch.from_numpy(exact)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of w_x, w_h and bias."""
        x, count = ctx.saved_tensors
        gru: IntegerGru = ctx.gru
        d_states = grads[0].float().contiguous().numpy()
        acting = torch.from_numpy(gru.dequantize_recurrent().astype(np.float32))
        outside, inside, _ = propagate_back(d_states, ctx.trace, acting, gru.reset)
        hidden = gru.hidden
        d_w_x = sum_outer(outside, x * count[:, None])
        d_bias = torch.zeros(4, hidden)
        d_bias[:3] = outside.sum((0, 2)).reshape(3, hidden)
        h = torch.from_numpy(ctx.trace.states[:-1])
        if gru.reset == "after":
            d_w_h = sum_outer(inside, h)
            d_bias[3] = inside[:, 2 * hidden :].sum((0, 2))
        else:
            reset_h = torch.from_numpy(ctx.trace.product)
            d_w_h = torch.cat(
                (
                    sum_outer(inside[:, : 2 * hidden], h),
                    sum_outer(inside[:, 2 * hidden :], reset_h),
                )
            )
        shape = (3, hidden, hidden)
        d_w_x = d_w_x.reshape(3, hidden, -1)
        return None, None, None, None, d_w_x, d_w_h.reshape(shape), d_bias


class _IntegerHead(torch.autograd.Function):
    """The chip's output sums, with the gradient of the unrounded ones."""

    @staticmethod
    def forward(ctx: Any, head: IntegerHead, states: Tensor) -> Tensor:
        """Return the sums [T, K, B] of states [T, H, B]."""
        h_q30 = (states.numpy() * STATE_ONE).astype(np.int64)
        ctx.head = head
        return torch.from_numpy(head.rows @ round_shift(h_q30, 15).astype(np.float64))

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[None, Tensor]:
        """Return the gradient of the states."""
        return None, torch.from_numpy(2.0**15 * ctx.head.rows.T) @ grads[0]
