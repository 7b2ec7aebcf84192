"""The effects that a model may lack: which of them these logs can test, and how well they fit."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.base.records import OPTIONAL
from zerodrift.diagnosis.evidence import Errors, hold_out
from zerodrift.diagnosis.span import LogSpan
from zerodrift.physics.campaign import Campaign, Sums
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.effect import Effect, Parameter
from zerodrift.physics.reduction import combine
from zerodrift.physics.search import (
    Found,
    assess,
    get_coordinates,
    grid,
    invert_scaled,
    list_coordinates,
    list_slopes,
    search,
    set_coordinates,
    sum_with_slopes,
)
from zerodrift.physics.signals import explain_missing
from zerodrift.physics.terms import CHIP, Term, name_feature, start_term

# How much of an effect these logs excite: the share that the model as it is cannot imitate.

LEAST_EXCITATION = 0.05
"""Share of an effect that the model cannot imitate, below which it cannot be tested."""


def measure_excitation(
    campaign: Campaign, base: Found, terms: Sequence[Term], place: int, weights: Array
) -> float:
    """Return the share of what the term at a place changes that the present model cannot imitate.

    What it changes is its new columns, or for effects that rewrite the temperature the change of
    the prediction; what the model imitates is the span of its columns and of their slopes. Where
    the typical value shows nothing, the others of the typical range are tried.
    """
    with campaign.rates.search_roughly():
        return _excite_most(campaign, base, terms, place, weights)


def _excite_most(
    campaign: Campaign, base: Found, terms: Sequence[Term], place: int, weights: Array
) -> float:
    """Return the excitation at the typical value, or the best over the typical range."""
    share = _excite(campaign, base, terms, weights)
    own = [c for c in list_coordinates(terms) if c.term == place]
    for u in grid(own) if own else []:
        if share >= LEAST_EXCITATION:
            break
        elsewhere = set_coordinates(terms, own, np.array(u))
        share = max(share, _excite(campaign, base, elsewhere, weights))
    return share


def _excite(campaign: Campaign, base: Found, terms: Sequence[Term], weights: Array) -> float:
    """Return the share left of what these terms change, at their present values."""
    coordinates = list_coordinates(base.terms)
    features, slopes = list_slopes(campaign, base.terms, coordinates)
    changed = campaign.build(terms)
    known = {f.name: j for j, f in enumerate(features)}
    new = [f for f in changed if f.name not in known]
    outputs: list[str | None] = []
    if new:
        extra = [campaign.column(f.signal, name_feature(f, terms)) for f in new]
        outputs = [f.output for f in new]
    else:
        steps = [
            (known[f.name], campaign.column(f.signal) - campaign.column(now.signal))
            for f in changed
            if f.signal is not (now := features[known[f.name]]).signal
        ]
        extra = [
            combine([step for _, step in steps], [row[j] for j, _ in steps])
            for row in base.solution.coefficients
            if steps
        ]
        outputs += campaign.plan.outputs[: len(extra)]
    width = len(coordinates)
    marked = [*slopes, *((width + i, -1, column) for i, column in enumerate(extra))]
    sums = campaign.sum(features, base.terms, marked)
    gram = np.einsum("l,glab->ab", weights.mean(axis=1) / weights.mean(), sums.products)
    first = len(features) + len(slopes)
    offsets = range(first + len(extra), gram.shape[0] - sums.outputs)
    seen_by = [f.output for f in features] + [features[j].output for _, j, _ in slopes]
    shares = [0.0]
    for output in campaign.plan.outputs:
        # A column that another output alone sees imitates nothing in this one.
        model = [*(i for i, owner in enumerate(seen_by) if owner in (None, output)), *offsets]
        inverse = invert_scaled(gram[np.ix_(model, model)])
        for e, owner in enumerate(outputs, start=first):
            if owner in (None, output) and gram[e, e] > 0.0:
                left = gram[e, e] - gram[e, model] @ inverse @ gram[model, e]
                shares.append(float(np.sqrt(max(left, 0.0) / gram[e, e])))
    return max(shares)


# The effects that a model may lack: which of them these logs can test, and how well they fit.

NEAR = 3.0
"""A value is near its typical range within this factor of it."""
LEADING = 0.5
"""Candidates with this share of the best one's gain are fitted on all samples."""
AT_AN_END, OF_WHAT_IS_LEFT = 0.02, 0.01
"""A value is as good as the end of its range if it gains less over that than these shares of its
effect's gain and of the squared error that is left, ..."""
AT_AN_END_UNITS = 10.0
"""... or less than this in noise units."""
SAME = 1.1
"""Time constants whose ratio is below this are the same one twice."""
NO_SHARE = 0.01
"""A share of a response below this is none."""


