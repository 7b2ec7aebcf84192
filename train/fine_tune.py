"""A short training of trained GRUs in the chip's own arithmetic, for coarse weights.

The integer network learns to answer as the float one does, over the training runs' features as the
chip computes them. What the float network has learnt from the measurements is not learnt again, so
that noise, tares and held-out runs have no part in it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from zerodrift.operations.gru.cell import FloatGru
from zerodrift.train.integer_network import IntegerGruNetwork
from zerodrift.train.optimise import GRADIENT_LIMIT, one_cycle
from zerodrift.train.sequences import (
    Course,
    Sequence32,
    StreamCourse,
    WindowCourse,
    predict_sequences,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Settings:
    """How the fine-tuning is done."""

    epochs: int = 24
    learning_rate: float = 2e-4
    """Peak of the one cycle; a row's step at 8 bits is 1/127 of its largest weight."""
    warm_up: float = 0.1
    chunk: int = 32
    """Samples over which a stream is differentiated."""
    batch: int = 64
    """Chunks in a step of the optimiser."""
    evaluations: int = 12
    """How often all runs are walked through from their start and the best weights are kept."""
    seed: int = 0


@dataclass(frozen=True)
class Tuned:
    """What a fine-tuning gave."""

    layers: tuple[FloatGru, ...]
    """Weights whose quantized form answers best, from the bottom up; the first ones if no other did
    better."""
    before: float
    """RMS difference from the float network before, in shares of the float network's answer."""
    after: float
    epoch: int
    """0: the first weights were kept."""


def fine_tune(
    network: IntegerGruNetwork,
    sequences: Sequence[Sequence32],
    memory: str | int,
    settings: Settings | None = None,
    report: Callable[[float, float], None] = lambda done, rms: None,
) -> Tuned:
    """Train an integer network towards the targets; the same inputs give the same weights.

    Args:
        network: starts from trained weights, and is changed.
        sequences: features in counts, targets from the float network in the network's scale.
        memory: "stream", or the window's length in samples.
        settings: the recipe.
        report: is told the share that is done and the difference so far.
    """
    s = settings or Settings()
    torch.set_num_threads(1)
    course: Course
    if memory == "stream":
        course = StreamCourse(sequences, s.chunk, s.batch)
    else:
        course = WindowCourse(sequences, int(memory), s.chunk * s.batch // int(memory))
    optimiser = torch.optim.Adam(network.parameters(), lr=s.learning_rate, betas=(0.9, 0.99))
    before = best = measure(network, sequences, memory)
    kept, kept_epoch = network.to_float(), 0
    every = max(1, s.epochs // s.evaluations)
    for epoch in range(s.epochs):
        rng = np.random.default_rng((s.seed, epoch))
        for number, batch in enumerate(course.walk(network, rng)):
            place = (epoch + number / course.batches_per_epoch) / s.epochs
            for group in optimiser.param_groups:
                group["lr"] = s.learning_rate * one_cycle(place, s.warm_up)
            drift, states = network(batch.features, batch.state)
            course.keep(batch, states)
            error = (drift[-batch.target.shape[0] :] - batch.target) * batch.weight
            loss = error.square().sum() / (batch.weight.sum() * error.shape[1])
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), GRADIENT_LIMIT)
            optimiser.step()
        if (epoch + 1) % every == 0 or epoch + 1 == s.epochs:
            rms = measure(network, sequences, memory)
            if rms < best:
                best, kept, kept_epoch = rms, network.to_float(), epoch + 1
        report((epoch + 1) / s.epochs, best)
    return Tuned(kept, before, best, kept_epoch)


def measure(
    network: IntegerGruNetwork, sequences: Sequence[Sequence32], memory: str | int
) -> float:
    """Return the RMS difference between a network's answers and the targets."""
    answers = predict_sequences(network, [s.features for s in sequences], memory)
    errors = [s.target - a for s, a in zip(sequences, answers, strict=True)]
    return math.sqrt(float(np.mean(np.concatenate(errors) ** 2)))
