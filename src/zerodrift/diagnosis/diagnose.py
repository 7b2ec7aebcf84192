"""Which effect a model lacks: a name, a group of look-alikes, "nothing", or an honest "unknown"."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset, Run, count_outliers
from zerodrift.diagnosis.case import Advance, Case, open_case
from zerodrift.diagnosis.changes import list_extensions
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.diagnosis_report import report
from zerodrift.diagnosis.evidence import hold_in, hold_out
from zerodrift.diagnosis.examination import (
    Examination,
    Judged,
    examine,
    fit_base,
    predict,
    share_explained,
)
from zerodrift.diagnosis.revision import try_extension
from zerodrift.diagnosis.rules import (
    EXPLAINED,
    EXPLAINED_WITHOUT_DWELL,
    LEFT_WITHOUT_DWELL,
    SURE_SHARE,
    SURE_UNITS,
    SURELY_THERE,
    Finding,
    find_ageing,
    helps,
    is_at_floor,
    is_enough,
    is_there,
    lead,
    wanders,
)
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.effect import Effect, Values
from zerodrift.physics.search import get_coordinates, list_coordinates, sum_with_slopes
from zerodrift.physics.terms import Term, start_term

# What is gained by setting aside the samples at a converter's rail.


def look_at_rails(case: Case, first: Examination) -> Judged | None:
    """Return what setting samples at a converter's rail aside gains, if there are any."""
    known = any(term.effect.sets_aside for term in case.terms)
    kinds = [kind for kind, effect in case.catalogue.items() if effect.sets_aside]
    if known or not kinds or not case.plan.saturated:
        return None
    raw = Campaign(
        case.dataset.train,
        case.plan,
        list(case.catalogue),
        tared=case.campaign.tared,
        set_aside=False,
    )
    coordinates = list_coordinates(first.base.terms)
    position = get_coordinates(first.base.terms, coordinates)
    scores, errors, left = [], [], []
    for campaign in (raw, case.campaign):
        sums = sum_with_slopes(campaign, first.base.terms, coordinates)
        out = hold_out(sums, first.weights, coordinates, position, campaign.unit_of_piece)
        units = campaign.unit_of_piece
        scores.append(np.asarray(np.bincount(units, weights=out.score(first.weights)), float))
        errors.append(out.mean_squares(campaign.means) / first.floor**2)
        inside = hold_in(sums, first.weights).mean_squares(campaign.means)
        left.append(float(np.mean(inside / first.floor**2)))
    effect = case.catalogue[kinds[0]]
    term = start_term(case.catalogue, EffectConfig(effect.kind))
    return Judged(
        kind=effect.kind,
        parameters={},
        found=replace(first.base, terms=(*first.base.terms, term)),
        excitation=1.0,
        sound=True,
        plausible=True,
        gains=scores[0] - scores[1],
        # Seen, not inferred: noise does not repeat an extreme to the last digit.
        p_value=0.0,
        rmse_ratio=float(np.sqrt(np.mean(errors[1]) / np.mean(errors[0]))),
        best_output_ratio=float(np.sqrt(np.min(errors[1] / errors[0]))),
        floor_ratio=float(np.sqrt(np.mean(errors[1]))),
        fitted_ratio=float(np.sqrt(left[1])),
        share=share_explained(left[0], left[1]),
        errors=errors[1] * first.floor**2,
        nats=0.5 * float((scores[0] - scores[1]).sum()),
        follows_signal=True,
    )


def count_rails(first: Examination, rails: Judged) -> Examination:
    """Return the first examination with the samples at a rail counted among its errors."""
    held_out = (rails.floor_ratio / rails.rmse_ratio / first.floor_ratio) ** 2
    before = rails.fitted_ratio**2
    if rails.share < 1.0:
        before = (before - rails.share) / (1.0 - rails.share)
    judged = sorted((*first.judged, rails), key=lambda j: -j.gain)
    return replace(
        first,
        base_errors=first.base_errors * held_out,
        base_left=first.base_left * before / first.fitted_ratio**2,
        judged=tuple(judged),
    )