@dataclass(frozen=True)
class Proposal:
    """One change of the model: a new effect, or another choice for one it has."""

    effect: Effect
    choices: Mapping[str, float]
    place: int
    """Index of the term that it replaces; the number of terms for a new one."""
    terms: tuple[Term, ...]
    """The whole model with the change, at starting values."""

    @property
    def kind(self) -> str:
        """The effect's name."""
        return self.effect.kind


@dataclass(frozen=True)
class Candidate:
    """A proposal fitted to the runs, with its held-out errors."""

    proposal: Proposal
    found: Found
    sums: Sums
    """With slopes along all coordinates, so that it can be judged again with other weights."""
    held_out: Errors
    excitation: float
    exact: bool
    """Whether it was fitted on all samples, not on averages over blocks."""
    distinct: bool = True
    """Whether its values do better than the ends of their ranges, where an effect turns into a
    simpler one: a play wider than the load's range is a gain, a very fast creep is one too."""

    @property
    def kind(self) -> str:
        """The effect's name."""
        return self.proposal.kind

    @property
    def parameters(self) -> dict[str, float]:
        """Values of the effect's fitted parameters, and its choices where not the default."""
        term = self.found.terms[self.proposal.place]
        values = {p.name: term.values[p.name] for p in term.free}
        default = self.proposal.effect.variants[0]
        chosen = {k: v for k, v in self.proposal.choices.items() if default.get(k) != v}
        return {**chosen, **values}

    @property
    def term(self) -> Term:
        """The effect as fitted."""
        return self.found.terms[self.proposal.place]

    @property
    def is_plausible(self) -> bool:
        """Whether every fitted value is distinct, near its typical range and off its bounds."""
        term = self.found.terms[self.proposal.place]
        return self.distinct and all(
            p.is_setting or _is_near_typical(p, term.values[p.name]) for p in term.free
        )


def are_sound(term: Term, span: LogSpan) -> bool:
    """Return whether an effect's fitted values are off their bounds and such as logs can show.

    A pair of equal time constants, and a second one without any share, are one in disguise. A play
    as wide as the noise of what it plays with smooths that noise: the error falls by the noise of
    the reference, and nothing of the load's history is in it.

    Args:
        term: the effect as fitted.
        span: what the logs can show.
    """
    shortest_s, longest_s = span.shortest_s, span.longest_s
    values = [(p, term.values[p.name]) for p in term.free if not p.is_setting]
    times = [(p, v) for p, v in values if p.unit == "s" and p.scale == "log"]
    times_s = [v for _, v in times]
    inside = all(_is_off_bounds(p, v) for p, v in values)
    # Some effects are slower than any run, by what is known of them.
    shown = all(shortest_s <= t <= max(longest_s, p.typical[1]) for p, t in times)
    apart = all(late > SAME * early for early, late in itertools.pairwise(sorted(times_s)))
    shared = all(abs(v) >= NO_SHARE for p, v in values if p.name.endswith("_share"))
    wide = all(v >= span.least_slack.get(p.slack_in, 0.0) for p, v in values if p.slack_in)
    return inside and shown and apart and shared and wide


def _is_near_typical(parameter: Parameter, value: float) -> bool:
    """Return whether a value is within three times the typical range, and not at a bound."""
    low, high = parameter.typical
    if parameter.scale == "log":
        near = low / NEAR <= value <= high * NEAR
    else:
        spread = (NEAR - 1.0) * (high - low)
        near = low - spread <= value <= high + spread
    return near and _is_off_bounds(parameter, value)


def _is_off_bounds(parameter: Parameter, value: float) -> bool:
    """Return whether a value lies inside of its range."""
    if parameter.scale == "log":
        return parameter.lower * 1.01 < value < parameter.upper / 1.01
    margin = 0.01 * (parameter.upper - parameter.lower)
    return parameter.lower + margin < value < parameter.upper - margin


