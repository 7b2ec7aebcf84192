"""Fits a physical model to runs: parameters, coefficients, their errors, and what is
undetermined.
"""

import itertools
import weakref
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import stdtrit

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.physics.campaign import Campaign, Sums
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.effect import Effect
from zerodrift.physics.live import find_live
from zerodrift.physics.model import FittedTerm, PhysicalModel
from zerodrift.physics.search import (
    Coordinate,
    Found,
    Solution,
    get_coordinates,
    invert_scaled,
    list_coordinates,
    note_arrivals,
    search,
    search_beyond_rails,
    slope_directions,
    solve,
    sum_with_slopes,
    weigh,
)
from zerodrift.physics.signals import (
    SignalPlan,
    build_stretches,
    explain_missing,
    plan_signals,
    read_signals,
)
from zerodrift.physics.terms import OFFSET, Term, start_term, tidy_terms

if TYPE_CHECKING:
    from zerodrift.physics.campaign import Campaign


# Whether the offsets of the runs follow the clock: then they are ageing, and no tare.

FEWEST = 3
"""Two offsets lie on a line whatever they are."""
BENDS = (0.03, 0.1, 0.3, 1.0)
"""A logarithmic drift turns from a line into a logarithm after these shares of the clock's span."""
STILL_SCATTERED = 0.1
"""Share of the offsets' squares that what explains them may leave: an effect that is missing, or a
line or a logarithm over the clock, ..."""
TREND_BY_CHANCE = 0.005
"""... so little being left by chance with at most this probability."""
DRAWS = 4000
"""Normal offsets drawn to tell what chance leaves; as many orders of the runs, where there are
more."""


@dataclass(frozen=True)
class ClockTrend:
    """How well the offsets of the runs follow the clock."""

    share: float
    """Of their squares that the best line or logarithm over the clock leaves."""
    chance: float
    """Probability that offsets drawn at random leave so little."""

    @property
    def is_real(self) -> bool:
        """Whether the offsets follow the clock by more than chance."""
        return self.share <= STILL_SCATTERED and self.chance <= TREND_BY_CHANCE


NO_TREND = ClockTrend(1.0, 1.0)


def follows_clock_alone(effect: Effect) -> bool:
    """Return whether an effect needs the clock and nothing else."""
    return set(effect.needs) == {"clock"}


def measure_clock_trend(tared: Campaign, found: Found) -> ClockTrend:
    """Return how well the offsets follow the clock, beside the model without its ageing.

    Args:
        tared: the runs, each with an offset of its own.
        found: the model fitted to them.
    """
    if "clock" not in tared.plan.channels or len(tared.groups) < FEWEST:
        return NO_TREND
    others = [term for term in found.terms if not follows_clock_alone(term.effect)]
    names = {feature.name for feature in tared.build(others)}
    offsets = tared.drift_means()
    for feature, row in zip(tared.build(found.terms), found.solution.coefficients.T, strict=True):
        if feature.name in names:
            offsets = offsets - tared.mean_of(feature.signal)[:, None] * row
    noise = np.sqrt(np.maximum(found.solution.errors, 0.0))
    alive = noise > 0.0
    return weigh_trend(tared.average_runs(offsets)[:, alive] / noise[alive], _read_clock(tared))


def weigh_trend(offsets: Array, clock: Array) -> ClockTrend:
    """Return how well offsets follow a clock.

    What is left is held against two kinds of chance: normal offsets, and these very offsets in any
    other order of the runs. One run that is far off, first or last, fools the one, and a line
    through three runs the other.

    Args:
        offsets: [R, K] of the runs, each output in units of its noise.
        clock: [R] when the runs were.
    """
    runs = clock.size
    centred = offsets - offsets.mean(axis=0)
    span = float(np.ptp(clock))
    if runs < FEWEST or span == 0.0 or not centred.any():
        return NO_TREND
    shapes = _list_shapes((clock - clock.min()) / span)
    share = float(_leave(centred[None], shapes)[0])
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(DRAWS, runs, 1))
    by_noise = _leave(normal - normal.mean(axis=1, keepdims=True), shapes)
    orders = list(itertools.islice(itertools.permutations(range(runs)), DRAWS + 1))
    drawn = len(orders) > DRAWS
    if drawn:
        orders = [tuple(rng.permutation(runs).tolist()) for _ in range(DRAWS)]
    by_order = _leave(centred[np.array(orders)], shapes) <= share * (1.0 + 1e-9)
    # Few runs have few orders: then this one and its reverse have to be the best of all.
    best = 0.0 if by_order.sum() <= 2 and not drawn else float(by_order.mean())
    return ClockTrend(share, max(float((by_noise <= share).mean()), best))


