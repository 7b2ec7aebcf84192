"""A short training of trained GRUs in the chip's own arithmetic, for coarse weights.

The integer network learns to answer as the float one does, over the training runs' features as the
chip computes them. What the float network has learnt from the measurements is not learnt again, so
that noise, tares and held-out runs have no part in it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from zerodrift.base.errors import InputError
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.train.attempts import Problem
from zerodrift.train.engine import train_networks
from zerodrift.train.integer_network import IntegerGruNetwork
from zerodrift.train.sequences import Sequence32
from zerodrift.train.settings import Settings, Tuning


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
    settings: Tuning | None = None,
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
    s = settings or Tuning()
    recipe = Settings(
        memory=memory,
        seed=s.seed,
        starts=(0,),
        epochs=s.epochs,
        learning_rate=s.learning_rate,
        weight_decay=0.0,
        chunk=s.chunk,
        batch=s.batch,
        warm_up=s.warm_up,
        evaluations=s.evaluations,
    )
    problem = Problem(lambda _: network, sequences, sequences, recipe)
    (found,) = train_networks([problem], report=lambda p: report(p.done, p.best_rmse))
    if isinstance(found, InputError):
        raise found
    network.load_state_dict({k: torch.from_numpy(v) for k, v in found.weights.items()})
    return Tuned(network.to_float(), found.rmse_without, found.rmse, found.epoch)
