"""Networks in float64, whoever trained them: layers in a row, or any that read others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.layer_norm import FloatLayerNorm
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.train.onnx_export import OnnxNetwork

# A network in float64 whose layers may read several others: recurrent and dense ones, a head.

STEPS_AT_ONCE = 10_000


Recurrent = FloatGru | FloatLstm
Still = FloatDense | FloatLayerNorm
"""A layer that carries nothing."""
Cell = Recurrent | Still

WINDOWS_AT_ONCE = 2_000


def width_of(cell: Cell) -> int:
    """Return how many numbers a layer gives."""
    if isinstance(cell, Still):
        return int(cell.bias.size)
    return int(cell.w_h.shape[1])


def carried_by(cell: Recurrent) -> int:
    """Return how many numbers a recurrent layer carries from step to step."""
    return width_of(cell) * (2 if isinstance(cell, FloatLstm) else 1)


@dataclass(frozen=True)
class FloatLayer:
    """One layer, and what it reads."""

    cell: Cell
    """Over the numbers of all that it reads, side by side."""
    reads: tuple[int, ...]
    """0 for the features, k for the k-th layer; in ascending order."""

    @property
    def recurrent(self) -> bool:
        """Whether it carries a state."""
        return not isinstance(self.cell, Still)


@dataclass(frozen=True)
class FloatLayeredNetwork:
    """Layers, each on some of those before it, and outputs = head x + head_bias."""

    inputs: int
    """Number of features I."""
    layers: tuple[FloatLayer, ...]
    reads: tuple[int, ...]
    """What the head reads, as in `FloatLayer`."""
    head: Array
    """[K, N] in output units."""
    head_bias: Array
    """[K] in output units."""
    trained: OnnxNetwork | None = None
    """The file that training left, where it is one of ours: its answers are asked of it."""

    def widths(self, reads: Sequence[int]) -> list[int]:
        """Return how many numbers each of some sources gives."""
        return [width_of(self.layers[k - 1].cell) if k else self.inputs for k in reads]

    def run(self, features: Array, states: Sequence[Array | None] | None = None) -> Array:
        """Return the outputs [B, T, K] for features [B, T, I], from states or else from zero.

        Args:
            features: [B, T, I].
            states: of each layer [B, carried], None for one without.
        """
        now = list(states) if states is not None else self.start(features.shape[0])
        parts = []
        for first in range(0, features.shape[1], STEPS_AT_ONCE):  # bounds the memory
            found = [features[:, first : first + STEPS_AT_ONCE]]
            for k, layer in enumerate(self.layers):
                x = gather(found, layer.reads)
                y, now[k] = run_layer(layer.cell, x, now[k])
                found.append(y)
            parts.append(gather(found, self.reads) @ self.head.T + self.head_bias)
        return np.concatenate(parts, axis=1)

    def start(self, batch: int) -> list[Array | None]:
        """Return states of zero."""
        return [
            None if isinstance(n.cell, Still) else np.zeros((batch, carried_by(n.cell)))
            for n in self.layers
        ]

    def settle(self, x: Array) -> list[Array | None]:
        """Return the states at rest under constant features x [B, I]."""
        found, states = [x], list[Array | None]()
        for layer in self.layers:
            given = gather(found, layer.reads)
            if isinstance(layer.cell, Still):
                states.append(None)
                found.append(layer.cell.step(given))
            else:
                state = layer.cell.settle(given)
                states.append(state)
                found.append(state[:, : width_of(layer.cell)])
        return states

    def answer(self, features: Array, window: int) -> Array:
        """Return the outputs [n, K] for features [n, I] of a run that starts at rest.

        Args:
            features: of the whole run.
            window: samples that each answer is from; 0 carries the state from sample to sample.
        """
        if self.trained is not None:
            return self.trained.run(features, window)
        return self.answer_from(features, window, {})

    def answer_from(self, features: Array, window: int, known: Mapping[int, Array]) -> Array:
        """Return the outputs [n, K] where what some layers give [n, M] is known beforehand.

        Args:
            features: [n, I] of a run that starts at rest.
            window: as in `answer`.
            known: layer, counted from 1 -> what it gives at every sample.
        """
        if not window and not known:
            return np.asarray(self.run(features[None], self.settle(features[:1]))[0])
        found: dict[int, Array] = {0: features}
        for k, layer in enumerate(self.layers, 1):
            if k in known:
                found[k] = known[k]
            elif not layer.recurrent:
                given = gather([found[i] for i in layer.reads])
                found[k], _ = run_layer(layer.cell, given[None], None)
                found[k] = found[k][0]
            elif window:
                found[k] = self._run_windows(k, found, window)
            else:
                assert not isinstance(layer.cell, Still)
                given = gather([found[i] for i in layer.reads])
                y, _ = run_layer(layer.cell, given[None], layer.cell.settle(given[:1]))
                found[k] = y[0]
        return np.asarray(gather([found[i] for i in self.reads]) @ self.head.T + self.head_bias)

    def run_windows(self, features: Array, length: int) -> Array:
        """Return the outputs [n, K] for features [n, I], each from zero over the last `length`."""
        return self.answer(features, length)

    def _run_windows(self, k: int, found: Mapping[int, Array], window: int) -> Array:
        """Return what a recurrent layer gives at the end of every sample's window [n, M]."""
        count = len(found[0])
        parts = []
        for first in range(0, count, WINDOWS_AT_ONCE):  # bounds the memory
            at = np.arange(first, min(first + WINDOWS_AT_ONCE, count))
            samples = np.maximum(at[:, None] + np.arange(1 - window, 1), 0)
            parts.append(self._walk(k, found, samples)[:, -1])
        return np.concatenate(parts)

    def _walk(self, k: int, found: Mapping[int, Array], samples: NDArray[np.int64]) -> Array:
        """Return what a layer gives over windows of samples [n, N] from zero, [n, N, M]."""
        if not k or not self.layers[k - 1].recurrent:
            return found[k][samples]
        layer = self.layers[k - 1]
        assert not isinstance(layer.cell, Still)
        given = gather([self._walk(i, found, samples) for i in layer.reads])
        return run_layer(layer.cell, given, np.zeros((len(samples), carried_by(layer.cell))))[0]

    def rescale_inputs(self, center: Array, scale: Array) -> "FloatLayeredNetwork":
        """Return the same network for features (x - center) / scale in place of x."""
        layers = tuple(
            replace(n, cell=_rescale(n.cell, center, scale)) if 0 in n.reads else n
            for n in self.layers
        )
        head, bias = self.head.copy(), self.head_bias
        if 0 in self.reads:  # they stand first
            bias = bias + head[:, : self.inputs] @ center
            head[:, : self.inputs] *= scale
        return replace(self, layers=layers, head=head, head_bias=bias, trained=None)

    def list_arrays(self) -> list[tuple[str, Array]]:
        """Return all weights and biases by name."""
        named = [("head", self.head), ("head bias", self.head_bias)]
        for k, layer in enumerate(self.layers):
            cell = layer.cell
            if isinstance(cell, FloatDense):
                named.append((f"layer {k}", np.column_stack([cell.weight, cell.bias])))
            elif isinstance(cell, FloatLayerNorm):
                named.append((f"layer {k}", np.column_stack([cell.gain, cell.bias])))
            else:
                kind = "GRU" if isinstance(cell, FloatGru) else "LSTM"
                named += [(f"{kind} {k} {n}", getattr(cell, n)) for n in ("w_x", "w_h", "bias")]
        return named


