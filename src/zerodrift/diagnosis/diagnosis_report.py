"""The findings in words and numbers: verdict, next experiment, evidence, notes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import OutlierCount, tell_outliers
from zerodrift.diagnosis.candidates import Untested
from zerodrift.diagnosis.case import Case
from zerodrift.diagnosis.diagnosis import LIKELY, CandidateReport, Diagnosis, OutputErrors
from zerodrift.diagnosis.examination import Examination, Judged, predict
from zerodrift.diagnosis.experiments import choose_experiment
from zerodrift.diagnosis.probability import tell_probabilities
from zerodrift.diagnosis.remainder import RemainderPattern, describe_remainder, single_out_runs
from zerodrift.diagnosis.rules import ENOUGH_RUNS, Finding, list_lookalikes, wanders
from zerodrift.physics.effect import FEWEST_RUNS
from zerodrift.physics.fit import flat_weights
from zerodrift.physics.run_offsets import TREND_BY_CHANCE
from zerodrift.physics.search import Found, search
from zerodrift.physics.signals import explain_missing
from zerodrift.physics.terms import tidy_terms

WANTED_RUNS = 8


def report(
    case: Case,
    verdict: str,
    first: Examination,
    finding: Finding | None,
    others: tuple[Finding, ...],
    *,
    beside: float = 0.0,
) -> Diagnosis:
    """Return the diagnosis in words and numbers.

    Args:
        case: what is diagnosed.
        verdict: missing | complete | unknown.
        first: the examination of the model as it is.
        finding: the effect that is named, or comes nearest.
        others: further effects that are named.
        beside: the least probability that something else is missing.
    """
    missing = verdict == "missing" and finding is not None
    alike = []
    if missing and finding is not None:
        alike = list_lookalikes(finding, beside=beside >= LIKELY)
    nearest = finding.judged if finding else (first.judged[0] if first.judged else None)
    after = before = first.floor_ratio
    named = None
    if missing and finding is not None:
        named = finding.judged if not others else _alone(first, finding)
        after = named.floor_ratio
    remainder = _describe(case, first, first.base) if verdict == "unknown" else ()
    told = tell_probabilities(
        Diagnosis(
            verdict=verdict,
            effect=finding.judged.kind if missing and finding is not None else None,
            parameters=_refit(case, finding.judged) if missing and finding is not None else {},
            lookalikes=tuple(judged.kind for judged in alike),
            also=tuple(other.judged.kind for other in others) if missing else (),
            nearest=nearest.kind if verdict == "unknown" and nearest is not None else None,
            candidates=tuple(
                CandidateReport(
                    judged.kind,
                    judged.rmse_ratio,
                    judged.p_value,
                    judged.excitation,
                    judged.parameters,
                    nats=judged.nats,
                    explained=float(np.clip(judged.share, 0.0, 1.0)),
                    sound=judged.sound,
                )
                for judged in sorted(first.judged, key=lambda j: j.rmse_ratio)
            ),
            not_testable=_list_untested(case, first),
            floor_ratio_before=before,
            floor_ratio_after=after,
            noise_floor_source="dwell" if case.dataset.dwell else "estimated",
            outputs=_list_errors(case, first, named),
            remainder=remainder,
            next_experiment=_advise(case, verdict, first, finding, alike),
            evidence=_weigh_evidence(case),
            remarks=_list_remarks(case, verdict, first),
            outliers=_tell_outliers(case),
        )
    )
    told = replace(told, something_else=max(told.something_else, beside))
    if missing and finding is not None and told.something_else >= LIKELY:
        rest = _describe(case, first, (others[-1] if others else finding).judged.found)
        return replace(told, remainder=rest)
    return told


def _refit(case: Case, judged: Judged) -> dict[str, float]:
    """Return the effect's values by plain least squares, as the fit of the model gives them."""
    found = search(case.campaign, judged.found.terms, flat_weights(case.campaign), vary=())
    terms = tidy_terms(found.terms)
    values = next(term.values for term in terms if term.effect.kind == judged.kind)
    return {name: values[name] for name in judged.parameters}


def _alone(first: Examination, finding: Finding) -> Judged:
    """Return this one of several effects as it does when it is added alone."""
    alone = (judged for judged in first.judged if judged.kind == finding.judged.kind)
    return next(alone, finding.judged)


def _list_errors(case: Case, first: Examination, named: Judged | None) -> dict[str, OutputErrors]:
    """Return each output's held-out RMSE as it is and with the effect that is named."""
    return {
        name: OutputErrors(
            case.dataset.units[k],
            float(np.sqrt(first.base_errors[k])),
            float(np.sqrt(named.errors[k])) if named is not None else None,
            float(case.floor[k]),
        )
        for k, name in enumerate(case.dataset.outputs)
    }


def _list_untested(case: Case, first: Examination) -> tuple[Untested, ...]:
    """Return the effects that could not be tested, those without rails included."""
    untested = list(first.untested)
    for kind, effect in case.catalogue.items():
        if effect.sets_aside and not any(t.effect.kind == kind for t in case.terms):
            why = explain_missing(effect, case.plan)
            if why:
                untested.append(Untested(kind, why))
    return tuple(untested)


def _describe(case: Case, first: Examination, model: Found) -> tuple[RemainderPattern, ...]:
    """Return what the remainder of a model follows."""
    rests = _list_rests(case, model)
    return tuple(describe_remainder(case.dataset.train, rests, case.plan, first.floor))


def _list_rests(case: Case, model: Found) -> list[Array]:
    """Return what a model leaves of each run's drift, [n, K]."""
    return [
        run.steady_drift - predict(model, run, case.plan, case.campaign.order)
        for run in case.dataset.train
    ]