@dataclass(frozen=True)
class Untested:
    """An effect that these logs cannot test, and why."""

    effect: str
    why: str
    excitation: float | None = field(default=None, metadata=OPTIONAL)


def propose(
    catalogue: Catalogue, terms: Sequence[Term], campaign: Campaign
) -> tuple[list[Proposal], list[Untested]]:
    """Return every change of the model that the logs have the signals for, and the others."""
    proposals, untested = [], []
    kinds = {term.effect.kind: i for i, term in enumerate(terms) if term.signal == CHIP}
    for effect in catalogue.values():
        why = explain_missing(effect, campaign.plan)
        if effect.sets_aside:
            # Seen directly in the logs, not by what it would gain; see `diagnose`.
            continue
        if why:
            if effect.kind not in kinds:
                untested.append(Untested(effect.kind, why))
            continue
        if effect.kind in kinds:
            proposals += _upgrade(effect, terms, kinds[effect.kind])
            continue
        for choices in effect.list_plain(len(campaign.groups)):
            term = start_term(catalogue, EffectConfig(effect.kind), choices)
            proposals.append(Proposal(effect, choices, len(terms), (*terms, term)))
    return proposals, untested


def _upgrade(effect: Effect, terms: Sequence[Term], place: int) -> list[Proposal]:
    """Return the richer forms of an effect that the model has already."""
    present = terms[place]
    now = _find_variant(effect, present)
    proposals = []
    for choices in effect.forms[now + 1 :]:
        values = {**present.values, **choices}
        changed = Term(effect, values, present.held, present.signal)
        proposals.append(
            Proposal(effect, choices, place, (*terms[:place], changed, *terms[place + 1 :]))
        )
    return proposals


def _find_variant(effect: Effect, term: Term) -> int:
    """Return the index of the last variant whose choices the term has."""
    fitting = [
        i
        for i, choices in enumerate(effect.forms)
        if all(term.values[name] == value for name, value in choices.items())
    ]
    return fitting[-1] if fitting else len(effect.forms) - 1


def try_candidates(
    campaign: Campaign,
    base: Found,
    proposals: Sequence[Proposal],
    weights: Array,
    advance: Callable[[str], None] = lambda kind: None,
) -> tuple[list[Candidate], list[Untested]]:
    """Return the proposals fitted and judged, and those that the logs cannot test.

    Values are searched for on averages over blocks where that is good enough; the leading
    candidates are then fitted again on all samples.
    """
    candidates, untested = [], []
    with campaign.rates.search_roughly():
        # On averages the model itself is less good too: like is compared with like.
        roughly = assess(campaign, base.terms, weights)
    for proposal in proposals:
        excitation = measure_excitation(campaign, base, proposal.terms, proposal.place, weights)
        if excitation < LEAST_EXCITATION:
            untested.append(
                Untested(
                    proposal.kind,
                    f"these logs do not excite it: the model imitates all but "
                    f"{100 * excitation:.1f} % of it",
                    excitation,
                )
            )
        else:
            candidates.append(fit_candidate(campaign, roughly, proposal, weights, excitation))
        advance(proposal.kind)
    refined = _refine_leaders(campaign, base, roughly, candidates, weights)
    return [_compare_with_ends(campaign, base, c, weights) for c in refined], untested


def fit_candidate(
    campaign: Campaign, roughly: Found, proposal: Proposal, weights: Array, excitation: float
) -> Candidate:
    """Return one proposal fitted to all runs, and judged on each from the others.

    `roughly` is the model without it, on averages over blocks.
    """
    place = proposal.place
    if not proposal.terms[place].free or campaign.block == 1:
        found = search(campaign, proposal.terms, weights, vary=(place,), refined_starts=1)
        return _judge(campaign, proposal, found, weights, excitation, exact=True)
    with campaign.rates.search_roughly():
        found = search(
            campaign,
            proposal.terms,
            weights,
            vary=(place,),
            refined_starts=1,
            without=roughly.cost,
        )
        return _judge(campaign, proposal, found, weights, excitation, exact=False)


