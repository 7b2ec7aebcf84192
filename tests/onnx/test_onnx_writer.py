"""Exact int64 arithmetic in onnxruntime, on numbers of every size, those beyond 32 bits first."""

from collections.abc import Callable

import numpy as np
import onnxruntime
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper

from zerodrift.operations.arithmetic import round_shift, saturate
from zerodrift.operations.onnx_writer import IR_VERSION, OPSET, OnnxWriter

Int64Array = NDArray[np.int64]


def draw_numbers() -> Int64Array:
    """Return numbers of every size, and those around powers of two where halves change sign."""
    rng = np.random.default_rng(7)
    sizes = rng.integers(-(2**62), 2**62, 20_000) >> rng.integers(0, 62, 20_000)
    edges = [s * 2**k + d for k in range(62) for s in (1, -1) for d in (-1, 0, 1)]
    halves = [s * (2**k + 2**31 + d) for k in range(32, 62) for s in (1, -1) for d in (-1, 0, 1)]
    return np.concatenate([sizes, edges, halves]).astype(np.int64)


NUMBERS = draw_numbers()


def compute(write: Callable[[OnnxWriter, str], str], x: Int64Array) -> Int64Array:
    w = OnnxWriter()
    w.rename(write(w, "x"), "y")
    values = [helper.make_tensor_value_info(n, TensorProto.INT64, None) for n in "xy"]
    graph = helper.make_graph(w.nodes, "g", values[:1], values[1:], list(w.initializers.values()))
    opsets = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION)
    session = onnxruntime.InferenceSession(model.SerializeToString())
    return np.asarray(session.run(None, {"x": x})[0])


@pytest.mark.parametrize("shift", range(64))
def test_floor_shift_is_that_of_python(shift: int) -> None:
    ends = np.array([-(2**63), -(2**63) + 1, 2**63 - 1])
    x = np.concatenate([NUMBERS, ends]).astype(np.int64)
    np.testing.assert_array_equal(compute(lambda w, v: w.floor_shift(v, shift), x), x >> shift)


@pytest.mark.parametrize("shift", [0, 1, 15, 22, 31, 32, 46, 61])
def test_round_shift_is_that_of_the_reference(shift: int) -> None:
    found = compute(lambda w, v: w.round_shift(v, shift), NUMBERS)
    np.testing.assert_array_equal(found, round_shift(NUMBERS, shift))


def test_shifts_by_column() -> None:
    shifts = [0, 7, 31, 63]
    x = NUMBERS[: NUMBERS.size // 4 * 4].reshape(-1, 4)
    found = compute(lambda w, v: w.floor_shift(v, shifts), x)
    np.testing.assert_array_equal(found, x >> np.array(shifts))


@pytest.mark.parametrize(
    "limits",
    [(-32768, 32767), (-3_000_000, 3_000_000), (-(2**31), 2**31 - 1), (-(2**40), 2**33 + 5)],
)
def test_saturation_of_numbers_beyond_32_bits(limits: tuple[int, int]) -> None:
    found = compute(lambda w, v: w.saturate(v, *limits), NUMBERS)
    np.testing.assert_array_equal(found, saturate(NUMBERS, *limits))


def test_sums_and_products_of_wide_numbers() -> None:
    small = NUMBERS[np.abs(NUMBERS) < 2**31]
    factor = 2**30 + 12345
    found = compute(lambda w, v: w.mul(v, w.constant(factor)), small)
    np.testing.assert_array_equal(found, small * factor)
    other = -(2**61) + 987
    added = compute(lambda w, v: w.add(v, w.constant(other)), NUMBERS)
    np.testing.assert_array_equal(added, NUMBERS + other)
    matrix = np.array([[2**30, -5], [-(2**30) + 1, 2**29], [77, -(2**30)]])
    rows = small[: small.size // 3 * 3].reshape(-1, 3)
    found = compute(lambda w, v: w.op("MatMul", v, w.constant(matrix)), rows)
    np.testing.assert_array_equal(found, rows @ matrix)
