"""The kernels of effects: C against reference, and the reference against what it stands for."""

import ctypes
from typing import Any

import numpy as np
import pytest

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import (
    INCLUDE_DIRECTORY,
    RUNTIME_DIRECTORY,
    WARNINGS,
    find_compilers,
)
from zerodrift.operations.delay import IntegerDelay, delay
from zerodrift.operations.exp2 import OCTAVE_Q29, IntegerExp2
from zerodrift.operations.intervals import Interval
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.node import CODES, PREVIOUS_DRIFT
from zerodrift.operations.play import IntegerPlay, play
from zerodrift.operations.polynomial import bound_polynomial, evaluate_polynomial, fit_octave
from zerodrift.operations.power import IntegerPower

Array = np.ndarray[Any, Any]
EVERY_FRACTION = np.arange(2**24, dtype=np.int64)
"""All fractions of an octave that an exponent can have."""


@pytest.fixture(scope="module", params=find_compilers(), ids=lambda compiler: str(compiler.name))
def kernels(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The kernels as a shared library of one compiler."""
    library = tmp_path_factory.mktemp("kernels") / f"signals_{request.param.name}.so"
    sources = [RUNTIME_DIRECTORY / "tests/signal_kernels.c", RUNTIME_DIRECTORY / "src/zd_runtime.c"]
    arguments = [*WARNINGS, "-O2", "-shared", "-fPIC", f"-I{INCLUDE_DIRECTORY}"]
    request.param.run([*arguments, *map(str, sources), "-o", str(library)])
    return ctypes.CDLL(str(library))


def point(array: Array) -> Any:
    """Return a pointer to an array of int32 that keeps the array alive."""
    assert array.dtype == np.int32 and array.flags.c_contiguous
    return array.ctypes


def make_exp2(top: int) -> IntegerExp2:
    """Return a node whose input is the exponent itself, in Q7.24."""
    high = ((top + 1) << 24) - 1
    return IntegerExp2("e", ("x",), 1, 0, 0, low=-60 * 2**24, high=high, top=top)


def make_power(exponent: float, largest: int, bits: int = 27) -> IntegerPower:
    """Return x**exponent for x up to `largest`."""
    octaves = largest.bit_length() - 1
    gain_bits = 30 - int(np.ceil(octaves * exponent))
    return IntegerPower(
        name="p",
        inputs=("x",),
        octave=fit_octave(lambda v: float(v**exponent), 8, bits),
        low=1 << bits,
        high=round(2.0 ** (bits + exponent)),
        gains=tuple(round(2.0 ** (n * exponent + gain_bits)) for n in range(octaves + 1)),
        shift=bits + 3,
    )


@pytest.mark.long
def test_octave_is_accurate_monotone_and_exact_at_its_ends() -> None:
    octave = evaluate_polynomial(EVERY_FRACTION << 7, OCTAVE_Q29)
    truth = 2.0 ** (29.0 + EVERY_FRACTION / 2.0**24)
    assert np.abs(octave - truth).max() <= 4.1
    assert (np.diff(octave) >= 0).all()
    assert octave[0] == 2**29 and octave[-1] <= 2**30
    assert sum(OCTAVE_Q29) == 2**30 and min(OCTAVE_Q29) > 0


@pytest.mark.parametrize("top", [-7, 0, 40])
def test_exp2_equals_reference_and_its_bounds(kernels: Any, top: int) -> None:
    node = make_exp2(top)
    rng = np.random.default_rng(1)
    ends = np.arange(-60, top + 1)[:, None] * 2**24 + np.array([-1, 0, 1, 2**23])
    t = np.concatenate([rng.integers(node.low, node.high + 1, 200_000), ends.ravel()])
    t = np.clip(t, node.low, node.high)
    expected = node.step({}, {"x": t})[1]
    actual = np.empty(t.size, dtype=np.int32)
    kernels.zk_exp2(
        point(t.astype(np.int32)), ctypes.c_int32(top), point(actual), ctypes.c_uint32(t.size)
    )
    np.testing.assert_array_equal(actual, expected)
    error = np.abs(expected - 2.0 ** (t / 2.0**24 - top + 27))
    assert error.max() <= 1.6, "1.1 counts of the octave and one rounding"
    out = node.prove([[Interval(int(t.min()), int(t.max()))]])[0][0]
    assert (out.low, out.high) == (expected.min(), expected.max())


@pytest.mark.parametrize("exponent", [0.1, 0.5, 0.9, 1.5, 2.7])
def test_power_equals_reference_and_the_truth(kernels: Any, exponent: float) -> None:
    largest = 2**27 + 12345
    node = make_power(exponent, largest)
    rng = np.random.default_rng(2)
    edges = (1 << np.arange(28))[:, None] + np.array([-1, 0, 1])
    spread = np.exp2(rng.uniform(0.0, 27.0, 100_000)).astype(np.int64)
    x = np.concatenate([edges.ravel(), spread, [largest, 0, -1, -largest]])
    expected = node.step({}, {"x": x})[1]
    actual = np.empty(x.size, dtype=np.int32)
    kernels.zk_power(
        point(np.array(node.octave, dtype=np.int32)), ctypes.c_uint32(len(node.octave)),
        ctypes.c_int32(node.low), ctypes.c_int32(node.high),
        point(np.array(node.gains, dtype=np.int32)), ctypes.c_uint32(node.shift),
        point(x.astype(np.int32)), point(actual), ctypes.c_uint32(x.size),
    )  # fmt: skip
    np.testing.assert_array_equal(actual, expected)
    gain_bits = 27 - np.ceil(27 * exponent)
    truth = np.maximum(x, 0.0) ** exponent * 2.0**gain_bits
    gain_error = 0.5 * 2.0**exponent / 8.0  # half a count of the gain, times (1 + f)^p
    assert (np.abs(expected - truth) <= truth * 2.0**-25 + gain_error + 0.5).all()
    out = node.prove([[Interval(-largest, largest)]])[0][0]
    assert out.low <= expected.min() and expected.max() <= out.high


@pytest.mark.parametrize("exponent", [0.1, 0.37, 1.5, 3.3, 7.9])
def test_octave_of_a_power_is_within_its_stated_error(exponent: float) -> None:
    bits = 29 - int(np.ceil(exponent))
    octave = fit_octave(lambda v: float(v**exponent), 8, bits)
    f = np.linspace(0.0, 1.0, 20001)[:-1]
    found = evaluate_polynomial(np.round(f * 2.0**31).astype(np.int64), octave)
    error = np.abs(found / 2.0**bits / (1.0 + f) ** exponent - 1.0).max()
    assert error <= 2.0**-27 + 5.0 * 2.0**-bits, "the fit's error and nine roundings"
    bounds = bound_polynomial("p", octave)
    assert bounds[-1].interval.low <= found.min() and found.max() <= bounds[-1].interval.high


def test_power_with_a_table_too_short_is_refused() -> None:
    node = make_power(0.5, 1000)
    node.prove([[Interval(-5, 1023)]])
    with pytest.raises(CheckError, match=r"p: x reaches 1024, in octave 10, and the table"):
        node.prove([[Interval(-5, 1024)]])


def test_polynomial_that_could_overflow_is_refused() -> None:
    bound_polynomial("p", (2**30, 2**30 - 1))
    with pytest.raises(CheckError, match=r"p\.degree_0: can reach"):
        bound_polynomial("p", (2**30 + 1, 2**30))


@pytest.mark.parametrize("half_width", [0, 1, 777, 2**27])
def test_play_equals_reference_and_float(kernels: Any, half_width: int) -> None:
    x = np.cumsum(np.random.default_rng(3).integers(-900, 901, 4000))
    x[2000:2100:2], x[2001:2100:2] = -(2**27), 2**27
    node = IntegerPlay("p", ("x",), half_width)
    state = node.rest({"x": x[:1]})
    expected = np.empty_like(x)
    for t in range(x.size):
        state, out = node.step(state, {"x": x[t : t + 1]})
        expected[t] = out[0]
    np.testing.assert_array_equal(expected, play(x.astype(np.float64), float(half_width)))
    actual = np.empty(x.size, dtype=np.int32)
    y = ctypes.c_int32(int(x[0]))
    kernels.zk_play(
        ctypes.byref(y), ctypes.c_int32(half_width), point(x.astype(np.int32)), point(actual),
        ctypes.c_uint32(x.size),
    )  # fmt: skip
    np.testing.assert_array_equal(actual, expected)
    ((out_range,), _) = node.prove([[Interval(int(x.min()), int(x.max()))]])
    assert out_range.low <= expected.min() and expected.max() <= out_range.high


@pytest.mark.parametrize("share", [0.0, 0.25, 0.999, 1.0 - 2.0**-31])
def test_delay_by_part_of_a_step_equals_kernel_and_float(kernels: Any, share: float) -> None:
    newer_q31 = int(share * 2**31)
    x = np.random.default_rng(4).integers(-(2**27), 2**27, 2000)
    node = IntegerDelay("d", ("x",), steps=3, newer_q31=newer_q31)
    state = node.rest({"x": x[:1]})
    expected = np.empty_like(x)
    for t in range(x.size):
        state, out = node.step(state, {"x": x[t : t + 1]})
        expected[t] = out[0]
    assert np.abs(expected - delay(x.astype(np.float64), 1.0, 3.0 - share)).max() <= 0.76
    late = np.concatenate([np.full(3, x[0]), x])
    actual = np.empty(x.size, dtype=np.int32)
    older, newer = late[: x.size].astype(np.int32), late[1 : x.size + 1].astype(np.int32)
    kernels.zk_between(
        point(older), point(newer), ctypes.c_int32(newer_q31), point(actual),
        ctypes.c_uint32(x.size),
    )  # fmt: skip
    np.testing.assert_array_equal(actual, expected)


def test_load_equals_reference_at_the_ends_of_int32(kernels: Any) -> None:
    ends = np.array([-(2**31), -(2**31) + 1, -1, 0, 1, 2**31 - 1])
    codes, drift = np.repeat(ends, ends.size), np.tile(ends, ends.size)
    node = IntegerLoad("l", (), channel=0, output=0, low=-70000, high=90000, shift=0)
    values = {CODES: codes[:, None], PREVIOUS_DRIFT: drift[:, None]}
    expected = node.step({}, values)[1]
    actual = np.empty(codes.size, dtype=np.int32)
    kernels.zk_load(
        point(codes.astype(np.int32)), point(drift.astype(np.int32)), ctypes.c_int32(node.low),
        ctypes.c_int32(node.high), point(actual), ctypes.c_uint32(codes.size),
    )  # fmt: skip
    np.testing.assert_array_equal(actual, expected)


@pytest.mark.parametrize("gap_lsb", [0.13, 0.25, 1.0, 100.0])
def test_ten_hours_at_ten_milliseconds_do_not_stall(gap_lsb: float) -> None:
    """The state moves until it is within an eighth of a count of x: the output is then x itself."""
    share = -np.expm1(-0.01 / 36_000.0)
    exponent = int(np.floor(-np.log2(share)))
    node = IntegerLowpass("f", ("x",), 2, round(share * 2.0 ** (31 + exponent)), 31 + exponent - 22)
    for sign in (-1, 1):
        x = 12_345_678
        v = (x << 24) - 2 * x - round(sign * gap_lsb * 2**24)
        state, _ = node.step({"v": np.array([v])}, {"x": np.array([x])})
        moved = int(state["v"][0]) - v
        assert sign * moved >= 1
        assert abs(moved - sign * share * gap_lsb * 2**24) <= 1.0
