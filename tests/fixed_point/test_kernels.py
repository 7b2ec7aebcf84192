"""Every kernel of the runtime against the reference, over every input or the ones that matter."""

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from zerodrift.c_runtime.compilers import (
    INCLUDE_DIRECTORY,
    RUNTIME_DIRECTORY,
    WARNINGS,
    find_compilers,
)
from zerodrift.c_runtime.write_table import render_runtime
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.tables import T_MAX, T_MIN, sigmoid_q31, tanh_nodes, tanh_q30

EVERY_T = np.arange(T_MIN - 4096, T_MAX + 4097)
"""All 2**20 inputs of the table, and beyond both ends."""
Call = Callable[..., np.ndarray[Any, Any]]


@pytest.fixture(scope="module", params=find_compilers(), ids=lambda compiler: str(compiler.name))
def kernels(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The kernels as a shared library of one compiler."""
    library = tmp_path_factory.mktemp("kernels") / f"kernels_{request.param.name}.so"
    sources = [RUNTIME_DIRECTORY / "tests/kernels.c", RUNTIME_DIRECTORY / "src/zd_runtime.c"]
    arguments = [*WARNINGS, "-O2", "-shared", "-fPIC", f"-I{INCLUDE_DIRECTORY}"]
    request.param.run([*arguments, *map(str, sources), "-o", str(library)])
    return ctypes.CDLL(str(library))


def call(function: Any, out_type: type, *arrays: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return what an array function of the library writes."""
    out = np.empty(arrays[0].size, dtype=out_type)
    pointers = [ctypes.c_void_p(np.ascontiguousarray(a).ctypes.data) for a in (*arrays, out)]
    function(*pointers, ctypes.c_uint32(out.size))
    return out


def test_tanh_equals_reference_for_every_input(kernels: Any) -> None:
    actual = call(kernels.zk_tanh_q30, np.int32, EVERY_T.astype(np.int32))
    np.testing.assert_array_equal(actual, tanh_q30(EVERY_T))


def test_sigmoid_equals_reference_for_every_input(kernels: Any) -> None:
    actual = call(kernels.zk_sigmoid_q31, np.int32, EVERY_T.astype(np.int32))
    np.testing.assert_array_equal(actual, sigmoid_q31(EVERY_T).astype(np.int64))


def test_activations_equal_reference_at_the_ends_of_int32(kernels: Any) -> None:
    t = np.array([-(2**31), -(2**31) + 1, -(2**20), 2**20, 2**31 - 2, 2**31 - 1], dtype=np.int32)
    np.testing.assert_array_equal(call(kernels.zk_tanh_q30, np.int32, t), tanh_q30(t))
    np.testing.assert_array_equal(
        call(kernels.zk_sigmoid_q31, np.int32, t), sigmoid_q31(t).astype(np.int64)
    )


def test_round_shift_equals_reference(kernels: Any) -> None:
    rng = np.random.default_rng(1)
    shift = rng.integers(0, 63, size=200_000)
    half = np.int64(1) << shift >> 1
    x = rng.integers(-(2**63) + 2**62, 2**63 - 2**62, size=shift.size)
    x[::3] = x[::3] // (half[::3] + 1) * half[::3]  # multiples of the half: the ties
    actual = call(kernels.zk_round_shift64, np.int64, x, shift.astype(np.uint32))
    expected = [round_shift(int(v), int(s)) for v, s in zip(x, shift, strict=True)]
    np.testing.assert_array_equal(actual, expected)


def test_mul_high_equals_reference(kernels: Any) -> None:
    rng = np.random.default_rng(2)
    ends = np.array([-(2**31), -(2**31) + 1, -(2**16), -1, 0, 1, 2**15, 2**16, 2**31 - 1])
    a = np.concatenate([np.repeat(ends, ends.size), rng.integers(-(2**31), 2**31, 100_000)])
    b = np.concatenate([np.tile(ends, ends.size), rng.integers(-(2**31), 2**31, 100_000)])
    allowed = (a != -(2**31)) | (b != -(2**31))  # the kernel's precondition
    a, b = a[allowed], b[allowed]
    actual = call(kernels.zk_mul_high, np.int32, a.astype(np.int32), b.astype(np.int32))
    np.testing.assert_array_equal(actual, round_shift(a * b, 32))


@pytest.mark.parametrize(("tau_steps", "c_q24"), [(0.4, 10000000), (50.0, 166667), (3.6e6, 2)])
def test_lowpass_equals_reference(kernels: Any, tau_steps: float, c_q24: int) -> None:
    share = -np.expm1(-1.0 / tau_steps)
    k = int(np.floor(-np.log2(share)))
    node = IntegerLowpass("f", ("x",), c_q24, int(share * 2.0 ** (31 + k)), 31 + k - 22)
    x = np.random.default_rng(3).choice([-(2**27), 2**27 - 4096, 5], size=3000)
    state = node.rest({"x": x[:1]})
    v = ctypes.c_int64(int(state["v"][0]))
    actual = np.empty(x.size, dtype=np.int32)
    wide = np.ascontiguousarray(x, dtype=np.int32)
    kernels.zk_lowpass(
        ctypes.byref(v), ctypes.c_void_p(wide.ctypes.data), ctypes.c_int32(node.c_q24),
        ctypes.c_int32(node.m_q31), ctypes.c_uint32(node.shift),
        ctypes.c_void_p(actual.ctypes.data), ctypes.c_uint32(x.size),
    )  # fmt: skip
    expected = np.empty(x.size, dtype=np.int64)
    for t in range(x.size):
        state, out = node.step(state, {"x": x[t : t + 1]})
        expected[t] = out[0]
    np.testing.assert_array_equal(actual, expected)
    assert v.value == int(state["v"][0])


def test_runtime_holds_the_reference_tables_and_its_identity() -> None:
    """After a change of the runtime's text: `make golden`."""
    for path, text in render_runtime().items():
        assert path.read_text(encoding="utf-8") == text, path.name


def test_tanh_error_is_within_the_specified_limit() -> None:
    truth = np.tanh(EVERY_T / 2.0**16)
    error_lsb = np.abs(tanh_q30(EVERY_T) / 2.0**30 - truth) * 2.0**15
    assert error_lsb.max() <= 1.57
    sigmoid = 1.0 / (1.0 + np.exp(-EVERY_T / 2.0**15))
    assert (np.abs(sigmoid_q31(EVERY_T) / 2.0**31 - sigmoid) * 2.0**15).max() <= 0.79


def test_tanh_nodes_are_odd_and_monotone() -> None:
    nodes = tanh_nodes().astype(np.int64)
    np.testing.assert_array_equal(nodes, -nodes[::-1])
    assert (np.diff(nodes) >= 0).all()
    assert nodes[0] == -32767 * 16 and nodes[256] == 0


def test_reference_activations_are_odd_complementary_and_saturating() -> None:
    wide = np.array([-(2**62), T_MIN - 1, T_MAX + 1, 2**62])
    ends = tanh_q30(wide)
    np.testing.assert_array_equal(ends, [-(2**30) + 2**15] * 2 + [2**30 - 2**15] * 2)
    np.testing.assert_array_equal(tanh_q30(-EVERY_T), -tanh_q30(EVERY_T))
    np.testing.assert_array_equal(
        sigmoid_q31(-EVERY_T).astype(np.int64) + sigmoid_q31(EVERY_T), np.full(EVERY_T.size, 2**31)
    )
