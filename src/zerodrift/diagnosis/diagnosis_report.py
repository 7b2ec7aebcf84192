"""The findings in words and numbers: verdict, next experiment, evidence, notes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import OutlierCount, Run, tell_outliers
from zerodrift.diagnosis.candidates import Untested
from zerodrift.diagnosis.case import Case
from zerodrift.diagnosis.diagnosis import LIKELY, CandidateReport, Diagnosis, OutputErrors
from zerodrift.diagnosis.examination import Examination, Judged, predict
from zerodrift.diagnosis.remainder import RemainderPattern, describe_remainder, single_out_runs
from zerodrift.diagnosis.rules import ENOUGH_RUNS, Finding, list_lookalikes, wanders
from zerodrift.operations.backend import NumpyOperations
from zerodrift.physics.effect import FEWEST_RUNS, Signals
from zerodrift.physics.fit import TREND_BY_CHANCE, flat_weights
from zerodrift.physics.search import Found, Solution, search
from zerodrift.physics.signals import SignalPlan, explain_missing
from zerodrift.physics.terms import Term, build_features, tidy_terms

# The next experiment: the one of a few simple ones that would tell two explanations apart.
#
# Both models are simulated through each experiment on the menu, within the temperatures and loads
# that the logs have seen; the experiment is best in which their predictions differ most
# (discrimination design, Atkinson and Fedorov, Biometrika 62 (1975)).

STEPS = 7200
"""Simulated seconds of each experiment."""
WORTHWHILE = 1.0
"""Predictions must differ by this many times the noise for an experiment to be worth doing."""


NEARLY = 0.95
"""An experiment that tells this share of what the best one tells will do."""


@dataclass(frozen=True)
class Experiment:
    """One item of the menu: what to do, and what the signals would then be."""

    name: str
    instruction: str
    temperature_degC: Array
    load_share: Array
    """[n] of each output's largest load in the logs."""
    channel_share: Mapping[str, Array]
    """Channel -> [n] share of its range in the logs, 0..1."""

    @property
    def effort(self) -> int:
        """How many things have to be moved."""
        moves_temperature = bool(np.ptp(self.temperature_degC) > 0.0)
        return int(moves_temperature) + int(self.load_share.any()) + len(self.channel_share)


def list_experiments(lowest_degC: float, highest_degC: float) -> list[Experiment]:
    """Return the menu, within a range of temperatures."""
    t = np.arange(STEPS, dtype=np.float64)
    middle = 0.5 * (lowest_degC + highest_degC)
    rest = np.full(STEPS, middle)
    none = np.zeros(STEPS)
    half = np.full(STEPS, 0.5)
    reach = highest_degC - lowest_degC

    def ramps(*knots: tuple[float, float]) -> Array:
        times, shares = zip(*knots, strict=True)
        return np.asarray(lowest_degC + reach * np.interp(t / STEPS, times, shares))

    two_rates = ramps((0.0, 0.2), (0.1, 0.2), (0.15, 0.8), (0.45, 0.8), (0.8, 0.2), (1.0, 0.2))
    loop = ramps((0.0, 0.5), (0.05, 0.5), (0.3, 1.0), (0.7, 0.0), (0.95, 0.5), (1.0, 0.5))
    hold = ((t > 0.1 * STEPS) & (t < 0.5 * STEPS)).astype(np.float64)
    stairs = np.minimum(np.floor(t / STEPS * 20.0), 20.0 - np.floor(t / STEPS * 20.0)) / 10.0
    switched = (np.floor(t / STEPS * 8.0) % 2.0).astype(np.float64)
    return [
        Experiment(
            "two ramp rates",
            "ramp the temperature once fast and once slowly, with dwells between, unloaded",
            two_rates,
            none,
            {},
        ),
        Experiment(
            "heating and cooling loop",
            "run one full loop of temperature, warm, cold and back, slowly and unloaded",
            loop,
            none,
            {},
        ),
        Experiment(
            "step and hold of the load",
            "at constant temperature put a load on, hold it for an hour, take it off, wait",
            rest,
            hold,
            {},
        ),
        Experiment(
            "stairs of the load",
            "at constant temperature raise the load in ten steps and lower it by the same steps",
            rest,
            stairs,
            {},
        ),
        Experiment(
            "load at several temperatures",
            "hang the same load on and off while the temperature ramps",
            loop,
            switched,
            {},
        ),
        Experiment(
            "cold power-on",
            "switch the power on at constant temperature after hours off, and log two hours "
            "without taring",
            rest,
            none,
            {},
        ),
        *(
            Experiment(name, instruction, rest, none, {channel: share})
            for name, instruction, channel, share in (
                (
                    "light off and on",
                    "at rest switch the light off and on, several times",
                    "ambient_light",
                    switched,
                ),
                (
                    "supply steps",
                    "at rest step the supply up and down, several times",
                    "supply",
                    switched,
                ),
                (
                    "humidity step",
                    "at constant temperature step the humidity once and wait",
                    "humidity",
                    hold,
                ),
                (
                    "six attitudes",
                    "turn the unloaded sensor through six attitudes",
                    "acceleration_z",
                    half * 2.0 * switched,
                ),
            )
        ),
    ]


