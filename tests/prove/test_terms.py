"""Terms stand for whole numbers: every normal form has the value that it was made of."""

import random

import pytest

from zerodrift_proof.equality.terms import Terms, UndecidedError, Whole
from zerodrift_proof.object.words import WordTerms

LOW, HIGH = -9, 9


def evaluate(terms: Terms, term: Whole, values: dict[str, int]) -> int:
    """Return a term's number, from what it says of itself."""
    if term.kind == "sum":
        parts = ((evaluate(terms, terms.atom(n), values), f) for n, f in term.sums)
        return term.constant + sum(x * f for x, f in parts)
    if term.kind == "symbol":
        return next(v for n, v in values.items() if terms.symbol(n, *term.inner) is term)
    if term.kind == "shift":
        return evaluate(terms, terms.atom(term.inner[0]), values) >> term.inner[1]
    if term.kind == "select":
        at = evaluate(terms, terms.atom(term.inner[0]), values)
        cells = dict(zip(term.inner[1::2], term.inner[2::2], strict=True))
        return evaluate(terms, terms.atom(cells[at]), values)
    inner = [evaluate(terms, terms.atom(n), values) for n in term.inner]
    rules = {
        "product": lambda: inner[0] * inner[1],
        "max": lambda: max(inner),
        "min": lambda: min(inner),
        "le": lambda: int(inner[0] <= 0),
        "eq": lambda: int(inner[0] == 0),
        "or": lambda: int(any(inner)),
        "choose": lambda: inner[1] if inner[0] else inner[2],
    }
    return rules[term.kind]()


class Draw:
    """A random term, and the same thing computed with numbers."""

    def __init__(self, seed: int, terms: Terms | None = None) -> None:
        self.rng, self.terms = random.Random(seed), terms or Terms()
        self.names = ["a", "b", "c"]
        self.ends = {}
        for name in self.names:
            low = self.rng.randint(LOW, HIGH - 1)
            self.ends[name] = low, self.rng.randint(low + 1, HIGH)

    def draw(self, depth: int) -> tuple[Whole, object]:
        """Return a term and a function of the symbols' values."""
        rng, terms = self.rng, self.terms
        if depth == 0:
            if rng.random() < 0.3:
                n = rng.randint(-40, 40)
                return terms.constant(n), lambda v: n
            name = rng.choice(self.names)
            return terms.symbol(name, *self.ends[name]), lambda v: v[name]
        (a, f), (b, g), (c, h) = (self.draw(rng.randint(0, depth - 1)) for _ in range(3))
        k = rng.randint(0, 5)
        low = rng.randint(-20, 20)
        high = low + rng.randint(0, 30)
        ends = terms.constant(low), terms.constant(high)
        bit = 1 << k
        t, u = terms.less(a, b), terms.equal(b, c)
        ways = [
            (lambda: terms.add(a, b), lambda v: f(v) + g(v)),
            (lambda: terms.subtract(a, b), lambda v: f(v) - g(v)),
            (lambda: terms.scale(a, low), lambda v: f(v) * low),
            (lambda: terms.multiply(a, b), lambda v: f(v) * g(v)),
            (lambda: terms.shift(a, k), lambda v: f(v) >> k),
            (lambda: terms.shift(terms.scale(a, bit), rng.randint(0, 6)), None),
            (lambda: terms.modulo(a, k), lambda v: f(v) % bit),
            (lambda: terms.maximum(a, b), lambda v: max(f(v), g(v))),
            (lambda: terms.minimum(a, b), lambda v: min(f(v), g(v))),
            (lambda: terms.clamp(a, *ends), lambda v: min(max(f(v), low), high)),
            (lambda: t, lambda v: int(f(v) < g(v))),
            (lambda: u, lambda v: int(g(v) == h(v))),
            (lambda: terms.at_most(a, ends[0]), lambda v: int(f(v) <= low)),
            (lambda: terms.either([t, u]), lambda v: int(f(v) < g(v) or g(v) == h(v))),
            (lambda: terms.both([t, u]), lambda v: int(f(v) < g(v) and g(v) == h(v))),
            (lambda: terms.choose(t, a, b), lambda v: f(v) if f(v) < g(v) else g(v)),
            (lambda: terms.choose(t, b, a), lambda v: g(v) if f(v) < g(v) else f(v)),
            (lambda: terms.choose(u, c, a), lambda v: h(v) if g(v) == h(v) else f(v)),
            (
                lambda: terms.choose(t, terms.add(a, ends[0]), a),
                lambda v: f(v) + low if f(v) < g(v) else f(v),
            ),
            (lambda: self._clamp_as_c(a, *ends), lambda v: min(max(f(v), low), high)),
            (
                lambda: terms.choose(u, terms.add(c, terms.scale(t, bit)), c),
                lambda v: h(v) + bit * (f(v) < g(v) and g(v) == h(v)),
            ),
            (lambda: self._set_twice(t, u, bit), lambda v: bit * (f(v) < g(v) or g(v) == h(v))),
        ]
        make, compute = rng.choice([w for w in ways if w[1] is not None])
        return make(), compute

    def _clamp_as_c(self, x: Whole, low: Whole, high: Whole) -> Whole:
        terms = self.terms
        inner = terms.choose(terms.less(high, x), high, x)
        return terms.choose(terms.less(x, low), low, inner)

    def _set_twice(self, t: Whole, u: Whole, bit: int) -> Whole:
        """flags |= bit where t; flags |= bit where u."""
        terms = self.terms
        once = terms.scale(t, bit)
        own = terms.add(once, terms.scale(terms.negate(t), bit))
        return terms.choose(u, own, once)


