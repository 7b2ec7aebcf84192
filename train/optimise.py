"""The training loop: several starts, one learning-rate cycle each, the best epoch kept."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift.base.lock import tell
from zerodrift.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from zerodrift.train.networks import Network
from zerodrift.train.sequences import (
    Batch,
    Course,
    Sequence32,
    StreamCourse,
    WindowCourse,
    predict_sequences,
)

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

CYCLE_START, CYCLE_END = 1 / 25, 1e-4
"""The learning rate begins and ends at these shares of its peak."""
RESULT_NUMBERS = ("start", "epoch", "rmse", "last_rmse", "rmse_without")
GRADIENT_LIMIT = 1.0
"""Longest gradient; a longer one is shortened to this."""


@dataclass(frozen=True)
class Settings:
    """How a network is trained; `docs/explanation/training.md` says where the numbers come from."""

    memory: str | int = "stream"
    """"stream", or the window's length in samples."""
    seed: int = 0
    starts: tuple[int, ...] = (0, 1)
    """Which first weights to try; each number stands for its own draw."""
    epochs: int = 80
    """Length of the learning-rate cycle."""
    learning_rate: float = 2e-2
    """Peak of the one cycle."""
    weight_decay: float = 0.1
    """Per step and unit of learning rate, on weights but not on biases."""
    chunk: int = 32
    """Samples over which a stream is differentiated."""
    batch: int = 128
    """Chunks in a step of the optimiser; of windows, as many as hold that many samples."""
    warm_up: float = 0.25
    """Share of the steps in which the learning rate rises."""
    evaluations: int = 10
    """How often per start the held-out runs are looked at and the checkpoint is written."""


@dataclass(frozen=True)
class Progress:
    """Where a training stands, for a progress bar."""

    start: int
    epoch: int
    train_rmse: float
    """Of this epoch, in multiples of what physics leaves."""
    heldout_rmse: float
    """Best so far of this start."""


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


@dataclass
class _Attempt:
    """One start on its way: everything that changes from epoch to epoch."""

    start: int
    network: Network
    optimiser: torch.optim.AdamW
    course: Course
    offsets: Array
    """[G, K] offset of each group, which is not the network's to explain."""
    epoch: int = 0
    best: dict[str, Array32] = field(default_factory=dict)
    best_epoch: int = 0
    best_rmse: float = math.inf
    last_rmse: float = math.inf
    rmse_without: float = math.inf


