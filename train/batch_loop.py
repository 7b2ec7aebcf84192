"""The epochs of many trainings in step: chunks, gradients, judgement on the held-out runs."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.train.batch_data import Attempt, Chunks, Problem, Runs, Sums
from zerodrift.train.batch_recurrence import run_backward, run_forward, settle, sum_outer
from zerodrift.train.batch_weights import StackedWeights
from zerodrift.train.optimise import draw_seed, explain_divergence, one_cycle
from zerodrift.train.sequences import Sequence32

Array = NDArray[np.float64]

STEPS_AT_ONCE = 512
"""Whole runs are walked through in pieces of this many samples, which bounds the memory."""


class Training:
    """Some attempts on their way, all at the same epoch."""

    def __init__(
        self, problems: Sequence[Problem], attempts: Sequence[Attempt], device: str, block: int
    ) -> None:
        """Take what is trained together.

        Args:
            problems: of the whole batch.
            attempts: those of its starts that go in step.
            device: where the tensors are.
            block: networks in one pass forward and back.
        """
        self._attempts = attempts
        self._device = device
        mine = list(dict.fromkeys(a.problem for a in attempts))
        self._problems = [problems[i] for i in mine]
        self._sensor = np.array([mine.index(a.problem) for a in attempts])
        self._settings = self._problems[0].settings
        s = self._settings
        width = max(a.features for a in attempts)
        self._runs = Runs([p.sequences for p in self._problems], width, s.chunk, s.chunk, device)
        self._held = (
            Runs([p.held_out for p in self._problems], width, 0, 0, device)
            if all(p.held_out for p in self._problems)
            else None
        )
        networks = []
        for attempt, sensor in zip(attempts, self._sensor, strict=True):
            generator = torch.Generator().manual_seed(draw_seed(s.seed, attempt.start))
            networks.append(self._problems[sensor].build(generator))
        self._stack = StackedWeights(networks, width, s.weight_decay, device)
        self._groups, self._group_of = self._list_groups()
        self._tared = self._problems[0].tared
        outputs = self._problems[0].sequences[0].target.shape[1]
        self._offsets = torch.zeros(len(attempts), self._groups, outputs, device=device)
        self._sensor_t = torch.from_numpy(self._sensor).to(device)
        self._states = torch.empty(0)
        """[A, R, P + 1, H] before each sample and after the last."""
        self._block = block

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
                    self._stack.flat[i] = 0.0
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
        weights, chunk, runs = self._stack.read(), self._settings.chunk, self._runs
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

    def _cut(self, epoch: int, active: Sequence[int]) -> Chunks:
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
        return Chunks(x, target, weight, slots, offsets, most)

    def _run_epoch(self, epoch: int, active: Sequence[int]) -> Array:
        """Walk once through all training runs; return the RMSE [A] on the way."""
        self._start_epoch()
        chunks = self._cut(epoch, active)
        count, outputs = len(self._attempts), self._offsets.shape[2]
        zeros = torch.zeros(count, dtype=torch.float64, device=self._device)
        by_group = torch.zeros(count * self._groups, outputs, 2, device=self._device)
        sums = Sums(zeros, zeros.clone(), by_group)
        # What a chunk goes through; the slot behind the last takes what only fills the shape.
        slots = len(chunks.x) + 1
        walked = self._states.new_empty(slots, self._settings.chunk, self._states.shape[3])
        for number in range(max((len(batches) for batches in chunks.slots), default=0)):
            batches = [b[number] if number < len(b) else None for b in chunks.slots]
            for begin in range(0, count, self._block):
                self._differentiate(
                    chunks, batches, slice(begin, min(begin + self._block, count)), walked, sums
                )
            self._step(epoch, number, [b is not None for b in batches])
        self._keep_states(chunks, walked, active)
        if self._tared:
            totals = by_group.view(count, self._groups, outputs, 2).double()
            change = totals[..., 0] / totals[..., 1].clamp(min=1.0)
            offsets = self._offsets.double() - change
            for i in active:
                own = len(dict.fromkeys(s.group for s in self._sequences(i)))
                self._offsets[i, :own] = (offsets[i, :own] - offsets[i, :own].mean(0)).float()
        return np.asarray(torch.sqrt(sums.squares / sums.weight.clamp(min=1e-30)).cpu().numpy())

    def _keep_states(self, chunks: Chunks, walked: Tensor, active: Sequence[int]) -> None:
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
        chunks: Chunks,
        batches: Sequence[NDArray[np.int64] | None],
        part: slice,
        walked: Tensor,
        sums: "Sums",
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
            self._stack.gradient[part] = 0.0
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
        weights = self._stack.read().take(part)
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
        gradient = self._stack.gradient[part]
        d_states = torch.matmul(weights.head.transpose(1, 2), error)
        d_w_x, d_w_h, d_bias = run_backward(d_states, x, trace, weights)
        self._stack.view(gradient, "w_x").copy_(d_w_x.view(count, *self._stack.shapes["w_x"]))
        self._stack.view(gradient, "w_h").copy_(d_w_h.view(count, *self._stack.shapes["w_h"]))
        self._stack.view(gradient, "bias").copy_(d_bias)
        self._stack.view(gradient, "head").copy_(sum_outer(error, states))
        self._stack.view(gradient, "head_bias").copy_(error.sum((0, 3)))

    def _step(self, epoch: int, number: int, moving: Sequence[bool]) -> None:
        """Take a step on every attempt that moves, each at its own place in its cycle."""
        s = self._settings
        rates = [
            s.learning_rate
            * one_cycle((epoch * a.batches + number) / (a.epochs * a.batches), s.warm_up)
            if moves
            else 0.0
            for a, moves in zip(self._attempts, moving, strict=True)
        ]
        self._stack.step(rates, moving)

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
                copies = self._stack.flat.cpu().numpy()
            attempt.best_rmse, attempt.best_epoch = float(rmse[i]), epoch
            attempt.best = self._stack.unstack(copies[i], attempt.features)

    def _measure(self) -> Array:
        """Return the RMSE [A] on the held-out runs, without each one's offset where tared."""
        held = self._held
        assert held is not None
        weights = self._stack.read()
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
