"""The training loop of many networks at once: every sensor and start with weights of its own.

Each network goes through the very steps that `zerodrift.train.optimise.Trainer` would take it
through alone - the same first weights, chunks, order, learning rate, limit of the gradient - so
one sensor is a batch of one, and the results differ by rounding only.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.errors import InputError
from zerodrift.train.batch_recurrence import (
    BatchWeights,
    run_backward,
    run_forward,
    settle,
    sum_outer,
)
from zerodrift.train.networks import GruNetwork
from zerodrift.train.optimise import (
    GRADIENT_LIMIT,
    Result,
    Settings,
    draw_seed,
    explain_divergence,
    one_cycle,
)
from zerodrift.train.sequences import Sequence32

Array = NDArray[np.float64]

BETAS, EPSILON = (0.9, 0.99), 1e-8
"""Of AdamW, as `Trainer` sets them."""
NAMES = ("w_x", "w_h", "bias", "head", "head_bias")
STEPS_AT_ONCE = 512
"""Whole runs are walked through in pieces of this many samples, which bounds the memory."""
AT_ONCE = 256
"""Networks that walk through the epochs together on the CPU."""
SAMPLES_AT_ONCE = 4_000_000
"""Samples of all networks that walk together, each run counted as long as the longest: they take
some 150 bytes each."""
BLOCK = 32
"""Networks in one pass forward and back on the CPU: more of them do not stay in its cache."""


@dataclass(frozen=True)
class Problem:
    """One sensor's training."""

    build: Callable[[torch.Generator], GruNetwork]
    """Makes the untrained network."""
    sequences: Sequence[Sequence32]
    held_out: Sequence[Sequence32]
    """What start and epoch are chosen by; empty = best start, last epoch."""
    settings: Settings
    """Starts and epochs may differ among the sensors; nothing else may."""
    tared: bool = False


@dataclass
class _Attempt:
    """One start of one sensor."""

    problem: int
    start: int
    epochs: int
    batches: int
    features: int
    best: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    best_epoch: int = 0
    best_rmse: float = math.inf
    last_rmse: float = math.inf
    rmse_without: float = math.inf
    error: InputError | None = None