class Trainer:
    """Trains a network from several starts; the same inputs give the same weights to the bit.

    That holds on one machine, and also for a training that was interrupted and taken up again.
    """

    def __init__(
        self,
        build: Callable[[torch.Generator], Network],
        sequences: Sequence[Sequence32],
        held_out: Sequence[Sequence32],
        settings: Settings,
        *,
        tared: bool = False,
        checkpoint: Path | None = None,
        report: Callable[[Progress], None] | None = None,
    ) -> None:
        """Take the problem.

        Args:
            build: makes the untrained network from a random generator.
            sequences: what to learn from.
            held_out: what start and epoch are chosen by; empty = best start, last epoch.
            settings: the recipe.
            tared: each group has an offset of its own.
            checkpoint: file to keep the state in, and in the end the result.
            report: called after each epoch.
        """
        self._build = build
        self._sequences, self._held_out = sequences, held_out
        self._settings = settings
        self._tared = tared
        self._checkpoint = checkpoint
        self._report = report or (lambda _: None)
        groups = list(dict.fromkeys(s.group for s in sequences))
        self._group_of_run = np.array([groups.index(s.group) for s in sequences])
        self._every = max(1, settings.epochs // settings.evaluations)
        self._mark = self._fingerprint()

    def run(self, resume: bool = True) -> Result:
        """Train and return the best network.

        Args:
            resume: take up the checkpoint, if there is one of these very inputs.

        Raises:
            InputError: the training diverged.
        """
        torch.set_num_threads(1)  # with two, a step of so small a network takes far longer
        stored = self._load() if resume else None
        best = _read_result(stored) if stored else None
        starts = self._settings.starts
        done = starts.index(stored.values["start"]) if stored else 0
        for start in starts[done:]:
            attempt = self._begin(start)
            if stored:
                _restore(attempt, stored)
                stored = None
            while attempt.epoch < self._settings.epochs:
                rmse = self._run_epoch(attempt)
                if attempt.epoch % self._every == 0 or attempt.epoch == self._settings.epochs:
                    self._judge(attempt, rmse)
                    self._save(attempt, best)
                self._report(Progress(start, attempt.epoch, rmse, attempt.best_rmse))
            if best is None or attempt.best_rmse < best.rmse:
                best = _conclude(attempt)
        assert best is not None
        return best

    def _begin(self, start: int) -> _Attempt:
        s = self._settings
        generator = torch.Generator().manual_seed(draw_seed(s.seed, start))
        network = self._build(generator)
        biases = [p for name, p in network.named_parameters() if "bias" in name]
        weights = [p for name, p in network.named_parameters() if "bias" not in name]
        optimiser = torch.optim.AdamW(
            [
                {"params": weights, "weight_decay": s.weight_decay},
                {"params": biases, "weight_decay": 0.0},
            ],
            lr=s.learning_rate,
            betas=(0.9, 0.99),
        )
        course: Course
        if s.memory == "stream":
            course = StreamCourse(self._sequences, s.chunk, s.batch)
        else:
            memory = int(s.memory)
            course = WindowCourse(self._sequences, memory, s.chunk * s.batch // memory)
        outputs = self._sequences[0].target.shape[1]
        offsets = np.zeros((int(self._group_of_run.max()) + 1, outputs))
        attempt = _Attempt(start, network, optimiser, course, offsets)
        self._judge(attempt, math.inf)
        attempt.rmse_without = attempt.best_rmse
        return attempt

    def _run_epoch(self, attempt: _Attempt) -> float:
        """Walk once through the training runs; return the RMSE on the way."""
        s = self._settings
        rng = np.random.default_rng((s.seed, attempt.start, attempt.epoch))
        batches = attempt.course.batches_per_epoch
        sums = np.zeros((*attempt.offsets.shape, 2))  # of error and of weight, by group
        squares = weight = 0.0
        for number, batch in enumerate(attempt.course.walk(attempt.network, rng)):
            place = (attempt.epoch * batches + number) / (s.epochs * batches)
            for group in attempt.optimiser.param_groups:
                group["lr"] = s.learning_rate * one_cycle(place, s.warm_up)
            drift, states = attempt.network(batch.features, batch.state)
            attempt.course.keep(batch, states)
            group_of = self._group_of_run[batch.run]
            offset = torch.from_numpy(attempt.offsets[group_of].T.astype(np.float32))
            error = (drift[-batch.target.shape[0] :] + offset - batch.target) * batch.weight
            total = batch.weight.sum() * error.shape[1]
            loss = error.square().sum() / total
            attempt.optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(attempt.network.parameters(), GRADIENT_LIMIT)
            attempt.optimiser.step()
            squares += loss.item() * float(total)
            weight += float(total)
            if self._tared:
                _add_by_group(sums, group_of, error.detach(), batch)
        attempt.epoch += 1
        if self._tared:
            attempt.offsets -= sums[..., 0] / np.maximum(sums[..., 1], 1.0)
            attempt.offsets -= attempt.offsets.mean(axis=0)
        rmse = math.sqrt(squares / weight)
        if not math.isfinite(rmse):
            raise explain_divergence(attempt.epoch, s.learning_rate)
        return rmse

    def _judge(self, attempt: _Attempt, train_rmse: float) -> None:
        """Keep the weights if they are the best so far; with nothing held out, the latest are."""
        rmse = self._measure(attempt.network) if self._held_out else train_rmse
        attempt.last_rmse = rmse
        if self._held_out and rmse >= attempt.best_rmse:
            return
        attempt.best_rmse, attempt.best_epoch = rmse, attempt.epoch
        attempt.best = {
            name: p.detach().numpy().copy() for name, p in attempt.network.named_parameters()
        }

    def _measure(self, network: Network) -> float:
        """Return the RMSE on the held-out runs, without the offset of each where logs are tared."""
        features = [s.features for s in self._held_out]
        answers = predict_sequences(network, features, self._settings.memory)
        by_group: dict[str, list[Array]] = {}
        for s, answer in zip(self._held_out, answers, strict=True):
            error = (s.target - answer)[s.skip :].astype(np.float64)
            by_group.setdefault(s.group, []).append(error)
        errors = [np.concatenate(parts) for parts in by_group.values()]
        rest = [e - e.mean(axis=0) if self._tared else e for e in errors]
        return float(np.sqrt(np.mean(np.concatenate(rest) ** 2)))

    def _fingerprint(self) -> str:
        """Return a mark of everything that decides the result."""
        digest = hashlib.sha256(json.dumps(asdict(self._settings), sort_keys=True).encode())
        digest.update(f"{self._tared} {torch.__version__} {np.__version__}".encode())
        network = self._build(torch.Generator().manual_seed(0))
        for name, p in network.named_parameters():
            digest.update(f"{name} {tuple(p.shape)}".encode())
        for use in (self._sequences, self._held_out):
            for s in use:
                digest.update(f"{s.group} {s.features.shape} {s.skip}".encode())
                digest.update(np.ascontiguousarray(s.features).tobytes())
                digest.update(np.ascontiguousarray(s.target).tobytes())
        return digest.hexdigest()

    def _load(self) -> Checkpoint | None:
        """Return the checkpoint if it is of this very training."""
        try:
            stored = load_checkpoint(self._checkpoint) if self._checkpoint else None
        except InputError as error:
            tell(f"{error} The training is begun again.")
            return None
        return stored if stored and stored.values["mark"] == self._mark else None

    def _save(self, attempt: _Attempt, best: Result | None) -> None:
        if self._checkpoint is None:
            return
        arrays: dict[str, NDArray[Any]] = {"offsets": attempt.offsets}
        for name, p in attempt.network.named_parameters():
            state = attempt.optimiser.state[p]
            arrays[f"weights.{name}"] = p.detach().numpy()
            for moment in ("exp_avg", "exp_avg_sq", "step"):
                arrays[f"{moment}.{name}"] = state[moment].numpy()
        arrays |= {f"course.{k}": v for k, v in attempt.course.export_memory().items()}
        arrays |= {f"attempt.{k}": v for k, v in attempt.best.items()}
        values: dict[str, Any] = {
            "mark": self._mark,
            "start": attempt.start,
            "epoch": attempt.epoch,
            "best_epoch": attempt.best_epoch,
            "best_rmse": attempt.best_rmse,
            "last_rmse": attempt.last_rmse,
        }
        if best:
            arrays |= {f"result.{k}": v for k, v in best.weights.items()}
            values["result"] = {name: getattr(best, name) for name in RESULT_NUMBERS}
        save_checkpoint(self._checkpoint, Checkpoint(arrays, values))


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


def _add_by_group(
    sums: Array, group_of: NDArray[np.int64], error: torch.Tensor, batch: Batch
) -> None:
    """Add errors [S, K, B] and weights to sums [G, K, 2]."""
    np.add.at(sums[..., 0], group_of, error.sum(0).T.numpy().astype(np.float64))
    np.add.at(sums[..., 1], group_of, batch.weight.sum(0).T.numpy().astype(np.float64))


def _conclude(attempt: _Attempt) -> Result:
    """Return what became of a start."""
    return Result(
        weights=attempt.best,
        start=attempt.start,
        epoch=attempt.best_epoch,
        rmse=attempt.best_rmse,
        last_rmse=attempt.last_rmse,
        rmse_without=attempt.rmse_without,
    )


def _pick(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def _read_result(stored: Checkpoint) -> Result | None:
    """Return the best of the starts that are complete."""
    found = stored.values.get("result")
    if found is None:
        return None
    return Result(weights=_pick(stored.arrays, "result."), **found)


def _restore(attempt: _Attempt, stored: Checkpoint) -> None:
    """Put an attempt back to where its checkpoint was written."""
    arrays, values = stored.arrays, stored.values
    for name, p in attempt.network.named_parameters():
        with torch.no_grad():
            p.copy_(torch.from_numpy(arrays[f"weights.{name}"]))
        attempt.optimiser.state[p] = {
            moment: torch.from_numpy(arrays[f"{moment}.{name}"])
            for moment in ("step", "exp_avg", "exp_avg_sq")
        }
    attempt.course.import_memory(_pick(arrays, "course."))
    attempt.offsets = arrays["offsets"]
    attempt.epoch = int(values["epoch"])
    attempt.best = _pick(arrays, "attempt.")
    attempt.best_epoch, attempt.best_rmse = int(values["best_epoch"]), float(values["best_rmse"])
    attempt.last_rmse = float(values["last_rmse"])
