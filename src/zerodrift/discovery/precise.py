"""Plans by precision: for the model in zerodrift.toml as it is, not for effects it may lack."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.examination import fit_base, measure_rest
from zerodrift.discovery.contenders import Scene, Truth, draw_fitted, spread_typical
from zerodrift.discovery.criterion import ROWS, Judge
from zerodrift.discovery.limits import Limits, resolve_limits
from zerodrift.discovery.patterns import USE_CROSSINGS, choose_spaces
from zerodrift.discovery.plan import Question, leave_alone, open_blank
from zerodrift.discovery.precise_plan import (
    FoundPrecise,
    Sought,
    draw_base,
    find_cheapest,
    find_precise,
    name_widths,
)
from zerodrift.discovery.programme import SetProgramme
from zerodrift.discovery.search import list_designs
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.projection import list_coordinates

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
