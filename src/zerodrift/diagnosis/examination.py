"""One look at a model: what each effect that it lacks would gain, run by run, beside the floor."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.candidates import (
    Candidate,
    Untested,
    are_sound,
    fit_leaders_again,
    judge_again,
    propose,
    try_candidates,
)
from zerodrift.diagnosis.evidence import (
    Errors,
    compare_likelihoods,
    flip_signs,
    hold_in,
    hold_out,
)
from zerodrift.diagnosis.noise import Noise, measure_noise
from zerodrift.diagnosis.span import measure_span
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.search import (
    Found,
    get_coordinates,
    list_coordinates,
    search,
    search_beyond_rails,
    sum_with_slopes,
)
from zerodrift.physics.signals import SignalPlan, build_stretches
from zerodrift.physics.terms import Term

PRIOR_COUNT = 8.0
"""The dwell counts as this many coefficients per octave beside those that the runs leave over."""
WARMED_UP_S = 1e6
"""Time since power-on at which nothing warms up any more."""
TIME_ALONE = frozenset({"elapsed", "clock"})
"""Needs of an effect that follows the time and no other signal."""
LIKE_BEST = 0.01
"""Of an effect's forms, the simplest within this share of the best form's gain is taken."""
LIKE_BEST_UNITS = 10.0
"""The same in noise units."""
LIKE_BEST_NATS = 3.0
"""The same in likelihood, where no dwell tells the noise: odds of 20 to 1 on runs left out."""


@dataclass(frozen=True)
class Judged:
    """One effect that the model lacks, in its best form, and what it gains."""

    kind: str
    """The effect's name."""
    parameters: Mapping[str, float]
    """Fitted values, and choices where they are not the default."""
    found: Found
    """The whole model with the effect, fitted to all runs."""
    excitation: float
    sound: bool
    """Whether its values lie off their bounds and within what the logs can show."""
    plausible: bool
    """Whether every fitted value lies near its typical range and off its bounds."""
    gains: Array
    """[R] held-out gain in each unit of evidence (run), noise units."""
    p_value: float
    rmse_ratio: float
    """Held-out RMSE with it over without, pooled over outputs in units of the floor."""
    best_output_ratio: float
    """The same for the output that gains most."""
    floor_ratio: float
    """Held-out RMSE with it over the noise floor."""
    fitted_ratio: float
    """RMSE with it over the noise floor in the runs it was fitted to: what is left that no value
    of its parameters takes away, while a run left out may lie beyond the others' temperatures."""
    share: float
    """Share of the squared error above the floor that it takes away, fitted."""
    errors: Array
    """[K] held-out mean squares with it."""
    nats: float
    """Held-out gain in log-likelihood, the noise of each octave refitted beside either model: what
    slow noise explains as well is no gain."""
    follows_signal: bool
    """Whether it follows more than the time: a trend and slow noise look alike in one run."""

    @property
    def gain(self) -> float:
        """Total held-out gain in noise units."""
        return float(self.gains.sum())

    @property
    def positive_share(self) -> float:
        """How much of what moves is gain rather than loss, 0..1."""
        moved = float(np.abs(self.gains).sum())
        return float(np.maximum(self.gains, 0.0).sum()) / moved if moved > 0.0 else 0.0


@dataclass(frozen=True)
class Examination:
    """A model with its noise floor, its held-out error, and every effect it lacks, best first."""

    terms: tuple[Term, ...]
    base: Found
    noise: Noise
    floor: Array
    """[K] RMS of the noise."""
    weights: Array
    """[L, K] used for the gains."""
    base_errors: Array
    """[K] held-out mean squares of the model as it is."""
    base_left: Array
    """[K] mean squares that its fit leaves."""
    judged: tuple[Judged, ...]
    untested: tuple[Untested, ...]
    runs: int

    @property
    def floor_ratio(self) -> float:
        """Held-out RMSE of the model as it is over the noise floor, pooled over outputs."""
        return float(np.sqrt(np.mean(self.base_errors / self.floor**2)))

    @property
    def fitted_ratio(self) -> float:
        """RMSE of the model as it is over the floor in the runs that it was fitted to."""
        return float(np.sqrt(np.mean(self.base_left / self.floor**2)))


