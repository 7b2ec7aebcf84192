"""The two orders in which many networks go through their training runs: streams and windows.

For each step of the optimiser and each network a course returns sequences of equal length.
Arrays run [time, network, channel, sequence].
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from zerodrift.base.arrays import IntArray, Mask
from zerodrift.train.attempts import Attempt, Problem, Stored
from zerodrift.train.networks import Network, Parameters
from zerodrift.train.sequences import Sequence32

STEPS_AT_ONCE = 512
"""Whole runs are walked through in pieces of this many samples, which bounds the memory."""


class Runs:
    """The sequences of all sensors as one array, the ends of shorter ones filled."""

    def __init__(
        self, uses: Sequence[Sequence[Sequence32]], front: int, back: int, device: str
    ) -> None:
        """Lay the sequences out.

        Args:
            uses: those of each sensor; who has fewer features than others has zeros for the rest.
            front: samples at rest in front of each.
            back: samples behind the longest.
            device: where the arrays go.
        """
        self.lengths = [[len(s) for s in use] for use in uses]
        self.count = max(map(len, uses))
        self.length = front + max(map(max, self.lengths)) + back
        shape = (len(uses), self.count, self.length)
        width = max(use[0].features.shape[1] for use in uses)
        x = np.zeros((*shape, width), np.float32)
        target = np.zeros((*shape, uses[0][0].target.shape[1]), np.float32)
        weight = np.zeros((*shape, 1), np.float32)
        group = np.zeros(shape[:2], np.int64)
        self.groups = [list(dict.fromkeys(s.group for s in use)) for use in uses]
        for i, use in enumerate(uses):
            for j, s in enumerate(use):
                own, end = s.features.shape[1], front + len(s)
                x[i, j, :front, :own] = s.features[0]
                x[i, j, front:end, :own] = s.features
                x[i, j, end:, :own] = s.features[-1]
                target[i, j, front:end] = s.target
                weight[i, j, front + s.skip : end] = 1.0
                group[i, j] = self.groups[i].index(s.group)
        self.x, self.target, self.weight, self.group = (
            torch.from_numpy(a).to(device) for a in (x, target, weight, group)
        )


@dataclass(frozen=True)
class Batch:
    """Sequences of some networks, B each, that they are trained on together."""

    features: Tensor
    """[T, A, I, B]."""
    state: Tensor
    """[A, H, B] before the first sample."""
    target: Tensor
    """[S, A, K, B] for the last S <= T samples."""
    weight: Tensor
    """[S, A, 1, B]: 1 for a sample that counts, 0 for one that only fills the shape."""
    group: Tensor
    """[A, B] group of the run that each sequence comes from."""


class Course(ABC):
    """An order in which several attempts go through their training sequences, epoch by epoch."""

    def __init__(
        self, problems: Sequence[Problem], owner: IntArray, front: int, device: str
    ) -> None:
        """Lay out the runs.

        Args:
            problems: those of the attempts.
            owner: [A] which problem each attempt is of.
            front: samples at rest in front of each run.
            device: where the arrays go.
        """
        self._settings, self._device, self._owner = problems[0].settings, device, owner
        chunk = self._settings.chunk
        self.runs = Runs([p.sequences for p in problems], front, chunk, device)
        self._owner_t = torch.from_numpy(owner).to(device)
        self._slots: list[list[IntArray]] = []
        """Of each attempt, what its batches of this epoch are made of."""

    def start_epoch(
        self, attempts: Sequence[Attempt], active: Sequence[int], parameters: Parameters
    ) -> None:
        """Shuffle the sequences of those that are active.

        Args:
            attempts: all of them.
            active: which walk through an epoch.
            parameters: of all networks, as they are now.
        """
        self._slots = [[] for _ in attempts]
        for i in active:
            a = attempts[i]
            rng = np.random.default_rng((self._settings.seed, a.start, a.epoch))
            self._slots[i] = np.array_split(self._shuffle(i, rng), a.batches)

    def find_moving(self, number: int) -> list[bool]:
        """Return for each attempt whether it has a batch of this number."""
        return [number < len(slots) for slots in self._slots]

    def _gather_slots(self, number: int, part: slice) -> tuple[IntArray, Mask] | None:
        """Return the slots [A, B] of a batch and which are filled; None if none is."""
        mine = [slots[number] if number < len(slots) else () for slots in self._slots[part]]
        most = max(map(len, mine), default=0)
        if most == 0:
            return None
        found, filled = np.zeros((len(mine), most), np.int64), np.zeros((len(mine), most), bool)
        for i, own in enumerate(mine):
            found[i, : len(own)], filled[i, : len(own)] = own, True
        return found, filled

    @abstractmethod
    def _shuffle(self, i: int, rng: np.random.Generator) -> IntArray:
        """Return the slots of one attempt's epoch in random order."""

    @abstractmethod
    def take(self, number: int, part: slice) -> Batch | None:
        """Return one batch of some attempts, or None if none of them has any more."""

    @abstractmethod
    def keep(self, states: Tensor) -> None:
        """Store the states [T, A, H, B] of the last batch."""

    @abstractmethod
    def end_epoch(self, active: Sequence[int]) -> None:
        """Store what the next epoch needs from this one."""

    @abstractmethod
    def export(self, i: int) -> dict[str, Stored]:
        """Return what an attempt's next epoch needs from the last, for a checkpoint."""

    @abstractmethod
    def restore(self, i: int, stored: Mapping[str, Stored]) -> None:
        """Take back what `export` returned."""


