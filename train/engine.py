"""Trains any number of networks at once; one sensor is a batch of one.

Each network has weights, chunks, order and learning rate of its own, and makes the same steps as it
would alone; training together changes the order of sums, so that results differ by rounding. The
same call gives the same weights to the bit on one machine, also where it was interrupted and taken
up again.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.errors import InputError
from zerodrift.train.attempts import (
    Attempt,
    Problem,
    Standing,
    Stored,
    load_standings,
    mark_problems,
    save_standings,
)
from zerodrift.train.contraction import measure_reach, measure_swing
from zerodrift.train.courses import (
    STEPS_AT_ONCE,
    Batch,
    Course,
    Runs,
    StreamCourse,
    WindowCourse,
)
from zerodrift.train.networks import Network
from zerodrift.train.onnx_export import WINDOWS_AT_ONCE
from zerodrift.train.sequences import Array32

# How networks are trained: the settings, the learning-rate cycle, and AdamW on many at once.


CYCLE_START, CYCLE_END = 1 / 25, 1e-4
"""The learning rate begins and ends at these shares of its peak."""
GRADIENT_LIMIT = 1.0
"""Longest gradient; a longer one is shortened to this."""
BETAS, EPSILON = (0.9, 0.99), 1e-8
"""Of AdamW."""


class Stack:
    """The parameters of many networks of one kind as one array, and AdamW's steps on all of them.

    A network that sees fewer features than another has zeros for the missing weights, which stay
    zero since the features that they multiply are.
    """

    def __init__(self, networks: Sequence[Network], weight_decay: float, device: str) -> None:
        """Take the networks' parameters.

        Args:
            networks: of one kind; their parameters have the same names and numbers of axes.
            weight_decay: per step and unit of learning rate, on weights but not on biases.
            device: where the arrays go.
        """
        self._device = device
        parameters = [dict(network.named_parameters()) for network in networks]
        self._own = [{name: tuple(p.shape) for name, p in own.items()} for own in parameters]
        self._shapes = {
            name: tuple(np.max([own[name] for own in self._own], axis=0).tolist())
            for name in self._own[0]
        }
        sizes = [math.prod(shape) for shape in self._shapes.values()]
        begins = np.cumsum([0, *sizes]).tolist()
        self._places = {
            name: slice(begin, begin + size)
            for name, begin, size in zip(self._shapes, begins, sizes, strict=False)
        }
        self.flat = torch.zeros(len(networks), sum(sizes), device=device)
        """[A, P]."""
        self.gradient, self._first, self._second = (torch.zeros_like(self.flat) for _ in range(3))
        self._steps = torch.zeros(len(networks), 1, dtype=torch.float64, device=device)
        self._decays = torch.zeros(sum(sizes), device=device)
        for name, place in self._places.items():
            if "bias" not in name:
                self._decays[place] = weight_decay
        for i, own in enumerate(parameters):
            self._fill(self.flat, i, {k: p.detach().numpy() for k, p in own.items()})

    def _view(self, flat: Tensor, name: str) -> Tensor:
        return flat[:, self._places[name]].view(len(flat), *self._shapes[name])

    def _fill(self, flat: Tensor, i: int, values: Mapping[str, NDArray[np.float32]]) -> None:
        """Put one network's values by name in an array like `flat`."""
        for name, value in values.items():
            corner = tuple(slice(0, n) for n in value.shape)
            self._view(flat, name)[i][corner] = torch.from_numpy(value).to(self._device)

    def read(self) -> dict[str, Tensor]:
        """Return the parameters of all networks by name, [A, ...]."""
        return {name: self._view(self.flat, name) for name in self._shapes}

    def track(self, part: slice) -> dict[str, Tensor]:
        """Return the parameters of some networks as leaves that gradients are asked for."""
        return {name: p[part].detach().requires_grad_() for name, p in self.read().items()}

    def differentiate(self, loss: Tensor, part: slice, tracked: Mapping[str, Tensor]) -> None:
        """Put the gradient of some networks' losses in its place.

        Args:
            loss: sum of the losses, each of which depends on its own network alone.
            part: which networks.
            tracked: what `track` returned for them.
        """
        found = torch.autograd.grad(loss, list(tracked.values()))
        for name, gradient in zip(tracked, found, strict=True):
            self._view(self.gradient, name)[part] = gradient

    def step(self, rates: Sequence[float], moving: Sequence[bool]) -> None:
        """Take AdamW's step on every network that moves, gradients limited in length.

        Source: Loshchilov and Hutter, "Decoupled weight decay regularization", 2019.
        """
        gradient = self.gradient
        norm = gradient.norm(dim=1, keepdim=True)
        gradient *= (GRADIENT_LIMIT / (norm + 1e-6)).clamp(max=1.0)
        moves = torch.tensor(moving, device=self._device)[:, None]
        before = None
        if not all(moving):
            before = [t.clone() for t in (self.flat, self._first, self._second)]
        self._steps += moves
        rate = torch.tensor(rates, dtype=torch.float64, device=self._device)[:, None]
        self.flat *= 1.0 - rate.float() * self._decays
        self._first.lerp_(gradient, 1.0 - BETAS[0])
        self._second.mul_(BETAS[1]).addcmul_(gradient, gradient, value=1.0 - BETAS[1])
        first = 1.0 - BETAS[0] ** self._steps.clamp(min=1.0)
        second = (1.0 - BETAS[1] ** self._steps.clamp(min=1.0)).sqrt()
        denominator = self._second.sqrt() / second.float() + EPSILON
        self.flat -= (rate / first).float() * (self._first / denominator)
        if before is not None:
            for now, then in zip((self.flat, self._first, self._second), before, strict=True):
                now.copy_(torch.where(moves, now, then))

    def unstack(self, flat: Array32, i: int) -> dict[str, Array32]:
        """Return one network's parameters by name, from its row of an array like `flat`."""
        found = {}
        for name, own in self._own[i].items():
            corner = tuple(slice(0, n) for n in own)
            found[name] = flat[self._places[name]].reshape(self._shapes[name])[corner].copy()
        return found

    def export(self, i: int) -> dict[str, NDArray[np.generic]]:
        """Return one network's parameters and moments, for a checkpoint."""
        found: dict[str, NDArray[np.generic]] = {"step": self._steps[i].cpu().numpy()}
        kinds = {"weights": self.flat, "exp_avg": self._first, "exp_avg_sq": self._second}
        for kind, flat in kinds.items():
            own = self.unstack(flat[i].cpu().numpy(), i)
            found |= {f"{kind}.{name}": value for name, value in own.items()}
        return found

    def restore(self, i: int, stored: Mapping[str, NDArray[np.generic]]) -> None:
        """Take back what `export` returned."""
        self._steps[i] = float(stored["step"].item())
        kinds = {"weights": self.flat, "exp_avg": self._first, "exp_avg_sq": self._second}
        for kind, flat in kinds.items():
            self._fill(flat, i, {n: stored[f"{kind}.{n}"].astype(np.float32) for n in self._own[i]})


