"""What tables, powers of two and recurrent layers compute, over terms.

Written from docs/reference/integer-arithmetic.md (3.7 to 3.9, 4) and integer-layers.md; the tests
hold it against the reference, number by number.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from zerodrift_proof.equality.terms import Opaque, Terms, Whole

H_LIMIT_Q30 = 2**30 - 2**15 + 1
CELL_LIMIT = 2**30
RELAX_STEPS = 64
SLOWEST = 15
OCTAVE_Q29 = (536870912, 372130457, 128972571, 29786284, 5198974, 665093, 117533)


@cache
def list_nodes() -> tuple[int, ...]:
    """Return tanh in Q0.19 at -8, -8 + 1/32, ..., 8, as 4.1 says."""
    half = []
    for i in range(257):
        g = math.tanh(i / 32)
        bent = math.floor(2**19 * (g + g * (1 - g * g) * 2.0**-13) + 0.5)
        half.append(min(bent, 2**19 - 2**4))
    return (*(-n for n in half[:0:-1]), *half)


def compute_tanh(t: int) -> int:
    """Return tanh in Q0.30 of t in Q3.16."""
    p = min(max(t, -(2**19)), 2**19 - 1) + 2**19
    i, f, nodes = p >> 11, p % 2**11, list_nodes()
    return (nodes[i] << 11) + (nodes[i + 1] - nodes[i]) * f


TANH = Opaque(
    "tanh",
    lambda a: (compute_tanh(a[0].low), compute_tanh(a[0].high)),
    lambda values: compute_tanh(values[0]),
)
"""It rises, so that its ends are at the ends of its argument."""


class TermArithmetic:
    """The operations of section 1, over terms."""

    def __init__(self, terms: Terms) -> None:
        """Make terms with these."""
        self.terms = terms

    def number(self, value: int) -> Whole:
        """Return a constant."""
        return self.terms.constant(value)

    def round_shift(self, x: Whole, by: int) -> Whole:
        """Return floor((x + 2^(by-1)) / 2^by)."""
        if by == 0:
            return x
        return self.terms.shift(self.terms.add(x, self.number(1 << (by - 1))), by)

    def saturate(self, x: Whole, low: int, high: int) -> Whole:
        """Return x limited."""
        return self.terms.clamp(x, self.number(low), self.number(high))

    def mul_high(self, a: Whole, b: Whole) -> Whole:
        """Return round_shift(a b, 32)."""
        return self.round_shift(self.terms.multiply(a, b), 32)

    def dot(self, bias: int, factors: Sequence[int], values: Sequence[Whole]) -> Whole:
        """Return bias + sum of products."""
        if all(v.low == v.high for v in values):
            pairs = zip(factors, values, strict=True)
            return self.number(bias + sum(f * v.low for f, v in pairs))
        total = self.number(bias)
        for factor, value in zip(factors, values, strict=True):
            total = self.terms.add(total, self.terms.scale(value, factor))
        return total

    def tanh(self, t: Whole) -> Whole:
        """Return tanh in Q0.30."""
        return self.terms.call(TANH, [t])

    def sigmoid(self, t: Whole) -> Whole:
        """Return the sigmoid of 2 t in Q0.31."""
        return self.terms.add(self.tanh(t), self.number(1 << 30))

    def polynomial(self, coefficients: Sequence[int], f: Whole) -> Whole:
        """Horner's rule, 3.7."""
        total = self.number(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            rounded = self.round_shift(self.terms.multiply(total, f), 31)
            total = self.terms.add(self.number(c), rounded)
        return total

    def exp2_in_octave(self, t: Whole, octave: int, top: int) -> Whole:
        """3.8, of a t whose octave is known."""
        f = self.terms.scale(self.terms.subtract(t, self.number(octave << 24)), 1 << 7)
        by = min(top + 2 - octave, 31)
        return self.round_shift(self.polynomial(OCTAVE_Q29, f), by)

    def power_in_octave(self, power: "Power", x: Whole, n: int) -> Whole:
        """3.9, of an x > 0 with 2^n <= x < 2^(n+1)."""
        f = self.terms.scale(self.terms.subtract(x, self.number(1 << n)), 1 << (31 - n))
        m = self.saturate(self.polynomial(power.octave, f), power.low, power.high)
        return self.round_shift(self.terms.scale(m, power.gains[n]), power.shift)


@dataclass(frozen=True)
class Power:
    """The numbers of 3.9."""

    octave: tuple[int, ...]
    gains: tuple[int, ...]
    low: int
    high: int
    shift: int


def find_exp2(terms: Terms, top: int) -> Opaque:
    """Return 2^t for a top, as a function that stands for itself; it rises."""
    rule = TermArithmetic(terms)

    def compute(values: Sequence[int]) -> int:
        t = values[0]
        found = rule.exp2_in_octave(terms.constant(t), t >> 24, top).exact
        assert found is not None
        return found

    return Opaque(f"2^t, top {top}", lambda a: (compute([a[0].low]), compute([a[0].high])), compute)


def find_power(terms: Terms, name: str, power: Power) -> Opaque:
    """Return x^p, as a function that stands for itself."""
    rule = TermArithmetic(terms)
    most = power.high * max(power.gains)

    def compute(values: Sequence[int]) -> int:
        x = values[0]
        if x <= 0:
            return 0
        found = rule.power_in_octave(power, terms.constant(x), x.bit_length() - 1).exact
        assert found is not None
        return found

    top = (most + (1 << power.shift >> 1)) >> power.shift
    return Opaque(f"x^p, {name}", lambda a: (0, max(top, 0)), compute)


@dataclass(frozen=True)
class Numbered:
    """A recurrent layer: its numbers, unit by unit."""

    name: str
    kind: str
    """gru | gru before | lstm."""
    inputs: int
    hidden: int
    w_x: tuple[tuple[int, ...], ...]
    """[H * G][I], gates side by side."""
    w_h: tuple[tuple[int, ...], ...]
    bias: tuple[int, ...]
    """[H * 4]."""
    shift: tuple[int, ...]
    multiplier: tuple[int, ...] = ()
    """[H * G], of 8-bit weights."""
    multiplier_shift: tuple[int, ...] = ()
    cell_bits: int = 0

    @property
    def gates(self) -> int:
        """3 or 4."""
        return 4 if self.kind == "lstm" else 3


@dataclass(frozen=True)
class LayerStep(TermArithmetic):
    """A step of a layer, written out."""

    terms: Terms
    layer: Numbered

    def _recurrent(self, row: int, copies: Sequence[Whole]) -> Whole:
        layer = self.layer
        total = self.dot(0, layer.w_h[row], copies)
        if not layer.multiplier:
            return total
        by = layer.multiplier_shift[row % layer.gates]
        return self.round_shift(self.terms.scale(total, layer.multiplier[row]), by)

    def _sum(self, row: int, bias: int, x: Sequence[Whole], copies: Sequence[Whole]) -> Whole:
        given = self.dot(bias, self.layer.w_x[row], x)
        return self.terms.add(given, self._recurrent(row, copies))

    def copy(self, h: Sequence[Whole]) -> list[Whole]:
        """Return the states in Q0.15."""
        return [self.round_shift(one, 15) for one in h]

    def run(
        self, x: Sequence[Whole], h: Sequence[Whole], c: Sequence[Whole], relaxing: bool
    ) -> tuple[list[Whole], list[Whole]]:
        """Return states and cells after a step in time, or towards rest."""
        if self.layer.kind == "lstm":
            return self._run_lstm(x, h, c, relaxing)
        return self._run_gru(x, h, relaxing), []

    def _run_gru(self, x: Sequence[Whole], h: Sequence[Whole], relaxing: bool) -> list[Whole]:
        terms, layer = self.terms, self.layer
        copies, after = self.copy(h), layer.kind == "gru"
        resets = []
        for j in range(layer.hidden):
            a = self._sum(3 * j, layer.bias[4 * j], x, copies)
            resets.append(self.sigmoid(terms.shift(a, layer.shift[0])))
        given = copies
        if not after:
            given = [
                self.round_shift(terms.multiply(one, r), 46)
                for one, r in zip(h, resets, strict=True)
            ]
        out = []
        for j in range(layer.hidden):
            u = self.number(1 << 30)
            if not relaxing:
                a = self._sum(3 * j + 1, layer.bias[4 * j + 1], x, copies)
                u = self.sigmoid(terms.shift(a, layer.shift[1]))
            row, outside = 3 * j + 2, layer.bias[4 * j + 2]
            if after:
                inside = self._recurrent(row, copies)
                inside = terms.add(inside, self.number(layer.bias[4 * j + 3]))
                inside = self.mul_high(inside, resets[j])
            else:
                inside = self._recurrent(row, given)
            a = terms.add(self.dot(outside, layer.w_x[row], x), inside)
            n = self.tanh(terms.shift(a, layer.shift[2]))
            moved = terms.scale(self.mul_high(terms.subtract(n, h[j]), u), 2)
            out.append(terms.add(h[j], moved))
        return out

    def _run_lstm(
        self, x: Sequence[Whole], h: Sequence[Whole], c: Sequence[Whole], relaxing: bool
    ) -> tuple[list[Whole], list[Whole]]:
        terms, layer = self.terms, self.layer
        copies, one = self.copy(h), self.number(1 << 30)
        outputs, cells = [], []
        for j in range(layer.hidden):
            t = [
                terms.shift(self._sum(4 * j + g, layer.bias[4 * j + g], x, copies), layer.shift[g])
                for g in range(4)
            ]
            i, f, g, o = self.sigmoid(t[0]), self.tanh(t[1]), self.tanh(t[2]), self.sigmoid(t[3])
            added = self.round_shift(self.mul_high(g, i), 30 - layer.cell_bits)
            if relaxing:
                forget = terms.subtract(one, f)
                doublings = self.number(0)
                for k in range(SLOWEST):
                    small = terms.less(forget, self.number(1 << (30 - k)))
                    doublings = terms.add(doublings, small)
                far = terms.subtract(added, self.mul_high(c[j], forget))
                far = terms.multiply(far, self.double(doublings))
                cell = self.saturate(terms.add(c[j], far), -CELL_LIMIT, CELL_LIMIT)
            else:
                moved = terms.add(self.mul_high(c[j], terms.add(f, one)), added)
                half = self.saturate(moved, -CELL_LIMIT // 2, CELL_LIMIT // 2)
                cell = terms.scale(half, 2)
            bend = self.tanh(self.round_shift(cell, layer.cell_bits - 16))
            outputs.append(terms.scale(self.mul_high(bend, o), 2))
            cells.append(cell)
        return outputs, cells

    def double(self, by: Whole) -> Whole:
        """Return 2^by."""
        power = Opaque("2^", lambda a: (1 << a[0].low, 1 << a[0].high), lambda v: 1 << v[0])
        return self.terms.call(power, [by])


class Layers:
    """Steps of recurrent layers as functions that stand for themselves."""

    def __init__(self, terms: Terms, layers: Sequence[Numbered]) -> None:
        """Know these layers."""
        self.terms = terms
        self.layers = {layer.name: layer for layer in layers}
        self.given: dict[tuple[str, bool], list[tuple[int, int]]] = {}
        """(layer, relaxing) -> the widest ranges of the features that it was stepped with."""
        self._known: dict[tuple[tuple[int, ...], str, bool], tuple[list[Whole], list[Whole]]] = {}

    def step(
        self,
        name: str,
        x: Sequence[Whole],
        h: Sequence[Whole],
        c: Sequence[Whole],
        relaxing: bool,
    ) -> tuple[list[Whole], list[Whole]]:
        """Return states and cells after a step, each standing for itself where not known."""
        layer, terms = self.layers[name], self.terms
        ranges = self.given.setdefault((name, relaxing), [(v.low, v.high) for v in x])
        for i, v in enumerate(x):
            ranges[i] = min(ranges[i][0], v.low), max(ranges[i][1], v.high)
        every = (*x, *h, *c)
        if all(v.exact is not None for v in every):
            key = tuple(v.low for v in every), name, relaxing
            if key not in self._known:
                self._known[key] = LayerStep(terms, layer).run(x, h, c, relaxing)
            return self._known[key]
        row = terms.row(every)
        mark = f"{name}, relaxing" if relaxing else name
        limit = H_LIMIT_Q30
        outputs = [
            terms.call(Opaque(f"{mark}.h[{j}]", lambda _: (-limit, limit)), every, row)
            for j in range(layer.hidden)
        ]
        if layer.kind != "lstm":
            return outputs, []
        cells = [
            terms.call(Opaque(f"{mark}.c[{j}]", lambda _: (-CELL_LIMIT, CELL_LIMIT)), every, row)
            for j in range(layer.hidden)
        ]
        return outputs, cells