def examine(
    campaign: Campaign,
    dwell: Sequence[Run],
    catalogue: Catalogue,
    terms: Sequence[Term],
    floor: Array,
    *,
    kinds: frozenset[str] | None = None,
    advance: Callable[[str], None] = lambda kind: None,
) -> Examination:
    """Return what each effect of the catalogue that the model lacks would gain.

    Args:
        campaign: the runs.
        dwell: isothermal, unloaded runs; may be empty.
        catalogue: the known effects.
        terms: the model, at starting or earlier values.
        floor: [K] RMS of the noise; see `measure_floor`.
        kinds: the effects to try; None = all.
        advance: called with the effect's name when a proposal has been tried.
    """
    base, noise, weights = fit_base(campaign, dwell, terms)
    proposals, untested = propose(catalogue, base.terms, campaign)
    proposals = [p for p in proposals if kinds is None or p.kind in kinds]
    candidates, unexcited = try_candidates(campaign, base, proposals, weights, advance)
    tried = {candidate.kind for candidate in candidates}
    untested += _most_excited([u for u in unexcited if u.effect not in tried])

    coordinates = list_coordinates(base.terms)
    sums = sum_with_slopes(campaign, base.terms, coordinates)
    position = get_coordinates(base.terms, coordinates)

    def judge_base(weights: Array) -> Errors:
        return hold_out(sums, weights, coordinates, position, campaign.unit_of_piece)

    base_out = judge_base(weights)
    judged_by = {id(c): c.held_out for c in candidates}
    if candidates:
        best = _choose_best(campaign, candidates, base_out, weights, bool(dwell))
        noise = measure_rest(campaign, dwell, best.found)
        weights = _weigh_by_rest(campaign, noise, hold_in(best.sums, weights), bool(dwell))
        base_out = judge_base(weights)
        if not dwell:
            # The slow effects themselves had enlarged the noise that hid them.
            candidates = fit_leaders_again(
                campaign, candidates, weights, float(base_out.score(weights).sum())
            )
            judged_by = {id(c): c.held_out for c in candidates}
        else:
            judged_by = {id(c): judge_again(campaign, c, weights) for c in candidates}
    base_in = hold_in(sums, weights)
    judged = _judge(
        campaign,
        candidates,
        judged_by,
        (base_out, base_in),
        weights,
        floor,
        has_dwell=bool(dwell),
    )
    return Examination(
        tuple(base.terms),
        base,
        noise,
        floor,
        weights,
        base_out.mean_squares(campaign.means),
        base_in.mean_squares(campaign.means),
        tuple(judged),
        tuple(untested),
        len(campaign.groups),
    )


def _choose_best(
    campaign: Campaign,
    candidates: Sequence[Candidate],
    base_out: Errors,
    weights: Array,
    has_dwell: bool,
) -> Candidate:
    """Return the candidate whose remainder comes nearest to noise.

    Without a dwell the weights still hold what is missing for noise: there likelihoods are
    compared, each with a noise of its own.
    """
    if has_dwell:
        return min(candidates, key=lambda c: float(c.held_out.score(weights).sum()))
    unjudged = campaign.means & (not campaign.uses_means)
    return max(
        candidates,
        key=lambda c: compare_likelihoods(base_out, c.held_out, campaign.levels, unjudged),
    )


def fit_base(
    campaign: Campaign, dwell: Sequence[Run], terms: Sequence[Term]
) -> tuple[Found, Noise, Array]:
    """Return the model fitted to the runs, the noise beside it, and the weights per octave."""
    outputs = len(campaign.plan.outputs)
    flat = np.ones((campaign.levels.size, outputs))
    if not campaign.uses_means:
        flat[campaign.means] = 0.0
    base = search_beyond_rails(campaign, terms, flat)
    noise = measure_rest(campaign, dwell, base)
    weights = _invert(campaign, _expect(campaign, noise))
    return search(campaign, base.terms, weights, vary=()), noise, weights


def measure_rest(campaign: Campaign, dwell: Sequence[Run], found: Found) -> Noise:
    """Return the noise beside a model.

    The noise is what the dwell shows beyond the model. Without a dwell it is what the runs do,
    missing effects included.
    """
    runs = campaign.runs
    if dwell:
        rests = [_rest_of_dwell(found, run, campaign) for run in dwell]
        return measure_noise(rests, "dwell")
    rests = [run.steady_drift - predict(found, run, campaign.plan, campaign.order) for run in runs]
    return measure_noise(rests, "residual")


def _rest_of_dwell(found: Found, run: Run, campaign: Campaign) -> Array:
    """Return what a dwell [n, K] has beyond a model, be it warmed up or begun at power-on.

    A log's time seldom says which; the right reading leaves less.
    """
    warm = replace(run, time_s=run.time_s - run.time_s[0] + WARMED_UP_S, start_s=0.0, before=None)
    rests = [
        run.steady_drift - predict(found, reading, campaign.plan, campaign.order)
        for reading in (run, warm)
    ]
    return min(rests, key=lambda rest: float(np.log(rest.var(axis=0) + 1e-300).sum()))


def predict(found: Found, run: Run, plan: SignalPlan, order: Sequence[str]) -> Array:
    """Return the drift [n, K] that a search's end predicts for a run, but for a constant."""
    columns = build_stretches([run], plan, found.terms, order)[0][1:]
    total = np.zeros(run.drift.shape)
    for column, row in zip(columns, found.solution.coefficients.T, strict=True):
        total += column.signal[:, None] * row
    return total


def _typical_length(campaign: Campaign) -> int:
    return int(np.median([len(run) for run in campaign.runs]))


def _expect(campaign: Campaign, noise: Noise) -> Array:
    """Return the noise's variance per octave [L, K]."""
    return noise.variance(campaign.levels, _typical_length(campaign), campaign.block)


def _invert(campaign: Campaign, variance: Array) -> Array:
    """Return weights [L, K] from variances; the means count only beside offsets' columns."""
    weights = 1.0 / np.maximum(variance, 1e-30)
    if not campaign.uses_means:
        weights[campaign.means] = 0.0
    return weights