def gather(found: Sequence[Array], reads: Sequence[int] | None = None) -> Array:
    """Return some sources' numbers side by side."""
    parts = list(found) if reads is None else [found[k] for k in reads]
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)


def run_layer(cell: Cell, x: Array, state: Array | None) -> tuple[Array, Array | None]:
    """Return what a layer gives [B, T, M] for x [B, T, N], and its last state."""
    if isinstance(cell, Still):
        return cell.step(x), None
    assert state is not None
    if isinstance(cell, FloatGru):
        y = cell.run(x, state)
        return y, y[:, -1]
    return cell.run(x, state)


def _rescale(cell: Cell, center: Array, scale: Array) -> Cell:
    """Return a layer whose first numbers are (x - center) / scale in place of x."""
    count = center.size
    if isinstance(cell, FloatLayerNorm):
        raise TypeError("a layer normalisation reads a layer, not the features")
    if isinstance(cell, FloatDense):
        weight = cell.weight.copy()
        bias = cell.bias + weight[:, :count] @ center
        weight[:, :count] *= scale
        return replace(cell, weight=weight, bias=bias)
    w_x, bias = cell.w_x.copy(), cell.bias.copy()
    bias[: len(w_x)] += w_x[..., :count] @ center
    w_x[..., :count] *= scale
    return replace(cell, w_x=w_x, bias=bias)


# A recurrent network in float64, whoever trained it: GRUs, dense layers, a linear head.