def _refine_leaders(
    campaign: Campaign,
    base: Found,
    roughly: Found,
    candidates: Sequence[Candidate],
    weights: Array,
) -> list[Candidate]:
    """Return the candidates, those near the best one fitted on all samples."""
    if not candidates:
        return []
    exact = _score(campaign, base, weights)
    with campaign.rates.search_roughly():
        rough = _score(campaign, roughly, weights)
    gains = [
        (exact if c.exact else rough) - float(c.held_out.score(weights).sum()) for c in candidates
    ]
    refined = []
    for candidate, gain in zip(candidates, gains, strict=True):
        if candidate.exact or gain < LEADING * max(gains):
            refined.append(candidate)
            continue
        found = search(campaign, candidate.found.terms, weights, vary=())
        refined.append(
            _judge(campaign, candidate.proposal, found, weights, candidate.excitation, exact=True)
        )
    return refined


def fit_leaders_again(
    campaign: Campaign, candidates: Sequence[Candidate], weights: Array, base_score: float
) -> list[Candidate]:
    """Return the candidates judged with other weights, the leading ones fitted with them too.

    Args:
        campaign: the runs.
        candidates: as fitted with other weights.
        weights: [L, K].
        base_score: of the model as it is, with these weights.
    """
    errors = [judge_again(campaign, candidate, weights) for candidate in candidates]
    gains = [base_score - float(each.score(weights).sum()) for each in errors]
    judged = []
    for candidate, held_out, gain in zip(candidates, errors, gains, strict=True):
        if not candidate.exact or gain < LEADING * max(gains):
            judged.append(replace(candidate, held_out=held_out))
            continue
        place = candidate.proposal.place
        found = search(campaign, candidate.found.terms, weights, vary=(place,), refined_starts=1)
        again = _judge(
            campaign, candidate.proposal, found, weights, candidate.excitation, exact=True
        )
        judged.append(replace(again, distinct=candidate.distinct))
    return judged


def _compare_with_ends(
    campaign: Campaign, base: Found, candidate: Candidate, weights: Array
) -> Candidate:
    """Return the candidate, marked where an end of a parameter's range does about as well."""
    terms, place = candidate.found.terms, candidate.proposal.place
    best = float(candidate.found.solution.errors.sum())
    gain = float(base.solution.errors.sum()) - best
    if not candidate.exact or gain <= 0.0:
        return candidate
    for coordinate in list_coordinates(terms):
        if coordinate.term != place or coordinate.parameter.is_setting:
            continue
        for end in coordinate.bounds:
            moved = set_coordinates(terms, [coordinate], np.array([end]))
            lost = float(assess(campaign, moved, weights).solution.errors.sum()) - best
            if lost <= max(AT_AN_END_UNITS, min(AT_AN_END * gain, OF_WHAT_IS_LEFT * best)):
                return replace(candidate, distinct=False)
    return candidate


def _score(campaign: Campaign, found: Found, weights: Array) -> float:
    """Return the held-out score of a model as it was found."""
    coordinates = list_coordinates(found.terms)
    sums = sum_with_slopes(campaign, found.terms, coordinates)
    position = get_coordinates(found.terms, coordinates)
    held_out = hold_out(sums, weights, coordinates, position, campaign.unit_of_piece)
    return float(held_out.score(weights).sum())


def _judge(
    campaign: Campaign,
    proposal: Proposal,
    found: Found,
    weights: Array,
    excitation: float,
    *,
    exact: bool,
) -> Candidate:
    """Return a fitted proposal with its held-out errors."""
    coordinates = list_coordinates(found.terms)
    sums = sum_with_slopes(campaign, found.terms, coordinates)
    position = get_coordinates(found.terms, coordinates)
    held_out = hold_out(sums, weights, coordinates, position, campaign.unit_of_piece)
    return Candidate(proposal, found, sums, held_out, excitation, exact)


def judge_again(campaign: Campaign, candidate: Candidate, weights: Array) -> Errors:
    """Return the candidate's held-out errors under other weights, without building columns."""
    coordinates = list_coordinates(candidate.found.terms)
    position = get_coordinates(candidate.found.terms, coordinates)
    return hold_out(candidate.sums, weights, coordinates, position, campaign.unit_of_piece)