@dataclass(frozen=True)
class Chunks:
    """All runs cut into the chunks of one epoch; a slot is (attempt, run, place in the run)."""

    x: Tensor
    """[slots, T, I]."""
    target: Tensor
    """[slots, T, K]."""
    weight: Tensor
    """[slots, T, 1]."""
    walked: Tensor
    """[slots + 1, T, H] states after each sample; the last slot takes what fills the shape."""
    most: int
    """Places in a run."""


class StreamCourse(Course):
    """Chunks of the runs, each starting from the state that the last epoch reached there.

    Back-propagation ends at the chunk's start; the state itself does not. Chunks are cut anew each
    epoch, so that no sample stays at an edge. Before its first sample a run is at rest.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        owner: IntArray,
        network: Network,
        parameters: Parameters,
        device: str,
    ) -> None:
        """Walk once through the whole runs, whose states the first epoch starts from.

        Args:
            problems: those of the attempts.
            owner: [A] which problem each attempt is of.
            network: one of the networks.
            parameters: of all of them.
            device: where the arrays go.
        """
        super().__init__(problems, owner, problems[0].settings.chunk, device)
        self._network = network
        self._offsets = np.ones(len(owner), np.int64)
        runs, chunk = self.runs, self._settings.chunk
        self._states = torch.empty(
            (len(owner), runs.count, runs.length + 1, network.width),
            dtype=network.state_type,
            device=device,
        )
        """[A, R, P + 1, H] before each sample and after the last."""
        self._place: tuple[Tensor, Tensor, Tensor] | None = None
        if not network.width:
            return
        state = self._rest(parameters)
        for begin in range(chunk, runs.length, STEPS_AT_ONCE):
            x = runs.x[self._owner_t, :, begin : begin + STEPS_AT_ONCE].permute(2, 0, 3, 1)
            with torch.no_grad():
                _, states = network.run_many(parameters, x.contiguous(), state)
            self._states[:, :, begin + 1 : begin + 1 + len(x)] = states.permute(1, 3, 0, 2)
            state = states[-1]

    def _rest(self, parameters: Parameters) -> Tensor:
        """Bring the states [A, H, R] in front of the runs to rest."""
        first = self.runs.x[self._owner_t, :, 0].transpose(1, 2)  # [A, I, R]
        with torch.no_grad():
            rest = self._network.rest_many(parameters, first)
        self._states[:, :, : self._settings.chunk + 1] = rest.transpose(1, 2)[:, :, None]
        return rest

    def start_epoch(
        self, attempts: Sequence[Attempt], active: Sequence[int], parameters: Parameters
    ) -> None:
        """Cut all runs into this epoch's chunks, in this epoch's order."""
        super().start_epoch(attempts, active, parameters)
        if self._network.width:
            self._rest(parameters)
        runs, chunk, count = self.runs, self._settings.chunk, len(attempts)
        most = self._most
        arrays = [
            a.new_zeros(count, runs.count, most, chunk, a.shape[3])
            for a in (runs.x, runs.target, runs.weight)
        ]
        for i in active:
            offset, sensor = int(self._offsets[i]), int(self._owner[i])
            fit = self._count_places(i)
            for array, source in zip(arrays, (runs.x, runs.target, runs.weight), strict=True):
                part = source[sensor, :, offset : offset + fit * chunk]
                array[i, :, :fit] = part.reshape(runs.count, fit, chunk, -1)
        x, target, weight = (a.flatten(0, 2) for a in arrays)
        walked = self._states.new_empty(len(x) + 1, chunk, self._network.width)
        self._chunks = Chunks(x, target, weight, walked, most)

    @property
    def _most(self) -> int:
        """Places in the longest run."""
        chunk = self._settings.chunk
        return -(-(self.runs.length - chunk - 1) // chunk)

    def _count_places(self, i: int) -> int:
        return min(self._most, (self.runs.length - int(self._offsets[i])) // self._settings.chunk)

    def _shuffle(self, i: int, rng: np.random.Generator) -> IntArray:
        chunk = self._settings.chunk
        offset = int(rng.integers(1, chunk + 1))
        self._offsets[i] = offset
        places = np.concatenate(
            [
                (i * self.runs.count + j) * self._most
                + np.arange(len(range(offset, chunk + length, chunk)))
                for j, length in enumerate(self.runs.lengths[self._owner[i]])
            ]
        )
        return places[rng.permutation(len(places))]

    def take(self, number: int, part: slice) -> Batch | None:
        """Return a batch of chunks."""
        found = self._gather_slots(number, part)
        if found is None:
            return None
        slots, filled = found
        count, most = slots.shape
        runs, chunk, chunks = self.runs, self._settings.chunk, self._chunks
        own, within = np.divmod(slots, chunks.most)
        start = self._offsets[part][:, None] + within * chunk
        row = torch.from_numpy(np.where(filled, own * (runs.length + 1) + start, 0))
        slot = torch.from_numpy(np.where(filled, slots, len(chunks.x)))
        row, slot, taken, run, counts = (
            t.to(self._device)
            for t in (
                row,
                slot,
                torch.from_numpy(slots).reshape(-1),
                torch.from_numpy(own % runs.count),
                torch.from_numpy(filled),
            )
        )

        def gather(array: Tensor) -> Tensor:
            """Return [T, A, C, B] of chunks [slots, T, C]."""
            return array.index_select(0, taken).view(count, most, chunk, -1).permute(2, 0, 3, 1)

        state = self._states.new_zeros(count, 0, most)
        if self._network.width:
            table = self._states.view(-1, self._states.shape[3])
            state = table.index_select(0, row.reshape(-1)).view(count, most, -1).transpose(1, 2)
        self._place = (row, slot, counts)
        return Batch(
            features=gather(chunks.x).contiguous(),
            state=state.contiguous(),
            target=gather(chunks.target),
            weight=gather(chunks.weight) * counts[:, None],
            group=torch.gather(runs.group[self._owner_t[part]], 1, run),
        )

    def keep(self, states: Tensor) -> None:
        """Store the states; the chunk that follows may come in a later batch of this epoch."""
        if not self._network.width:
            return
        assert self._place is not None
        row, slot, counts = (t.reshape(-1) for t in self._place)
        table = self._states.view(-1, states.shape[2])
        last = states[-1].transpose(1, 2).reshape(len(row), -1)
        table.index_copy_(0, (row + self._settings.chunk)[counts], last[counts])
        self._chunks.walked.index_copy_(0, slot, states.permute(1, 3, 0, 2).flatten(0, 1))

    def end_epoch(self, active: Sequence[int]) -> None:
        """Store the states, from which the next epoch's chunks will start."""
        if not self._network.width:
            return
        chunk, runs = self._settings.chunk, self.runs
        shape = (len(self._owner), runs.count, self._chunks.most, chunk, self._network.width)
        parts = self._chunks.walked[:-1].view(shape)
        for i in active:
            begin, fit = int(self._offsets[i]) + 1, self._count_places(i)
            self._states[i, :, begin : begin + fit * chunk] = parts[i, :, :fit].flatten(1, 2)

    def export(self, i: int) -> dict[str, Stored]:
        """Return the states [R, P + 1, H] along an attempt's runs."""
        return {"states": self._states[i].cpu().numpy()}

    def restore(self, i: int, stored: Mapping[str, Stored]) -> None:
        """Take back the states along an attempt's runs."""
        if not self._network.width:
            return
        states = torch.from_numpy(stored["states"]).to(self._device)
        length = min(states.shape[1], self._states.shape[2])
        self._states[i, : len(states), :length] = states[:, :length]


