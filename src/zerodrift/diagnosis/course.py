"""Diagnosis repeated: add what is missing until nothing is, or until it has no name."""

from collections.abc import Sequence
from dataclasses import dataclass

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.case import Advance, open_case
from zerodrift.diagnosis.changes import extend_model
from zerodrift.diagnosis.diagnose import diagnose, list_idle
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.physics.catalogue import Catalogue, load_catalogue

MOST_ADDED = 6
"""Effects that repeated diagnosis adds at most."""


@dataclass(frozen=True)
class RepeatedDiagnosis:
    """What repeated diagnosis came to: its steps, the model in the end, and what to drop."""

    steps: tuple[Diagnosis, ...]
    """The last one is not `missing`, unless the limit of steps was reached."""
    effects: tuple[EffectConfig, ...]
    """The `[[effect]]` tables in the end."""
    drop: tuple[str, ...]
    """Effects that no longer earn their place."""


def diagnose_until_done(
    effects: Sequence[EffectConfig],
    dataset: Dataset,
    catalogue: Catalogue | None = None,
    advance: Advance = lambda kind: None,
) -> RepeatedDiagnosis:
    """Return the course of adding what is missing until nothing is, or it cannot be named.

    Args:
        effects: the model's `[[effect]]` tables.
        dataset: its runs.
        catalogue: the known effects; by default the built-ins.
        advance: called with each effect's name when it has been tried.
    """
    catalogue = catalogue or load_catalogue()
    steps: list[Diagnosis] = []
    while len(steps) <= MOST_ADDED:
        steps.append(diagnose(effects, dataset, catalogue, advance))
        if steps[-1].effect is None:
            break
        effects = extend_model(effects, catalogue, steps[-1].effect, steps[-1].parameters)
    drop = list_idle(open_case(dataset, catalogue, effects, advance))
    return RepeatedDiagnosis(tuple(steps), tuple(effects), drop)
