"""The formulas that are tried: what grows from the chip's operations, simple before complex.

A form is an expression with a grid of starting values for its numbers; a number's own range comes
from what its signal does in the runs and from how long they are.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.diagnosis.formula.expression import OWN_LOAD, Driver, Expression
from zerodrift.physics.effect import Parameter

TIMES = 9
"""Time constants per decade-spanning grid."""
LONGEST_SHARE = 0.5
"""Longest time constant on the grid, in lengths of the longest run."""
LONGEST_DELAY_SHARE = 0.12
MOST_DELAY_SAMPLES = 32_767
QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Where between the ends of a signal's values thresholds begin."""
ORIGINS = (-0.5, 0.2, 0.5, 0.8, 1.5)
"""The same for what a square or a size is counted from, which may lie outside."""
WIDTHS = (0.04, 0.1, 0.25)
"""Half-widths of a play, in spans of the signal."""
DOUBLINGS = (0.12, 0.25, 0.5)
"""What doubles 2^(x/d), in spans of the signal."""
NEAR = 2.0
"""Values are searched for from this factor, or this share of the span's tenth, of a start."""


@dataclass(frozen=True)
class Form:
    """One formula before its numbers are known."""

    expression: Expression
    starts: tuple[tuple[float, ...], ...]
    """Values of the expression's parameters, in their order."""

    @property
    def is_plain(self) -> bool:
        """Whether it has no number to search for."""
        return not self.expression.parameters


@dataclass(frozen=True)
class Spans:
    """The times that the runs can show."""

    period_s: float
    finest_s: float
    """The time that one row of the search covers."""
    longest_s: float
    """Length of the longest run."""


def list_forms(sources: Sequence[Driver], spans: Spans) -> list[Form]:
    """Return every form, simple before complex, each once."""
    grower = _Grower(spans)
    found: dict[str, Form] = {}
    for expression, starts in grower.grow(sources):
        form = Form(expression, starts)
        found.setdefault(expression.write(), form)
    return sorted(found.values(), key=lambda form: form.expression.complexity)


def centre(form: Form, values: Sequence[float]) -> Expression:
    """Return the expression with its numbers' typical ranges drawn around these values."""
    named = {
        p.name: _narrow(p, value)
        for p, value in zip(form.expression.parameters, values, strict=True)
    }

    def rebuild(one: Expression) -> Expression:
        parameter = named[one.parameter.name] if one.parameter else None
        return replace(one, inputs=tuple(rebuild(x) for x in one.inputs), parameter=parameter)

    return rebuild(form.expression)


def _narrow(parameter: Parameter, value: float) -> Parameter:
    low, high = parameter.lower, parameter.upper
    if parameter.scale == "log":
        near = (max(value / NEAR, low), min(value * NEAR, high))
    else:
        reach = 0.1 * (parameter.typical[1] - parameter.typical[0])
        near = (max(value - 1.4 * reach, low), min(value + 0.6 * reach, high))
    return replace(parameter, typical=near)


Grown = tuple[Expression, tuple[tuple[float, ...], ...]]


