"""The next experiment: undecided effects, limits, and the programme that distinguishes them
best.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.candidates import AT_AN_END, AT_AN_END_UNITS, OF_WHAT_IS_LEFT
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.diagnose import diagnose_config
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.examination import LIKE_BEST, LIKE_BEST_UNITS
from zerodrift.diagnosis.rules import ALIKE, ENOUGH_RUNS
from zerodrift.discovery.contenders import (
    SLOWER_THAN_PLANS,
    Contender,
    RivalForm,
    Scene,
    describe_noise,
    find_placeable,
    imagine,
    list_forms,
    list_own,
    look_back,
    place_nodes,
    refuse_unknown,
    spread_nodes,
)
from zerodrift.discovery.criterion import CLOSE_ROWS, Judge, Told, weigh
from zerodrift.discovery.limits import Limits, resolve_limits
from zerodrift.discovery.programme import SetProgramme
from zerodrift.discovery.search import FEW, Best, Space, choose_spaces, find_programme, list_designs
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.search import get_coordinates
from zerodrift.physics.signals import SignalPlan
from zerodrift.physics.terms import start_term

# A closer look at one programme: finer grids, all that may be mistaken, the nearest values.
#
# The search compares programmes on coarse grids. For the one that is taken, whatever comes near a
# truth is refined: around its best node for each truth, half a step to both sides, and again.

CLOSE = {1: 25, 2: 7, 3: 4}
"""Values of each shared parameter of a rival, by how many it has."""
ROUNDS = 4
"""Refinements, each of half the step before."""
IN_REACH = 3.0
"""A form is refined for a truth where it leaves less than this many times what the nearest does."""


def look_closer(scene: Scene, catalogue: Catalogue) -> Scene:
    """Return the scene with finer grids of all forms, and all else of the catalogue that may be
    mistaken."""
    open_kinds = {contender.kind for contender in scene.contenders}

    def spread(kind: str) -> tuple[RivalForm, ...]:
        forms = list_forms(catalogue, scene.base, kind, len(catalogue[kind].variants))
        return tuple(spread_nodes(form, CLOSE) for form in forms)

    others = [
        kind
        for kind, effect in catalogue.items()
        if kind not in open_kinds
        and not find_placeable(effect, scene.plan)
        and list_forms(catalogue, scene.base, kind)
    ]
    return replace(
        scene,
        contenders=tuple(replace(c, forms=spread(c.kind)) for c in scene.contenders),
        outsiders=tuple(Contender(kind, (), spread(kind)) for kind in others),
    )


def judge_closely(
    make_judge: Callable[[Scene], Judge], scene: Scene, space: Space, point: Array
) -> Told:
    """Return what a programme is expected to tell, each rival at its nearest values.

    Args:
        make_judge: the judge of a scene.
        scene: see `look_closer`.
        space: what the point stands for.
        point: the programme.
    """
    logs, repeats = space.list_patterns(point), space.repeats
    for number in range(1, ROUNDS + 1):
        told, left = make_judge(scene).judge_nodes(logs, repeats)
        scene = _refine(scene, told, left, 0.5**number)
    scene = _add_ends(scene, *make_judge(scene).judge_nodes(logs, repeats))
    return _tell(scene, *make_judge(scene).judge_nodes(logs, repeats))


def _refine(scene: Scene, told: Told, left: Sequence[Array], share: float) -> Scene:
    """Return the scene with the best nodes alone, and nodes beside those that are in reach.

    Args:
        scene: as it was judged.
        told: that.
        left: rival's form -> [N, M D] what each node leaves of each truth.
        share: of the first step between nodes, to either side.
    """
    nearest = np.minimum(told.apart.min(axis=2), told.beside).ravel()
    draws = told.gain.shape[1]

    def refine(form: RivalForm, own: int, squares: Array) -> RivalForm:
        coordinates, ends = list_own(form)
        if not coordinates:
            return form
        nodes = CLOSE.get(len(coordinates), 2)
        step = share * (ends[:, 1] - ends[:, 0]) / (nodes - 1)
        points: dict[tuple[float, ...], None] = {}
        for m, best in enumerate(squares.argmin(axis=0).tolist()):
            if m // draws == own:
                continue
            u = get_coordinates(form.models[best], coordinates)
            points[tuple(u.tolist())] = None
            if squares[best, m] > IN_REACH * nearest[m]:
                continue
            for p in range(len(coordinates)):
                for sign in (-1.0, 1.0):
                    moved = u.copy()
                    moved[p] = np.clip(u[p] + sign * step[p], *ends[p])
                    points[tuple(moved.tolist())] = None
        return place_nodes(form, coordinates, list(points)) if points else form

    return _change(scene, refine, left)


def _add_ends(scene: Scene, told: Told, left: Sequence[Array]) -> Scene:
    """Return the scene with the best node for each truth, [M D], and below these the same with each
    value at one end of all that it may be, at the other end, and so for the next value."""

    def extend(form: RivalForm, own: int, squares: Array) -> RivalForm:
        coordinates, _ = list_own(form)
        best = squares.argmin(axis=0).tolist()
        points = [get_coordinates(form.models[node], coordinates) for node in best]
        for p, coordinate in enumerate(coordinates):
            for end in coordinate.bounds:
                points += [np.where(np.arange(len(u)) == p, end, u) for u in points[: len(best)]]
        return place_nodes(form, coordinates, [u.tolist() for u in points])

    return _change(scene, extend, left)


def _change(
    scene: Scene, change: Callable[[RivalForm, int, Array], RivalForm], left: Sequence[Array]
) -> Scene:
    """Return the scene with changed forms; `change` is given a form, the number of its contender,
    or -1 of an outsider, and what its nodes leave."""
    rest = iter(left)

    def change_all(contender: Contender, own: int) -> Contender:
        forms = tuple(change(form, own, next(rest)) for form in contender.forms)
        return replace(contender, forms=forms)

    return replace(
        scene,
        contenders=tuple(change_all(c, m) for m, c in enumerate(scene.contenders)),
        outsiders=tuple(change_all(c, -1) for c in scene.outsiders),
    )


def _tell(scene: Scene, told: Told, left: Sequence[Array]) -> Told:
    """Return what is told, each rival in the form that `diagnose` would choose of it.

    An effect at a value that an end of its range does as well as is a simpler one, or another one,
    in disguise: `diagnose` takes it neither for the missing effect nor for a look-alike, if it sees
    that.

    Args:
        scene: with nodes as `_add_ends` lays them.
        told: by all nodes.
        left: rival's form -> [N, M D].
    """
    count, draws = told.gain.shape
    gain = told.gain.ravel()
    each = np.arange(gain.size)
    apart = np.full((gain.size, count), np.inf)
    disguised = np.zeros((gain.size, count))
    beside = np.full(gain.size, np.inf)
    rest = iter(left)
    for r, contender in enumerate((*scene.contenders, *scene.outsiders)):
        nearest, hidden = [], []
        for form in contender.forms:
            squares = next(rest).reshape(-1, gain.size, gain.size)[:, each, each]
            if told.runs >= form.fewest_runs:
                nearest.append(squares[0])
                hidden.append(expect_disguise(gain, squares, told.samples))
        if not nearest:
            continue
        chosen = choose_forms(gain, np.stack(nearest))
        near, hides = np.stack(nearest)[chosen, each], np.stack(hidden)[chosen, each]
        if r >= count:
            beside = np.minimum(beside, np.where(hides > 0.5, np.inf, near))
            continue
        others = each // draws != r
        apart[others, r] = near[others]
        disguised[others, r] = hides[others]
    return replace(
        told,
        apart=apart.reshape(count, draws, count),
        beside=beside.reshape(count, draws),
        disguised=disguised.reshape(count, draws, count),
    )


def choose_forms(gain: Array, nearest: Array) -> IntArray:
    """Return [T] the simplest form of a rival that gains about as much as its best one.

    Args:
        gain: [T] of each truth.
        nearest: [F, T] what each form leaves of it, simplest first.
    """
    gains = gain - nearest
    best = gains.max(axis=0)
    least = best - np.maximum(LIKE_BEST * np.abs(best), LIKE_BEST_UNITS)
    return np.asarray((gains >= least).argmax(axis=0), dtype=np.int64)


def expect_disguise(gain: Array, squares: Array, samples: float) -> Array:
    """Return [T] the probability that an end of a range is seen to do as well as the best values.

    What an end loses over these is a difference of two squared errors: with noise it spreads by
    twice the root of what is expected of it.

    Args:
        gain: [T] of each truth.
        squares: [1 + E, T] what the best values leave of it, and below these each end.
        samples: of all outputs, each of which leaves a unit of noise.
    """
    near, lost = squares[0], np.maximum(squares[1:] - squares[0], 1e-9)
    share = np.minimum(AT_AN_END * (gain - near), OF_WHAT_IS_LEFT * (samples + near))
    enough = np.maximum(AT_AN_END_UNITS, share)
    return np.asarray(ndtr((enough - lost) / (2.0 * np.sqrt(lost))).max(axis=0, initial=0.0))


# The next experiment: undecided effects, limits, and the programme that distinguishes them best.

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