def train_batch(
    problems: Sequence[Problem],
    *,
    device: str = "cpu",
    report: Callable[[float], None] = lambda _: None,
) -> list[Result | InputError]:
    """Return what `Trainer.run` would return for each problem, all trained at once.

    Args:
        problems: streams of one kind of network; the numbers of features, runs and samples differ
            as they like.
        device: where the tensors are: "cpu" or "cuda".
        report: is told the share that is done, 0 .. 1.

    Returns:
        For each problem its best start, or why its training diverged.
    """
    torch.set_num_threads(1)  # with two, steps this small take far longer
    attempts = []
    for index, problem in enumerate(problems):
        s = problem.settings
        chunks = sum(-(-len(x) // s.chunk) for x in problem.sequences)
        batches = max(1, -(-chunks // s.batch))
        width = problem.sequences[0].features.shape[1]
        attempts += [_Attempt(index, start, s.epochs, batches, width) for start in s.starts]
    largest = max((len(p.sequences) * max(map(len, p.sequences)) for p in problems), default=1)
    room = max(1, SAMPLES_AT_ONCE // largest)
    at_once = min(AT_ONCE, room) if device == "cpu" else room
    total = sum(a.epochs for a in attempts)
    done = 0.0
    for part in _arrange(problems, attempts, at_once):
        share = sum(a.epochs for a in part) / total

        def tell(x: float, before: float = done, share: float = share) -> None:
            report(before + share * x)

        _Training(problems, part, device).run(tell)
        done += share
    return [_choose(attempts, index) for index in range(len(problems))]


def _arrange(
    problems: Sequence[Problem], attempts: Sequence[_Attempt], at_once: int
) -> list[list[_Attempt]]:
    """Return the attempts in parts that are trained in step: those that are judged alike."""
    alike: dict[tuple[bool, bool], list[_Attempt]] = {}
    for attempt in attempts:
        problem = problems[attempt.problem]
        alike.setdefault((problem.tared, bool(problem.held_out)), []).append(attempt)
    parts = []
    for found in alike.values():
        # Those that end an epoch together go together.
        found.sort(key=lambda a: (a.batches, a.epochs))
        parts += [found[i : i + at_once] for i in range(0, len(found), at_once)]
    return parts


def _choose(attempts: Sequence[_Attempt], problem: int) -> Result | InputError:
    """Return the best start of a problem, the earlier one where they are equal."""
    best: _Attempt | None = None
    for attempt in attempts:
        if attempt.problem != problem:
            continue
        if attempt.error is not None:
            return attempt.error
        if best is None or attempt.best_rmse < best.best_rmse:
            best = attempt
    assert best is not None
    return Result(
        weights=best.best,
        start=best.start,
        epoch=best.best_epoch,
        rmse=best.best_rmse,
        last_rmse=best.last_rmse,
        rmse_without=best.rmse_without,
    )


class _Runs:
    """The sequences of all sensors as one array, the ends of shorter ones filled."""

    def __init__(
        self, uses: Sequence[Sequence[Sequence32]], width: int, front: int, back: int, device: str
    ) -> None:
        """Lay the sequences out.

        Args:
            uses: those of each sensor.
            width: features I; sensors with fewer have zeros for the others.
            front: samples at rest in front of each.
            back: samples behind the longest.
            device: where the arrays go.
        """
        self.count = max(len(use) for use in uses)
        self.length = front + max(len(s) for use in uses for s in use) + back
        shape = (len(uses), self.count, self.length)
        x = np.zeros((*shape, width), np.float32)
        target = np.zeros((*shape, uses[0][0].target.shape[1]), np.float32)
        weight = np.zeros((*shape, 1), np.float32)
        for i, use in enumerate(uses):
            for j, s in enumerate(use):
                own, end = s.features.shape[1], front + len(s)
                x[i, j, :front, :own] = s.features[0]
                x[i, j, front:end, :own] = s.features
                x[i, j, end:, :own] = s.features[-1]
                target[i, j, front:end] = s.target
                weight[i, j, front + s.skip : end] = 1.0
        self.x, self.target, self.weight = (
            torch.from_numpy(a).to(device) for a in (x, target, weight)
        )


@dataclass(frozen=True)
class _Chunks:
    """All runs cut into the chunks of one epoch; a slot is (attempt, run, place in the run)."""

    x: Tensor
    """[slots, T, I]."""
    target: Tensor
    """[slots, T, K]."""
    weight: Tensor
    """[slots, T, 1]."""
    slots: list[list[NDArray[np.int64]]]
    """Of each attempt, the slots [B] of each of its batches."""
    offsets: NDArray[np.int64]
    """[A] where the first chunks start."""
    most: int
    """Places in a run."""


@dataclass(frozen=True)
class _Sums:
    """Of one epoch, [A] squared errors and their weights, [A G, K, 2] errors and weights."""

    squares: Tensor
    weight: Tensor
    by_group: Tensor


class _Training:
    """Some attempts on their way, all at the same epoch."""

    def __init__(
        self, problems: Sequence[Problem], attempts: Sequence[_Attempt], device: str
    ) -> None:
        self._attempts = attempts
        self._device = device
        mine = list(dict.fromkeys(a.problem for a in attempts))
        self._problems = [problems[i] for i in mine]
        self._sensor = np.array([mine.index(a.problem) for a in attempts])
        self._settings = self._problems[0].settings
        s = self._settings
        width = max(a.features for a in attempts)
        self._runs = _Runs([p.sequences for p in self._problems], width, s.chunk, s.chunk, device)
        self._held = (
            _Runs([p.held_out for p in self._problems], width, 0, 0, device)
            if all(p.held_out for p in self._problems)
            else None
        )
        networks = []
        for attempt, sensor in zip(attempts, self._sensor, strict=True):
            generator = torch.Generator().manual_seed(draw_seed(s.seed, attempt.start))
            networks.append(self._problems[sensor].build(generator))
        self._reset = networks[0].reset
        self._stack(networks, width)
        self._groups, self._group_of = self._list_groups()
        self._tared = self._problems[0].tared
        outputs = self._problems[0].sequences[0].target.shape[1]
        self._offsets = torch.zeros(len(attempts), self._groups, outputs, device=device)
        self._sensor_t = torch.from_numpy(self._sensor).to(device)
        self._states = torch.empty(0)
        """[A, R, P + 1, H] before each sample and after the last."""
        self._block = BLOCK if device == "cpu" else len(attempts)

    def _stack(self, networks: Sequence[GruNetwork], width: int) -> None:
        """Put all parameters into one array [A, P], so that a step of the optimiser is one."""
        hidden, outputs = networks[0].w_h.shape[1], networks[0].head.shape[0]
        shapes = ((3, hidden, width), (3, hidden, hidden), (4, hidden), (outputs, hidden))
        self._shapes = dict(zip(NAMES, (*shapes, (outputs,)), strict=True))
        sizes = [math.prod(shape) for shape in self._shapes.values()]
        self._places = dict(zip(NAMES, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
        flat = torch.zeros(len(networks), sum(sizes))
        decays = torch.zeros(sum(sizes))
        for name, shape in self._shapes.items():
            place, size = self._places[name], math.prod(shape)
            part = flat[:, place : place + size].view(len(networks), *shape)
            for i, network in enumerate(networks):
                value = getattr(network, name).detach()
                if name == "w_x":
                    part[i, ..., : value.shape[2]] = value
                else:
                    part[i] = value
            if "bias" not in name:
                decays[place : place + size] = self._settings.weight_decay
        self._flat, self._decays = flat.to(self._device), decays.to(self._device)
        self._gradient = torch.zeros_like(self._flat)
        self._first, self._second = torch.zeros_like(self._flat), torch.zeros_like(self._flat)
        self._steps = torch.zeros(len(networks), 1, dtype=torch.float64, device=self._device)

    def _view(self, flat: Tensor, name: str) -> Tensor:
        shape, place = self._shapes[name], self._places[name]
        return flat[:, place : place + math.prod(shape)].view(len(flat), *shape)

    def _weights(self) -> BatchWeights:
        parts = {name: self._view(self._flat, name) for name in NAMES}
        for name in ("w_x", "w_h"):
            parts[name] = parts[name].flatten(1, 2).contiguous()
        return BatchWeights(**parts, reset=self._reset)

    def _list_groups(self) -> tuple[int, Tensor]:
        """Return the most groups of any sensor, and [sensors, runs] the group of each run."""
        numbers = np.zeros((len(self._problems), self._runs.count), np.int64)
        most = 1
        for i, problem in enumerate(self._problems):
            groups = list(dict.fromkeys(s.group for s in problem.sequences))
            numbers[i, : len(problem.sequences)] = [
                groups.index(s.group) for s in problem.sequences
            ]
            most = max(most, len(groups))
        return most, torch.from_numpy(numbers).to(self._device)

    def run(self, report: Callable[[float], None]) -> None:
        """Train all attempts to their ends."""
        longest = max(a.epochs for a in self._attempts)
        self._judge(0, np.full(len(self._attempts), math.inf), range(len(self._attempts)))
        for attempt in self._attempts:
            attempt.rmse_without = attempt.best_rmse
        for epoch in range(longest):
            active = [
                i for i, a in enumerate(self._attempts) if epoch < a.epochs and a.error is None
            ]
            rmse = self._run_epoch(epoch, active)
            s = self._settings
            for i in active:
                if not math.isfinite(rmse[i]):
                    error = explain_divergence(epoch + 1, s.learning_rate)
                    self._attempts[i].error = error
                    self._flat[i] = 0.0
            due = [
                i
                for i in active
                if self._attempts[i].error is None
                and (
                    (epoch + 1) % max(1, self._attempts[i].epochs // s.evaluations) == 0
                    or epoch + 1 == self._attempts[i].epochs
                )
            ]
            self._judge(epoch + 1, rmse, due)
            report((epoch + 1) / longest)

    def _start_epoch(self) -> None:
        """Bring the states in front of the runs to rest; before the first epoch, all of them."""
        weights, chunk, runs = self._weights(), self._settings.chunk, self._runs
        first = runs.x[self._sensor_t, :, 0]  # [A, R, I]
        rest = settle(first.transpose(1, 2), weights)  # [A, H, R]
        if self._states.numel() == 0:
            shape = (len(first), runs.count, runs.length + 1, weights.hidden)
            self._states = torch.empty(shape, device=self._device)
            state = rest
            for begin in range(chunk, runs.length, STEPS_AT_ONCE):
                part = runs.x[self._sensor_t, :, begin : begin + STEPS_AT_ONCE]
                states = run_forward(part.permute(2, 0, 3, 1).contiguous(), state, weights).states
                end = begin + part.shape[2]
                self._states[:, :, begin + 1 : end + 1] = states[1:].permute(1, 3, 0, 2)
                state = states[-1]
        self._states[:, :, : chunk + 1] = rest.transpose(1, 2)[:, :, None]

    def _cut(self, epoch: int, active: Sequence[int]) -> "_Chunks":
        """Return all runs cut into this epoch's chunks, in this epoch's order."""
        s, runs, chunk = self._settings, self._runs, self._settings.chunk
        count, most = len(self._attempts), -(-(runs.length - chunk - 1) // chunk)
        arrays = [
            a.new_zeros(count, runs.count, most, chunk, a.shape[3])
            for a in (runs.x, runs.target, runs.weight)
        ]
        slots: list[list[NDArray[np.int64]]] = [[] for _ in self._attempts]
        offsets = np.ones(count, np.int64)
        for i in active:
            attempt, sensor = self._attempts[i], int(self._sensor[i])
            rng = np.random.default_rng((s.seed, attempt.start, epoch))
            offset = int(rng.integers(1, chunk + 1))
            offsets[i] = offset
            fit = min(most, (runs.length - offset) // chunk)
            for array, source in zip(arrays, (runs.x, runs.target, runs.weight), strict=True):
                part = source[sensor, :, offset : offset + fit * chunk]
                array[i, :, :fit] = part.reshape(runs.count, fit, chunk, -1)
            found = [
                (i * runs.count + j) * most + np.arange(len(range(offset, chunk + len(q), chunk)))
                for j, q in enumerate(self._sequences(i))
            ]
            places = np.concatenate(found)
            places = places[rng.permutation(len(places))]
            slots[i] = np.array_split(places, attempt.batches)
        x, target, weight = (a.flatten(0, 2) for a in arrays)
        return _Chunks(x, target, weight, slots, offsets, most)

    def _run_epoch(self, epoch: int, active: Sequence[int]) -> Array:
        """Walk once through all training runs; return the RMSE [A] on the way."""
        self._start_epoch()
        chunks = self._cut(epoch, active)
        count, outputs = len(self._attempts), self._offsets.shape[2]
        zeros = torch.zeros(count, dtype=torch.float64, device=self._device)
        by_group = torch.zeros(count * self._groups, outputs, 2, device=self._device)
        sums = _Sums(zeros, zeros.clone(), by_group)
        # What a chunk goes through; the slot behind the last takes what only fills the shape.
        slots = len(chunks.x) + 1
        walked = self._states.new_empty(slots, self._settings.chunk, self._states.shape[3])
        for number in range(max((len(batches) for batches in chunks.slots), default=0)):
            batches = [b[number] if number < len(b) else None for b in chunks.slots]
            for begin in range(0, count, self._block):
                self._differentiate(
                    chunks, batches, slice(begin, min(begin + self._block, count)), walked, sums
                )
            self._update(epoch, number, [b is not None for b in batches])
        self._keep_states(chunks, walked, active)
        if self._tared:
            totals = by_group.view(count, self._groups, outputs, 2).double()
            change = totals[..., 0] / totals[..., 1].clamp(min=1.0)
            offsets = self._offsets.double() - change
            for i in active:
                own = len(dict.fromkeys(s.group for s in self._sequences(i)))
                self._offsets[i, :own] = (offsets[i, :own] - offsets[i, :own].mean(0)).float()
        return np.asarray(torch.sqrt(sums.squares / sums.weight.clamp(min=1e-30)).cpu().numpy())

    def _keep_states(self, chunks: "_Chunks", walked: Tensor, active: Sequence[int]) -> None:
        """Store the states, from which the next epoch's chunks will start."""
        chunk, runs = self._settings.chunk, self._runs
        shape = (len(self._attempts), runs.count, chunks.most, chunk, walked.shape[2])
        parts = walked[:-1].view(shape)
        for i in active:
            begin = int(chunks.offsets[i]) + 1
            fit = min(chunks.most, (runs.length - begin + 1) // chunk)
            end = begin + fit * chunk
            self._states[i, :, begin:end] = parts[i, :, :fit].flatten(1, 2)

    def _sequences(self, attempt: int) -> Sequence[Sequence32]:
        problem: Problem = self._problems[int(self._sensor[attempt])]
        return problem.sequences

    def _differentiate(
        self,
        chunks: "_Chunks",
        batches: Sequence[NDArray[np.int64] | None],
        part: slice,
        walked: Tensor,
        sums: "_Sums",
    ) -> None:
        """Put the gradient of one batch of some attempts in its place, and note errors and states.

        Args:
            chunks: of this epoch.
            batches: slots [B] of each attempt's chunks; None = it has no more.
            part: which attempts.
            walked: [slots + 1, T, H] states after each sample of the chunks.
            sums: of this epoch.
        """
        mine = list(batches[part])
        count, most = len(mine), max((len(b) for b in mine if b is not None), default=0)
        if most == 0:
            self._gradient[part] = 0.0
            return
        chunk, runs = self._settings.chunk, self._runs
        slots = np.full((count, most), len(chunks.x), np.int64)
        for i, b in enumerate(mine):
            if b is not None:
                slots[i, : len(b)] = b
        filled = slots < len(chunks.x)
        read = np.where(filled, slots, 0)
        own, within = np.divmod(read, chunks.most)
        start = chunks.offsets[part][:, None] + within * chunk
        row = torch.from_numpy(np.where(filled, own * (runs.length + 1) + start, 0)).to(
            self._device
        )
        slot, taken = (torch.from_numpy(a).to(self._device) for a in (slots, read))
        counts = torch.from_numpy(filled.astype(np.float32)).to(self._device)
        run = torch.from_numpy(own % runs.count).to(self._device)

        def gather(array: Tensor) -> Tensor:
            """Return [T, A, C, B] of chunks [slots, T, C]."""
            found = array.index_select(0, taken.reshape(-1))
            return found.view(count, most, chunk, -1).permute(2, 0, 3, 1)

        x = gather(chunks.x).contiguous()
        table = self._states.view(-1, self._states.shape[3])
        state = table.index_select(0, row.reshape(-1)).view(count, most, -1).transpose(1, 2)
        weights = self._weights().take(part)
        trace = run_forward(x, state, weights)
        states = trace.states[1:]
        # The chunk that follows may come in a later batch, and starts where this one ends.
        last = states[-1].transpose(1, 2).reshape(count * most, -1)
        there = counts.reshape(-1) > 0.0
        table.index_copy_(0, (row.reshape(-1) + chunk)[there], last[there])
        walked.index_copy_(0, slot.reshape(-1), states.permute(1, 3, 0, 2).flatten(0, 1))

        weight = gather(chunks.weight) * counts[:, None]  # [T, A, 1, B]
        drift = torch.matmul(weights.head, states)
        drift += weights.head_bias[..., None]
        group = torch.gather(self._group_of[self._sensor_t[part]], 1, run)  # [A, B]
        if self._tared:
            where = group[..., None].expand(-1, -1, drift.shape[2])
            drift += torch.gather(self._offsets[part], 1, where).transpose(1, 2)
        drift -= gather(chunks.target)
        error = drift
        error *= weight
        total = weight.sum((0, 2, 3)) * error.shape[2]
        sums.squares[part] += error.square().sum((0, 2, 3)).double()
        sums.weight[part] += total.double()
        if self._tared:
            base = torch.arange(part.start, part.start + count, device=self._device)[:, None]
            by_chunk = torch.stack(
                [
                    error.sum(0).transpose(1, 2),
                    weight.sum(0).transpose(1, 2).expand(-1, -1, error.shape[2]),
                ],
                dim=-1,
            )
            sums.by_group.index_add_(
                0, (base * self._groups + group).reshape(-1), by_chunk.flatten(0, 1)
            )
        error *= (2.0 / total.clamp(min=1.0))[None, :, None, None]
        gradient = self._gradient[part]
        d_states = torch.matmul(weights.head.transpose(1, 2), error)
        d_w_x, d_w_h, d_bias = run_backward(d_states, x, trace, weights)
        self._view(gradient, "w_x").copy_(d_w_x.view(count, *self._shapes["w_x"]))
        self._view(gradient, "w_h").copy_(d_w_h.view(count, *self._shapes["w_h"]))
        self._view(gradient, "bias").copy_(d_bias)
        self._view(gradient, "head").copy_(sum_outer(error, states))
        self._view(gradient, "head_bias").copy_(error.sum((0, 3)))

    def _update(self, epoch: int, number: int, moving: Sequence[bool]) -> None:
        """Take AdamW's step on every attempt that moves, gradients limited in length.

        Source: Loshchilov and Hutter, "Decoupled weight decay regularization", 2019.
        """
        s = self._settings
        rates = [
            s.learning_rate
            * one_cycle((epoch * a.batches + number) / (a.epochs * a.batches), s.warm_up)
            if moves
            else 0.0
            for a, moves in zip(self._attempts, moving, strict=True)
        ]
        gradient = self._gradient
        norm = gradient.norm(dim=1, keepdim=True)
        gradient *= (GRADIENT_LIMIT / (norm + 1e-6)).clamp(max=1.0)
        moves = torch.tensor(moving, device=self._device)[:, None]
        before = None
        if not all(moving):
            before = [t.clone() for t in (self._flat, self._first, self._second)]
        self._steps += moves
        rate = torch.tensor(rates, dtype=torch.float64, device=self._device)[:, None]
        self._flat *= 1.0 - rate.float() * self._decays
        self._first.lerp_(gradient, 1.0 - BETAS[0])
        self._second.mul_(BETAS[1]).addcmul_(gradient, gradient, value=1.0 - BETAS[1])
        first = 1.0 - BETAS[0] ** self._steps.clamp(min=1.0)
        second = (1.0 - BETAS[1] ** self._steps.clamp(min=1.0)).sqrt()
        denominator = self._second.sqrt() / second.float() + EPSILON
        self._flat -= (rate / first).float() * (self._first / denominator)
        if before is not None:
            for now, then in zip((self._flat, self._first, self._second), before, strict=True):
                now.copy_(torch.where(moves, now, then))

    def _judge(self, epoch: int, train_rmse: Array, due: Sequence[int]) -> None:
        """Keep the weights of those that are at their best; with nothing held out, the latest."""
        if len(due) == 0:
            return
        rmse = self._measure() if self._held is not None else train_rmse
        copies: NDArray[np.float32] | None = None
        for i in due:
            attempt = self._attempts[i]
            attempt.last_rmse = float(rmse[i])
            if self._held is not None and rmse[i] >= attempt.best_rmse:
                continue
            if copies is None:
                copies = self._flat.cpu().numpy()
            attempt.best_rmse, attempt.best_epoch = float(rmse[i]), epoch
            attempt.best = self._unstack(copies[i], attempt.features)

    def _unstack(self, flat: NDArray[np.float32], features: int) -> dict[str, NDArray[np.float32]]:
        """Return one network's parameters by name, as `Trainer` does."""
        found: dict[str, NDArray[np.float32]] = {}
        for name, shape in self._shapes.items():
            place = self._places[name]
            value = flat[place : place + math.prod(shape)].reshape(shape)
            found[name] = (value[..., :features] if name == "w_x" else value).copy()
        return found

    def _measure(self) -> Array:
        """Return the RMSE [A] on the held-out runs, without each one's offset where tared."""
        held = self._held
        assert held is not None
        weights = self._weights()
        state = None
        errors = []
        for begin in range(0, held.length, STEPS_AT_ONCE):
            part = slice(begin, begin + STEPS_AT_ONCE)
            x = held.x[self._sensor_t, :, part].permute(2, 0, 3, 1).contiguous()
            if state is None:
                state = settle(x[0], weights)
            states = run_forward(x, state, weights).states
            state = states[-1]
            drift = torch.matmul(weights.head, states[1:]) + weights.head_bias[..., None]
            errors.append(held.target[self._sensor_t, :, part] - drift.permute(1, 3, 0, 2))
        error = torch.cat(errors, dim=2).cpu().numpy()
        counted = held.weight.cpu().numpy() > 0.0
        return np.array(
            [self._pool(i, error[i], counted[self._sensor[i], ..., 0]) for i in range(len(error))]
        )

    def _pool(self, attempt: int, error: NDArray[np.float32], counts: NDArray[np.bool_]) -> float:
        """Return the RMSE of errors [R, P, K] where they count [R, P]."""
        held_out = self._problems[self._sensor[attempt]].held_out
        by_group: dict[str, list[Array]] = {}
        for j, s in enumerate(held_out):
            own = error[j][counts[j]].astype(np.float64)
            by_group.setdefault(s.group, []).append(own)
        parts = [np.concatenate(found) for found in by_group.values()]
        rest = [e - e.mean(axis=0) if self._tared else e for e in parts]
        return float(np.sqrt(np.mean(np.concatenate(rest) ** 2)))
