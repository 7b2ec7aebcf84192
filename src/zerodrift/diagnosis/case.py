"""A model under diagnosis, with all that a verdict on it is drawn from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import betainc

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.candidates import Proposal, propose
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.operations.operation import Node
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.effect import Feature
from zerodrift.physics.fit import (
    NO_TREND,
    STILL_SCATTERED,
    TARE_RATIO,
    ClockTrend,
    check_terms,
    flat_weights,
    follows_clock_alone,
    measure_clock_trend,
)
from zerodrift.physics.live import leave_out_still
from zerodrift.physics.search import Found, grid, list_coordinates, search, set_coordinates
from zerodrift.physics.signals import SignalPlan, plan_signals
from zerodrift.physics.terms import Term, start_term

# Whether runs have offsets of their own, as tared logs have, or share one.

RUNS_PER_COLUMN = 3
"""Columns that may explain the runs' offsets need this many runs each, the constant too, ..."""
BY_CHANCE = 0.01
"""... unless they follow the clock alone, have nothing to be fitted beside their size, and chance
alone leaves so little of the offsets with at most this probability."""


@dataclass(frozen=True)
class Layout:
    """The runs made ready, and what was seen of their offsets."""

    campaign: Campaign
    trend: ClockTrend = NO_TREND
    """How the offsets follow the clock, where runs differ in them and nobody says why."""


def lay_out_runs(
    runs: Sequence[Run], plan: SignalPlan, catalogue: Catalogue, terms: Sequence[Term]
) -> Layout:
    """Return the runs made ready, with offsets of their own unless they share one.

    `[logs] tared` decides where it says so. Otherwise they share one if the model explains them
    about as well that way; if their offsets follow the clock; or if the model with one effect that
    it lacks explains them: ageing from run to run looks like a tare until it is in the model.

    Args:
        runs: the training runs.
        plan: their signals.
        catalogue: the known effects.
        terms: the model, at starting values.
    """
    order = list(catalogue)
    common = Campaign(runs, plan, order, tared=False, set_aside=True)
    said = runs[0].tared
    if len(common.groups) == 1 or said is False:
        return Layout(common)
    tared = Campaign(runs, plan, order, set_aside=True)
    if said:
        return Layout(tared)
    own = search(tared, terms, flat_weights(tared))
    shared = search(common, own.terms, flat_weights(common), vary=())
    if _compare(shared, own) < TARE_RATIO:
        return Layout(common)
    trend = measure_clock_trend(tared, own)
    if trend.is_real:
        return Layout(common, trend)
    proposal = _find_explanation(tared, own, propose(catalogue, own.terms, tared)[0])
    if proposal is None:
        return Layout(tared, trend)
    shared = search(common, proposal.terms, flat_weights(common), vary=(proposal.place,))
    own = search(tared, shared.terms, flat_weights(tared), vary=())
    return Layout(common if _compare(shared, own) < TARE_RATIO else tared, trend)


def _compare(shared: Found, own: Found) -> float:
    """Return the squared error with one offset over that with an offset for each run."""
    return float(np.mean(shared.solution.errors / own.solution.errors))


def _find_explanation(
    tared: Campaign, own: Found, proposals: Sequence[Proposal]
) -> Proposal | None:
    """Return the missing effect whose means over the runs explain the runs' offsets, if any."""
    known = {feature.name for feature in own.sums.features}
    offsets = tared.drift_means()
    for feature, row in zip(tared.build(own.terms), own.solution.coefficients.T, strict=True):
        offsets = offsets - tared.mean_of(feature.signal)[:, None] * row
    offsets = tared.average_runs(offsets)
    best, least = None, STILL_SCATTERED
    for proposal in proposals:
        free = [c for c in list_coordinates(proposal.terms) if c.term == proposal.place]
        of_time = follows_clock_alone(proposal.effect) and not free
        for u in grid(free) if free else [()]:
            terms = tuple(set_coordinates(proposal.terms, free, np.array(u)))
            new = [f for f in tared.build(terms) if f.name not in known]
            share = _scatter(offsets, tared, new, few=of_time)
            if share < least:
                best, least = replace(proposal, terms=terms), share
    return best


def _scatter(
    offsets: Array, tared: Campaign, features: Sequence[Feature[Node]], *, few: bool
) -> float:
    """Return the share of the offsets' squares [R, K] that the features' means leave.

    Args:
        offsets: of the runs.
        tared: the runs.
        features: of the effect.
        few: whether a line through fewer runs may convince.
    """
    runs, shares = len(offsets), []
    for k, output in enumerate(tared.plan.outputs):
        means = [tared.mean_of(f.signal) for f in features if f.output in (None, output)]
        seen = [tared.average_runs(column[:, None])[:, 0] for column in means]
        thin = RUNS_PER_COLUMN * (len(seen) + 1) > runs
        if not seen or (thin and not few) or len(seen) + 1 >= runs:
            return 1.0
        design = np.stack([np.ones(runs), *seen], axis=1)
        centred = offsets[:, k] - offsets[:, k].mean()
        rest = centred - design @ np.linalg.lstsq(design, centred, rcond=None)[0]
        share = float(rest @ rest) / max(float(centred @ centred), 1e-300)
        # Without any cause, the share that is left of normal offsets is beta distributed.
        chance = betainc(0.5 * (runs - 1 - len(seen)), 0.5 * len(seen), np.clip(share, 0.0, 1.0))
        if thin and chance > BY_CHANCE:
            return 1.0
        shares.append(share)
    return float(np.mean(shares))


# A model under diagnosis, with all that a verdict on it is drawn from.

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
