"""Section 1, 3.7 and 4.1 of docs/reference/integer-arithmetic.md, in integers without a width.

Python's integers never overflow; what the page says fits a width is asserted to.
"""

from collections.abc import Sequence
from decimal import ROUND_FLOOR, Decimal, localcontext
from operator import mul

COPY_SHIFT = 15
ZERO_NODE = 256
NODE_BITS = 19
NODE_MAX = 2**19 - 2**4
"""No node of the table lies beyond: tanh_q30 stays within 2^30 - 2^15."""


def fit(x: int, bits: int) -> int:
    """Return x, which must fit a signed integer of that many bits."""
    assert -(2 ** (bits - 1)) <= x <= 2 ** (bits - 1) - 1, f"{x} does not fit int{bits}"
    return x


def round_shift(x: int, s: int) -> int:
    """Divide by 2^s to the nearest, halves upwards; x and its rounding half are 64 bits."""
    assert s >= 0
    return fit(x, 64) if s == 0 else fit(x + 2 ** (s - 1), 64) >> s


def saturate(x: int, low: int, high: int) -> int:
    """Limit x to low .. high."""
    assert low <= high
    return low if x < low else high if x > high else x


def mul_high(a: int, b: int) -> int:
    """Return the upper half of a product in 64 bits, rounded."""
    return round_shift(a * b, 32)


def add(bias: int, weights: Sequence[int], values: Sequence[int], bits: int) -> int:
    """Return bias + sum w v; the sizes of all terms together fit, hence any order of them does."""
    assert len(weights) == len(values)
    products = list(map(mul, weights, values))
    fit(abs(bias) + sum(map(abs, products)), bits)
    return bias + sum(products)


def evaluate_polynomial(coefficients: Sequence[int], f_q31: int) -> int:
    """Return the polynomial (3.7) on one octave, 0 <= f < 1 in Q0.31."""
    assert 0 <= f_q31 < 2**31
    p = fit(coefficients[-1], 32)
    for c in reversed(coefficients[:-1]):
        p = fit(c + round_shift(p * f_q31, 31), 32)
    return p


def _make_upper_nodes() -> list[int]:
    """Return T[256], ..., T[512]."""
    nodes = []
    with localcontext() as context:
        context.prec = 50
        for i in range(ZERO_NODE + 1):
            e = (Decimal(2 * i) / 32).exp()
            tanh = (e - 1) / (e + 1)
            moved = tanh + tanh * (1 - tanh * tanh) / 2**13
            nearest = (moved * 2**NODE_BITS + Decimal("0.5")).to_integral_value(ROUND_FLOOR)
            nodes.append(min(int(nearest), NODE_MAX))
    return nodes


_UPPER = _make_upper_nodes()
TANH_Q19 = [-node for node in reversed(_UPPER[1:])] + _UPPER


def tanh_q30(t_q16: int) -> int:
    """Return tanh(t) in Q0.30 from the table."""
    p = saturate(t_q16, -(2**19), 2**19 - 1) + 2**19
    i, f = p >> 11, p % 2**11
    return fit(TANH_Q19[i] * 2**11 + (TANH_Q19[i + 1] - TANH_Q19[i]) * f, 32)


def sigmoid_q31(half_t_q16: int) -> int:
    """Return sigmoid(2 t) in Q0.31 from the table."""
    return fit(tanh_q30(half_t_q16) + 2**30, 32)


def copy(y_q30: int) -> int:
    """Return the int16 that the layer after reads."""
    return fit(round_shift(y_q30, COPY_SHIFT), 16)
