"""What a batch of trainings is made of: problems, attempts, runs and chunks laid side by side."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.base.errors import InputError
from zerodrift.train.networks import GruNetwork
from zerodrift.train.optimise import Settings
from zerodrift.train.sequences import Sequence32


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
class Attempt:
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


class Runs:
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
class Chunks:
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
class Sums:
    """Of one epoch, [A] squared errors and their weights, [A G, K, 2] errors and weights."""

    squares: Tensor
    weight: Tensor
    by_group: Tensor
