"""Operations that keep a state from step to step: time, delays, low-passes, play."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Field, Meaning, Moment, Node, State, Values
from zerodrift_proof.equality.rules import MARGIN, bound_waiting, say_lowpass, say_time
from zerodrift_proof.equality.terms import Whole

# Steps since the start (3.3).


@dataclass(frozen=True)
class Counter(Node):
    """0 at the first step, one more at each, up to a limit."""

    kind: ClassVar[str] = "counter"
    limit: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return 0 to the limit."""
        return Ends(0, self.limit)

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the count."""
        return [Field(f"{self.name}_count", "int32_t", (), 0, self.limit)]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin at 0."""
        return {f"{self.name}_count": [m.number(0)]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Give the count, and count on."""
        count = at.state[f"{self.name}_count"][0]
        more = m.terms.less(count, m.number(self.limit))
        return {f"{self.name}_count": [m.terms.add(count, more)]}, [count]


# Time since the start (3.16).


@dataclass(frozen=True)
class Elapsed(Node):
    """time' = min(time + S, limit 2^bits), of which round_shift(time', bits) is given."""

    kind: ClassVar[str] = "elapsed"
    limit: int
    bits: int
    period_us: int
    """Of the logs; nothing in the chip depends on it."""

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return 0 to the limit."""
        return Ends(0, self.limit)

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the time."""
        return [Field(f"{self.name}_time", "int64_t", (), 0, self.limit << self.bits)]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin at 0."""
        return {f"{self.name}_time": [m.number(0)]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Add the step's time."""
        before = at.state[f"{self.name}_time"][0]
        time, ticks = say_time(m.terms, before, m.span, self.limit, self.bits)
        return {f"{self.name}_time": [time]}, [ticks]


# A delay by a ring of samples (3.11).


@dataclass(frozen=True)
class Delay(Node):
    """older + round_shift((newer - older) newer_q31, 31)."""

    kind: ClassVar[str] = "delay"
    steps: int
    newer_q31: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x's range: the result lies between two of them."""
        return given[0]

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the ring and the place of its oldest sample."""
        return [
            Field(f"{self.name}_line", "int32_t", (self.steps,), *given[0]),
            Field(f"{self.name}_oldest", "uint16_t", (), 0, self.steps - 1),
        ]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Fill the ring with x."""
        x = values[self.inputs[0]][0]
        return {f"{self.name}_line": [x] * self.steps, f"{self.name}_oldest": [m.number(0)]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """The oldest place takes the present input; the next one is the oldest then."""
        terms, name, x = m.terms, self.name, at.values[self.inputs[0]][0]
        line, place = at.state[f"{name}_line"], at.state[f"{name}_oldest"][0]
        cells = dict(enumerate(line))
        turn = terms.equal(place, m.number(self.steps - 1))
        after = terms.choose(turn, m.number(0), terms.add(place, m.number(1)))
        older = terms.select(place, cells)
        out = older
        if self.newer_q31:
            newer = x if self.steps == 1 else m.select(cells, after)
            rise = terms.scale(terms.subtract(newer, older), self.newer_q31)
            out = terms.add(older, m.round_shift(rise, 31))
        stored = [
            terms.choose(terms.equal(place, m.number(k)), x, cell) for k, cell in enumerate(line)
        ]
        return {f"{name}_line": stored, f"{name}_oldest": [after]}, [out]


# A low-pass of first order (3.10).


@dataclass(frozen=True)
class Lowpass(Node):
    """y = v + c x, v' = v + a (x - y)."""

    kind: ClassVar[str] = "lowpass"
    c_q24: int
    m_q31: int
    shift: int

    def _bound_state(self, x: Ends) -> Ends:
        """Return (1 - c) x and what rounding adds, 2^21 + 1/a counts, by induction (section 6)."""
        margin = 2**21 - (-(1 << (self.shift + 22)) // self.m_q31)
        return x.scale(2**24 - self.c_q24).plus(Ends(-margin, margin))

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x and the same margin, rounded."""
        margin = 2**21 - (-(1 << (self.shift + 22)) // self.m_q31)
        return given[0].scale(2**24).plus(Ends(-margin, margin)).round_shift(24)

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return v."""
        return [Field(f"{self.name}_v", "int64_t", (), *self._bound_state(given[0]))]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin where y = x."""
        x = values[self.inputs[0]][0]
        return {f"{self.name}_v": [m.terms.scale(x, 2**24 - self.c_q24)]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Move v on."""
        terms, x, v = m.terms, at.values[self.inputs[0]][0], at.state[f"{self.name}_v"][0]
        y = terms.add(v, terms.scale(x, self.c_q24))
        gap = m.round_shift(terms.subtract(terms.scale(x, 1 << 24), y), 22)
        moved = m.round_shift(terms.scale(gap, self.m_q31), self.shift)
        return {f"{self.name}_v": [terms.add(v, moved)]}, [m.round_shift(y, 24)]


# A low-pass of a variable step (3.16).


@dataclass(frozen=True)
class LowpassAfter(Node):
    """y' = y + a (x_1 - y) + c (x - x_1), with a and c of the time since y moved."""

    kind: ClassVar[str] = "lowpass_after"
    rate_q31: int
    shift: int

    def _bound_y(self, x: Ends) -> Ends:
        return x.scale(2**24).plus(Ends(-MARGIN, MARGIN))

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x and 2^22 counts of y on either side, by induction (section 6)."""
        return self._bound_y(given[0]).round_shift(24)

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the input of the last step that moved y, the time since then, and y."""
        waiting = bound_waiting(self.rate_q31, self.shift)
        return [
            Field(f"{self.name}_before", "int32_t", (), *given[0]),
            Field(f"{self.name}_waiting", "int32_t", (), 0, waiting),
            Field(f"{self.name}_y", "int64_t", (), *self._bound_y(given[0])),
        ]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin where y = x and no time is collected."""
        x, name = values[self.inputs[0]][0], self.name
        y = m.terms.scale(x, 2**24)
        return {f"{name}_before": [x], f"{name}_waiting": [m.number(0)], f"{name}_y": [y]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Collect the time, or move y on."""
        own = [at.state[f"{self.name}_{part}"][0] for part in ("before", "waiting", "y")]
        x = at.values[self.inputs[0]][0]
        moved = say_lowpass(m.terms, [*own, x, m.span], self.rate_q31, self.shift)
        after = {"before": moved.before, "waiting": moved.waiting, "y": moved.y}
        return {f"{self.name}_{part}": [value] for part, value in after.items()}, [moved.out]


# Play (3.13).


@dataclass(frozen=True)
class Play(Node):
    """y' = saturate(y, x - half_width, x + half_width)."""

    kind: ClassVar[str] = "play"
    half_width: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x's range, in which y stays by induction (section 6)."""
        return given[0]

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return y."""
        return [Field(f"{self.name}_y", "int32_t", (), *given[0])]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin at x."""
        return {f"{self.name}_y": values[self.inputs[0]]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Move y no further than it is pushed."""
        x, half = at.values[self.inputs[0]][0], m.number(self.half_width)
        low, high = m.terms.subtract(x, half), m.terms.add(x, half)
        y = m.terms.clamp(at.state[f"{self.name}_y"][0], low, high)
        return {f"{self.name}_y": [y]}, [y]


NODES = (
    Counter,
    Elapsed,
    Delay,
    Lowpass,
    LowpassAfter,
    Play,
)
