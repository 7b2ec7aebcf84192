"""Training problems, the starts of each, and a start's state in a checkpoint."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
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
