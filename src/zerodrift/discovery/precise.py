"""Plans by precision: programmes that make the values of the model, as it is, more certain."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.examination import fit_base, measure_rest
from zerodrift.discovery.contenders import Scene, Truth, draw_fitted, spread_typical
from zerodrift.discovery.criterion import ROWS, Judge, Staged
from zerodrift.discovery.limits import Limits, resolve_limits
from zerodrift.discovery.plan import LINE, Question, leave_alone, open_blank
from zerodrift.discovery.programme import SetProgramme
from zerodrift.discovery.search import (
    QUIET_S,
    USE_CROSSINGS,
    Best,
    Space,
    choose_spaces,
    find_programme,
    list_designs,
)
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.search import (
    Coordinate,
    get_coordinates,
    invert_scaled,
    list_coordinates,
    set_coordinates,
)
from zerodrift.physics.terms import Term

# How precise a programme makes a model: widths of its values, and the error that is left by them.
#
# Linear least squares around a model's values: coefficients of each output, and shared values along
# their slopes. The noise is white once octaves are weighted, so the inverse of the normal matrix is
# the covariance; a log's mean says nothing, since logs may be tared.
#
# Source: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973); JCGM 100 (GUM), 5.1.2.

STEP = 1e-3
"""Finite-difference step of a shared value, in its own coordinate."""
PRIOR = 2.0
"""Standard deviation of a shared value of which nothing is known, in its own coordinate."""


@dataclass(frozen=True)
class Precision:
    """What an experiment leaves uncertain of one model."""

    widths: Array
    """[P] standard error of each shared value, in its own coordinate (a logarithm, or a share)."""
    relative: Array
    """[K', J] standard error of each coefficient over its size; infinite for one of zero."""
    error: Array
    """[K'] RMS error of the prediction over the use profile, in each output's unit."""


def list_free(truth: Truth, *, known: bool) -> list[Coordinate]:
    """Return the shared values that are to be determined; none where they are known already."""
    return [] if known else [c for c in list_coordinates(truth.terms) if not c.parameter.is_setting]


def measure_precision(
    judge: Judge, stages: Sequence[Staged], use: Staged, truth: Truth, *, known: bool
) -> Precision:
    """Return what a model's values are still uncertain by after an experiment.

    Args:
        judge: of the scene.
        stages: the experiment's logs, and those before it.
        use: the use profile.
        truth: the model, with coefficients.
        known: whether shared values are known, as from another unit of the design.
    """
    free = list_free(truth, known=known)
    u = get_coordinates(truth.terms, free)
    moved = []
    for p in range(len(free)):
        there = u.copy()
        there[p] += STEP if u[p] + STEP <= free[p].bounds[1] else -STEP
        moved.append((set_coordinates(truth.terms, free, there), there[p] - u[p]))
    outputs = len(judge.outputs)
    told = [judge.lay_columns(stage, truth.terms) for stage in stages]
    shifted = [[judge.lay_columns(s, terms) for s in stages] for terms, _ in moved]
    used = judge.lay_columns(use, truth.terms, whiten=False)
    used_shifted = [judge.lay_columns(use, terms, whiten=False) for terms, _ in moved]
    places = judge.list_seen(use, truth.terms)
    own = [truth.coefficients[judge.outputs[k], places[k]] for k in range(outputs)]
    normals, crosses, seen = [], [], []
    information = np.eye(len(free)) / PRIOR**2
    for k in range(outputs):
        now = np.concatenate([one[k] for one in told])
        coefficients = own[k]
        slopes = np.stack(
            [
                (np.concatenate([one[k] for one in shifted[p]]) - now) @ coefficients / moved[p][1]
                for p in range(len(free))
            ]
            or [np.empty(0)],
            axis=-1,
        )
        slopes = slopes.reshape(len(now), -1) if free else np.empty((len(now), 0))
        inverse = invert_scaled(now.T @ now)
        cross = inverse @ now.T @ slopes
        information += slopes.T @ slopes - slopes.T @ now @ cross
        normals.append(inverse)
        crosses.append(cross)
        use_slopes = [
            (used_shifted[p][k] - used[k]) @ coefficients / moved[p][1] for p in range(len(free))
        ]
        seen.append(np.stack(use_slopes, axis=-1) if free else np.empty((len(used[k]), 0)))
    shared = np.linalg.inv(information) if free else np.empty((0, 0))
    relative, error = [], []
    for k in range(outputs):
        covariance = normals[k] + crosses[k] @ shared @ crosses[k].T
        size = np.abs(own[k])
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        relative.append(np.where(size > 0.0, spread / np.where(size > 0.0, size, 1.0), np.inf))
        along = seen[k] - used[k] @ crosses[k]
        rows = np.einsum("np,pq,nq->n", used[k], normals[k], used[k])
        rows = rows + np.einsum("np,pq,nq->n", along, shared, along)
        error.append(float(np.sqrt(np.mean(rows))))
    width = max(len(one) for one in relative)
    padded = np.stack(
        [np.pad(one, (0, width - len(one)), constant_values=np.inf) for one in relative]
    )
    return Precision(np.sqrt(np.diag(shared)), padded, np.array(error))


# Programmes for precision: narrow values, a small error in use, or few hours for further units.

HOURS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
"""Hours that are tried for further units, shortest first."""
NARROW = 0.05
"""A standard error of this share is half of what precision is worth."""
EDGE = 0.02
"""Of the profile's range, by which it may lie beyond the logs: a body follows its chamber late."""
COVERED = 0.99
"""Share of the use profile within what the logs reached, from which on nothing is left out."""


@dataclass(frozen=True)
class Sought:
    """What precision is sought of."""

    criterion: str
    """precision | error."""
    truths: tuple[Truth, ...]
    """Models, drawn."""
    use: Staged
    """The use profile."""
    size: Array
    """[K'] the error that is aimed at, in each output's unit."""
    known: bool = False
    """Whether shared values are known, as from another unit of the design."""


@dataclass(frozen=True)
class FoundPrecise:
    """A programme and what it leaves uncertain, one entry for each truth."""

    best: Best
    precisions: tuple[Precision, ...]
    covered: float
    """Share of the use profile within what the logs reach; see `measure_cover`."""

    @property
    def error(self) -> Array:
        """[K'] RMS error over the use profile, over the truths."""
        squares: Array = np.stack([p.error**2 for p in self.precisions])
        return np.asarray(np.sqrt(squares.mean(axis=0)))


def measure_all(judge: Judge, stages: Sequence[Staged], sought: Sought) -> tuple[Precision, ...]:
    """Return what the logs of these stages leave uncertain of each truth."""
    return tuple(
        measure_precision(judge, stages, sought.use, truth, known=sought.known)
        for truth in sought.truths
    )


def measure_cover(stages: Sequence[Staged], use: Staged, loads: Iterable[str]) -> float:
    """Return the share of the use profile at temperatures and loads that the logs reach, 0 .. 1.

    Least squares promise a small error anywhere, since they take the model for the true one. The
    firmware flags and limits what lies beyond the logs.

    Args:
        stages: the logs.
        use: the use profile.
        loads: those that the experiment sets.
    """
    names = tuple(loads)

    def list_signals(stage: Staged) -> list[Array]:
        signals = stage.signals
        return [signals.temperature_degC, *(signals.load[name] for name in names)]

    told = [list_signals(stage) for stage in stages]
    within = np.ones(use.signals.temperature_degC.shape, dtype=np.bool_)
    for k, used in enumerate(list_signals(use)):
        low = min(float(one[k].min()) for one in told)
        high = max(float(one[k].max()) for one in told)
        margin = EDGE * (float(used.max()) - float(used.min()))
        within &= (used >= low - margin) & (used <= high + margin)
    return float(within.mean())


def has_time(space: Space, use: Staged) -> bool:
    """Return whether logs are long enough to go where the use profile is, and back.

    One log has to go both ways, of several one each way; there it waits until the body, which
    follows late, is as near as counts.
    """
    limits, used = space.limits, use.signals.temperature_degC
    high, low = float(used.max()), float(used.min())
    margin = max(EDGE * (high - low), 1e-9)

    def last_s(away_K: float, there: float, back: float) -> float:
        if away_K <= margin:
            return 0.0
        behind = min(there * limits.follows_s, away_K) / margin
        waits_s = limits.follows_s * float(np.log(max(1.0, behind)))
        return (away_K - margin) * (1.0 / there + 1.0 / back) + waits_s

    up, down = limits.heating_K_per_s, limits.cooling_K_per_s
    ways = [
        last_s(high - limits.start_degC, up, down),
        last_s(limits.start_degC - low, down, up),
    ]
    return QUIET_S + (max(ways) if space.logs > 1 else sum(ways)) <= space.log_s


def value(precisions: Sequence[Precision], covered: float, sought: Sought) -> float:
    """Return the worth of what is left uncertain, 0 .. 1."""
    if sought.criterion == "error":
        errors = [float(np.sqrt(np.mean((p.error / sought.size) ** 2))) for p in precisions]
        return covered / (1.0 + float(np.mean(errors)))
    widths = []
    for p in precisions:
        finite = p.relative[np.isfinite(p.relative)]
        told = np.concatenate([p.widths, [np.median(finite)] if finite.size else []])
        widths.append(float(np.mean(told)) / NARROW)
    return 1.0 / (1.0 + float(np.mean(widths)))


def find_precise(
    judge: Judge,
    spaces: Sequence[Space],
    before: Sequence[Run],
    sought: Sought,
    budget_s: float,
    say: Callable[[str], None],
) -> FoundPrecise:
    """Return the programme that leaves least uncertain.

    Args:
        judge: of the scene.
        spaces: numbers and lengths of logs.
        before: logs that there are already.
        sought: of what.
        budget_s: processor seconds.
        say: told how far it is.
    """
    earlier = [judge.stage_run(run) for run in before]

    def measure(space: Space, point: Array) -> tuple[tuple[Precision, ...], float]:
        logs = space.list_patterns(point)
        stages = [*earlier, judge.stage(logs, space.repeats[: len(logs)])]
        return measure_all(judge, stages, sought), measure_cover(
            stages, sought.use, judge.limits.loads
        )

    def worth(space: Space, point: Array) -> float:
        lines = sum(len(log.settings) for log in space.list_patterns(point))
        return value(*measure(space, point), sought) - LINE * lines

    if sought.criterion == "error" and not before:
        spaces = [space for space in spaces if has_time(space, sought.use)] or spaces
    best = find_programme(spaces, worth, budget_s, say)
    return FoundPrecise(best, *measure(best.space, best.point))


def find_cheapest(
    judge: Judge,
    limits: Limits,
    sought: Sought,
    budget_s: float,
    say: Callable[[str], None],
) -> tuple[float, FoundPrecise]:
    """Return the fewest hours after which a further unit's error is as aimed at.

    Raises:
        InputError: no programme of a day reaches it.
    """
    begin = time.process_time()
    last: FoundPrecise | None = None
    for hours in HOURS:
        if 3600.0 * hours < limits.log_s + limits.rest_s:
            continue
        left = budget_s - (time.process_time() - begin)
        spaces = choose_spaces(limits, hours, 0, wanted=2)
        if not any(has_time(space, sought.use) for space in spaces):
            continue
        last = find_precise(judge, spaces, (), sought, max(1.0, 0.3 * left), say)
        if bool(np.all(last.error <= sought.size)) and last.covered >= COVERED:
            return hours, last
        if left < 0.0:
            break
    reached = (
        ""
        if last is None
        else f"; that of {hours:g} h reaches {np.max(last.error / sought.size):.2g} times it, over "
        f"{100.0 * last.covered:.0f} % of the use profile"
    )
    raise InputError(
        f"plan --units: no programme of up to {hours:g} h that was tried reaches the error aimed at"
        f"{reached}. Expected a target that noise and limits allow. Raise --target or --budget, or "
        "widen [experiment]."
    )


def draw_base(judge: Judge, stage: Staged, size: Array, terms: Sequence[Term]) -> Truth:
    """Return a model whose drift is as large as asked, every column bringing as much of it.

    Args:
        judge: of the scene.
        stage: a programme that moves everything.
        size: [K] RMS of the drift there, in each output's unit.
        terms: the model's values.
    """
    places = judge.list_seen(stage, terms)
    columns = judge.lay_columns(stage, terms, whiten=False)
    count = 1 + max((j for place in places for j in place), default=-1)
    coefficients = np.zeros((len(judge.scene.plan.outputs), count))
    for k, (seen, mine) in enumerate(zip(places, columns, strict=True)):
        spread = mine.std(axis=0)
        each = np.where(spread > 0.0, 1.0 / np.where(spread > 0.0, spread, 1.0), 0.0)
        place = judge.outputs[k]
        coefficients[place, seen] = each * size[place] / np.sqrt(max(1, len(seen)))
    return Truth(tuple(terms), coefficients, True)


def name_widths(truth: Truth, precision: Precision, *, known: bool) -> list[tuple[str, str, float]]:
    """Return (effect, parameter, standard error in its own coordinate) of each shared value."""
    free = list_free(truth, known=known)
    return [
        (truth.terms[c.term].effect.kind, c.parameter.name, float(width))
        for c, width in zip(free, precision.widths, strict=True)
    ]


# Plans by precision: for the model in zerodrift.toml as it is, not for effects it may lack.

DRIFT = 0.01
"""RMS of the drift over full scale before the first log, over a programme that moves everything."""
SEED = 1
DRAWS = 4
"""Models before the first log: the catalogue's typical values, and others of their range."""


@dataclass(frozen=True)
class Width:
    """One shared value of the model, and how well it will be known."""

    effect: str
    parameter: str
    unit: str
    value: float
    half_width: float
    """Of its 95 % interval, to first order, in its unit."""


@dataclass(frozen=True)
class PlannedPrecisely:
    """A programme, and what it leaves uncertain."""

    question: Question
    limits: Limits
    programme: SetProgramme
    found: FoundPrecise
    widths: tuple[Width, ...]
    errors: dict[str, float]
    """Output -> RMS error over the use profile and the models drawn, in its unit."""
    aimed: dict[str, float] | None
    """Output -> the error that the target asks for, in its unit; None without a target."""
    notes: tuple[str, ...]
    cpu_s: float


def plan_precisely(
    config: Config,
    dataset: Dataset | None,
    catalogue: Catalogue,
    question: Question,
    say: Callable[[str], None] = lambda text: None,
) -> PlannedPrecisely:
    """Return the programme that leaves the model's values, or its error in use, least uncertain.

    Args:
        config: the project.
        dataset: its runs; None before any log.
        catalogue: the known effects.
        question: hours, criterion, use profile, units, target and budget.
        say: told how far it is.

    Raises:
        InputError: limits that contradict each other, no effects in the model, no such run, or a
            target that no programme of a day reaches.
    """
    begin = time.process_time()
    if not config.effects:
        raise InputError(
            f"{config.path}: the model has no [[effect]]; expected one whose values are to be "
            "known better. Add one, or plan without --criterion and --units."
        )
    runs: Sequence[Run] = () if dataset is None else dataset.train
    limits = resolve_limits(config, runs, question.hours)
    notes = list(limits.notes)
    full_scale = np.array([output.full_scale for output in config.outputs])
    if dataset is None:
        scene, floor = open_blank(config, catalogue, limits, replace(question, between=()), notes)
        truths: tuple[Truth, ...] = ()
    else:
        scene, floor, truths = _fit(dataset, catalogue, config)
    scene = replace(scene, contenders=())
    limits = leave_alone(limits, [term.effect.kind for term in scene.base], catalogue)
    judge = Judge(scene, limits, (), tuple(range(len(config.outputs))))
    spaces = choose_spaces(limits, question.hours, scene.runs)
    wide = spaces[0].lengthen(USE_CROSSINGS)
    widest = Judge(scene, limits, (), judge.outputs, 2 * ROWS).stage(
        wide.list_patterns(list_designs(wide)[1]), np.ones(2)
    )
    if not truths:
        truths = tuple(
            draw_base(judge, widest, DRIFT * full_scale, terms)
            for terms in spread_typical(scene.base, DRAWS, SEED)
        )
        drawn = f", and {len(truths) - 1} times drawn from it" if len(truths) > 1 else ""
        notes.append(
            "no logs yet: the model's values are the middle of the catalogue's typical range"
            f"{drawn}; the drift is {100.0 * DRIFT:g} % of full scale"
        )
    use = widest
    if question.profile is not None:
        use = judge.stage_run(_find_run(dataset, question.profile))
    size = floor if question.target is None else question.target * full_scale
    known = question.units > 0 and dataset is not None
    criterion = "error" if question.units else question.criterion
    sought = Sought(criterion, truths, use, size, known)
    if question.units:
        hours, found = find_cheapest(judge, limits, sought, question.budget_s, say)
        turns = -(-question.units // limits.units)
        whole = turns * hours
        told = "values that units share are taken from the logs" if known else "no logs tell values"
        notes.append(
            f"{question.units} units, {limits.units} at once: {turns} times {hours:g} h, "
            f"{whole:g} h in all; {told}"
        )
    else:
        before = [replace(run, before=None) for run in runs]
        few = choose_spaces(limits, question.hours, 0, wanted=2)
        spaces = [*spaces, *(space for space in few if space not in spaces)]
        found = find_precise(judge, spaces, before, sought, question.budget_s, say)
    names = [output.name for output in config.outputs]
    return PlannedPrecisely(
        question,
        limits,
        found.best.space.build(found.best.point),
        found,
        _list_widths(truths[0], found, known=known),
        dict(zip(names, found.error.tolist(), strict=True)),
        None if question.target is None else dict(zip(names, size.tolist(), strict=True)),
        tuple(notes),
        time.process_time() - begin,
    )


def _fit(
    dataset: Dataset, catalogue: Catalogue, config: Config
) -> tuple[Scene, Array, tuple[Truth, ...]]:
    """Return the scene after logs, their noise floor, and models drawn around the fit."""
    case = open_case(dataset, catalogue, config.effects)
    base, _, weights = fit_base(case.campaign, dataset.dwell, case.terms)
    noise = measure_rest(case.campaign, case.dataset.dwell, base)
    rng = np.random.default_rng(SEED)
    truths = tuple(draw_fitted(case, base, weights, rng)[:3])
    order = tuple(case.campaign.order)
    runs = len(case.campaign.groups)
    return Scene(case.plan, order, tuple(base.terms), noise, (), runs), case.floor, truths


def _find_run(dataset: Dataset | None, name: str) -> Run:
    runs = {} if dataset is None else {r.name: r for r in (*dataset.train, *dataset.test)}
    if name not in runs:
        raise InputError(
            f"--profile {name}: there is no such run{nearest(name, runs) or '.'} Expected one of "
            f"{', '.join(runs) or 'the logs, of which there are none yet'}."
        )
    return replace(runs[name], before=None)


def _list_widths(truth: Truth, found: FoundPrecise, *, known: bool) -> tuple[Width, ...]:
    """Return the values that the programme determines, with half of their 95 % intervals."""
    told = name_widths(truth, found.precisions[0], known=known)
    units = {
        (truth.terms[c.term].effect.kind, c.parameter.name): c
        for c in list_coordinates(truth.terms)
    }
    widths = []
    for effect, parameter, error in told:
        coordinate = units[effect, parameter]
        value = truth.terms[coordinate.term].values[parameter]
        half = 1.96 * error * abs(coordinate.slope(coordinate.encode(value)))
        widths.append(Width(effect, parameter, coordinate.parameter.unit, value, float(half)))
    return tuple(widths)