def _read_clock(campaign: Campaign) -> Array:
    """Return the mean of the clock over each run [R]."""
    total = dict.fromkeys(campaign.groups, 0.0)
    count = dict.fromkeys(campaign.groups, 0)
    for run in campaign.runs:
        total[run.group] += float(run.inputs["clock"].sum())
        count[run.group] += len(run)
    return np.array([total[group] / max(count[group], 1) for group in campaign.groups])


def _list_shapes(clock: Array) -> Array:
    """Return a line and logarithms over a clock [R] from 0 to 1, centred, of unit length [S, R]."""
    shapes = np.stack([clock, *(np.log1p(clock / bend) for bend in BENDS)])
    shapes -= shapes.mean(axis=1, keepdims=True)
    return np.asarray(shapes / np.linalg.norm(shapes, axis=1, keepdims=True))


def _leave(offsets: Array, shapes: Array) -> Array:
    """Return the share [N] of centred offsets' squares [N, R, K] that the best shape leaves."""
    explained = np.einsum("sr,nrk->nsk", shapes, offsets) ** 2
    whole = np.einsum("nrk,nrk->n", offsets, offsets)
    return np.asarray(1.0 - explained.sum(axis=2).max(axis=1) / np.maximum(whole, 1e-300))


# The last few fits, so that a model is not fitted again that was just fitted to the same runs.
#
# Errors left out, the diagnosis and the curves of an effect each ask for the fit of the model as it
# is; a fit is a function of its question alone.

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


# Fits a physical model to runs: parameters, coefficients, their errors, and what is undetermined.

TARE_RATIO = 1.25
"""Runs have offsets of their own where these lower the squared error by more than this factor, and
are not what the model's ageing makes of the clock."""
CLUSTERS = 8
"""Fewest runs whose scatter counts for the standard errors."""
FIT_ROWS = 60_000
"""Rows of a fit; more samples than that are averaged where signals are slow."""
UNTOLD = 10.0
"""Standard error of a coordinate that the runs say nothing about: all of its range."""
COLLINEAR = 0.03
"""A feature of which less than this share is left beside the others cannot be told from them."""


def fit_config(
    config: Config, dataset: Dataset, catalogue: Catalogue | None = None
) -> PhysicalModel:
    """Return the model of zerodrift.toml fitted to its training runs.

    Args:
        config: the project.
        dataset: its runs.
        catalogue: the known effects; by default the built-ins and the project's own.

    Raises:
        InputError: unknown effect or parameter, a held value out of bounds, a signal that is
            missing, or a user's effect that fails.
    """
    catalogue = catalogue or load_catalogue(config.plugin_files)
    return fit(
        config.effects,
        dataset.train,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        catalogue=catalogue,
    )


def fit(
    effects: Sequence[EffectConfig],
    runs: Sequence[Run],
    *,
    outputs: Sequence[str],
    units: Sequence[str],
    full_scale: Sequence[float],
    catalogue: Catalogue | None = None,
    start: PhysicalModel | None = None,
) -> PhysicalModel:
    """Return the model with these effects, fitted to the drift of the runs by least squares.

    Args:
        effects: the `[[effect]]` tables.
        runs: training runs.
        outputs: names of the K outputs.
        units: their units.
        full_scale: their full scales.
        catalogue: the known effects; by default the built-ins.
        start: an earlier fit to start from, which saves the search over typical ranges.
    """
    catalogue = catalogue or load_catalogue()
    question = ask(effects, runs, (outputs, units, full_scale), catalogue)
    known = recall(question) if start is None else None
    if known is not None:
        return known
    plan = plan_signals(runs, outputs, full_scale)
    terms = [start_term(catalogue, config) for config in effects]
    check_terms(terms, effects, plan)
    if start is not None:
        terms = _take_values(terms, start)
    model = fit_terms(terms, runs, plan, units, list(catalogue), search_starts=start is None)
    if start is None:
        keep(question, model)
    return model


