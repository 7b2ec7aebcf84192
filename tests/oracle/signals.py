"""Section 3 of docs/reference/integer-arithmetic.md: the nodes before the network.

A node is put to rest (`rest`), and from there computes one value per step (`step`).
"""

from collections.abc import Sequence

from tests.oracle.model_file import Node, read_rows, read_vector
from tests.oracle.primitives import add, evaluate_polynomial, fit, round_shift, saturate

OCTAVE_Q29 = (536870912, 372130457, 128972571, 29786284, 5198974, 665093, 117533)
SIGNAL_BITS = 27


class Signal:
    """A node of no memory: at rest it computes what it computes in any step."""

    def __init__(self, node: Node) -> None:
        """Keep the fields of the model file."""
        self.node = node

    def rest(self, x: Sequence[int]) -> int:
        """Return the value at rest and put the state there."""
        return self.step(x)

    def step(self, x: Sequence[int]) -> int:
        """Return the value of one step and move the state on."""
        raise NotImplementedError


class Input(Signal):
    """3.1; reads the code of its channel."""

    def step(self, x: Sequence[int]) -> int:
        node = self.node
        limited = saturate(x[0], node["low"], node["high"])
        return fit((limited - node["origin"]) << node["shift"], 32)


class Load(Signal):
    """3.2; reads the code of its channel and the drift of the step before."""

    def step(self, x: Sequence[int]) -> int:
        node = self.node
        limited = saturate(fit(x[0] - x[1], 64), node["low"], node["high"])
        return fit(limited << node["shift"], 32)


class Counter(Signal):
    """3.3."""

    n = 0

    def rest(self, x: Sequence[int]) -> int:
        self.n = 0
        return 0

    def step(self, x: Sequence[int]) -> int:
        n = self.n
        self.n = min(n + 1, self.node["limit"])
        return fit(n, 32)


class Offset(Signal):
    """3.4."""

    def step(self, x: Sequence[int]) -> int:
        return fit(x[0] - self.node["offset"], 32)


class Difference(Signal):
    """3.4."""

    def step(self, x: Sequence[int]) -> int:
        return fit(x[0] - x[1], 32)


class Sum(Signal):
    """3.5."""

    def step(self, x: Sequence[int]) -> int:
        node = self.node
        total = add(node["bias"], node["coefficients"], x, 64)
        return fit(saturate(total >> node["shift"], node["low"], node["high"]), 32)


class Product(Signal):
    """3.6."""

    def step(self, x: Sequence[int]) -> int:
        node = self.node
        product = round_shift(fit(x[0] * x[1], 64), node["shift"])
        return fit(saturate(product, node["low"], node["high"]), 32)


class Exp2(Signal):
    """3.8."""

    def step(self, x: Sequence[int]) -> int:
        node = self.node
        total = add(node["bias"], [node["coefficient"]], x, 64)
        t_q24 = fit(saturate(total >> node["shift"], node["low"], node["high"]), 32)
        m = evaluate_polynomial(OCTAVE_Q29, (t_q24 % 2**24) * 2**7)
        assert 2**29 <= m <= 2**30
        assert node["top"] == node["high"] >> 24
        return fit(round_shift(m, min(node["top"] + 2 - (t_q24 >> 24), 31)), 32)


class Power(Signal):
    """3.9."""

    def step(self, x: Sequence[int]) -> int:
        node = self.node
        if x[0] <= 0:
            return 0
        n = x[0].bit_length() - 1
        f_q31 = (x[0] - 2**n) * 2 ** (31 - n)
        m = saturate(evaluate_polynomial(node["octave"], f_q31), node["low"], node["high"])
        return fit(round_shift(m * node["gains"][n], node["shift"]), 32)


class Lowpass(Signal):
    """3.10."""

    v = 0

    def rest(self, x: Sequence[int]) -> int:
        self.v = fit(x[0] * (2**24 - self.node["c_q24"]), 64)
        return x[0]

    def step(self, x: Sequence[int]) -> int:
        node = self.node
        assert abs(x[0]) <= 2**SIGNAL_BITS
        y = add(self.v, [node["c_q24"]], x, 64)
        gap = fit(round_shift(fit(fit(x[0] * 2**24, 64) - y, 64), 22), 32)
        self.v = fit(self.v + round_shift(gap * node["m_q31"], node["shift"]), 64)
        return fit(round_shift(y, 24), 32)


class Delay(Signal):
    """3.11; the line holds the oldest input first."""

    line: list[int]

    def rest(self, x: Sequence[int]) -> int:
        self.line = [x[0]] * self.node["steps"]
        return x[0]

    def step(self, x: Sequence[int]) -> int:
        older, *rest = [*self.line, x[0]]
        self.line = rest
        newer = rest[0]
        rise = fit(newer - older, 64)
        return fit(older + round_shift(rise * self.node["newer_q31"], 31), 32)


class Maximum(Signal):
    """3.4."""

    def step(self, x: Sequence[int]) -> int:
        return fit(x[0] if x[0] > x[1] else x[1], 32)


class Minimum(Signal):
    """3.4."""

    def step(self, x: Sequence[int]) -> int:
        return fit(x[1] if x[0] > x[1] else x[0], 32)


class Clip(Signal):
    """3.12."""

    def step(self, x: Sequence[int]) -> int:
        return fit(saturate(x[0], self.node["low"], self.node["high"]), 32)


class Play(Signal):
    """3.13."""

    y = 0

    def rest(self, x: Sequence[int]) -> int:
        self.y = x[0]
        return x[0]

    def step(self, x: Sequence[int]) -> int:
        half = self.node["half_width"]
        self.y = fit(saturate(self.y, x[0] - half, x[0] + half), 32)
        return self.y


SIGNALS: dict[str, type[Signal]] = {
    "input": Input,
    "load": Load,
    "counter": Counter,
    "offset": Offset,
    "difference": Difference,
    "sum": Sum,
    "product": Product,
    "exp2": Exp2,
    "power": Power,
    "lowpass": Lowpass,
    "delay": Delay,
    "clip": Clip,
    "maximum": Maximum,
    "minimum": Minimum,
    "play": Play,
}


class Features:
    """3.14."""

    def __init__(self, node: Node) -> None:
        """Read the matrix."""
        self.bias = read_vector(node["bias"])
        self.matrix = read_rows(node["matrix"])
        self.shift = list(node["shift"])

    def step(self, x: Sequence[int]) -> list[int]:
        """Return the int16 features of the signals."""
        return [
            saturate(add(bias, row, x, 64) >> shift, -32768, 32767)
            for bias, row, shift in zip(self.bias, self.matrix, self.shift, strict=True)
        ]