def choose_experiment(
    plan: SignalPlan,
    runs: Sequence[Run],
    order: Sequence[str],
    one: tuple[Sequence[Term], Solution],
    other: tuple[Sequence[Term], Solution],
    noise: Array,
) -> tuple[Experiment, float] | None:
    """Return the experiment in which two fitted models differ most, and by how many noise RMS.

    Args:
        plan: the project's signals.
        runs: the logs, for the ranges of temperature, loads and channels.
        order: the catalogue's order.
        one: terms and coefficients of a model.
        other: the same of another.
        noise: [K] RMS.

    Returns:
        None where no experiment on the menu would separate them.
    """
    lowest = min(float(run.temperature_degC.min()) for run in runs)
    highest = max(float(run.temperature_degC.max()) for run in runs)
    found: list[tuple[Experiment, float]] = []
    for experiment in list_experiments(lowest, highest):
        if any(channel not in plan.channels for channel in experiment.channel_share):
            continue
        if experiment.load_share.any() and not plan.loaded:
            continue
        signals = _simulate(experiment, plan, runs)
        difference = _predict(signals, plan, order, *one) - _predict(signals, plan, order, *other)
        difference -= difference.mean(axis=0)
        apart = float(np.sqrt(np.mean((difference / noise) ** 2)))
        found.append((experiment, apart))
    most = max((apart for _, apart in found), default=0.0)
    if most < WORTHWHILE:
        return None
    # Of experiments that tell about as much, the one that moves least is the easiest.
    return min(
        (entry for entry in found if entry[1] >= NEARLY * most),
        key=lambda entry: (entry[0].effort, -entry[1]),
    )


def _simulate(experiment: Experiment, plan: SignalPlan, runs: Sequence[Run]) -> Signals[Array]:
    """Return the signals of an experiment at one sample per second."""
    elapsed_s = np.arange(STEPS, dtype=np.float64)
    load = {}
    for name in plan.loaded:
        k = plan.outputs.index(name)
        largest = max((run.reference[:, k] for run in runs), key=lambda x: float(np.abs(x).max()))
        load[name] = experiment.load_share * float(largest[np.abs(largest).argmax()])
    channels = {}
    for name in plan.channels:
        low = min(float(run.inputs[name].min()) for run in runs)
        high = max(float(run.inputs[name].max()) for run in runs)
        middle = np.full(STEPS, 0.5)
        channels[name] = low + (high - low) * experiment.channel_share.get(name, middle)
    return Signals(
        temperature_degC=experiment.temperature_degC,
        elapsed_s=elapsed_s,
        clock_s=elapsed_s,
        load=load,
        saturated={name: np.zeros(STEPS) for name in plan.saturated},
        channels=channels,
        outputs=plan.outputs,
        full_scale=dict(zip(plan.outputs, plan.full_scale, strict=True)),
        reference_temperature_degC=plan.reference_temperature_degC,
    )


