"""The integer ONNX in onnxruntime gives the reference's bits: drift, flags, nodes and states."""

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.fixed_point.strategies import shapes
from tests.golden.model_factory import Shape, draw_model
from tests.golden.models import CASES
from tests.golden.vectors import crc_of, find_hidden, load

from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.integer_onnx import build_integer_onnx, list_state
from zerodrift.export.reference import Reference
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_sequences

RELAXED = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example]


def run_reference(
    model: IntegerModel, codes: NDArray[np.int16], settled: bool
) -> tuple[NDArray[np.int64], ...]:
    """Return drift, flags, all nodes [B, T, N] and the packed state of the reference."""
    rows: list[NDArray[np.int64]] = []

    def keep(_: int, values: dict[str, NDArray[np.int64]]) -> None:
        parts = [values[node.name].reshape(len(codes), -1) for node in model.nodes]
        rows.append(np.concatenate(parts, axis=1))

    trace = Reference(model).run(codes, settled=settled, observe=keep)
    nodes = np.stack(rows, axis=1)
    return trace.drift.astype(np.int64), trace.flags.astype(np.int64), nodes, trace.state.pack()


def compare(model: IntegerModel, codes: NDArray[np.int16]) -> None:
    """Compare both starts over a batch of sequences [B, T, C]."""
    runtime = OnnxModel(model)
    for settled in (True, False):
        expected = run_reference(model, codes, settled)
        trace = runtime.run(codes, settled=settled)
        for want, got in zip(
            expected, (trace.drift, trace.flags, trace.nodes, trace.state), strict=True
        ):
            np.testing.assert_array_equal(got, want)


@pytest.mark.spread(4, "name", CASES)
def test_onnxruntime_replays_golden_vectors(name: str) -> None:
    golden = load(name)
    trace = OnnxModel(golden.model).run(golden.codes[None], settled=golden.settled)
    hidden = find_hidden(golden.model)
    rows = np.column_stack(
        [trace.drift[0], trace.flags[0].astype(np.int32), trace.nodes[0][:, hidden]]
    ).astype(np.int32)
    np.testing.assert_array_equal(rows[golden.every - 1 :: golden.every], golden.rows)
    assert crc_of(rows) == golden.crc


@pytest.mark.long
@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=RELAXED)
@given(shape=shapes(most_hidden=24), seed=st.integers(0, 2**31))
def test_random_model_equals_reference(shape: Shape, seed: int) -> None:
    model = draw_model(shape, seed)
    compare(model, np.stack(list(draw_sequences(model, 100).values())))


def test_run_in_parts_equals_run_at_once() -> None:
    model = draw_model(Shape(front_end=("lowpass", "delay", "delay"), window=3), 8)
    codes = np.random.default_rng(3).integers(-9000, 9000, (2, 60, 4)).astype(np.int16)
    runtime = OnnxModel(model, observe=False)
    whole = runtime.run(codes)
    first = runtime.run(codes[:, :23])
    rest = runtime.run(codes[:, 23:], state=first.state)
    np.testing.assert_array_equal(np.concatenate([first.drift, rest.drift], axis=1), whole.drift)
    np.testing.assert_array_equal(np.concatenate([first.flags, rest.flags], axis=1), whole.flags)
    np.testing.assert_array_equal(rest.state, whole.state)


def test_file_for_users_computes_what_the_observed_one_does() -> None:
    model = draw_model(Shape(front_end=("product",), weights="int8"), 12)
    codes = np.random.default_rng(4).integers(-32768, 32768, (1, 50, 4)).astype(np.int16)
    plain, observed = (OnnxModel(model, observe=o).run(codes) for o in (False, True))
    np.testing.assert_array_equal(plain.drift, observed.drift)
    np.testing.assert_array_equal(plain.state, observed.state)
    assert plain.nodes.size == 0 and observed.nodes.size > 0


def test_file_is_reproducible_and_names_its_model() -> None:
    model = draw_model(Shape(), 2)
    content = build_integer_onnx(model)
    assert content == build_integer_onnx(draw_model(Shape(), 2))
    proto = onnx.load_model_from_string(content)
    assert {p.key: p.value for p in proto.metadata_props} == {"model_hash": model.hash}
    assert {i.name for i in proto.graph.input} == {"codes", "start", *list_state(model)}


def test_file_holds_integers_only() -> None:
    """Not one float: neither a constant nor a value between the nodes."""
    shape = Shape(front_end=("lowpass", "product", "delay", "difference"), window=2)
    proto = onnx.load_model_from_string(build_integer_onnx(draw_model(shape, 5)))
    inferred = onnx.shape_inference.infer_shapes(proto, strict_mode=True, data_prop=True)
    whole_numbers = {
        onnx.TensorProto.INT64,
        onnx.TensorProto.INT32,
        onnx.TensorProto.INT16,
        onnx.TensorProto.UINT32,
        onnx.TensorProto.BOOL,
    }
    values = [*inferred.graph.input, *inferred.graph.output, *inferred.graph.value_info]
    assert {v.type.tensor_type.elem_type for v in values} <= whole_numbers
    assert {t.data_type for t in proto.graph.initializer} == {onnx.TensorProto.INT64}
    assert {n.domain for n in proto.graph.node} == {""}