class _Grower:
    """Grows expressions from sources; `number` keeps the parameters' names apart."""

    def __init__(self, spans: Spans) -> None:
        self._spans = spans
        longest = LONGEST_SHARE * spans.longest_s
        first = min(max(2.0 * spans.period_s, 0.5 * spans.finest_s), 0.5 * longest)
        self._times = tuple(np.geomspace(first, longest, TIMES).tolist())
        last = min(LONGEST_DELAY_SHARE * spans.longest_s, 0.9 * MOST_DELAY_SAMPLES * spans.period_s)
        self._delays = tuple(np.geomspace(min(first, 0.5 * last), last, TIMES - 2).tolist())

    def grow(self, sources: Sequence[Driver]) -> Iterator[Grown]:
        """Yield everything, roughly simple before complex."""
        moving = [s for s in sources if s.kind != "time"]
        for source in moving:
            yield from self._grow_one(source)
        for a, b in itertools.combinations(moving, 2):
            yield from self._join(a, b)
        partners = [s for s in moving if s.kind != "load" or s.name == OWN_LOAD]
        if not any(s.name == OWN_LOAD for s in moving):
            partners = moving
        for a, b in itertools.permutations(partners, 2):
            yield from self._join_grown(a, b)
        for time in (s for s in sources if s.kind == "time"):
            yield from self._grow_time(time, moving)

    def _grow_one(self, source: Driver) -> Iterator[Grown]:
        x = _leaf(source)
        yield x, ((),)
        slow, tau = self._lowpass(x)
        fast = Expression("difference", (x, slow))
        yield slow, tau
        yield fast, tau
        late, delays = self._delay(x)
        yield late, delays
        slack, widths = self._play(x, source)
        yield slack, widths
        bent = list(self._bend(x, source))
        yield from bent
        yield from self._bend(slow, source, tau)
        for form, starts in bent:
            lagged, taus = self._lowpass(form)
            yield lagged, _cross(starts, taus)
        yield Expression("power", (fast,), number=2.0), tau
        yield Expression("size", (fast,)), tau
        yield _hinge(fast, "above", source, "0"), tau
        yield _hinge(fast, "below", source, "0"), tau
        slower, _ = self._lowpass(x, "tau_slow_s")
        pairs = tuple((a, b) for a, b in itertools.combinations(self._times[::2], 2))
        yield Expression("difference", (slow, slower)), pairs
        loose, _ = self._play(slow, source)
        yield loose, _cross(tau, widths)
        dragged, _ = self._lowpass(slack)
        yield dragged, _cross(widths, tau)
        yield Expression("power", (slack,), number=2.0), widths
        yield Expression("difference", (x, late)), delays

    def _bend(
        self, x: Expression, source: Driver, before: tuple[tuple[float, ...], ...] = ((),)
    ) -> Iterator[Grown]:
        """Yield bent forms of an expression that has a source's unit and range."""
        for op in ("above", "below"):
            limited, thresholds = self._limit(op, x, source)
            yield limited, _cross(before, thresholds)
        shifted, origins = self._shift(x, source)
        # Without an origin of its own a square or a size is of what is counted from zero.
        if source.low < 0.0 < source.high:
            yield Expression("size", (x,)), before
        yield Expression("power", (x,), number=2.0), before
        yield Expression("power", (x,), number=3.0), before
        if source.low >= 0.0:
            yield Expression("power", (x,), number=0.5), before
            yield Expression("power", (x,), number=1.5), before
        yield Expression("size", (shifted,)), _cross(before, origins)
        yield Expression("power", (shifted,), number=2.0), _cross(before, origins)
        yield Expression("power", (shifted,), number=3.0), _cross(before, origins)
        for sign in (1.0, -1.0):
            form, doublings = self._exp2(x, source, sign)
            yield form, _cross(before, doublings)

    def _join(self, a: Driver, b: Driver) -> Iterator[Grown]:
        x, y = _leaf(a), _leaf(b)
        if OWN_LOAD in (a.name, b.name) and a.kind == b.kind:
            return
        left, right = self._count(x, a, "origin_a"), self._count(y, b, "origin_b")
        yield from _multiply(left, right, (x, y))
        both = Expression("product", (x, y))
        slow, tau = self._lowpass(both)
        yield slow, tau
        if a.unit == b.unit and a.kind != "load":
            apart = Expression("difference", (x, y))
            yield apart, ((),)
            for op in ("larger", "smaller"):
                larger = Expression(op, (x, y))
                yield larger, ((),)
                yield self._lowpass(larger)[0], tau
            yield Expression("power", (apart,), number=2.0), ((),)
            yield Expression("size", (apart,)), ((),)
            yield self._lowpass(apart)[0], tau

    def _join_grown(self, a: Driver, b: Driver) -> Iterator[Grown]:
        """Yield products of what has grown from `a` with plain `b`."""
        x, y = _leaf(a), _leaf(b)
        counted, origins = self._count(y, b, "origin_b", middle_only=True)
        slow, tau = self._lowpass(x)
        for moved, starts in ((slow, tau), self._play(x, a), self._delay(x)):
            own, origins_a = self._count(moved, a, "origin_a", middle_only=True)
            left = (own, _cross(starts, origins_a))
            yield from _multiply(left, (counted, origins), (moved, y), starts)
        thresholds = tuple((a.low + q * a.span,) for q in QUANTILES[1:4])
        shifted, origins_a = self._shift(x, a)
        grown: list[Grown] = [
            (Expression("difference", (x, slow)), tau),
            (_hinge(x, "above", a, "threshold"), thresholds),
            (_hinge(x, "below", a, "threshold"), thresholds),
            (Expression("power", (shifted,), number=2.0), origins_a[2:3]),
            (Expression("size", (shifted,)), origins_a[2:3]),
            self._exp2(x, a, 1.0),
        ]
        for form, starts in grown:
            yield Expression("product", (form, y)), starts
            yield Expression("product", (form, counted)), _cross(starts, origins)
        if a.unit == b.unit and a.kind != "load":
            apart = Expression("difference", (slow, y))
            yield apart, tau
            yield Expression("size", (apart,)), tau

    def _grow_time(self, time: Driver, moving: Sequence[Driver]) -> Iterator[Grown]:
        x = _leaf(time)
        fading = Expression(
            "exp2", (x,), parameter=_time("half_life_s", self._spans, 0.05), number=-1.0
        )
        lives = tuple((t,) for t in self._times)
        root = Expression("power", (x,), number=0.5)
        for form, starts in ((x, ((),)), (root, ((),)), (fading, lives)):
            yield form, starts
            for source in moving:
                counted, origins = self._count(_leaf(source), source, "origin_b", middle_only=True)
                yield Expression("product", (form, counted)), _cross(starts, origins)

    def _lowpass(self, x: Expression, name: str = "tau_s") -> Grown:
        parameter = _time(name, self._spans, 0.3)
        return Expression("lowpass", (x,), parameter=parameter), tuple((t,) for t in self._times)

    def _delay(self, x: Expression) -> Grown:
        upper = min(MOST_DELAY_SAMPLES * self._spans.period_s, 0.5 * self._spans.longest_s)
        lower = 0.05 * self._spans.period_s
        parameter = Parameter("delay_s", "s", lower, upper, (lower, upper))
        return Expression("delay", (x,), parameter=parameter), tuple((t,) for t in self._delays)

    def _play(self, x: Expression, source: Driver) -> Grown:
        low, high = 1e-4 * source.span, 0.6 * source.span
        parameter = Parameter("half_width", source.unit, low, high, (low, high))
        starts = tuple((w * source.span,) for w in WIDTHS)
        return Expression("play", (x,), parameter=parameter), starts

    def _limit(self, op: str, x: Expression, source: Driver) -> Grown:
        parameter = _inside("threshold", source)
        starts = tuple((source.low + q * source.span,) for q in QUANTILES)
        return Expression(op, (x,), parameter=parameter), starts

    def _shift(self, x: Expression, source: Driver) -> Grown:
        parameter = _inside("origin", source, beyond=1.0)
        starts = tuple((source.low + q * source.span,) for q in ORIGINS)
        return Expression("shift", (x,), parameter=parameter), starts

    def _count(
        self, x: Expression, source: Driver, name: str, *, middle_only: bool = False
    ) -> Grown:
        """Return x less an origin; a load counts from zero."""
        if source.kind == "load":
            return x, ((),)
        parameter = _inside(name, source, beyond=2.0)
        quantiles = (0.5,) if middle_only else (0.1, 0.5, 0.9)
        starts = tuple((source.low + q * source.span,) for q in quantiles)
        # From zero on it is at least as good as the form without an origin.
        if parameter.lower <= 0.0 <= parameter.upper:
            starts += ((0.0,),)
        return Expression("shift", (x,), parameter=parameter), starts

    def _exp2(self, x: Expression, source: Driver, sign: float) -> Grown:
        low = max(0.03 * source.span, max(abs(source.low), abs(source.high)) / 50.0)
        high = 3.0 * max(source.span, low)
        parameter = Parameter("doubling", source.unit, low, high, (low, high))
        starts = tuple((min(max(w * source.span, 1.1 * low), high),) for w in DOUBLINGS)
        return Expression("exp2", (x,), parameter=parameter, number=sign), starts