def _advise(
    case: Case,
    verdict: str,
    first: Examination,
    finding: Finding | None,
    alike: Sequence[Judged],
) -> str:
    """Return the next experiment."""
    if verdict == "missing" and finding is not None:
        if alike:
            return _separate(case, finding, alike[0])
        effect = case.catalogue[finding.judged.kind]
        return f"to see {effect.kind} at its clearest: {_lower(effect.provoke)}"
    silent = [u for u in _list_untested(case, first) if u.why.startswith("no input")]
    if verdict == "unknown":
        if silent:
            inputs = ", ".join(sorted({u.effect for u in silent}))
            return f"log what could not be tested here ({inputs}), and diagnose again"
        return (
            "repeat one run exactly: what comes back is an effect of temperature, load or "
            "time that the catalogue lacks, what does not is noise or a fault"
        )
    for untested in first.untested:
        effect = case.catalogue[untested.effect]
        return f"nothing is missing; to test {effect.kind} too: {_lower(effect.provoke)}"
    return "nothing is missing in these logs"


def _separate(case: Case, finding: Finding, rival: Judged) -> str:
    """Return the experiment that tells a finding from its look-alike."""
    leading = finding.judged
    if case.catalogue[leading.kind].sets_aside or case.catalogue[rival.kind].sets_aside:
        return _lower(case.catalogue[leading.kind].provoke)
    chosen = choose_experiment(
        case.plan,
        case.dataset.train,
        case.campaign.order,
        (leading.found.terms, leading.found.solution),
        (rival.found.terms, rival.found.solution),
        finding.examination.floor,
    )
    if chosen is None:
        return (
            "no simple experiment within the logs' temperatures and loads tells "
            f"{leading.kind} from {rival.kind}; {_lower(case.catalogue[leading.kind].provoke)}"
        )
    experiment, apart = chosen
    return (
        f"{experiment.instruction}: {leading.kind} and {rival.kind} would then differ by "
        f"{apart:.1f} times the noise"
    )


def _weigh_evidence(case: Case) -> str:
    """Return how many runs count as evidence, and whether they are few."""
    runs = len(case.campaign.groups)
    if runs < FEWEST_RUNS:
        pieces = case.campaign.run_of_piece.size
        noun = "run was" if runs == 1 else "runs were"
        return (
            f"thin: {runs} {noun} cut into {pieces} pieces, which resemble each other more "
            f"than runs would; p-values are too small. {WANTED_RUNS} runs or more are wanted"
        )
    if runs < ENOUGH_RUNS:
        return (
            f"thin: with {runs} runs no p-value can be below {2.0**-runs:.2g}; "
            f"{WANTED_RUNS} runs or more are wanted"
        )
    return f"{runs} runs"


def _tell_outliers(case: Case) -> OutlierCount:
    """Return the outliers in the logs that the verdict is drawn from."""
    return tell_outliers((*case.dataset.train, *case.dataset.dwell))


def _tell_offsets(case: Case, first: Examination) -> str:
    """Return what became of the runs' offsets, in a sentence; or nothing."""
    if case.trend.is_real:
        return (
            "the runs' offsets follow the clock, so they count as drift: a line or a logarithm over"
            f" the clock leaves {100.0 * case.trend.share:.2g} % of their squares, and offsets at "
            f"random leave as little in at most {100.0 * TREND_BY_CHANCE:g} % of all cases. Logs"
            " that are zeroed one by one: set [logs] tared = true, and the offsets are taken off"
        )
    if not case.campaign.tared or len(case.campaign.groups) < 2:
        return ""
    rests = _list_rests(case, first.base)
    means = [
        np.concatenate(
            [r for r, run in zip(rests, case.dataset.train, strict=True) if run.group == group]
        ).mean(axis=0)
        for group in case.campaign.groups
    ]
    offsets = np.stack(means).std(axis=0)
    told = [
        f"{name} {offset:.3g} {unit} (error {np.sqrt(error):.3g})"
        for name, unit, offset, error in zip(
            case.dataset.outputs, case.dataset.units, offsets, first.base_errors, strict=True
        )
    ]
    stated = case.dataset.train[0].tared
    why = "[logs] tared says so" if stated else "the runs differ that way"
    note = f"each run's own offset is taken off, as {why}; RMS over the runs: {', '.join(told)}"
    if stated:
        return note
    return (
        f"{note}. Logs that are not zeroed one by one: set [logs] tared = false, and the offsets"
        " count"
    )


def _list_remarks(case: Case, verdict: str, first: Examination) -> tuple[str, ...]:
    """Return what else a reader should know."""
    notes = list(case.notes)
    outliers = _tell_outliers(case).explain()
    notes += [outliers] if outliers else []
    notes += [offsets] if (offsets := _tell_offsets(case, first)) else []
    if not case.dataset.dwell:
        notes.append(
            "no dwell shows the noise, so the floor is estimated from the fast part of "
            "what the model leaves, and slow noise cannot be told from a missing effect"
        )
    elif wanders(case, first):
        notes.append(
            "the sensor wanders slowly even in the dwell, at rest: that part is no effect of "
            "temperature or load"
        )
    if len(case.campaign.groups) == 1:
        notes.append(
            "one run cannot show what differs from run to run, and a slow trend in it may have "
            "more than one cause; only another run tells"
        )
    if verdict == "unknown":
        culprits = single_out_runs(case.dataset.train, _list_rests(case, first.base), first.floor)
        notes += [culprits] if culprits else []
    return tuple(notes)


def _lower(sentence: str) -> str:
    """Return a sentence to go on with after a colon."""
    return sentence[:1].lower() + sentence[1:].rstrip(".")