def place_rails(first: Examination, rails: Judged, findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings with the rails among them, before weaker effects."""
    mine = Finding(first, rails)
    if findings and findings[0].judged.gain > rails.gain:
        return [findings[0], mine, *findings[1:]]
    return [mine, *findings]


# Which effect a model lacks: a name, a group of look-alikes, "nothing", or an honest "unknown".

MOST_EFFECTS = 4
"""Effects that are looked for together before giving up."""
SHORTLIST = 6
"""Effects that are tried again in each other's presence."""
GIVEN_BACK = 0.02
"""Outliers that the model explains are sound samples again where they held this share of the
squares that it leaves of an output."""


def diagnose_config(
    config: Config, dataset: Dataset, advance: Advance = lambda kind: None
) -> Diagnosis:
    """Return which effect the model of zerodrift.toml lacks.

    Args:
        config: the project.
        dataset: its runs.
        advance: called with each effect's name when it has been tried.

    Raises:
        InputError: as `fit_config`.
    """
    return diagnose(config.effects, dataset, load_catalogue(config.plugin_files), advance)


def diagnose(
    effects: Sequence[EffectConfig],
    dataset: Dataset,
    catalogue: Catalogue | None = None,
    advance: Advance = lambda kind: None,
) -> Diagnosis:
    """Return which effect a model lacks, from its training runs.

    Args:
        effects: the model's `[[effect]]` tables.
        dataset: its runs.
        catalogue: the known effects; by default the built-ins.
        advance: called with each effect's name when it has been tried.
    """
    catalogue = catalogue or load_catalogue()
    return conclude(open_case(dataset, catalogue, effects, advance))


def conclude(case: Case) -> Diagnosis:
    """Return the verdict.

    Where something is left, outliers are looked for once more beside what the best model explains:
    what jumps with a signal hides them, and they hide what is left.
    """
    diagnosis, terms = _conclude(case)
    if diagnosis.verdict == "complete":
        return diagnosis
    again = weigh_again(case, terms)
    if again is not None:
        case, diagnosis = again, _conclude(again)[0]
    return try_richer(case, diagnosis) if diagnosis.verdict == "unknown" else diagnosis


def try_richer(case: Case, plain: Diagnosis) -> Diagnosis:
    """Return what the richer forms of effects that the model lacks explain, or what was found.

    They have more freedom than the plain ones, so they are asked only where these explain too
    little, and only if one of them comes nearer by itself than any of these.
    """
    present = {term.effect.kind for term in case.terms}
    runs = len(case.campaign.groups)
    absent = {k: e for k, e in case.catalogue.items() if k not in present}
    richer = {k: e for k, e in absent.items() if e.list_richer(runs)}
    alone = {k: _with_forms(e, e.list_richer(runs)) for k, e in richer.items()}
    leading = lead(look(replace(case, catalogue=Catalogue(alone)), case.terms)) if alone else None
    nearest = min((candidate.rmse_left_out_ratio for candidate in plain.candidates), default=1.0)
    if leading is None or leading.rmse_ratio >= nearest:
        return plain
    every = {k: _with_forms(e, e.forms) for k, e in richer.items()}
    found = _conclude(replace(case, catalogue=Catalogue({**case.catalogue, **every})))[0]
    return found if found.verdict == "missing" else plain


def _with_forms(effect: Effect, forms: tuple[Values, ...]) -> Effect:
    """Return the effect with these forms as its plain ones, and no others."""
    return replace(effect, variants=forms, run_variants=(), upgrades=())


def weigh_again(case: Case, terms: Sequence[Term]) -> Case | None:
    """Return the case with outliers found beside what these terms explain; None: the same ones.

    There may be more of them, or fewer: where a load that drifts changes next to the end of a log,
    its first samples lie far off from their neighbours, and are sound.
    """
    found = fit_base(case.campaign, case.dataset.dwell, terms)[0]
    predicted = [predict(found, run, case.plan, case.campaign.order) for run in case.dataset.train]
    train = tuple(
        replace(run, explained=explained)
        for run, explained in zip(case.dataset.train, predicted, strict=True)
    )
    are_more = count_outliers(train) > count_outliers(case.dataset.train)
    if not are_more and not _are_given_back(case.dataset.train, train, predicted):
        return None
    dataset = replace(case.dataset, train=train)
    campaign = Campaign(
        train, case.plan, case.campaign.order, tared=case.campaign.tared, set_aside=True
    )
    return replace(case, dataset=dataset, campaign=campaign)


def _are_given_back(
    before: Sequence[Run], after: Sequence[Run], predicted: Sequence[Array]
) -> bool:
    """Return whether samples that are outliers no longer held much of what was left."""
    held = [_square(b.steady_drift - a.steady_drift) for a, b in zip(before, after, strict=True)]
    rests = [run.steady_drift - explained for run, explained in zip(before, predicted, strict=True)]
    left = [_square(rest - rest.mean(axis=0)) for rest in rests]
    return bool(np.any(np.sum(held, axis=0) > GIVEN_BACK * np.sum(left, axis=0)))


def _square(x: Array) -> Array:
    """Return the sums of squares [K] of columns [n, K]."""
    return np.asarray(np.sum(x**2, axis=0))


def _conclude(case: Case) -> tuple[Diagnosis, tuple[Term, ...]]:
    """Return the verdict, and the model that explains most."""
    first = look(case, case.terms)
    findings, last = find_missing(case, first)
    terms = findings[-1].judged.found.terms if findings else case.terms
    rails = look_at_rails(case, first)
    if rails is not None and helps(rails, first):
        first = count_rails(first, rails)
        findings = place_rails(first, rails, findings)
    is_pair = not findings and not is_at_floor(first, first.fitted_ratio)
    if is_pair:
        findings = find_pair(case, first)
        terms = findings[-1].judged.found.terms if findings else case.terms
    if not findings and case.follows_clock:
        # The offsets of all runs together tell more than the pieces of time one by one.
        findings = find_ageing(case, first)
        terms = findings[-1].judged.found.terms if findings else case.terms
    if not findings:
        complete = is_at_floor(first, first.fitted_ratio) and not wanders(case, first)
        complete = complete and not case.follows_clock
        verdict = "complete" if complete else "unknown"
        return report(case, verdict, first, None, ()), terms
    # Fits with the noise that is left weigh anew: what one of them explained stays explained.
    left = min(finding.judged.fitted_ratio for finding in findings)
    left = left if last is None else min(left, last.fitted_ratio)
    alone = findings[0]
    if len(findings) > 1 and not is_pair:
        confirmed = confirm(case, findings)
        strongest = confirmed[0]
        if strongest.judged.sound and helps(strongest.judged, strongest.examination):
            findings = confirmed
    share = share_explained(first.fitted_ratio**2, left**2)
    explained = is_at_floor(first, left) or share >= EXPLAINED
    if not case.dataset.dwell:
        # A floor that is a lower bound cannot refuse; a large held-out gain must do.
        explained = explained or findings[0].judged.rmse_ratio ** 2 <= LEFT_WITHOUT_DWELL
        explained = explained or share >= EXPLAINED_WITHOUT_DWELL
    if len(findings) == 1:
        explained = explained and is_enough(alone)
    beside = 0.0
    if not explained:
        unknown = report(case, "unknown", first, findings[0], ())
        # What is there is named, though something else is missing beside it.
        kind = findings[0].judged.kind
        sure = unknown.probability_of(kind) >= SURELY_THERE
        sure = sure or is_there(findings[0])
        sure = sure or (kind == alone.judged.kind and is_there(alone))
        if not (sure and is_enough(findings[0])):
            return unknown, terms
        findings = findings[:1]
        beside = unknown.something_else
    refusal = foresee_refusal(case, findings[0])
    if refusal:
        # What `add` refuses is not offered: here, or at any later look at these logs.
        case = replace(case, notes=(*case.notes, refusal))
        verdict = "complete" if is_at_floor(first, first.fitted_ratio) else "unknown"
        return report(case, verdict, first, findings[0], ()), terms
    others = tuple(findings[1:])
    return report(case, "missing", first, findings[0], others, beside=beside), terms


def foresee_refusal(case: Case, finding: Finding) -> str:
    """Return why `add` would refuse a finding on these logs, in a sentence; empty if it keeps it.

    Both speak of runs left out, but `add` by plain errors of the logs as they were read, and the
    diagnosis by octaves of them, with outliers beside what the best model explains.
    """
    kind = finding.judged.kind
    logs = case.dataset if case.whole is None else case.whole
    runs = len({run.group for run in logs.train})
    forms = list_extensions(case.effects, case.catalogue, kind, finding.judged.parameters, runs)
    kept, reason = try_extension(case.effects, forms, logs, case.catalogue)
    return "" if kept else f"{kind} would gain a little, but not enough for `add`: {reason}"


def look(case: Case, terms: Sequence[Term], kinds: frozenset[str] | None = None) -> Examination:
    """Return what every effect that `terms` lack would gain."""
    return examine(
        case.campaign,
        case.dataset.dwell,
        case.catalogue,
        terms,
        case.floor,
        kinds=kinds,
        advance=case.advance,
    )


def find_missing(case: Case, first: Examination) -> tuple[list[Finding], Examination | None]:
    """Return missing effects, the strongest first, each beside those before it.

    The last examination, in which nothing more helped, is None where the floor was reached.
    """
    findings: list[Finding] = []
    examination = first
    while len(findings) < MOST_EFFECTS:
        leading = lead(examination, beside=bool(findings))
        if leading is None:
            return findings, examination if findings else None
        findings.append(Finding(examination, leading))
        if is_at_floor(examination, leading.fitted_ratio):
            return findings, None
        examination = look(case, leading.found.terms)
    return findings, examination


def find_pair(case: Case, first: Examination) -> list[Finding]:
    """Return two missing effects of which each hides the other, or none.

    Where both are large, the error with one of them is still that of the other, and its share of
    the whole may even grow. Each has to help beside the other as an effect has to that is alone.
    First comes one that `add` keeps by itself, or that lowers the error more.
    """
    leading = next((j for j in first.judged if j.sound), None)
    if leading is None or leading.gain < SURE_UNITS or leading.positive_share < SURE_SHARE:
        return []
    shortlist = frozenset(j.kind for j in first.judged[:SHORTLIST])
    found = []
    terms, kind = leading.found.terms, ""
    for _ in range(2):  # the other one beside the first, then the first beside the other one
        examination = look(case, terms, shortlist - {kind})
        best = lead(examination)
        if best is None:
            return []
        found.append(Finding(examination, best))
        told = {term.effect.kind: term for term in case.terms}
        kind, terms = best.kind, _without(best.found.terms, leading.kind, told)
    if found[-1].judged.kind != leading.kind:
        return []
    alone = {j.kind: j.rmse_ratio for j in first.judged}
    found.sort(key=lambda finding: alone.get(finding.judged.kind, 1.0))
    return found[::-1] if foresee_refusal(case, found[0]) else found


def confirm(case: Case, findings: Sequence[Finding]) -> list[Finding]:
    """Return several missing effects tried once more, each in the presence of the others.

    The first was chosen while the others were still missing, so it may be a mere resemblance.
    """
    shortlist = {j.kind for f in findings for j in f.examination.judged[:SHORTLIST]}
    told = {term.effect.kind: term for term in case.terms}
    best: dict[str, Finding] = {}
    terms = findings[-1].judged.found.terms
    for kind in [finding.judged.kind for finding in findings]:
        others = _without(terms, kind, told)
        if others == terms:
            continue
        wanted = shortlist - {t.effect.kind for t in others if t.effect.kind not in told}
        examination = look(case, others, frozenset(wanted))
        leading = lead(examination, beside=True)
        if leading is not None:
            best[leading.kind] = Finding(examination, leading)
            terms = leading.found.terms
    rails = [f for f in findings if case.catalogue[f.judged.kind].sets_aside]
    confirmed = sorted(best.values(), key=lambda f: -f.judged.gain)
    return rails + confirmed if confirmed else list(findings)


def list_idle(case: Case) -> tuple[str, ...]:
    """Return the effects of the model without which runs left out are predicted as well."""
    idle = []
    for term in case.terms:
        if term.effect.sets_aside:
            continue
        others = tuple(other for other in case.terms if other is not term)
        examination = look(case, others, frozenset({term.effect.kind}))
        if lead(examination) is None:
            idle.append(term.effect.kind)
    return tuple(idle)


def _without(terms: Sequence[Term], kind: str, told: Mapping[str, Term]) -> tuple[Term, ...]:
    """Return the terms without an effect that was added, or with one as the user told it."""
    kept = [told.get(kind, term) if term.effect.kind == kind else term for term in terms]
    return tuple(term for term in kept if term.effect.kind != kind or kind in told)
