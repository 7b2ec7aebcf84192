"""Runs as training sees them, and the two ways of walking through them: streams and windows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.train.networks import Network

Array32 = NDArray[np.float32]

WINDOWS_AT_ONCE = 4096
"""Windows that are predicted together: enough to keep the loop over time short."""


@dataclass(frozen=True)
class Sequence32:
    """One stretch of one run: what the network sees, and what it has to learn."""

    group: str
    features: Array32
    """[n, I]."""
    target: Array32
    """[n, K] drift that physics leaves, in multiples of each output's scale."""
    skip: int = 0
    """Samples at the start that a held-out sequence only passes through, without being judged."""

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.features.shape[0])


@dataclass(frozen=True)
class Batch:
    """Sequences of equal length that are trained on together."""

    features: Tensor
    """[T, I, B]."""
    state: Tensor
    """[H, B] before the first sample."""
    target: Tensor
    """[S, K, B] for the last S <= T samples."""
    weight: Tensor
    """[S, 1, B]: 1 for a sample that counts, 0 for one that only fills the shape."""
    run: NDArray[np.int64]
    """[B] index of the sequence that each comes from."""


class Course(Protocol):
    """A way of walking through the training sequences, one epoch at a time."""

    @property
    def batches_per_epoch(self) -> int:
        """Number of optimiser steps in an epoch."""
        ...

    def walk(self, network: Network, rng: np.random.Generator) -> Iterator[Batch]:
        """Yield the batches of one epoch."""
        ...

    def keep(self, batch: Batch, states: Tensor) -> None:
        """Take note of the states [T, H, B] that a batch went through."""
        ...

    def export_memory(self) -> dict[str, Array32]:
        """Return what the next epoch needs from this one, for a checkpoint."""
        ...

    def import_memory(self, memory: dict[str, Array32]) -> None:
        """Take back what `export_memory` returned."""
        ...