def check_terms(terms: Sequence[Term], effects: Sequence[EffectConfig], plan: SignalPlan) -> None:
    """Refuse effects whose signals these logs lack, and an effect named twice.

    Raises:
        InputError: naming the line of zerodrift.toml.
    """
    seen: set[str] = set()
    for term, config in zip(terms, effects, strict=True):
        where = f"zerodrift.toml:{config.line}: " if config.line else ""
        reason = explain_missing(term.effect, plan, term.signal)
        if reason:
            raise InputError(
                f"{where}effect '{config.kind}' cannot be fitted: {reason}. Add the column to "
                "[inputs] or the reference to [outputs], or remove the effect."
            )
        if term.name in seen:
            raise InputError(
                f"{where}effect '{term.name}' stands here twice; remove one of the tables."
            )
        seen.add(term.name)


def _take_values(terms: Sequence[Term], start: PhysicalModel) -> list[Term]:
    """Return the terms at the values that an earlier fit found for those it has."""
    known = {fitted.term.name: fitted.term for fitted in start.terms}
    return [
        term.with_values({p.name: known[term.name].values[p.name] for p in term.free})
        if term.name in known
        else term
        for term in terms
    ]


def fit_terms(
    terms: Sequence[Term],
    runs: Sequence[Run],
    plan: SignalPlan,
    units: Sequence[str],
    order: Sequence[str],
    *,
    search_starts: bool = True,
) -> PhysicalModel:
    """Return the fitted model of these terms; `fit` says the rest."""
    vary = None if search_starts else ()
    set_aside = any(term.effect.sets_aside for term in terms)
    campaign = Campaign(runs, plan, order, tared=True, set_aside=set_aside, most_rows=FIT_ROWS)
    found = search_beyond_rails(campaign, terms, flat_weights(campaign), vary=vary)
    live = find_live(runs)
    said = runs[0].tared
    if len(campaign.groups) > 1 and live.any() and said is not True:
        common = campaign.share(tared=False)
        common.fill(found.terms, found.solution.coefficients)
        together = search(common, found.terms, flat_weights(common), vary=())
        ratio = float(np.mean((together.solution.errors / found.solution.errors)[live]))
        ageing = [i for i, term in enumerate(terms) if follows_clock_alone(term.effect)]
        if said is False or ratio < TARE_RATIO:
            campaign, found = common, together
        elif ageing and measure_clock_trend(campaign, found).is_real:
            again = ageing if search_starts else ()
            campaign, found = common, search(common, found.terms, flat_weights(common), vary=again)
    return _finish(campaign, replace(found, terms=tuple(tidy_terms(found.terms))), units)


def flat_weights(campaign: Campaign) -> Array:
    """Return the weights [L, K] of plain least squares: one, and none for means without offsets."""
    weights = np.ones((campaign.levels.size, len(campaign.plan.outputs)))
    if not campaign.uses_means:
        weights[campaign.means] = 0.0
    return weights