def _weigh_by_rest(campaign: Campaign, noise: Noise, best: Errors, has_dwell: bool) -> Array:
    """Return weights [L, K] from what the best candidate leaves over, and from the dwell.

    A candidate that is right leaves the noise; one that is nearly right leaves more where it is
    wrong, and what is compared there should weigh less.
    """
    expected = _expect(campaign, noise)
    count = best.counts.sum(axis=0)[:, None]
    left = best.squares.sum(axis=0) / np.maximum(count, 1.0)
    prior = PRIOR_COUNT if has_dwell else 1.0
    return _invert(campaign, (count * left + prior * expected) / (count + prior))


def _most_excited(untested: Sequence[Untested]) -> list[Untested]:
    """Return one entry per effect, its best excited form."""
    best: dict[str, Untested] = {}
    for entry in untested:
        other = best.get(entry.effect)
        if other is None or (entry.excitation or 0.0) > (other.excitation or 0.0):
            best[entry.effect] = entry
    return list(best.values())


def _judge(
    campaign: Campaign,
    candidates: Sequence[Candidate],
    judged_by: Mapping[int, Errors],
    base: tuple[Errors, Errors],
    weights: Array,
    floor: Array,
    *,
    has_dwell: bool,
) -> list[Judged]:
    """Return every effect in its best form, best gain first.

    `base` are the model's own errors, held out and fitted.
    """
    base_out, base_in = base
    units = campaign.unit_of_piece
    base_score = _per_unit(base_out.score(weights), units)
    gains = {
        id(c): base_score - _per_unit(judged_by[id(c)].score(weights), units) for c in candidates
    }
    # Runs that share an offset are compared by their means too; the floor is within runs.
    unjudged = campaign.means & (not campaign.uses_means)
    nats = {
        id(c): compare_likelihoods(base_out, judged_by[id(c)], campaign.levels, unjudged)
        for c in candidates
    }
    units_gained = {id(c): float(gains[id(c)].sum()) for c in candidates}
    measure, enough = (units_gained, LIKE_BEST_UNITS) if has_dwell else (nats, LIKE_BEST_NATS)
    span = measure_span(campaign.runs, campaign.plan.full_scale)
    before = base_out.mean_squares(unjudged)
    sound = {
        id(c)
        for c in candidates
        if are_sound(c.term, span)
        and span.is_more_than_smoothing(c.term, before - judged_by[id(c)].mean_squares(unjudged))
    }
    chosen = [
        _choose_form([f for f in forms if id(f) in sound] or forms, measure, enough)
        for forms in _group_by_kind(candidates)
    ]
    if not chosen:
        return []
    p_values = flip_signs(np.stack([gains[id(c)] for c in chosen]))
    base_left = float(np.mean(base_in.mean_squares(campaign.means) / floor**2))
    judged = []
    for candidate, p_value in zip(chosen, p_values.tolist(), strict=True):
        ratios = judged_by[id(candidate)].mean_squares(unjudged) / before
        weight = before / floor**2
        errors = judged_by[id(candidate)].mean_squares(campaign.means) / floor**2
        left = hold_in(candidate.sums, weights).mean_squares(campaign.means) / floor**2
        judged.append(
            Judged(
                candidate.kind,
                candidate.parameters,
                candidate.found,
                candidate.excitation,
                id(candidate) in sound,
                candidate.is_plausible,
                gains[id(candidate)],
                p_value,
                float(np.sqrt(np.average(ratios, weights=weight))),
                float(np.sqrt(np.min(ratios))),
                float(np.sqrt(np.mean(errors))),
                float(np.sqrt(np.mean(left))),
                share_explained(base_left, float(np.mean(left))),
                errors * floor**2,
                nats[id(candidate)],
                not set(candidate.proposal.effect.needs) <= TIME_ALONE,
            )
        )
    return sorted(judged, key=lambda j: -j.gain)


def share_explained(before: float, after: float) -> float:
    """Return the share of the squared error above the floor (1.0) that was taken away."""
    return (before - after) / max(before - 1.0, 1e-9)


def _per_unit(scores: Array, units: NDArray[np.int64]) -> Array:
    """Return scores summed over the pieces of each unit of evidence."""
    return np.asarray(np.bincount(units, weights=scores))


def _group_by_kind(candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Return the candidates' forms, effect by effect, simplest first."""
    grouped: dict[str, list[Candidate]] = {}
    for candidate in candidates:
        grouped.setdefault(candidate.kind, []).append(candidate)
    return list(grouped.values())


def _choose_form(
    forms: Sequence[Candidate], gains: Mapping[int, float], enough: float
) -> Candidate:
    """Return the simplest form that gains about as much as the best one.

    Args:
        forms: of one effect, simplest first.
        gains: of each form.
        enough: a simpler form may gain this much less, and a share of the gain.
    """
    best = max(gains[id(form)] for form in forms)
    least = best - max(LIKE_BEST * abs(best), enough)
    return next(form for form in forms if gains[id(form)] >= least)
