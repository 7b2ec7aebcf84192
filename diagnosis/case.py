"""A model under diagnosis, with all that a verdict on it is drawn from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.offsets import lay_out_runs
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import check_terms
from zerodrift.physics.live import leave_out_still
from zerodrift.physics.signals import SignalPlan, plan_signals
from zerodrift.physics.terms import Term, start_term

Advance = Callable[[str], None]


@dataclass(frozen=True)
class Case:
    """A model under diagnosis: its runs, the catalogue, and its terms at starting values."""

    dataset: Dataset
    catalogue: Catalogue
    plan: SignalPlan
    terms: tuple[Term, ...]
    campaign: Campaign
    effects: tuple[EffectConfig, ...]
    """The model's `[[effect]]` tables."""
    advance: Advance = lambda kind: None
    """Called with each effect's name when it has been tried."""
    notes: tuple[str, ...] = ()
    """What was left out of the data, and what `add` would refuse."""


def open_case(
    dataset: Dataset,
    catalogue: Catalogue,
    effects: Sequence[EffectConfig],
    advance: Advance = lambda kind: None,
) -> Case:
    """Return the case, the runs with offsets of their own unless they share one.

    Args:
        dataset: the runs.
        catalogue: the known effects.
        effects: the model's `[[effect]]` tables.
        advance: called with each effect's name when it has been tried.

    Raises:
        InputError: an effect that these logs cannot feed or that stands there twice, or outputs of
            which none moves.
    """
    dataset, notes = leave_out_still(dataset)
    plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
    terms = tuple(start_term(catalogue, config) for config in effects)
    check_terms(terms, effects, plan)
    campaign = lay_out_runs(dataset.train, plan, catalogue, terms)
    return Case(dataset, catalogue, plan, terms, campaign, tuple(effects), advance, notes)