def _finish(campaign: Campaign, found: Found, units: Sequence[str]) -> PhysicalModel:
    """Return the model with errors, intervals, offsets and notes."""
    runs, plan, terms = campaign.runs, campaign.plan, found.terms
    coordinates = list_coordinates(terms)
    sums = sum_with_slopes(campaign, terms, coordinates)
    weights = flat_weights(campaign)
    solution = solve(sums, weigh(sums, weights).sum(axis=0))
    theta_errors, coefficient_errors = estimate_errors(
        campaign, sums, weights, solution, len(coordinates)
    )
    coefficients = solution.coefficients.T
    totals: dict[str, Array] = {}
    samples: dict[str, Array] = {}
    names: tuple[str, ...] = ()
    feature_units: tuple[str, ...] = ()
    built = build_stretches(runs, plan, terms, campaign.order)
    for run, (_, *columns) in zip(runs, built, strict=True):
        signals = read_signals(run, plan)
        names = tuple(column.name for column in columns)
        feature_units = tuple(column.unit for column in columns)
        rest = run.steady_drift
        for column, row in zip(columns, coefficients, strict=True):
            rest -= column.signal[:, None] * row
        counts = np.full(len(plan.outputs), float(len(run)))
        for name, flags in signals.saturated.items() if campaign.set_aside else ():
            k = plan.outputs.index(name)
            rest[flags > 0.0, k] = 0.0
            counts[k] -= flags.sum()
        totals[run.group] = totals.get(run.group, 0.0) + rest.sum(axis=0)
        samples[run.group] = samples.get(run.group, 0.0) + counts
    offsets = {group: totals[group] / np.maximum(samples[group], 1.0) for group in totals}
    tared = campaign.tared and len(campaign.groups) > 1
    if tared:
        constant = np.mean(np.stack(list(offsets.values())), axis=0)
    else:
        whole = np.sum(np.stack(list(samples.values())), axis=0)
        constant = np.sum(np.stack(list(totals.values())), axis=0) / np.maximum(whole, 1.0)
        offsets = {group: constant.copy() for group in offsets}
    scatter = np.std(np.stack(list(offsets.values())), axis=0) / np.sqrt(len(offsets))
    fitted = _attach_errors(terms, coordinates, theta_errors, len(campaign.groups))
    return PhysicalModel(
        plan=plan,
        units=tuple(units),
        terms=fitted,
        feature_names=(OFFSET, *names),
        feature_units=("1", *feature_units),
        coefficients=np.concatenate([constant[None], coefficients]),
        std_errors=np.concatenate([scatter[None], coefficient_errors]),
        offsets=offsets,
        tared=tared,
        notes=note_arrivals(terms, campaign.groups)
        + _note_bounds(fitted)
        + _note_collinearity(sums, weights, names),
        order=campaign.order,
    )


def estimate_errors(
    campaign: Campaign, sums: Sums, weights: Array, solution: Solution, count: int
) -> tuple[Array, Array]:
    """Return the standard errors of the coordinates [P] and of the coefficients [J, K].

    Residuals are correlated in time, so their variance is taken octave by octave and carried
    through the least-squares solution (the sandwich estimator); with eight runs or more also run by
    run (clusters), and the larger of the two holds.

    Source: White, Econometrica 48 (1980); Cameron and Miller, J. Human Resources 50 (2015).
    """
    size, outputs = sums.mask.shape
    live = find_live(campaign.runs)
    along = slope_directions(sums, solution, count)
    offsets = len(sums.features) + len(sums.slopes) + np.arange(sums.offsets)
    clustered = len(campaign.groups) >= CLUSTERS
    owners = np.arange(len(campaign.groups))[:, None] == campaign.run_of_piece
    errors = np.zeros((size, outputs))
    curvature = np.zeros((count, count))
    by_octave = np.zeros((count, count))
    by_run = np.zeros((len(campaign.groups), count))
    counts = sums.counts.sum(axis=0)
    weighted = per_octave = np.zeros(0)
    for k in range(outputs):
        seen = np.flatnonzero(sums.mask[:, k])
        plain = np.concatenate([seen, offsets]).astype(int)
        # Columns of the design: features and offsets, then the slopes along each coordinate.
        design = np.zeros((sums.products.shape[-1], plain.size + count))
        design[plain, np.arange(plain.size)] = 1.0
        design[:, plain.size :] = along[k]
        if k == 0 or (weights[:, k] != weights[:, k - 1]).any():
            weighted = np.einsum("l,glab->gab", weights[:, k], sums.products)
            per_octave = np.einsum("l,glab->lab", weights[:, k], sums.products)
        gram = design.T @ weighted.sum(axis=0) @ design
        inverse = invert_scaled(gram)
        residual = solution.residual[k]
        squares = (per_octave @ residual) @ residual
        inner = design.T @ per_octave @ design
        leverage = np.einsum("lab,ba->l", inner, inverse)
        freedom = np.maximum(counts - leverage, 1.0)
        meat = np.einsum("l,lab->ab", squares / freedom, inner)
        scores = owners @ ((weighted @ residual) @ design)
        scores *= np.sqrt(len(scores) / max(len(scores) - 1, 1))
        variance = np.diag(inverse @ meat @ inverse)
        if clustered:
            variance = np.maximum(variance, np.sum((scores @ inverse) ** 2, axis=0))
        errors[seen, k] = np.sqrt(np.maximum(variance[: seen.size], 0.0))
        if count and live[k]:
            first = gram[: plain.size, : plain.size]
            turn = np.concatenate(
                [-gram[plain.size :, : plain.size] @ invert_scaled(first), np.eye(count)], axis=1
            )
            weight = 1.0 / solution.errors[k]
            curvature += weight * turn @ gram @ turn.T
            by_octave += weight**2 * turn @ meat @ turn.T
            by_run += weight * scores @ turn.T
    if not count:
        return np.zeros(0), errors
    inverse = invert_scaled(curvature)
    variance = np.diag(inverse @ by_octave @ inverse)
    if clustered:
        variance = np.maximum(variance, np.sum((by_run @ inverse) ** 2, axis=0))
    # Without curvature the value may be anywhere in its range.
    told = np.diag(curvature) > 0.0
    return np.where(told, np.sqrt(np.maximum(variance, 0.0)), UNTOLD), errors


