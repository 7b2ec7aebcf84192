"""Programmes for precision: narrow values, a small error in use, or few hours for further units."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Run
from zerodrift.discovery.contenders import Truth
from zerodrift.discovery.criterion import Judge
from zerodrift.discovery.limits import Limits
from zerodrift.discovery.patterns import Space, choose_spaces
from zerodrift.discovery.precision import Precision, list_free, measure_precision
from zerodrift.discovery.search import Best, find_programme
from zerodrift.discovery.stage import Staged
from zerodrift.physics.terms import Term

Array = NDArray[np.float64]

HOURS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
"""Hours that are tried for further units, shortest first."""
NARROW = 0.05
"""A standard error of this share is half of what precision is worth."""
LINE = 2e-4


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


def value(precisions: Sequence[Precision], sought: Sought) -> float:
    """Return the worth of what is left uncertain, 0 .. 1."""
    if sought.criterion == "error":
        errors = [float(np.sqrt(np.mean((p.error / sought.size) ** 2))) for p in precisions]
        return 1.0 / (1.0 + float(np.mean(errors)))
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

    def measure(space: Space, point: Array) -> tuple[Precision, ...]:
        logs = space.list_patterns(point)
        return measure_all(judge, [*earlier, judge.stage(logs, space.repeats[: len(logs)])], sought)

    def worth(space: Space, point: Array) -> float:
        lines = sum(len(log.settings) for log in space.list_patterns(point))
        return value(measure(space, point), sought) - LINE * lines

    best = find_programme(spaces, worth, budget_s, say)
    return FoundPrecise(best, measure(best.space, best.point))


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
        spaces = choose_spaces(limits, hours, 0, wanted=2)[:1]
        last = find_precise(judge, spaces, (), sought, max(1.0, 0.3 * left), say)
        if bool(np.all(last.error <= sought.size)):
            return hours, last
        if left < 0.0:
            break
    reached = (
        "" if last is None else f", it reaches {np.max(last.error / sought.size):.2g} times it"
    )
    raise InputError(
        f"plan --units: no programme of up to {HOURS[-1]:g} h reaches the error aimed at{reached}. "
        "Expected a target that noise and limits allow. Raise --target, or widen [experiment]."
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
