"""A network in float64, whoever trained it: layers that read others, and a linear head."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.layer_norm import FloatLayerNorm
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.train.onnx_export import OnnxNetwork

STEPS_AT_ONCE = 2_000


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


def inputs_of(cell: Cell) -> int:
    """Return how many numbers a layer reads."""
    if isinstance(cell, FloatLayerNorm):
        return width_of(cell)
    return int((cell.weight if isinstance(cell, FloatDense) else cell.w_x).shape[-1])


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
class FloatNetwork:
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

    @classmethod
    def stack(cls, cells: Sequence[Cell], head: Array, head_bias: Array) -> "FloatNetwork":
        """Return a network of layers on top of each other, the first on the features."""
        layers = tuple(FloatLayer(cell, (k,)) for k, cell in enumerate(cells))
        return cls(inputs_of(cells[0]), layers, (len(layers),), head, head_bias)

    @property
    def grus(self) -> tuple[FloatGru, ...]:
        """The recurrent layers from the bottom up, where it is a `chain` that begins with GRUs."""
        cells = (layer.cell for layer in self.layers if self.is_chain)
        return tuple(cell for cell in cells if isinstance(cell, FloatGru))

    @property
    def is_chain(self) -> bool:
        """Whether it is GRUs, if any, below dense layers, if any, below the head."""
        straight = [*(n.reads for n in self.layers), self.reads] == [
            (k,) for k in range(len(self.layers) + 1)
        ]
        kinds = [type(layer.cell) for layer in self.layers]
        grus = kinds.count(FloatGru)
        return straight and kinds == [FloatGru] * grus + [FloatDense] * (len(kinds) - grus)

    def replace_grus(self, grus: Sequence[FloatGru]) -> "FloatNetwork":
        """Return the network with other recurrent layers in the place of `grus`."""
        cells = (*grus, *(layer.cell for layer in self.layers[len(grus) :]))
        return FloatNetwork.stack(cells, self.head, self.head_bias)

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
        found: dict[int, Array] = {0: features, **known}
        for k in self._list_below(self.reads, found):
            layer = self.layers[k - 1]
            if not layer.recurrent:
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

    def _list_below(self, reads: Sequence[int], known: Mapping[int, Array]) -> list[int]:
        """Return the layers that some sources need, the lowest first, those known apart."""
        needed, left = set[int](), list(reads)
        while left:
            k = left.pop()
            if k not in known and k not in needed:
                needed.add(k)
                left += self.layers[k - 1].reads
        return sorted(needed)

    def _run_windows(self, k: int, found: Mapping[int, Array], window: int) -> Array:
        """Return what a recurrent layer gives at the end of every sample's window [n, M]."""
        count = len(found[0])
        parts = []
        for first in range(0, count, WINDOWS_AT_ONCE):  # bounds the memory
            at = np.arange(first, min(first + WINDOWS_AT_ONCE, count))
            samples = np.maximum(at[:, None] + np.arange(1 - window, 1), 0)
            parts.append(self._walk(k, found, samples)[:, -1])
        return np.concatenate(parts)

    def _walk(self, k: int, found: Mapping[int, Array], samples: IntArray) -> Array:
        """Return what a layer gives over windows of samples [n, N] from zero, [n, N, M]."""
        if not k or not self.layers[k - 1].recurrent:
            return found[k][samples]
        layer = self.layers[k - 1]
        assert not isinstance(layer.cell, Still)
        given = gather([self._walk(i, found, samples) for i in layer.reads])
        return run_layer(layer.cell, given, np.zeros((len(samples), carried_by(layer.cell))))[0]

    def rescale_inputs(self, center: Array, scale: Array) -> "FloatNetwork":
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