@dataclass(frozen=True)
class FloatNetwork:
    """GRUs on top of each other, dense layers, and outputs = head x + head_bias."""

    gru: FloatGru
    """The layer that reads the features."""
    head: Array
    """[K, N] in output units."""
    head_bias: Array
    """[K] in output units."""
    upper: tuple[FloatGru, ...] = ()
    """Further layers, each on the state of the one before it."""
    dense: tuple[FloatDense, ...] = ()
    """Between the topmost state and the head."""
    trained: OnnxNetwork | None = None
    """The file that training left, where it is one of ours: its answers are asked of it."""

    @property
    def inputs(self) -> int:
        """Number of features I."""
        return int(self.gru.w_x.shape[2])

    def list_arrays(self) -> list[tuple[str, Array]]:
        """Return all weights and biases by name."""
        named = [("head", self.head), ("head bias", self.head_bias)]
        for k, gru in enumerate(self.layers):
            named += [(f"GRU {k} {name}", getattr(gru, name)) for name in ("w_x", "w_h", "bias")]
        for k, layer in enumerate(self.dense):
            named.append((f"dense layer {k}", np.column_stack([layer.weight, layer.bias])))
        return named

    @property
    def layers(self) -> tuple[FloatGru, ...]:
        """All recurrent layers from the bottom up."""
        return (self.gru, *self.upper)

    def with_layers(self, layers: Sequence[FloatGru]) -> "FloatNetwork":
        """Return the network with other recurrent layers."""
        return replace(self, gru=layers[0], upper=tuple(layers[1:]), trained=None)

    def start(self, batch: int) -> list[Array]:
        """Return states of zero, [B, H] each."""
        return [np.zeros((batch, layer.w_h.shape[1])) for layer in self.layers]

    def settle(self, x: Array) -> list[Array]:
        """Return the states at rest under constant features x [B, I]."""
        states = []
        for layer in self.layers:
            x = layer.settle(x)
            states.append(x)
        return states

    def step(self, x: Array, states: Sequence[Array]) -> list[Array]:
        """Return the states after features x [B, I]."""
        after = []
        for layer, state in zip(self.layers, states, strict=True):
            x = layer.step(x, state)
            after.append(x)
        return after

    def read_out(self, top: Array) -> Array:
        """Return the outputs [..., K] for the topmost state [..., H]."""
        for layer in self.dense:
            top = layer.step(top)
        return np.asarray(top @ self.head.T + self.head_bias)

    def run(self, features: Array, states: Sequence[Array] | None = None) -> Array:
        """Return the outputs [B, T, K] for features [B, T, I], from states or else from zero."""
        now = list(states) if states is not None else self.start(features.shape[0])
        parts = []
        for first in range(0, features.shape[1], STEPS_AT_ONCE):  # bounds the memory
            x = features[:, first : first + STEPS_AT_ONCE]
            for i, layer in enumerate(self.layers):
                x = layer.run(x, now[i])
                now[i] = x[:, -1]
            parts.append(self.read_out(x))
        return np.concatenate(parts, axis=1)

    def answer(self, features: Array, window: int) -> Array:
        """Return the outputs [n, K] for features [n, I] of a run that starts at rest.

        Args:
            features: of the whole run.
            window: samples that each answer is from; 0 carries the state from sample to sample.
        """
        if self.trained is not None:
            return self.trained.run(features, window)
        if window:
            return self.run_windows(features, window)
        return np.asarray(self.run(features[None], self.settle(features[:1]))[0])

    def run_windows(self, features: Array, length: int) -> Array:
        """Return the outputs [n, K] for features [n, I], each from zero over the last `length`.

        Before the first sample the features are taken to have been what they are there.
        """
        padded = np.concatenate([np.repeat(features[:1], length - 1, axis=0), features])
        windows = np.lib.stride_tricks.sliding_window_view(padded, length, axis=0)  # [n, I, N]
        now = self.start(len(features))
        for t in range(length):
            now = self.step(windows[:, :, t], now)
        return self.read_out(now[-1])

    def rescale_inputs(self, center: Array, scale: Array) -> "FloatNetwork":
        """Return the same network for features (x - center) / scale in place of x."""
        gru = self.gru
        bias = gru.bias.copy()
        bias[:3] += gru.w_x @ center
        return FloatNetwork(
            FloatGru(gru.w_x * scale, gru.w_h, bias, gru.reset),
            self.head,
            self.head_bias,
            self.upper,
            self.dense,
        )