def _multiply(
    left: Grown,
    right: Grown,
    plain: tuple[Expression, Expression],
    starts: tuple[tuple[float, ...], ...] = ((),),
) -> Iterator[Grown]:
    """Yield the products of two signals, each with or without an origin of its own.

    Where the model has one of them already, the other's origin says nothing: it is not needed.

    Args:
        left, right: with an origin.
        plain: both without one.
        starts: values of the numbers of the plain left one.
    """
    yield Expression("product", plain), starts
    yield Expression("product", (left[0], plain[1])), left[1]
    yield Expression("product", (plain[0], right[0])), _cross(starts, right[1])
    yield Expression("product", (left[0], right[0])), _cross(left[1], right[1])


def _leaf(source: Driver) -> Expression:
    return Expression("source", source=source)


def _hinge(x: Expression, op: str, source: Driver, name: str) -> Expression:
    """Return x above (below) a threshold, else the threshold; zero is no parameter."""
    if name == "0":
        return Expression(op, (x,))
    parameter = _inside(name, source)
    return Expression(op, (Expression("shift", (x,), parameter=parameter),))


def _inside(name: str, source: Driver, beyond: float = 0.0) -> Parameter:
    low, high = source.low - beyond * source.span, source.high + beyond * source.span
    return Parameter(name, source.unit, low, high, (source.low, source.high), scale="linear")


def _time(name: str, spans: Spans, share: float) -> Parameter:
    lower, upper = share * spans.period_s, 10.0 * spans.longest_s
    return Parameter(name, "s", lower, upper, (spans.period_s, spans.longest_s))


def _cross(
    one: tuple[tuple[float, ...], ...], two: tuple[tuple[float, ...], ...]
) -> tuple[tuple[float, ...], ...]:
    return tuple((*a, *b) for a in one for b in two)