def one_cycle(place: float, warm_up: float) -> float:
    """Return the learning rate as a share of its peak: up by half a cosine, and down by another.

    Args:
        place: share of the training that is done, 0 .. 1.
        warm_up: share in which it rises.

    Source: Smith and Topin, "Super-convergence", 2018.
    """
    if place < warm_up:
        rise = 0.5 - 0.5 * math.cos(math.pi * place / warm_up)
        return CYCLE_START + (1.0 - CYCLE_START) * rise
    fall = 0.5 + 0.5 * math.cos(math.pi * (place - warm_up) / (1.0 - warm_up))
    return CYCLE_END + (1.0 - CYCLE_END) * fall


def draw_seed(seed: int, start: int) -> int:
    """Return the seed of one start, unrelated to those of its neighbours."""
    return int(
        np.random.SeedSequence((seed, start)).generate_state(1, np.uint64)[0] >> np.uint64(1)
    )


def explain_divergence(epoch: int, learning_rate: float) -> InputError:
    """Return the error of a training whose loss is no number any more."""
    return InputError(
        f"the training of the network diverged in epoch {epoch}; lower"
        f" [network] learning_rate (now {learning_rate:g}) or look at the logs' range."
    )


# The epochs of many trainings in step: gradients, steps, judgement on the held-out runs.


@dataclass(frozen=True)
class EpochSums:
    """Of one epoch, [A] squared errors and their weights, [A G, K, 2] errors and weights."""

    squares: Tensor
    weight: Tensor
    by_group: Tensor