def _attach_errors(
    terms: Sequence[Term], coordinates: Sequence[Coordinate], errors: Array, runs: int
) -> tuple[FittedTerm, ...]:
    """Return the terms with errors and intervals in the parameters' own units.

    A scatter from few runs is itself uncertain, so Student's t is used, with one degree of freedom
    less than there are runs.
    """
    quantile = float(stdtrit(runs - 1, 0.975)) if runs >= CLUSTERS else 1.96
    u = get_coordinates(terms, coordinates)
    fitted = []
    for i, term in enumerate(terms):
        std_errors, intervals, at_bound = {}, {}, []
        for coordinate, position, error in zip(coordinates, u, errors, strict=True):
            if coordinate.term != i:
                continue
            name = coordinate.parameter.name
            std_errors[name] = float(abs(coordinate.slope(position)) * error)
            low, high = coordinate.bounds
            # An interval is cut at ten times the range.
            reach = min(quantile * error, UNTOLD * (high - low))
            intervals[name] = (
                coordinate.decode(position - reach),
                coordinate.decode(position + reach),
            )
            setting = coordinate.parameter.is_setting
            if min(position - low, high - position) < 1e-3 * (high - low) and not setting:
                at_bound.append(name)
        fitted.append(FittedTerm(term, std_errors, intervals, tuple(at_bound)))
    return tuple(fitted)


def _note_bounds(terms: Sequence[FittedTerm]) -> tuple[str, ...]:
    """Return a sentence for each parameter that ended at a bound."""
    return tuple(
        f"{fitted.term.name}: {name} = {fitted.term.values[name]:.4g} "
        f"{fitted.term.effect.parameter(name).unit} is at the bound of its range; "
        "the logs do not determine it or the effect is another one"
        for fitted in terms
        for name in fitted.at_bound
    )


def _note_collinearity(sums: Sums, weights: Array, names: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence for each feature that the others imitate almost completely."""
    notes = []
    gram = np.einsum("l,glab->ab", weights[:, 0], sums.products)
    offsets = [len(sums.features) + len(sums.slopes) + o for o in range(sums.offsets)]
    for j, name in enumerate(names):
        together = [
            i for i in range(len(names)) if i != j and (sums.mask[i] & sums.mask[j]).any()
        ] + offsets
        if not together or gram[j, j] <= 0.0:
            continue
        across = gram[j, together]
        left = gram[j, j] - across @ invert_scaled(gram[np.ix_(together, together)]) @ across
        share = float(np.sqrt(max(left, 0.0) / gram[j, j]))
        if share < COLLINEAR:
            notes.append(
                f"{name}: only {100 * share:.2g} % of it differs from the other features in these "
                "logs; its coefficient is not well determined on its own"
            )
    return tuple(notes)