class WindowCourse(Course):
    """All windows of `memory` samples in random order; only the last sample of each is trained.

    Before its first sample a run is at rest: the window is filled with the first features.
    """

    def __init__(
        self, problems: Sequence[Problem], owner: IntArray, network: Network, device: str
    ) -> None:
        self._memory = int(problems[0].settings.memory)
        super().__init__(problems, owner, self._memory - 1, device)
        self._network = network

    def _shuffle(self, i: int, rng: np.random.Generator) -> IntArray:
        """Return the rows where windows start, in random order."""
        first = np.concatenate(
            [
                j * self.runs.length + np.arange(length)
                for j, length in enumerate(self.runs.lengths[self._owner[i]])
            ]
        )
        return first[rng.permutation(len(first))]

    def take(self, number: int, part: slice) -> Batch | None:
        """Return a batch of windows."""
        found = self._gather_slots(number, part)
        if found is None:
            return None
        rows, filled = (torch.from_numpy(a).to(self._device) for a in found)
        count, most = rows.shape
        runs, memory, owner = self.runs, self._memory, self._owner_t[part]
        rows = rows + owner[:, None] * (runs.count * runs.length)
        times = torch.arange(memory, device=self._device)[:, None, None] + rows
        features = runs.x.view(-1, runs.x.shape[3])[times].transpose(2, 3)
        target = runs.target.view(-1, runs.target.shape[3])[times[-1]].transpose(1, 2)
        cold = torch.zeros(
            count, self._network.width, most, dtype=self._network.state_type, device=self._device
        )
        run = times[-1] // runs.length % runs.count
        return Batch(
            features=features.contiguous(),
            state=cold,
            target=target[None],
            weight=filled[None, :, None].to(runs.weight.dtype),
            group=torch.gather(runs.group[owner], 1, run),
        )

    def keep(self, states: Tensor) -> None:
        """Forget the states: each window starts afresh."""

    def end_epoch(self, active: Sequence[int]) -> None:
        """Keep nothing: windows have no memory of the last epoch."""

    def export(self, i: int) -> dict[str, Stored]:
        """Return nothing."""
        return {}

    def restore(self, i: int, stored: Mapping[str, Stored]) -> None:
        """Take back nothing."""
