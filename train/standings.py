"""What a checkpoint of a training holds: where each attempt stands, and a mark of the inputs."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from zerodrift.base.errors import InputError
from zerodrift.base.lock import tell
from zerodrift.base.records import Json, from_json
from zerodrift.train.attempts import Attempt, Problem, Standing, Stored
from zerodrift.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint

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
