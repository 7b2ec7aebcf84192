"""A model under diagnosis, with all that a verdict on it is drawn from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.diagnosis.offsets import lay_out_runs
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import check_terms
from zerodrift.physics.live import leave_out_still
from zerodrift.physics.run_offsets import NO_TREND, ClockTrend, follows_clock_alone
from zerodrift.physics.signals import SignalPlan, plan_signals
from zerodrift.physics.terms import Term, start_term

Advance = Callable[[str], None]

LEAST_SHARE = 1e-12
"""Share of the full scale that the floor is held above, as errors are divided by it."""


@dataclass(frozen=True)
class Case:
    """A model under diagnosis: its runs, the catalogue, and its terms at starting values."""

    dataset: Dataset
    catalogue: Catalogue
    plan: SignalPlan
    terms: tuple[Term, ...]
    campaign: Campaign
    floor: Array
    """[K] RMS of the noise, as `compare` has it."""
    effects: tuple[EffectConfig, ...]
    """The model's `[[effect]]` tables."""
    advance: Advance = lambda kind: None
    """Called with each effect's name when it has been tried."""
    notes: tuple[str, ...] = ()
    """What was left out of the data, and what `add` would refuse."""
    whole: Dataset | None = None
    """The logs as they were read, by which `add` judges; None: they are `dataset`."""
    trend: ClockTrend = NO_TREND
    """How the runs' offsets follow the clock, where they differ and nobody says why."""

    @property
    def follows_clock(self) -> bool:
        """Whether the runs' offsets follow the clock, and the model has nothing that does."""
        present = any(follows_clock_alone(term.effect) for term in self.terms)
        return self.trend.is_real and not present


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
    read, whole = dataset, measure_floor(dataset).rms
    names = dataset.outputs
    dataset, notes = leave_out_still(dataset)
    floor = whole[[names.index(name) for name in dataset.outputs]]
    plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
    terms = tuple(start_term(catalogue, config) for config in effects)
    check_terms(terms, effects, plan)
    layout = lay_out_runs(dataset.train, plan, catalogue, terms)
    return Case(
        dataset,
        catalogue,
        plan,
        terms,
        layout.campaign,
        np.maximum(floor, LEAST_SHARE * np.array(dataset.full_scale)),
        tuple(effects),
        advance,
        notes,
        read,
        layout.trend,
    )
