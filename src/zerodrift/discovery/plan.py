"""The next experiment: undecided effects, limits, and the programme that distinguishes them
best."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.diagnose import diagnose_config
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.rules import ALIKE, ENOUGH_RUNS
from zerodrift.discovery.closer import judge_closely, look_closer
from zerodrift.discovery.contenders import (
    SLOWER_THAN_PLANS,
    Scene,
    describe_noise,
    find_placeable,
    imagine,
    list_forms,
    look_back,
    refuse_unknown,
)
from zerodrift.discovery.criterion import CLOSE_ROWS, Judge, Told
from zerodrift.discovery.likely import weigh
from zerodrift.discovery.limits import Limits, resolve_limits
from zerodrift.discovery.patterns import FEW, Space, choose_spaces
from zerodrift.discovery.programme import SetProgramme
from zerodrift.discovery.search import Best, find_programme, list_designs
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.signals import SignalPlan
from zerodrift.physics.terms import start_term

HOURS = 8.0
BUDGET_S = 60.0
NOISE_PCT = 0.01
"""RMS of the noise in % of full scale where nothing is said and no log shows it: about one count of
a converter of 14 bits."""
SIZE_IN_NOISE = 3.0
"""Size of an effect that has to be named, where no target is set, in noise RMS."""
AFTER_POWER_ON = "warm_up"
"""The effect of which a log shows nothing that does not begin with the power-on."""
NEAR_ENOUGH = 0.97
"""With an UNKNOWN, candidates that leave no more than this of the error are open."""
MOST_NEAR = 4
"""Candidates that are open at most where none is named."""
MOST_OPEN = 8
SHOWN_OUTPUTS = 2
"""Outputs that stand for all where nothing is known of any."""
SEED = 1
LINE = 2e-4
"""Of two programmes that tell as much, the one with fewer lines is taken."""


class NothingLeftError(InputError):
    """No experiment is needed, or none could show what is open."""


@dataclass(frozen=True)
class Question:
    """What is asked for."""

    hours: float = HOURS
    between: tuple[str, ...] = ()
    """Effects to distinguish; empty: those that are undecided."""
    target: float | None = None
    """Share of full scale from which on an effect has to be named; None: 3 times the noise."""
    budget_s: float = BUDGET_S
    """Processor seconds of the search."""
    criterion: str = "discrimination"
    """discrimination | precision | error."""
    profile: str | None = None
    """For `error`: the run that the sensor is used as; None: all that the limits allow."""
    units: int = 0
    """Further units of the design, for which few hours are wanted; 0: no such question."""

    def __post_init__(self) -> None:
        """Refuse what is no number of hours, of seconds, or no share.

        Raises:
            InputError: one of them is not finite, or not above 0.
        """
        for name, value, expected in (
            ("hours", self.hours, "hours, such as 8"),
            ("budget", self.budget_s, "processor seconds, such as 60"),
            ("target", self.target, "a share of full scale, such as 0.1% (in Python 0.001)"),
        ):
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(
                    f"plan: {name} is {value:g}; expected {expected}, finite and more than 0."
                )


@dataclass(frozen=True)
class Planned:
    """A programme, and what it is expected to show."""

    question: Question
    limits: Limits
    scene: Scene
    programme: SetProgramme
    told: Told
    sized: SetProgramme
    """In which effects of which nothing is known were made as large as asked for."""
    best: Best
    notes: tuple[str, ...]
    cpu_s: float
    first_cpu_s: float
    """Processor seconds until there was a first answer."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """The effects that are open."""
        return tuple(contender.kind for contender in self.scene.contenders)


def find_open(diagnosis: Diagnosis, runs: int) -> tuple[tuple[str, ...], dict[str, str], str]:
    """Return what a diagnosis leaves open: effects, why some were not tested, and in words.

    Args:
        diagnosis: of the logs that there are.
        runs: training runs; with few of them COMPLETE says that nothing is sure yet, no more.

    Raises:
        NothingLeftError: nothing is left to tell apart.
    """
    silent = {u.effect: u.why for u in diagnosis.not_testable if u.excitation is not None}
    if diagnosis.verdict == "missing" and diagnosis.effect is not None and diagnosis.lookalikes:
        kinds = (diagnosis.effect, *diagnosis.lookalikes)
        return kinds, {}, f"these logs cannot tell {diagnosis.effect} from its look-alikes"
    if diagnosis.verdict == "unknown":
        near = [c.effect for c in diagnosis.candidates if c.rmse_left_out_ratio <= NEAR_ENOUGH]
        kinds = tuple(dict.fromkeys((*near[:MOST_NEAR], *silent)))
        if len(kinds) > 1:
            return kinds, silent, "something is missing that none of these explains yet"
    elif diagnosis.verdict == "complete" and runs < ENOUGH_RUNS:
        gaining = [c.effect for c in diagnosis.candidates if c.sound and c.rmse_left_out_ratio < 1]
        kinds = tuple(dict.fromkeys((*gaining[:MOST_NEAR], *silent)))
        if kinds:
            noun = "run is" if runs == 1 else "runs are"
            said = f"nothing is missing for sure, but {runs} {noun} thin evidence"
            return kinds, silent, said
    elif silent:
        said = (
            "nothing is missing" if diagnosis.effect is None else f"{diagnosis.effect} is missing"
        )
        return tuple(silent), silent, f"{said} in these logs, which could not test these effects"
    named = (
        f"{diagnosis.effect} is missing, and no other effect looks like it"
        if diagnosis.effect is not None
        else f"the verdict is {diagnosis.verdict}, and every effect that could be tested was"
    )
    raise NothingLeftError(
        f"plan: nothing is left to tell apart: {named}. Expected two open explanations or an "
        "effect that the logs could not test. Name what to compare by --between EFFECT EFFECT, or "
        "go on with `zerodrift add` or `zerodrift propose`."
    )


def plan_experiment(
    config: Config,
    dataset: Dataset | None,
    catalogue: Catalogue,
    question: Question,
    say: Callable[[str], None] = lambda text: None,
) -> Planned:
    """Return the programme that is expected to tell most of what is open.

    Args:
        config: the project.
        dataset: its runs; None before any log.
        catalogue: the known effects.
        question: hours, effects, target and budget.
        say: told how far it is.

    Raises:
        InputError: limits that contradict each other, an effect that no experiment can show, or
            nothing left to tell apart.
    """
    begin = time.process_time()
    runs: Sequence[Run] = () if dataset is None else dataset.train
    limits = resolve_limits(config, runs, question.hours)
    notes = list(limits.notes)
    if dataset is None:
        scene, floor = open_blank(config, catalogue, limits, question, notes)
        before: Sequence[Run] = ()
        outputs = _choose_blank(scene.plan)
    else:
        say("what is open")
        scene, floor = _open_logs(config, dataset, catalogue, limits, question, notes)
        before = [replace(run, before=None) for run in runs]
        outputs = tuple(np.argsort(-_rank_outputs(scene, floor))[:3].tolist())
    limits = leave_alone(limits, [c.kind for c in scene.contenders], catalogue)
    # "Nothing more is missing" takes so many runs: logs that go on with others have to reach them.
    few = [n for n in FEW if scene.runs == 0 or scene.runs + n >= ENOUGH_RUNS]
    spaces = choose_spaces(limits, question.hours, scene.runs, few=few)
    full_scale = np.array([output.full_scale for output in config.outputs])
    size = SIZE_IN_NOISE * floor if question.target is None else question.target * full_scale
    use = spaces[0].use_all()
    everything = list_designs(use)[1]
    scene = Judge(scene, limits, (), outputs, CLOSE_ROWS).scale(
        use.list_patterns(everything), use.lengthen().list_patterns(everything), size
    )
    judge = Judge(scene, limits, before, outputs)
    first_s = [0.0]

    def answer_first(best: Best) -> None:
        first_s[0] = time.process_time() - begin

    best = find_programme(
        spaces,
        lambda space, point: _weigh(judge, space, point),
        question.budget_s,
        say,
        answer_first,
    )
    if best.interrupted:
        notes.append("interrupted: the best programme until then")
    say("a closer look at the best programme")
    told = judge_closely(
        lambda closer: Judge(closer, limits, before, outputs, CLOSE_ROWS),
        look_closer(scene, catalogue),
        best.space,
        best.point,
    )
    return Planned(
        question,
        limits,
        scene,
        best.space.build(best.point),
        told,
        use.build(everything),
        best,
        tuple(notes),
        time.process_time() - begin,
        first_s[0],
    )


def refuse_alike(planned: Planned) -> None:
    """Refuse effects of which the best programme tells none from the nearest other one.

    `diagnose` takes two effects for look-alikes, however large they are, where one of them gains
    nearly as much as the other.

    Raises:
        NothingLeftError: so it is, for all of them and all of their values.
    """
    told, kinds = planned.told, planned.kinds
    if len(kinds) < 2:
        return
    gain = told.gain[:, :, None]
    rivals = np.where(told.disguised > 0.5, np.inf, told.apart)
    if (rivals > ALIKE * gain).all(axis=2).any():
        return
    left = float(np.minimum(rivals.min(axis=2), told.gain).max())
    share = float((rivals.min(axis=2) / np.maximum(told.gain, 1e-9)).max())
    raise NothingLeftError(
        f"--between {' '.join(kinds)}: no programme that was tried tells one from another. In the "
        f"best of {planned.best.tried} of {planned.programme.hours:.2g} h, refitting another one "
        f"leaves at most {left:.2g} noise units, {100.0 * share:.2g} % of what the right one gains;"
        f" expected more than {100.0 * ALIKE:g} %, which `diagnose` asks for. Allow more "
        "temperatures, loads or inputs under [experiment], or give more --hours or --budget."
    )


def _weigh(judge: Judge, space: Space, point: Array) -> float:
    """Return what a programme tells, less a little for each line that somebody has to set."""
    lines = sum(len(log.settings) for log in space.list_patterns(point))
    return weigh(judge.judge(space, point)) - LINE * lines


def leave_alone(limits: Limits, kinds: Sequence[str], catalogue: Catalogue) -> Limits:
    """Return the limits without the loads and inputs that none of these effects follows."""
    needs = {need for kind in kinds for need in catalogue[kind].needs}
    named = {name for need in needs for name in need.split("|")}
    loads = limits.loads if "load" in named else {}
    inputs = {name: reach for name, reach in limits.inputs.items() if name in named}
    nominal = {name: limits.nominal[name] for name in inputs}
    return replace(limits, loads=loads, inputs=inputs, nominal=nominal)


def _refuse_unpowered(kinds: Sequence[str], limits: Limits) -> None:
    if AFTER_POWER_ON in kinds and not limits.power:
        raise InputError(
            f"--between {AFTER_POWER_ON}: [experiment] power is false, so no log begins with the "
            "power-on, and none shows it; expected power = true. Leave the effect out, or allow "
            "the power under [experiment]."
        )


def _refuse_single(kinds: Sequence[str], said: str) -> None:
    if not kinds:
        raise NothingLeftError(
            f"plan: {said}; no effect is left that this experiment could show. Expected one at "
            "least. Allow loads or inputs under [experiment], or name effects by --between."
        )


def open_blank(
    config: Config,
    catalogue: Catalogue,
    limits: Limits,
    question: Question,
    notes: list[str],
) -> tuple[Scene, Array]:
    """Return the scene before any log, and the noise floor [K]."""
    outputs = tuple(output.name for output in config.outputs)
    full_scale = tuple(output.full_scale for output in config.outputs)
    plan = SignalPlan(
        outputs=outputs,
        full_scale=full_scale,
        sample_period_s=config.sample_period_s,
        loaded=tuple(limits.loads),
        saturated=(),
        channels=tuple(limits.inputs),
        reference_temperature_degC=float(round(limits.start_degC)),
        clock_origin_s=0.0,
    )
    base = [start_term(catalogue, effect) for effect in config.effects]
    for term in base:
        why = find_placeable(term.effect, plan)
        if why:
            raise InputError(
                f"{config.path}: the model has {term.effect.kind}, but {why}; expected what it "
                "needs among what the experiment sets. Add it under [experiment.loads] or "
                "[experiment.inputs]."
            )
    kinds = question.between or tuple(
        kind
        for kind, effect in catalogue.items()
        if not find_placeable(effect, plan)
        and list_forms(catalogue, base, kind)
        and kind not in SLOWER_THAN_PLANS
        and not (kind == AFTER_POWER_ON and not limits.power)
        and not (kind == "crosstalk" and len(limits.loads) < 2)
    )
    refuse_unknown(kinds, catalogue, base, plan)
    _refuse_unpowered(kinds, limits)
    _refuse_single(kinds, "there are no logs yet")
    share = (config.experiment.noise_pct or NOISE_PCT) / 100.0
    if config.experiment.noise_pct is None:
        notes.append(
            f"noise of {NOISE_PCT:g} % of full scale, assumed; [experiment] noise_pct says better"
        )
    noise = describe_noise(full_scale, share, config.sample_period_s)
    scene = imagine(plan, catalogue, base, kinds, noise, SEED)
    return scene, share * np.array(full_scale)


def _open_logs(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    limits: Limits,
    question: Question,
    notes: list[str],
) -> tuple[Scene, Array]:
    """Return the scene after logs, and their noise floor [K]."""
    case = open_case(dataset, catalogue, config.effects)
    plan = replace(
        case.plan,
        loaded=tuple(n for n in case.plan.outputs if n in {*case.plan.loaded, *limits.loads}),
    )
    case = replace(case, plan=plan)
    untold: Mapping[str, str] = {}
    kinds = question.between
    if kinds:
        refuse_unknown(kinds, catalogue, case.terms, plan)
        _refuse_unpowered(kinds, limits)
    else:
        kinds, untold, said = find_open(diagnose_config(config, dataset), len(case.campaign.groups))
        kinds = tuple(
            kind
            for kind in kinds
            if not find_placeable(catalogue[kind], plan)
            and list_forms(catalogue, case.terms, kind)
            and kind not in SLOWER_THAN_PLANS
        )[:MOST_OPEN]
        notes.append(f"open: {', '.join(kinds)}: {said}")
        _refuse_single(kinds, said)
    return look_back(case, kinds, untold, SEED)


def _choose_blank(plan: SignalPlan) -> tuple[int, ...]:
    """Return the outputs that stand for all, loaded ones first."""
    order = sorted(range(len(plan.outputs)), key=lambda k: plan.outputs[k] not in plan.loaded)
    return tuple(order[:SHOWN_OUTPUTS])


def _rank_outputs(scene: Scene, floor: Array) -> Array:
    """Return [K] how strongly the contenders' coefficients show in each output, in its noise."""
    rank = np.zeros(len(scene.plan.outputs))
    for contender in scene.contenders:
        for truth in contender.truths:
            if truth.known:
                rank += np.abs(truth.coefficients[:, -1]) / floor
    return rank
