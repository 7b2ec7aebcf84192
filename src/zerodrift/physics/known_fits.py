"""The last few fits, so that a model is not fitted again that was just fitted to the same runs.

Errors left out, the diagnosis and the curves of an effect each ask for the fit of the model as it
is; a fit is a function of its question alone.
"""

import weakref
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Run
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.model import PhysicalModel

MOST_KNOWN = 8


@dataclass(frozen=True)
class FitQuestion:
    """What is fitted to what: effects by their tables, runs and catalogue by their identity."""

    effects: tuple[EffectConfig, ...]
    names: tuple[tuple[str, ...], tuple[str, ...], tuple[float, ...]]
    """Outputs, their units, their full scales."""
    runs: tuple["weakref.ref[Run]", ...]
    """Kept no longer than others keep them, and so is the catalogue."""
    catalogue: "weakref.ref[Catalogue]"

    def is_same(self, other: "FitQuestion") -> bool:
        """Return whether both ask for one fit; what is gone is the same as nothing."""
        return (
            self.effects == other.effects
            and self.names == other.names
            and len(self.runs) == len(other.runs)
            and all(
                one() is not None and one() is another()
                for one, another in zip(self.runs, other.runs, strict=True)
            )
            and self.catalogue() is not None
            and self.catalogue() is other.catalogue()
        )


_KNOWN: deque[tuple[FitQuestion, PhysicalModel]] = deque(maxlen=MOST_KNOWN)


def ask(
    effects: Sequence[EffectConfig],
    runs: Sequence[Run],
    names: tuple[Sequence[str], Sequence[str], Sequence[float]],
    catalogue: Catalogue,
) -> FitQuestion:
    """Return the question of a fit.

    Args:
        effects: the `[[effect]]` tables.
        runs: the training runs.
        names: outputs, their units, their full scales.
        catalogue: the known effects.
    """
    outputs, units, scales = names
    return FitQuestion(
        tuple(effects),
        (tuple(outputs), tuple(units), tuple(scales)),
        tuple(weakref.ref(run) for run in runs),
        weakref.ref(catalogue),
    )


def recall(question: FitQuestion) -> PhysicalModel | None:
    """Return the model that was fitted to the same question, if it is known."""
    return next((model for known, model in list(_KNOWN) if known.is_same(question)), None)


def keep(question: FitQuestion, model: PhysicalModel) -> None:
    """Keep a fit."""
    _KNOWN.append((question, model))