class StreamCourse:
    """Chunks of the runs, each starting from the state that the last epoch reached there.

    Back-propagation ends at the chunk's start; the state itself does not. Chunks are cut anew each
    epoch, so that no sample stays at an edge. Before its first sample a run is at rest.
    """

    def __init__(self, sequences: Sequence[Sequence32], chunk: int, batch: int) -> None:
        self._chunk, self._batch = chunk, batch
        longest = max(len(s) for s in sequences)
        padded = -(-longest // chunk) * chunk + 2 * chunk
        count = len(sequences)
        self._x = torch.zeros(padded, sequences[0].features.shape[1], count)
        self._target = torch.zeros(padded, sequences[0].target.shape[1], count)
        self._weight = torch.zeros(padded, 1, count)
        for j, s in enumerate(sequences):
            x = torch.from_numpy(s.features)
            end = chunk + len(s)
            self._x[:chunk, :, j] = x[0]
            self._x[chunk:end, :, j] = x
            self._x[end:, :, j] = x[-1]
            self._target[chunk:end, :, j] = torch.from_numpy(s.target)
            self._weight[chunk:end, 0, j] = 1.0
        self._lengths = [len(s) for s in sequences]
        self._states = torch.empty(0)
        self._place: tuple[Tensor, Tensor] | None = None

    @property
    def batches_per_epoch(self) -> int:
        """Number of optimiser steps in an epoch."""
        chunks = sum(-(-length // self._chunk) for length in self._lengths)
        return max(1, -(-chunks // self._batch))

    def walk(self, network: Network, rng: np.random.Generator) -> Iterator[Batch]:
        """Yield all chunks in random order."""
        chunk = self._chunk
        with torch.no_grad():
            rest = network.rest(self._x[0])
            if self._states.ndim == 1:
                # The first epoch starts from a pass through the whole runs.
                _, states = network(self._x[chunk:], rest)
                self._states = torch.cat((rest.expand(chunk + 1, -1, -1), states))
            self._states[: chunk + 1] = rest
        offset = int(rng.integers(1, chunk + 1))
        places = np.array(
            [
                (start, j)
                for j, length in enumerate(self._lengths)
                for start in range(offset, chunk + length, chunk)
            ]
        )
        places = places[rng.permutation(len(places))]
        for part in np.array_split(places, self.batches_per_epoch):
            start, run = torch.from_numpy(part[:, 0]), torch.from_numpy(part[:, 1])
            time = start[None] + torch.arange(chunk)[:, None]
            column = run[None].expand_as(time)
            self._place = (time, column)
            yield Batch(
                features=self._x[time, :, column].transpose(1, 2).contiguous(),
                state=self._states[start, :, run].T.contiguous(),
                target=self._target[time, :, column].transpose(1, 2),
                weight=self._weight[time, :, column].transpose(1, 2),
                run=part[:, 1],
            )

    def keep(self, batch: Batch, states: Tensor) -> None:
        """Store the states, from which the next epoch's chunks will start."""
        assert self._place is not None
        time, column = self._place
        self._states[time + 1, :, column] = states.detach().transpose(1, 2)

    def export_memory(self) -> dict[str, Array32]:
        """Return the states along all runs."""
        return {"states": self._states.numpy().copy()}

    def import_memory(self, memory: dict[str, Array32]) -> None:
        """Take back the states along all runs."""
        self._states = torch.from_numpy(memory["states"].copy())


class WindowCourse:
    """All windows of `memory` samples in random order; only the last sample of each is trained.

    Before its first sample a run is at rest: the window is filled with the first features.
    """

    def __init__(self, sequences: Sequence[Sequence32], memory: int, batch: int) -> None:
        self._batch = batch
        self._memory = memory
        self._x = torch.cat([torch.from_numpy(_pad_front(s.features, memory)) for s in sequences])
        self._target = torch.cat([torch.from_numpy(s.target) for s in sequences])
        self._run = np.repeat(np.arange(len(sequences)), [len(s) for s in sequences])
        # Row of self._x where the window of each sample starts.
        self._first = np.arange(self._run.size) + self._run * (memory - 1)

    @property
    def batches_per_epoch(self) -> int:
        """Number of optimiser steps in an epoch."""
        return max(1, -(-self._run.size // self._batch))

    def walk(self, network: Network, rng: np.random.Generator) -> Iterator[Batch]:
        """Yield all windows in random order."""
        order = rng.permutation(self._run.size)
        steps = torch.arange(self._memory)[:, None]
        for part in np.array_split(order, self.batches_per_epoch):
            rows = torch.from_numpy(self._first[part])[None] + steps
            yield Batch(
                features=self._x[rows].transpose(1, 2).contiguous(),
                state=network.cold(part.size),
                target=self._target[torch.from_numpy(part)].T[None],
                weight=torch.ones(1, 1, part.size),
                run=self._run[part],
            )

    def keep(self, batch: Batch, states: Tensor) -> None:
        """Forget the states: each window starts afresh."""

    def export_memory(self) -> dict[str, Array32]:
        """Return nothing: windows have no memory of the last epoch."""
        return {}

    def import_memory(self, memory: dict[str, Array32]) -> None:
        """Take back nothing."""


def predict_sequences(
    network: Network, features: Sequence[Array32], memory: str | int
) -> list[Array32]:
    """Return the network's answer [n, K] for each sequence of features [n, I].

    Args:
        network: the network, whose weights are not changed.
        features: whole runs, each from rest.
        memory: "stream", or the window's length.
    """
    with torch.no_grad():
        if memory == "stream":
            return _predict_streams(network, features)
        return [_predict_windows(network, x, int(memory)) for x in features]


def _predict_streams(network: Network, features: Sequence[Array32]) -> list[Array32]:
    longest = max(x.shape[0] for x in features)
    together = torch.zeros(longest, features[0].shape[1], len(features))
    for j, x in enumerate(features):
        together[: x.shape[0], :, j] = torch.from_numpy(x)
        together[x.shape[0] :, :, j] = torch.from_numpy(x[-1])
    drift, _ = network(together, network.rest(together[0]))
    return [drift[: x.shape[0], :, j].numpy() for j, x in enumerate(features)]


def _predict_windows(network: Network, features: Array32, memory: int) -> Array32:
    padded = torch.from_numpy(_pad_front(features, memory))
    windows = padded.unfold(0, memory, 1)  # [n, I, N]
    parts = []
    for part in torch.split(windows, WINDOWS_AT_ONCE):
        x = part.permute(2, 1, 0).contiguous()
        drift, _ = network(x, network.cold(x.shape[2]))
        parts.append(drift[-1].T)
    return np.asarray(torch.cat(parts).numpy())


def _pad_front(x: Array32, memory: int) -> Array32:
    """Return x [n, I] with its first row repeated in front, so that every sample has a window."""
    return np.concatenate([np.repeat(x[:1], memory - 1, axis=0), x])