class Training:
    """Some attempts on their way, each at its own epoch."""

    def __init__(
        self, problems: Sequence[Problem], attempts: Sequence[Attempt], device: str, block: int
    ) -> None:
        """Take what is trained together, and judge the untrained networks.

        Args:
            problems: of the whole batch.
            attempts: those of its starts that go in step; none has begun.
            device: where the tensors are.
            block: networks in one pass forward and back.
        """
        self.attempts = attempts
        self._device, self._block = device, block
        mine = list(dict.fromkeys(a.problem for a in attempts))
        self._problems = [problems[i] for i in mine]
        self._owner = np.array([mine.index(a.problem) for a in attempts])
        self._owner_t = torch.from_numpy(self._owner).to(device)
        s = self._settings = self._problems[0].settings
        self._windowed = s.memory != "stream"
        networks = []
        for attempt, owner in zip(attempts, self._owner, strict=True):
            generator = torch.Generator().manual_seed(draw_seed(s.seed, attempt.start))
            networks.append(self._problems[owner].build(generator))
        self._network = networks[0]
        self._stack = Stack(networks, s.weight_decay, device)
        reach = [measure_reach(self._problems[owner].sequences) for owner in self._owner]
        most = max(map(len, reach))
        self._reach = torch.tensor([[*r, *[0.0] * (most - len(r))] for r in reach], device=device)
        """[A, I] largest absolute values of the features that the chip can hold."""
        swing = [measure_swing(self._problems[owner].sequences) for owner in self._owner]
        self._swing = torch.tensor(swing, device=device)
        """[A, K] half the distance of the lowest and highest target."""
        self._constrain()
        self._course = self._open_course()
        self._held = (
            Runs(
                [p.held_out for p in self._problems],
                int(s.memory) - 1 if self._windowed else 0,
                0,
                device,
            )
            if all(p.held_out for p in self._problems)
            else None
        )
        self._tared = self._problems[0].tared
        self._groups = max(map(len, self._course.runs.groups))
        outputs = self._course.runs.target.shape[3]
        self._offsets = torch.zeros(len(attempts), self._groups, outputs, device=device)
        """[A, G, K] offset of each group, which is not the network's to explain."""
        self._judge(np.full(len(attempts), math.inf), range(len(attempts)))
        for attempt in attempts:
            attempt.rmse_without = attempt.best_rmse

    def _open_course(self) -> Course:
        if self._windowed:
            return WindowCourse(self._problems, self._owner, self._network, self._device)
        return StreamCourse(
            self._problems, self._owner, self._network, self._stack.read(), self._device
        )

    def run(self, report: Callable[[float, bool], None]) -> None:
        """Train all attempts to their ends.

        Args:
            report: called after each epoch with its training RMSE, averaged over the attempts, and
                whether any of them was evaluated.
        """
        while active := [i for i, a in enumerate(self.attempts) if a.is_active]:
            rmse = self._run_epoch(active)
            for i in active:
                self.attempts[i].epoch += 1
                if not math.isfinite(rmse[i]):
                    self._give_up(i)
            going = [i for i in active if self.attempts[i].error is None]
            due = [i for i in going if self._is_due(self.attempts[i])]
            self._judge(rmse, due)
            report(float(np.mean(rmse[going])) if going else math.nan, bool(due))

    def _is_due(self, a: Attempt) -> bool:
        every = max(1, a.epochs // self._settings.evaluations)
        return a.epoch % every == 0 or a.epoch == a.epochs

    def _give_up(self, i: int) -> None:
        """End all starts of a problem one of whose starts diverged."""
        error = explain_divergence(self.attempts[i].epoch, self._settings.learning_rate)
        for k, other in enumerate(self.attempts):
            if other.problem == self.attempts[i].problem and other.error is None:
                other.error = error
                self._stack.flat[k] = 0.0

    def _run_epoch(self, active: Sequence[int]) -> Array:
        """Walk once through all training runs; return the RMSE [A] on the way."""
        self._course.start_epoch(self.attempts, active, self._stack.read())
        count, outputs = len(self.attempts), self._offsets.shape[2]
        zeros = torch.zeros(count, dtype=torch.float64, device=self._device)
        by_group = torch.zeros(count * self._groups, outputs, 2, device=self._device)
        sums = EpochSums(zeros, zeros.clone(), by_group)
        for number in range(max(self.attempts[i].batches for i in active)):
            for begin in range(0, count, self._block):
                self._differentiate(number, slice(begin, min(begin + self._block, count)), sums)
            self._step(number)
        self._course.end_epoch(active)
        if self._tared:
            totals = by_group.view(count, self._groups, outputs, 2).double()
            change = totals[..., 0] / totals[..., 1].clamp(min=1.0)
            offsets = self._offsets.double() - change
            for i in active:
                own = len(self._course.runs.groups[self._owner[i]])
                self._offsets[i, :own] = (offsets[i, :own] - offsets[i, :own].mean(0)).float()
        return np.asarray(torch.sqrt(sums.squares / sums.weight.clamp(min=1e-30)).cpu().numpy())

    def _differentiate(self, number: int, part: slice, sums: EpochSums) -> None:
        """Put the gradients of one batch of some attempts in their places, and note the errors."""
        batch = self._course.take(number, part)
        if batch is None:
            self._stack.gradient[part] = 0.0
            return
        tracked = self._stack.track(part)
        drift, states = self._network.run_many(tracked, batch.features, batch.state)
        self._course.keep(states.detach())
        error = drift[-len(batch.target) :] - batch.target
        if self._tared:
            where = batch.group[..., None].expand(-1, -1, error.shape[2])
            error = error + torch.gather(self._offsets[part], 1, where).transpose(1, 2)
        error = error * batch.weight
        total = batch.weight.sum((0, 2, 3)) * error.shape[2]
        squares = error.square().sum((0, 2, 3))
        self._stack.differentiate((squares / total.clamp(min=1.0)).sum(), part, tracked)
        sums.squares[part] += squares.detach().double()
        sums.weight[part] += total.double()
        if self._tared:
            self._add_by_group(sums, part, error.detach(), batch)

    def _add_by_group(self, sums: EpochSums, part: slice, error: Tensor, batch: Batch) -> None:
        """Add errors [S, A, K, B] and their weights to the sums of their groups."""
        first = torch.arange(part.start, part.stop, device=self._device)[:, None] * self._groups
        weight = batch.weight.sum(0).transpose(1, 2).expand(-1, -1, error.shape[2])
        found = torch.stack([error.sum(0).transpose(1, 2), weight], dim=-1)
        sums.by_group.index_add_(0, (first + batch.group).reshape(-1), found.flatten(0, 1))

    def _step(self, number: int) -> None:
        """Take a step on every attempt that has a batch, each at its own place in its cycle."""
        s, moving = self._settings, self._course.find_moving(number)
        rates = [
            s.learning_rate
            * one_cycle((a.epoch * a.batches + number) / (a.epochs * a.batches), s.warm_up)
            if moves
            else 0.0
            for a, moves in zip(self.attempts, moving, strict=True)
        ]
        self._stack.step(rates, moving)
        self._constrain()

    def _constrain(self) -> None:
        """Bring all weights to what their kind of network allows."""
        self._network.constrain_many(self._stack.read(), self._reach, self._swing)

    def _judge(self, train_rmse: Array, due: Sequence[int]) -> None:
        """Keep the weights of those that are at their best; with nothing held out, the latest."""
        if len(due) == 0:
            return
        rmse = train_rmse if self._held is None else self._measure(self._held)
        flat = self._stack.flat.cpu().numpy()
        for i in due:
            attempt = self.attempts[i]
            attempt.last_rmse = float(rmse[i])
            if self._held is not None and rmse[i] >= attempt.best_rmse:
                continue
            attempt.best_rmse, attempt.best_epoch = float(rmse[i]), attempt.epoch
            attempt.best = self._stack.unstack(flat[i], i)

    def _measure(self, held: Runs) -> Array:
        """Return the RMSE [A] on the held-out runs, without each one's offset where tared."""
        with torch.no_grad():
            answer = self._answer_windows(held) if self._windowed else self._answer_streams(held)
        front = held.length - answer.shape[2]
        target, weight = (a[self._owner_t, :, front:] for a in (held.target, held.weight))
        error, counts = (target - answer).cpu().numpy(), weight[..., 0].cpu().numpy() > 0.0
        return np.array([self._pool(i, error[i], counts[i]) for i in range(len(error))])

    def _answer_streams(self, held: Runs) -> Tensor:
        """Return the answers [A, R, P, K] of networks that walk through whole runs."""
        parameters = self._stack.read()
        x = held.x[self._owner_t, :, :STEPS_AT_ONCE].permute(2, 0, 3, 1)
        state = self._network.rest_many(parameters, x[0])
        found = []
        for begin in range(0, held.length, STEPS_AT_ONCE):
            x = held.x[self._owner_t, :, begin : begin + STEPS_AT_ONCE].permute(2, 0, 3, 1)
            drift, states = self._network.run_many(parameters, x.contiguous(), state)
            state = states[-1]
            found.append(drift.permute(1, 3, 0, 2))
        return torch.cat(found, dim=2)

    def _answer_windows(self, held: Runs) -> Tensor:
        """Return the answers [A, R, P, K] of networks that walk through the window of a sample."""
        memory = int(self._settings.memory)
        parameters, piece = self._stack.read(), max(1, WINDOWS_AT_ONCE // held.count)
        windows = held.x.unfold(2, memory, 1)  # [sensors, R, P, I, T]
        found = []
        for start in range(0, len(self.attempts), self._block):
            part = slice(start, start + self._block)
            mine = {name: p[part] for name, p in parameters.items()}
            answers = []
            for begin in range(0, windows.shape[2], piece):
                x = windows[self._owner_t[part], :, begin : begin + piece]
                shape = x.shape[:3]
                x = x.permute(4, 0, 3, 1, 2).flatten(3).contiguous()
                cold = self._network.cold(x.shape[3]).to(self._device)
                drift, _ = self._network.run_many(mine, x, cold.expand(shape[0], -1, -1))
                answers.append(drift[-1].transpose(1, 2).reshape(*shape, -1))
            found.append(torch.cat(answers, dim=2))
        return torch.cat(found)

    def _pool(self, i: int, error: NDArray[np.floating], counts: Mask) -> float:
        """Return the RMSE of errors [R, P, K] where they count [R, P]."""
        by_group: dict[str, list[Array]] = {}
        for j, s in enumerate(self._problems[self._owner[i]].held_out):
            by_group.setdefault(s.group, []).append(error[j][counts[j]].astype(np.float64))
        parts = [np.concatenate(found) for found in by_group.values()]
        rest = [e - e.mean(axis=0) if self._tared else e for e in parts]
        return float(np.sqrt(np.mean(np.concatenate(rest) ** 2)))

    def export(self, i: int) -> Standing:
        """Return where an attempt stands, for a checkpoint."""
        attempt = self.attempts[i]
        if not attempt.is_active:
            return attempt.stand({})
        own = len(self._course.runs.groups[self._owner[i]])
        offsets: dict[str, Stored] = {"offsets": self._offsets[i, :own].cpu().numpy()}
        return attempt.stand(offsets | self._stack.export(i) | self._course.export(i))

    def restore(self, i: int, standing: Standing) -> None:
        """Put an attempt back to where a checkpoint was written."""
        self.attempts[i].take_up(standing)
        offsets = torch.from_numpy(standing.arrays["offsets"].astype(np.float32))
        self._offsets[i, : len(offsets)] = offsets.to(self._device)
        self._stack.restore(i, standing.arrays)
        self._course.restore(i, standing.arrays)


__all__ = ["EpochProgress", "Problem", "Result", "train_networks"]

# Trains any number of networks at once; one sensor is a batch of one.

AT_ONCE = 256
"""Networks that walk through the epochs together on the CPU."""
SAMPLES_AT_ONCE = 4_000_000
"""Samples of all networks that walk together, each run counted as long as the longest: they take
some 150 bytes each."""
BLOCK = 32
"""Networks in one pass forward and back on the CPU: more of them do not stay in its cache."""


@dataclass(frozen=True)
class EpochProgress:
    """The progress of a training after an epoch, for a progress bar."""

    done: float
    """Share of all epochs of all networks, 0 .. 1."""
    train_rmse: float
    """Of this epoch, averaged over the networks in step, in multiples of what physics leaves."""
    best_rmse: float
    """On the held-out runs (without any: in training), best so far of any network."""


@dataclass(frozen=True)
class Result:
    """The network that did best on the held-out runs."""

    weights: Mapping[str, Array32]
    start: int
    epoch: int
    """0 means that no epoch did better than physics alone."""
    rmse: float
    """On the held-out runs (without any: in training), in multiples of what physics leaves."""
    last_rmse: float
    """The same at the end of the cycle."""
    rmse_without: float
    """The same with the network silent."""


def train_networks(
    problems: Sequence[Problem],
    *,
    device: str = "cpu",
    checkpoint: Path | None = None,
    resume: bool = True,
    report: Callable[[EpochProgress], None] = lambda _: None,
) -> list[Result | InputError]:
    """Return for each problem its best start, or why its training diverged.

    Args:
        problems: of one kind of network; the numbers of features, runs and samples differ as they
            like.
        device: where the tensors are: "cpu" or "cuda".
        checkpoint: file to keep the state in, as often as the networks are judged.
        resume: take up the checkpoint, if there is one of these very inputs.
        report: called after each epoch.
    """
    torch.set_num_threads(1)  # with two, steps this small take far longer
    attempts = _list_attempts(problems)
    mark = mark_problems(problems) if checkpoint else ""
    stood = load_standings(checkpoint, mark, attempts) if checkpoint and resume else {}
    for number, standing in stood.items():
        if standing.epoch == attempts[number].epochs:
            attempts[number].take_up(standing)
    largest = max((len(p.sequences) * max(map(len, p.sequences)) for p in problems), default=1)
    room = max(1, SAMPLES_AT_ONCE // largest)
    at_once = min(AT_ONCE, room) if device == "cpu" else room
    total = sum(a.epochs for a in attempts)
    for part in _arrange(problems, attempts, at_once):
        going = [a for a in part if a.is_active]
        if not going:
            continue
        training = Training(problems, going, device, BLOCK if device == "cpu" else len(going))
        for i, a in enumerate(going):
            if a.number in stood:
                training.restore(i, stood[a.number])

        def follow(train_rmse: float, judged: bool, training: Training = training) -> None:
            if checkpoint and judged:
                save_standings(checkpoint, mark, _list_standings(attempts, training))
            done = sum(a.epoch if a.error is None else a.epochs for a in attempts) / total
            report(EpochProgress(done, train_rmse, min(a.best_rmse for a in attempts)))

        training.run(follow)
    return [_choose(attempts, index) for index in range(len(problems))]


def _list_attempts(problems: Sequence[Problem]) -> list[Attempt]:
    """Return the starts of all problems."""
    pairs = [(index, start) for index, p in enumerate(problems) for start in p.settings.starts]
    return [
        Attempt(
            number, index, start, problems[index].settings.epochs, problems[index].count_batches()
        )
        for number, (index, start) in enumerate(pairs)
    ]


def _list_standings(attempts: Sequence[Attempt], training: Training) -> dict[int, Standing]:
    """Return where every attempt stands that is complete or on its way."""
    found = {a.number: a.stand({}) for a in attempts if a.epoch == a.epochs}
    going = enumerate(training.attempts)
    return found | {a.number: training.export(i) for i, a in going if a.error is None}


def _arrange(
    problems: Sequence[Problem], attempts: Sequence[Attempt], at_once: int
) -> list[list[Attempt]]:
    """Return the attempts in parts that are trained in step: those that are judged alike."""
    alike: dict[tuple[bool, bool], list[Attempt]] = {}
    for attempt in attempts:
        problem = problems[attempt.problem]
        alike.setdefault((problem.tared, bool(problem.held_out)), []).append(attempt)
    parts = []
    for found in alike.values():
        # Those that end an epoch together go together.
        found.sort(key=lambda a: (a.batches, a.epochs))
        parts += [found[i : i + at_once] for i in range(0, len(found), at_once)]
    return parts


def _choose(attempts: Sequence[Attempt], problem: int) -> Result | InputError:
    """Return the best start of a problem, the earlier one where they are equal."""
    mine = [a for a in attempts if a.problem == problem]
    for attempt in mine:
        if attempt.error is not None:
            return attempt.error
    best = min(mine, key=lambda a: a.best_rmse)
    return Result(
        weights=best.best,
        start=best.start,
        epoch=best.best_epoch,
        rmse=best.best_rmse,
        last_rmse=best.last_rmse,
        rmse_without=best.rmse_without,
    )