def _predict(
    signals: Signals[Array],
    plan: SignalPlan,
    order: Sequence[str],
    terms: Sequence[Term],
    solution: Solution,
) -> Array:
    """Return the drift [n, K] that a model predicts for simulated signals."""
    plan = replace(plan, sample_period_s=1.0)
    ops = NumpyOperations(plan.sample_period_s, signals.temperature_degC.shape)
    features = build_features(ops, signals, terms, order)[1:]
    total = np.zeros((STEPS, len(plan.outputs)))
    for feature, row in zip(features, solution.coefficients.T, strict=True):
        total += feature.signal[:, None] * row
    return total


# Figures of a diagnosis turned into probabilities, by logistic maps fitted on simulated cases.
#
# The maps are data: `probability.txt` beside this file, written by `python -m
# benchmarks.study_probability fit`, which says on how many cases of which kind. So the base rates
# are those of these cases, and a probability holds for logs like theirs.

MAPS = Path(__file__).with_name("probability.txt")
CANDIDATE, NOTHING, ELSE = "candidate", "nothing_missing", "something_else"
LEAST, MOST = 0.001, 0.999
"""No map that was fitted on some hundred cases can tell a smaller or a larger probability."""
MOST_DECADES = 3.6


@dataclass(frozen=True)
class ProbabilityMap:
    """A logistic map: weights [P] of the figures, the constant first."""

    name: str
    weights: tuple[float, ...]

    def apply(self, figures: Sequence[float]) -> float:
        """Return the probability that belongs to a diagnosis's figures [P]."""
        exponent = float(np.clip(np.dot(self.weights, figures), -20.0, 20.0))
        return float(np.clip(1.0 / (1.0 + np.exp(-exponent)), LEAST, MOST))


@lru_cache(maxsize=1)
def load_maps() -> dict[str, ProbabilityMap]:
    """Return the fitted maps by name."""
    maps = {}
    for line in MAPS.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            name, *weights = line.split()
            maps[name] = ProbabilityMap(name, tuple(float(w) for w in weights))
    return maps


def list_candidate_figures(diagnosis: Diagnosis, candidate: CandidateReport) -> list[float]:
    """Return what tells whether a candidate is missing: its standing, its gain, its share."""
    named = candidate.effect == diagnosis.effect
    beside = candidate.effect in diagnosis.also
    alike = candidate.effect in diagnosis.lookalikes
    nearest = candidate.effect == diagnosis.nearest
    return [
        1.0,
        float(named),
        float(beside),
        float(alike),
        float(nearest),
        float(diagnosis.effect is not None),
        float(np.log1p(max(candidate.nats, 0.0))) * float(candidate.sound),
        candidate.explained * float(candidate.sound),
        min(-float(np.log10(max(candidate.p_value, 1e-9))), MOST_DECADES),
    ]


def list_case_figures(diagnosis: Diagnosis) -> list[float]:
    """Return what tells whether anything is missing, and whether the named effect is all of it."""
    best = max((c.nats for c in diagnosis.candidates if c.sound), default=0.0)
    return [
        1.0,
        float(diagnosis.verdict == "missing"),
        float(diagnosis.verdict == "unknown"),
        float(bool(diagnosis.also)),
        float(np.log(max(diagnosis.floor_ratio_before, 1e-3))),
        float(np.log(max(diagnosis.floor_ratio_after, 1e-3))),
        float(diagnosis.noise_floor_source == "dwell"),
        float(np.log1p(max(best, 0.0))),
    ]


def tell_probabilities(diagnosis: Diagnosis) -> Diagnosis:
    """Return the diagnosis with its probabilities."""
    maps = load_maps()
    figures = list_case_figures(diagnosis)
    nothing = maps[NOTHING].apply(figures)
    beside = maps[ELSE].apply(figures) if diagnosis.effect is not None else 1.0 - nothing
    candidates = tuple(
        replace(c, probability=maps[CANDIDATE].apply(list_candidate_figures(diagnosis, c)))
        for c in diagnosis.candidates
    )
    return replace(diagnosis, candidates=candidates, nothing_missing=nothing, something_else=beside)


# The findings in words and numbers: verdict, next experiment, evidence, notes.

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
