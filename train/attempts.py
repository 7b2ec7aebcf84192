"""Training problems, the starts of each, and a start's state in a checkpoint."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift.base.records import Json, from_json
from zerodrift.base.terminal import tell
from zerodrift.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from zerodrift.train.networks import Network
from zerodrift.train.sequences import Array32, Sequence32
from zerodrift.train.settings import Settings

Stored = NDArray[np.generic]
"""An array of a checkpoint."""


@dataclass(frozen=True)
class Problem:
    """One sensor's training."""

    build: Callable[[torch.Generator], Network]
    """Makes the untrained network."""
    sequences: Sequence[Sequence32]
    """What to learn from."""
    held_out: Sequence[Sequence32]
    """Runs by which start and epoch are chosen; empty = best start, last epoch."""
    settings: Settings
    """Problems that are trained together may differ only in starts and epochs."""
    tared: bool = False
    """Each group has an offset of its own."""

    def count_batches(self) -> int:
        """Return the number of optimiser steps in an epoch."""
        s = self.settings
        if s.memory == "stream":
            chunks = sum(-(-len(x) // s.chunk) for x in self.sequences)
            return max(1, -(-chunks // s.batch))
        windows = sum(len(x) for x in self.sequences)
        return max(1, -(-windows // (s.chunk * s.batch // int(s.memory))))


@dataclass(frozen=True)
class Standing:
    """The state of an attempt in a checkpoint."""

    epoch: int
    best_epoch: int
    best_rmse: float
    last_rmse: float
    best: Mapping[str, Array32]
    """The weights of `best_epoch`."""
    arrays: Mapping[str, Stored]
    """Weights, moments and states to continue from; empty for a complete attempt."""
    rmse_without: float | None = None
    """RMSE of the untrained network; None: not kept, as it can be computed again."""


@dataclass
class Attempt:
    """One start of one problem: what is known of it from epoch to epoch."""

    number: int
    """Among all attempts."""
    problem: int
    start: int
    epochs: int
    batches: int
    epoch: int = 0
    """Epochs that are done."""
    best: Mapping[str, Array32] = field(default_factory=dict)
    best_epoch: int = 0
    best_rmse: float = math.inf
    last_rmse: float = math.inf
    rmse_without: float = math.inf
    error: InputError | None = None

    @property
    def is_active(self) -> bool:
        """Whether epochs are left."""
        return self.epoch < self.epochs and self.error is None

    def take_up(self, standing: Standing) -> None:
        """Go back to where a checkpoint was written."""
        self.epoch, self.best, self.best_epoch = standing.epoch, standing.best, standing.best_epoch
        self.best_rmse, self.last_rmse = standing.best_rmse, standing.last_rmse
        if standing.rmse_without is not None:
            self.rmse_without = standing.rmse_without

    def stand(self, arrays: Mapping[str, Stored]) -> Standing:
        """Return what a checkpoint holds of it."""
        return Standing(
            epoch=self.epoch,
            best_epoch=self.best_epoch,
            best_rmse=self.best_rmse,
            last_rmse=self.last_rmse,
            best=self.best,
            arrays=arrays,
            rmse_without=self.rmse_without,
        )


# What a checkpoint of a training holds: where each attempt stands, and a mark of the inputs.

NUMBERS = ("epoch", "best_epoch", "best_rmse", "last_rmse", "rmse_without")
MOMENTS = ("weights", "exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class _Numbers:
    """The numbers of a standing as a checkpoint holds them; null for infinity."""

    epoch: int
    best_epoch: int
    best_rmse: float | None
    last_rmse: float | None
    rmse_without: float | None = None


@dataclass(frozen=True)
class _Attempts:
    """What a checkpoint holds beside its arrays."""

    attempts: Mapping[str, _Numbers]
    """By the number of the attempt."""


@dataclass(frozen=True)
class _Result:
    """The best start of those that were complete."""

    start: int
    epoch: int
    rmse: float
    last_rmse: float
    rmse_without: float


@dataclass(frozen=True)
class _InTurn:
    """The same of a file from when one start was trained after the other."""

    start: int
    epoch: int
    best_epoch: int
    best_rmse: float
    last_rmse: float
    result: _Result | None = None


def mark_problems(problems: Sequence[Problem]) -> str:
    """Return a mark of everything that decides the results."""
    marks = [_mark(problem) for problem in problems]
    return marks[0] if len(marks) == 1 else hashlib.sha256(" ".join(marks).encode()).hexdigest()


def _mark(problem: Problem) -> str:
    digest = hashlib.sha256(json.dumps(asdict(problem.settings), sort_keys=True).encode())
    digest.update(f"{problem.tared} {torch.__version__} {np.__version__}".encode())
    network = problem.build(torch.Generator().manual_seed(0))
    for name, p in network.named_parameters():
        digest.update(f"{name} {tuple(p.shape)}".encode())
    for asked, mark in ((network.contracting, b"contracting"), (network.limited, b"limited")):
        if asked:
            digest.update(mark)
    for use in (problem.sequences, problem.held_out):
        for s in use:
            digest.update(f"{s.group} {s.features.shape} {s.skip}".encode())
            digest.update(np.ascontiguousarray(s.features).tobytes())
            digest.update(np.ascontiguousarray(s.target).tobytes())
    return digest.hexdigest()


def save_standings(path: Path, mark: str, standings: Mapping[int, Standing]) -> None:
    """Write a checkpoint.

    Args:
        path: the file.
        mark: of the inputs.
        standings: by the number of the attempt; one that is missing has not begun.
    """
    arrays: dict[str, Stored] = {}
    for number, standing in standings.items():
        arrays |= {f"{number}.best.{name}": value for name, value in standing.best.items()}
        arrays |= {f"{number}.{name}": value for name, value in standing.arrays.items()}
    values: dict[str, Json] = {
        str(number): {name: _store(getattr(standing, name)) for name in NUMBERS}
        for number, standing in standings.items()
    }
    save_checkpoint(path, Checkpoint(arrays, {"mark": mark, "attempts": values}))


def load_standings(path: Path, mark: str, attempts: Sequence[Attempt]) -> dict[int, Standing]:
    """Return where each attempt stood, by its number; nothing if the file is of other inputs.

    Args:
        path: the checkpoint; it need not exist.
        mark: of the inputs.
        attempts: all of them.
    """
    try:
        stored = load_checkpoint(path)
    except InputError as error:
        tell(f"{error} The training is begun again.")
        return {}
    if stored is None or stored.values.get("mark") != mark:
        return {}
    if "attempts" not in stored.values:
        in_turn = from_json(_InTurn, stored.values, str(path))
        return _read_in_turn(in_turn, stored.arrays, attempts)
    found = {}
    for text, numbers in from_json(_Attempts, stored.values, str(path)).attempts.items():
        mine = _pick(stored.arrays, f"{text}.")
        found[int(text)] = Standing(
            epoch=numbers.epoch,
            best_epoch=numbers.best_epoch,
            best_rmse=_restore(numbers.best_rmse),
            last_rmse=_restore(numbers.last_rmse),
            best={name: x.astype(np.float32) for name, x in _pick(mine, "best.").items()},
            arrays=mine,
            rmse_without=numbers.rmse_without,
        )
    return found


def _read_in_turn(
    told: _InTurn, arrays: Mapping[str, Stored], attempts: Sequence[Attempt]
) -> dict[int, Standing]:
    """Return the standings of a file from when one start was trained after the other.

    It holds the start that was on its way, and the best of those that were complete.
    """
    result = told.result
    found = {}
    for attempt in attempts:
        best = {k: v.astype(np.float32) for k, v in _pick(arrays, "result.").items()}
        if attempt.start == told.start:
            break
        if result is not None and attempt.start == result.start:
            numbers = (result.epoch, result.rmse, result.last_rmse)
            found[attempt.number] = Standing(
                attempt.epochs, *numbers, best, {}, result.rmse_without
            )
        else:
            found[attempt.number] = Standing(attempt.epochs, 0, math.inf, math.inf, {}, {})
    state = {k: v for k, v in arrays.items() if k.split(".")[0] in MOMENTS} | {
        "offsets": arrays["offsets"],
        "step": next(v for k, v in arrays.items() if k.startswith("step.")),
    }
    if "course.states" in arrays:
        state["states"] = arrays["course.states"].transpose(2, 0, 1)
    found[attempt.number] = Standing(
        epoch=told.epoch,
        best_epoch=told.best_epoch,
        best_rmse=told.best_rmse,
        last_rmse=told.last_rmse,
        best={k: v.astype(np.float32) for k, v in _pick(arrays, "attempt.").items()},
        arrays=state,
    )
    return found


def _store(number: float | None) -> float | None:
    """Return a number as JSON can hold it: nothing where it is not known."""
    return number if number is not None and math.isfinite(number) else None


def _restore(number: float | None) -> float:
    """Return a number that was stored."""
    return math.inf if number is None else number


def _pick(arrays: Mapping[str, Stored], prefix: str) -> dict[str, Stored]:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
