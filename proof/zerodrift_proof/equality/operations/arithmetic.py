"""Operations without a memory: signals in, a number out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.kernels import Power, find_exp2, find_power
from zerodrift_proof.equality.node import DRIFT, Ends, Meaning, Moment, Node, Row, State, bound_dot
from zerodrift_proof.equality.terms import Terms, Whole

# A raw code, limited and counted from an origin (3.1).


@dataclass(frozen=True)
class Input(Node):
    """(saturate(code, low, high) - origin) 2^shift."""

    kind: ClassVar[str] = "input"
    channel: int
    low: int
    high: int
    shift: int
    origin: int = 0

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the limits' own range."""
        return Ends(self.low - self.origin, self.high - self.origin).scale(1 << self.shift)

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Read the code."""
        code = m.saturate(at.codes[self.channel], self.low, self.high)
        return {}, [m.terms.scale(m.terms.subtract(code, m.number(self.origin)), 1 << self.shift)]


# A measured output, less its drift in the step before (3.2).


@dataclass(frozen=True)
class Load(Node):
    """saturate(code - drift, low, high) 2^shift."""

    kind: ClassVar[str] = "load"
    reads_drift: ClassVar[bool] = True
    channel: int
    low: int
    high: int
    shift: int
    output: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the limits' own range."""
        return Ends(self.low, self.high).scale(1 << self.shift)

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Read code and drift."""
        load = m.terms.subtract(at.codes[self.channel], at.state[DRIFT][self.output])
        return {}, [m.terms.scale(m.saturate(load, self.low, self.high), 1 << self.shift)]


# x - offset (3.4).


@dataclass(frozen=True)
class Offset(Node):
    """x - offset."""

    kind: ClassVar[str] = "offset"
    offset: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x's range, moved."""
        return given[0].minus(Ends(self.offset, self.offset))

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the difference."""
        return [m.terms.subtract(given[0][0], m.number(self.offset))]


# a - b (3.4).


@dataclass(frozen=True)
class Difference(Node):
    """a - b, of signals of equal scale."""

    kind: ClassVar[str] = "difference"

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the range of a difference of any two."""
        return given[0].minus(given[1])

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return it."""
        return [m.terms.subtract(given[0][0], given[1][0])]


# A sum of signals of any scales (3.5).


@dataclass(frozen=True)
class Sum(Node):
    """saturate((bias + sum_j c_j x_j) >> shift, low, high)."""

    kind: ClassVar[str] = "sum"
    coefficients: Row
    bias: int
    shift: int
    low: int
    high: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the range of the sum, limited."""
        total = bound_dot(self.bias, self.coefficients, given)
        return total.shift(self.shift).saturate(self.low, self.high)

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the sum."""
        total = m.dot(self.bias, self.coefficients, [x[0] for x in given])
        return [m.saturate(m.terms.shift(total, self.shift), self.low, self.high)]


# A product of two signals (3.6).


@dataclass(frozen=True)
class Product(Node):
    """saturate(round_shift(a b, shift), low, high)."""

    kind: ClassVar[str] = "product"
    shift: int
    low: int
    high: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the range of a product of any two, limited."""
        return given[0].times(given[1]).round_shift(self.shift).saturate(self.low, self.high)

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the product."""
        rounded = m.round_shift(m.terms.multiply(given[0][0], given[1][0]), self.shift)
        return [m.saturate(rounded, self.low, self.high)]


# The smaller of a and b (3.4).


@dataclass(frozen=True)
class Minimum(Node):
    """The smaller of a and b, of equal scale and offset."""

    kind: ClassVar[str] = "minimum"

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the smaller of each two ends."""
        return Ends(*map(min, *given))

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return it."""
        return [m.terms.minimum(given[0][0], given[1][0])]


# The larger of a and b (3.4).


@dataclass(frozen=True)
class Maximum(Node):
    """The larger of a and b, of equal scale and offset."""

    kind: ClassVar[str] = "maximum"

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the larger of each two ends."""
        return Ends(*map(max, *given))

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return it."""
        return [m.terms.maximum(given[0][0], given[1][0])]


# A signal within limits (3.12).


@dataclass(frozen=True)
class Clip(Node):
    """saturate(x, low, high)."""

    kind: ClassVar[str] = "clip"
    low: int
    high: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x's range, limited."""
        return given[0].saturate(self.low, self.high)

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return x limited."""
        return [m.saturate(given[0][0], self.low, self.high)]


# x^p for an exponent that is not whole (3.9).


@dataclass(frozen=True)
class PowerOf(Node):
    """round_shift(saturate(octave(f), low, high) gains[n], shift) of x = 2^n (1 + f), or 0."""

    kind: ClassVar[str] = "power"
    octave: Row
    low: int
    high: int
    gains: Row
    shift: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return 0 to the largest product with a gain that x can reach."""
        octaves = max(given[0].high, 1).bit_length()
        return Ends(0, self.high * max(self.gains[:octaves])).round_shift(self.shift)

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the power."""
        numbers = Power(self.octave, self.gains, self.low, self.high, self.shift)
        return [m.terms.call(find_power(m.terms, self.name, numbers), [given[0][0]])]


# A power of two (3.8).


@dataclass(frozen=True)
class Exp2(Node):
    """2^t of t = saturate((bias + c x) >> shift, low, high), largest in the octave `top`."""

    kind: ClassVar[str] = "exp2"
    coefficient: int
    bias: int
    shift: int
    low: int
    high: int
    top: int

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the results at the ends of t, in which it rises."""
        total = bound_dot(self.bias, [self.coefficient], given)
        t = total.shift(self.shift).saturate(self.low, self.high)
        terms = Terms()
        rule = find_exp2(terms, self.top)
        found = [terms.call(rule, [terms.constant(end)]).low for end in t]
        return Ends(found[0], found[1])

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return the power."""
        total = m.dot(self.bias, [self.coefficient], [given[0][0]])
        t = m.saturate(m.terms.shift(total, self.shift), self.low, self.high)
        return [m.terms.call(find_exp2(m.terms, self.top), [t])]


NODES = (
    Input,
    Load,
    Offset,
    Difference,
    Sum,
    Product,
    Minimum,
    Maximum,
    Clip,
    PowerOf,
    Exp2,
)
