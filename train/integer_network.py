"""GRUs whose forward pass is the chip's, bit for bit, and whose gradients are those of floats.

Rounding has no useful gradient. Forwards the integers of `zerodrift.operations.gru` run, from the
quantized weights; backwards every rounding counts as the identity (straight-through), so that the
gradients are those of the float cell at the values that the integers took.
Source: Bengio, Leonard and Courville, "Estimating or propagating gradients through stochastic
neurons", 2013.

States are float64 tensors that hold h_q30 / 2^30 exactly; features are float32 tensors of int16
counts. Arrays run [time, channel, sequence].
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import InputError
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.dense import COPY_BITS, IntegerDense
from zerodrift.operations.gru.cell import FloatGru, IntegerGru
from zerodrift.train.attempts import Problem
from zerodrift.train.engine import train_networks
from zerodrift.train.networks import Network, Parameters, read_array
from zerodrift.train.recurrence import GruTrace, GruWeights, run_backward
from zerodrift.train.sequences import Sequence32
from zerodrift.train.settings import Settings, Tuning

Quantizer = Callable[[Sequence[FloatGru]], Sequence[IntegerGru]]
"""What turns the weights in training into those of the chip, layer by layer from the bottom."""
STATE_ONE = 2.0**30
COPY_ONE = 2.0**15


class TorchIntegerHead:
    """The chip's linear output layer: int16 rows and the exponent of each row's sum."""

    def __init__(self, rows: NDArray[np.int16], exponents: IntArray) -> None:
        self.rows = rows.astype(np.float64)  # [K, H]
        self.scale = 2.0 ** -exponents.astype(np.float64)  # [K]


class IntegerGruNetwork(Network):
    """GRUs in training as the chip will run them; dense layers and head are held.

    The state [H, B] is that of all layers one after the other, the one that reads the features
    first.
    """

    state_type = torch.float64

    def __init__(
        self,
        layers: Sequence[FloatGru],
        quantize: Quantizer,
        count: Array,
        head: TorchIntegerHead,
        scale: Array,
        dense: Sequence[IntegerDense] = (),
    ) -> None:
        """Start from trained weights.

        Args:
            layers: the float weights from the bottom up; features in their own units.
            quantize: gives the chip's weights; what it raises ends the training.
            count: [I] a feature's value per count.
            head: the output layer.
            scale: [K] size of each output, by which the answers are divided.
            dense: layers between the topmost state and the head.
        """
        super().__init__()
        self.resets = [layer.reset for layer in layers]
        self.hidden = [layer.w_h.shape[1] for layer in layers]
        self.w_x, self.w_h, self.bias = (
            torch.nn.ParameterList(
                torch.nn.Parameter(torch.from_numpy(getattr(layer, name).astype(np.float32)))
                for layer in layers
            )
            for name in ("w_x", "w_h", "bias")
        )
        self._quantize, self.head, self._scale = quantize, head, scale
        self._dense = tuple(dense)
        self._counts = [torch.from_numpy(count.astype(np.float32))]
        self._counts += [torch.full((n,), 1.0 / COPY_ONE) for n in self.hidden[:-1]]

    @property
    def width(self) -> int:
        """Width of the states of all layers."""
        return sum(self.hidden)

    def to_float(self) -> tuple[FloatGru, ...]:
        """Return the weights in training, as the float network's file will hold them."""
        parts = [map(read_array, weights) for weights in (self.w_x, self.w_h, self.bias)]
        return tuple(
            FloatGru(w_x, w_h, bias, reset)
            for w_x, w_h, bias, reset in zip(*parts, self.resets, strict=True)
        )

    def to_integer(self) -> Sequence[IntegerGru]:
        """Return the chip's weights."""
        return self._quantize(self.to_float())

    def run_many(self, parameters: Parameters, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return drift and states of S networks, one after the other; see `Network`."""
        found = [
            torch.func.functional_call(
                self, {name: p[i] for name, p in parameters.items()}, (x[:, i], state[i])
            )
            for i in range(len(state))
        ]
        drift, states = zip(*found, strict=True)
        return torch.stack(drift, dim=1), torch.stack(states, dim=1)

    def rest_many(self, parameters: Parameters, x: Tensor) -> Tensor:
        """Return the states at rest of S networks, one after the other; see `Network`."""
        found = []
        for i, features in enumerate(x):
            network = copy.deepcopy(self)
            network.load_state_dict({name: p[i] for name, p in parameters.items()})
            found.append(network.rest(features))
        return torch.stack(found)

    def forward(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the head's answer [T, K, B] over `scale`, and the states [T, H, B].

        Args:
            x: [T, I, B] counts of the features.
            state: [H, B] before the first sample.
        """
        integers = self.to_integer()
        states: list[Tensor] = []
        for i, before in enumerate(torch.split(state, self.hidden)):
            if states:
                x = _StateCopy.apply(states[-1])  # type: ignore[no-untyped-call]  # torch leaves apply untyped
            states.append(
                _IntegerSequence.apply(  # type: ignore[no-untyped-call]  # as above
                    integers[i],
                    self._counts[i],
                    x,
                    before.contiguous(),
                    self.w_x[i],
                    self.w_h[i],
                    self.bias[i],
                )
            )
        results: Tensor = states[-1] * STATE_ONE
        for layer in self._dense:
            results = _IntegerDense.apply(layer, results)  # type: ignore[no-untyped-call]  # as above
        sums: Tensor = _IntegerHead.apply(self.head, results)  # type: ignore[no-untyped-call]  # as above
        weight = torch.from_numpy(self.head.scale / self._scale)
        return sums * weight[:, None], torch.cat(states, dim=1)

    def rest(self, x: Tensor) -> Tensor:
        """Return the state [H, B] that the chip's `settle` reaches under features x [I, B]."""
        counts, states = x.numpy().T.astype(np.int64), []
        for layer in self.to_integer():
            h_q30 = layer.settle(counts)
            states.append(torch.from_numpy(np.ascontiguousarray(h_q30.T / STATE_ONE)))
            counts = round_shift(h_q30, COPY_BITS)
        return torch.cat(states)


def run_integers(gru: IntegerGru, x: IntArray, h_q30: IntArray) -> tuple[GruTrace, Array]:
    """Return what the backward pass needs of one network, and the states [T, H, B] in float64.

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
    arrays = (exact.astype(np.float32), gates, candidate, product)
    return GruTrace(*(torch.from_numpy(a)[:, None] for a in arrays)), exact[1:]


class _IntegerContext(Protocol):
    """Where autograd keeps what `forward` of one of the functions below leaves for `backward`."""

    trace: GruTrace
    gru: IntegerGru
    layer: IntegerDense
    head: TorchIntegerHead
    results: Array
    saved_tensors: tuple[Tensor, ...]
    needs_input_grad: tuple[bool, ...]

    def save_for_backward(self, *tensors: Tensor) -> None:
        """Keep tensors."""


class _IntegerSequence(torch.autograd.Function):
    """The integer recurrence with the float cell's gradients."""

    @staticmethod
    def forward(
        ctx: _IntegerContext,
        gru: IntegerGru,
        count: Tensor,
        x: Tensor,
        state: Tensor,
        *weights: Tensor,
    ) -> Tensor:
        """Run the recurrence; see `run_integers`. The float weights only take their gradients."""
        counts = np.ascontiguousarray(x.numpy().transpose(0, 2, 1)).astype(np.int64)
        h_q30 = np.ascontiguousarray((state.numpy() * STATE_ONE).T).astype(np.int64)
        trace, exact = run_integers(gru, counts, h_q30)
        ctx.trace, ctx.gru = trace, gru
        ctx.save_for_backward(x, count, weights[0])
        return torch.from_numpy(exact)

    @staticmethod
    def backward(ctx: _IntegerContext, *grads: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of w_x, w_h and bias, and of x where a layer is below."""
        x, count, w_x = ctx.saved_tensors
        acting = torch.from_numpy(ctx.gru.dequantize_recurrent().astype(np.float32))
        acting, read = acting.flatten(0, 1)[None], w_x.flatten(0, 1)[None]
        weights = GruWeights(read, acting, torch.empty(0), ctx.gru.reset)
        d_states = grads[0].float().contiguous()
        found = run_backward(d_states[:, None], (x * count[:, None])[:, None], ctx.trace, weights)
        d_x = None
        if ctx.needs_input_grad[2]:
            d_x = torch.matmul(weights.w_x[0].T, found.outside[:, 0]) * count[:, None]
        d_w_x, d_w_h = found.w_x.view(w_x.shape), found.w_h.view(3, -1, ctx.gru.hidden)
        return None, None, d_x, None, d_w_x, d_w_h, found.bias[0]


class _StateCopy(torch.autograd.Function):
    """The int16 copy of a layer's states that the layer above reads, as float32 counts."""

    @staticmethod
    def forward(ctx: _IntegerContext, states: Tensor) -> Tensor:
        """Return the counts [T, H, B] of states [T, H, B]."""
        h_q30 = (states.numpy() * STATE_ONE).astype(np.int64)
        return torch.from_numpy(round_shift(h_q30, COPY_BITS).astype(np.float32))

    @staticmethod
    def backward(ctx: _IntegerContext, *grads: Tensor) -> Tensor:
        """Return the gradient of the states."""
        return grads[0].double() * COPY_ONE


class _IntegerDense(torch.autograd.Function):
    """A dense layer of the chip, with the gradient of the unrounded one."""

    @staticmethod
    def forward(ctx: _IntegerContext, layer: IntegerDense, below: Tensor) -> Tensor:
        """Return the layer's results [T, M, B] for results [T, N, B] of the one below."""
        steps, width, batch = below.shape
        flat = below.numpy().transpose(0, 2, 1).reshape(-1, width).astype(np.int64)
        _, found = layer.step({}, {layer.inputs[0]: flat})
        results = found.reshape(steps, batch, -1).transpose(0, 2, 1).astype(np.float64)
        ctx.layer, ctx.results = layer, results
        return torch.from_numpy(np.ascontiguousarray(results))

    @staticmethod
    def backward(ctx: _IntegerContext, *grads: Tensor) -> tuple[None, Tensor]:
        """Return the gradient of the results below."""
        layer, results = ctx.layer, ctx.results
        gain = 2.0 ** -np.array(layer.shift, dtype=np.float64)  # of the results per sum's count
        if layer.activation == "tanh":  # results in Q1.30 of a table's argument in Q3.16
            slope = (1.0 - (results / STATE_ONE) ** 2) * (STATE_ONE / COPY_ONE / 2.0**16)
        else:
            low, high = (np.array(x)[:, None] * COPY_ONE for x in (layer.low, layer.high))
            slope = ((results > low) & (results < high)).astype(np.float64)
        d_sums = grads[0].numpy() * slope * gain[:, None]
        return None, torch.from_numpy(layer.weights.astype(np.float64).T) @ torch.from_numpy(d_sums)


class _IntegerHead(torch.autograd.Function):
    """The chip's output sums, with the gradient of the unrounded ones."""

    @staticmethod
    def forward(ctx: _IntegerContext, head: TorchIntegerHead, results: Tensor) -> Tensor:
        """Return the sums [T, K, B] of results [T, H, B], which hold integers."""
        ctx.head = head
        copies = round_shift(results.numpy().astype(np.int64), COPY_BITS)
        return torch.from_numpy(head.rows @ copies.astype(np.float64))

    @staticmethod
    def backward(ctx: _IntegerContext, *grads: Tensor) -> tuple[None, Tensor]:
        """Return the gradient of the results."""
        return None, torch.from_numpy(ctx.head.rows.T / COPY_ONE) @ grads[0]


# A short training of trained GRUs in the chip's own arithmetic, for coarse weights.
#
# The integer network learns to answer as the float one does, over the training runs' features as
# the chip computes them. What the float network has learnt from the measurements is not learnt
# again, so that noise, tares and held-out runs have no part in it.


@dataclass(frozen=True)
class Tuned:
    """What a fine-tuning gave."""

    layers: tuple[FloatGru, ...]
    """Weights whose quantized form answers best, from the bottom up; the first ones if no other did
    better."""
    before: float
    """RMS difference from the float network before, in shares of the float network's answer."""
    after: float
    epoch: int
    """0: the first weights were kept."""


def fine_tune(
    network: IntegerGruNetwork,
    sequences: Sequence[Sequence32],
    memory: str | int,
    settings: Tuning | None = None,
    report: Callable[[float, float], None] = lambda done, rms: None,
) -> Tuned:
    """Train an integer network towards the targets; the same inputs give the same weights.

    Args:
        network: starts from trained weights, and is changed.
        sequences: features in counts, targets from the float network in the network's scale.
        memory: "stream", or the window's length in samples.
        settings: the recipe.
        report: is told the share that is done and the difference so far.
    """
    s = settings or Tuning()
    recipe = Settings(
        memory=memory,
        seed=s.seed,
        starts=(0,),
        epochs=s.epochs,
        learning_rate=s.learning_rate,
        weight_decay=0.0,
        chunk=s.chunk,
        batch=s.batch,
        warm_up=s.warm_up,
        evaluations=s.evaluations,
    )
    problem = Problem(lambda _: network, sequences, sequences, recipe)
    (found,) = train_networks([problem], report=lambda p: report(p.done, p.best_rmse))
    if isinstance(found, InputError):
        raise found
    network.load_state_dict({k: torch.from_numpy(v) for k, v in found.weights.items()})
    return Tuned(network.to_float(), found.rmse_without, found.rmse, found.epoch)
