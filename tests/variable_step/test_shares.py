"""The shares of a step, 1 - exp(-r) and 1 - (1 - exp(-r)) / r: how exact, how they end."""

from fractions import Fraction

import numpy as np
import pytest

from zerodrift.base.errors import CheckError
from zerodrift.operations.lowpass_after import (
    STRAIGHT_Q32,
    Shares,
    find_shares,
    make_lowpass_after,
    round_rate,
)
from zerodrift.operations.times import count_bits, exceeds_rate, hold_time
from zerodrift_proof.equality.rules import STRAIGHT
from zerodrift_proof.equality.rules import find_shares as find_said

TAUS_US = (1.0, 999.0, 1e6, 37.3e6, 3.6e10, 1e15)


def say(shares: Shares, row: int) -> tuple[int, int, int] | None:
    if not shares.moves[row]:
        return None
    return int(shares.a_q31[row]), int(shares.k[row]), int(shares.c_q31[row])


@pytest.mark.parametrize("tau_us", TAUS_US)
def test_shares_are_exact_from_the_shortest_step_to_the_longest(tau_us: float) -> None:
    rng = np.random.default_rng(11)
    drawn = np.round(10 ** rng.uniform(-6, 7, 100_000) * tau_us)
    times = drawn[(drawn > 0) & (drawn < 2.0**61)].astype(np.int64)
    shares = find_shares(times, *round_rate(tau_us))
    r = times.astype(np.longdouble) / np.longdouble(tau_us)
    a = -np.expm1(-r)
    c = np.where(r < 1e-3, r / 2 - r**2 / 6 + r**3 / 24, 1 - a / r)
    found = shares.a_q31 * np.exp2(-(31.0 + shares.k)).astype(np.longdouble)
    moves = shares.moves
    assert (moves == (r >= 2.0**-20)).mean() > 0.9999  # the edge itself may fall to either side
    assert np.abs(found / a - 1)[moves].max() < 2.0**-28
    assert np.abs(shares.c_q31 / 2.0**31 - c)[moves].max() < 2.0**-23  # r beyond 2^24 is 2^24
    assert np.abs(shares.c_q31 / 2.0**31 - c)[moves & (r < 1e4)].max() < 2.0**-28


def test_c_is_never_above_a_and_both_are_below_1() -> None:
    """What is proven of the state rests on it."""
    rng = np.random.default_rng(12)
    times = np.floor(np.exp2(rng.uniform(0, 61.9, 200_000))).astype(np.int64)
    for tau_us in TAUS_US:
        shares = find_shares(times, *round_rate(tau_us))
        assert (shares.c_q31 >= 0).all()
        assert (shares.c_q31 <= shares.a_q31 >> shares.k).all()
        assert (shares.a_q31 < 2**31).all()
        assert shares.k.max() <= 19


def test_shares_equal_what_the_proof_says_of_them() -> None:
    rng = np.random.default_rng(13)
    times = np.floor(np.exp2(rng.uniform(0, 61.9, 2000))).astype(np.int64)
    times[:4] = (0, 1, 2**32, 2**61 + 2**31)
    for tau_us in TAUS_US:
        rate, shift = round_rate(tau_us)
        shares = find_shares(times, rate, shift)
        for row, time in enumerate(times.tolist()):
            assert say(shares, row) == find_said(time, rate, shift)


def test_coefficients_are_those_of_the_series() -> None:
    total = 1
    for n, coefficient in enumerate(STRAIGHT_Q32):
        total *= n + 2
        assert abs(Fraction(2**32, total) - coefficient) <= Fraction(1, 2)
    assert list(STRAIGHT_Q32) == STRAIGHT


def test_a_longer_step_never_forgets_less() -> None:
    times = np.unique(np.round(10 ** np.linspace(0, 12, 400_000)).astype(np.int64))
    shares = find_shares(times, *round_rate(2.5e6))
    a = shares.a_q31 * np.exp2(-(31.0 + shares.k))
    moving = a[shares.moves]
    assert (np.diff(moving) >= -(2.0**-29)).all()


@pytest.mark.parametrize(
    ("x", "bits"), [(0, 0), (1, 1), (2, 2), (3, 2), (2**31, 32), (2**62 - 1, 62), (2**62, 63)]
)
def test_bits_are_counted(x: int, bits: int) -> None:
    assert count_bits(np.array([x]))[0] == bits


def test_times_are_held() -> None:
    given = np.array([0, 5, 2**61, 2**61 + 1, 2**63 - 1, -1])
    assert hold_time(given).tolist() == [0, 5, 2**61, 2**61, 2**61, 2**61]


@pytest.mark.parametrize(
    ("change", "span_us", "fast"),
    [
        (19, 1, False),  # a span shorter than a period counts as one
        (20, 1, True),
        (-20, 10**6, True),
        (38, 2 * 10**6, False),
        (39, 2 * 10**6, True),
        (2**32 - 1, 2**32 - 1, True),
        (2**32 - 1, 2**32, False),  # no rate over so long a time
    ],
)
def test_rate_is_told_over_the_span(change: int, span_us: int, fast: bool) -> None:
    found = exceeds_rate(np.array([change]), 19, np.array([span_us]), 10**6)
    assert bool(found[0]) is fast


@pytest.mark.parametrize("tau_s", [1e-7, 1e10, float("inf")])
def test_time_constant_that_is_not_held_is_refused(tau_s: float) -> None:
    with pytest.raises(CheckError, match="a time constant of"):
        make_lowpass_after("lowpass_0", ("in_0",), tau_s)