@pytest.mark.parametrize("make", [Terms, WordTerms])
@pytest.mark.spread(20, "seed", range(40))
def test_normal_forms_keep_their_value_and_range(seed: int, make: type[Terms]) -> None:
    draw = Draw(seed, make())
    for _ in range(60):
        term, compute = draw.draw(4)
        for _ in range(8):
            values = {n: draw.rng.randint(*draw.ends[n]) for n in draw.names}
            found = evaluate(draw.terms, term, values)
            assert found == compute(values)  # type: ignore[operator]
            assert term.low <= found <= term.high


def test_clamp_of_c_is_the_specifications() -> None:
    draw = Draw(1)
    x, low, high = draw.terms.symbol("x", -100, 100), *map(draw.terms.constant, (-7, 12))
    assert draw._clamp_as_c(x, low, high) is draw.terms.clamp(x, low, high)
    moved = draw.terms.add(x, draw.terms.constant(3))
    assert draw._clamp_as_c(moved, low, high) is draw.terms.clamp(moved, low, high)


def test_clamp_of_a_distance_is_the_clamp_of_what_it_is_from() -> None:
    """max(min(x - 12, 0) + 19, 0) - 7, as a core without a limit of its own computes it."""
    terms = WordTerms()
    x, zero = terms.symbol("x", -100, 100), terms.constant(0)
    below = terms.minimum(terms.subtract(x, terms.constant(12)), zero)
    limited = terms.maximum(terms.add(below, terms.constant(19)), zero)
    wanted = terms.clamp(x, terms.constant(-7), terms.constant(12))
    assert terms.subtract(limited, terms.constant(7)) is wanted


def test_step_towards_a_target_stays_between_the_two() -> None:
    terms = Terms()
    h, n = terms.symbol("h", -(2**30), 2**30), terms.symbol("n", -(2**29), 2**29)
    u = terms.symbol("u", 0, 2**31 - 1)
    product = terms.multiply(terms.subtract(n, h), u)
    half = terms.shift(terms.add(product, terms.constant(1 << 31)), 32)
    moved = terms.add(h, terms.scale(half, 2))
    assert (moved.low, moved.high) == (-(2**30) - 1, 2**30 + 1)


@pytest.mark.parametrize("share", [0, 1, 5, 12, 16])
@pytest.mark.parametrize("first", [True, False])
def test_mix_of_two_samples_lies_between_them(share: int, first: bool) -> None:
    """older + round((newer - older) share / 16): exactly as wide as what it takes on."""
    terms = Terms()
    newer, older = terms.symbol("newer", -7, 5), terms.symbol("older", -7, 5)
    apart = terms.scale(terms.subtract(newer, older), share)
    part = terms.shift(terms.add(apart, terms.constant(8)), 4)
    mixed = terms.add(older, part) if first else terms.add(part, older)
    every = [
        (evaluate(terms, mixed, {"newer": a, "older": b}), b + ((a - b) * share + 8 >> 4))
        for a in range(-7, 6)
        for b in range(-7, 6)
    ]
    assert all(a == b for a, b in every)
    assert (mixed.low, mixed.high) == (min(every)[0], max(every)[0]) == (-7, 5)


def test_mix_beyond_its_samples_is_as_wide_as_it_goes() -> None:
    """older + round((newer - older) 3 / 2) + 1 leaves the samples, and its range says so."""
    terms = Terms()
    newer, older = terms.symbol("newer", 0, 4), terms.symbol("older", 0, 4)
    apart = terms.scale(terms.subtract(newer, older), 3)
    part = terms.shift(terms.add(apart, terms.constant(1)), 1)
    mixed = terms.add(terms.add(older, terms.constant(1)), part)
    every = [b + 1 + ((a - b) * 3 + 1 >> 1) for a in range(5) for b in range(5)]
    assert (mixed.low, mixed.high) == (min(every), max(every)) == (-1, 7)


def test_limits_that_may_be_the_wrong_way_round_are_not_decided() -> None:
    terms = Terms()
    low, high = terms.symbol("low", 0, 9), terms.symbol("high", 5, 20)
    with pytest.raises(UndecidedError):
        terms.clamp(terms.symbol("x", 0, 9), low, high)


def test_a_counter_of_two_values_stays_within_them() -> None:
    terms = Terms()
    place = terms.symbol("place", 0, 1)
    after = terms.add(place, terms.constant(1))
    following = terms.choose(terms.equal(place, terms.constant(1)), terms.constant(0), after)
    assert (following.low, following.high) == (0, 1)
    for value in (0, 1):
        assert evaluate(terms, following, {"place": value}) == 1 - value
