"""Programmes for precision: narrow values, a small error in use, or few hours for further units."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Run
from zerodrift.discovery.contenders import Truth
from zerodrift.discovery.criterion import Judge
from zerodrift.discovery.limits import Limits
from zerodrift.discovery.patterns import QUIET_S, Space, choose_spaces
from zerodrift.discovery.precision import Precision, list_free, measure_precision
from zerodrift.discovery.search import Best, find_programme
from zerodrift.discovery.stage import Staged
from zerodrift.physics.terms import Term

HOURS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
"""Hours that are tried for further units, shortest first."""
NARROW = 0.05
"""A standard error of this share is half of what precision is worth."""
LINE = 2e-4
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
