"""Networks of other programs are read as onnxruntime computes them, or refused by node."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.onnx.graphs import Graph, keras
from tests.onnx.torch_networks import ACTIVATIONS, Form, export
from tests.onnx.write_exported import FORMS, STEPS

from zerodrift.base.errors import InputError
from zerodrift.export.onnx_reader import ImportedNetwork, read_imported, read_imported_bytes

EXPORTED = Path(__file__).parent / "exported"


def run_onnxruntime(content: bytes, x: NDArray[np.float64], state: int = 0) -> NDArray[np.float64]:
    """Return the first output for x, with initial states of zero where the graph takes them."""
    session = onnxruntime.InferenceSession(content)
    first, *others = session.get_inputs()
    feed = {first.name: x.astype(np.float32)}
    for given_input in others:
        feed[given_input.name] = np.zeros(given_input.shape, dtype=np.float32)
    return np.asarray(session.run(None, feed)[state], dtype=np.float64)


def check(content: bytes, batch_first: bool = True, steps: int = 10) -> ImportedNetwork:
    """Compare a file in onnxruntime with the network that is read from it."""
    imported = read_imported_bytes(content, "net.onnx")
    features = imported.network.inputs
    x = np.random.default_rng(5).normal(size=(1, steps, features))
    expected = run_onnxruntime(content, x if batch_first else x.swapaxes(0, 1))
    answer = imported.network.run(x)
    if imported.last_only:
        found = answer[:, -1].reshape(expected.shape)
    else:
        found = answer if batch_first else answer.swapaxes(0, 1)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, atol=1e-5 * max(1.0, np.abs(expected).max()))
    return imported


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize("batch_first", [True, False])
@pytest.mark.parametrize(("last", "state"), [("", False), ("", True), ("output", False)])
def test_torch_network_is_read(layers: int, batch_first: bool, last: str, state: bool) -> None:
    imported = check(export(Form(layers, batch_first, last, state)), batch_first)
    assert len(imported.network.grus) == layers
    assert imported.last_only == bool(last)
    assert imported.initial_state == ("input" if state else "zero")
    assert imported.window == 0, "the file holds for sequences of any length"


@pytest.mark.parametrize("opset", [9, 11, 13, 16, 18, 20])
def test_every_opset_of_the_older_exporter_is_read(opset: int) -> None:
    check(export(Form(layers=2, last="state", activation="relu"), opset=opset))


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_torch_head_is_read(activation: str) -> None:
    imported = check(export(Form(activation=activation, last="state"), dynamic=False))
    assert imported.window == 10
    assert len(imported.network.layers) - 1 == (activation != "none")


@pytest.mark.parametrize("name", FORMS)
def test_newer_torch_exporter_is_read(name: str) -> None:
    form = FORMS[name]
    content = (EXPORTED / f"{name}.onnx").read_bytes()
    imported = check(content, form.batch_first, STEPS)
    assert len(imported.network.grus) == form.layers
    assert imported.window == (STEPS if form.last else 0)
    assert read_imported(EXPORTED / f"{name}.onnx").output_name == imported.output_name


@pytest.mark.parametrize("opset", [9, 17])
@pytest.mark.parametrize("reset_after", [True, False])
@pytest.mark.parametrize("form", ["last", "sequence", "reshaped"])
def test_keras_network_is_read(form: str, reset_after: bool, opset: int) -> None:
    if form == "reshaped" and opset < 10:
        opset = 10  # Slice has attributes before
    imported = check(keras(form, reset_after, opset))
    assert imported.network.grus[0].reset == ("after" if reset_after else "before")
    assert imported.last_only == (form == "last")


def test_step_of_one_sample_without_batch_is_read() -> None:
    g, rng = Graph(), np.random.default_rng(1)
    one = g.constant([0, 1], np.int64)
    y, y_h = g.gru(g.op("Unsqueeze", "x", one), rng, 3, 4, "h")
    flat = g.op("Reshape", y, g.constant([4], np.int64))
    kernel = g.constant(rng.normal(size=(4, 2)))
    answer = g.op("MatMul", g.op("Unsqueeze", flat, g.constant([0], np.int64)), kernel)
    content = g.build({"x": (3,), "h": (1, 1, 4)}, [answer, y_h])
    imported = read_imported_bytes(content, "net.onnx")
    assert (imported.initial_state, imported.window, imported.last_only) == ("input", 0, True)
    expected = run_onnxruntime(content, np.array([0.3, -0.2, 0.9]))
    found = imported.network.run(np.array([[[0.3, -0.2, 0.9]]]))[:, -1]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_batch_major_layout_is_that_of_the_transposed_network() -> None:
    """onnxruntime does not run layout 1, so the same weights in layout 0 are the measure."""
    contents = []
    for layout in (0, 1):
        g, rng = Graph(), np.random.default_rng(8)
        x = "x" if layout else g.op("Transpose", "x", perm=[1, 0, 2])
        y, _ = g.gru(x, rng, 3, 4, layout=layout)
        if layout:
            flat = g.op("Squeeze", y, g.constant([2], np.int64))
        else:
            flat = g.op("Transpose", g.op("Squeeze", y, g.constant([1], np.int64)), perm=[1, 0, 2])
        answer = g.op("MatMul", flat, g.constant(rng.normal(size=(4, 2))))
        contents.append(g.build({"x": ("B", 7, 3)}, [answer]))
    first, second = (read_imported_bytes(c, "net.onnx") for c in contents)
    check(contents[0], steps=7)
    x = np.random.default_rng(2).normal(size=(1, 7, 3))
    np.testing.assert_array_equal(first.network.run(x), second.network.run(x))
    assert (first.steps, second.steps) == (7, 7)


def test_channels_first_with_batch_normalisation_is_read() -> None:
    g, rng = Graph(), np.random.default_rng(4)
    parameters = [g.constant(rng.uniform(0.5, 2.0, 3)) for _ in range(4)]
    normal = g.op("BatchNormalization", "x", *parameters, epsilon=1e-3)
    y, _ = g.gru(g.op("Transpose", normal, perm=[2, 0, 1]), rng, 3, 4)
    last = g.op("Slice", y, *(g.constant([n], np.int64) for n in (-1, 2**62, 0)))
    flat = g.op("Flatten", g.op("Squeeze", last, g.constant([0], np.int64)))
    answer = g.op("Gemm", flat, g.constant(rng.normal(size=(4, 2))), alpha=0.5)
    content = g.build({"x": (1, 3, 12)}, [answer])
    imported = read_imported_bytes(content, "net.onnx")
    x = rng.normal(size=(1, 3, 12))
    expected = run_onnxruntime(content, x)
    found = imported.network.run(x.transpose(0, 2, 1))[:, -1]
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert imported.window == 12


AFTER = (
    "Relu",
    "Tanh",
    "Sigmoid",
    "LeakyRelu",
    "Clip",
    "HardSigmoid",
    "Max",
    "PRelu",
    "Max2",
    "Min2",
)
ELEMENTWISE = ("Add", "Sub", "Mul", "Div", "Neg", "from", "MatMul", "Gemm2")


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    before=st.lists(st.sampled_from(("Add", "Sub", "Mul", "Div", "Neg", "from")), max_size=4),
    layers=st.lists(st.tuples(st.integers(1, 6), st.booleans()), min_size=1, max_size=3),
    between=st.booleans(),
    after=st.lists(st.sampled_from((*AFTER, *ELEMENTWISE)), max_size=6),
    last=st.sampled_from(("", "Gather", "Slice", "Y_h")),
    batch_first=st.booleans(),
    seed=st.integers(0, 2**20),
)
def test_random_graph_is_read(
    before: list[str],
    layers: list[tuple[int, bool]],
    between: bool,
    after: list[str],
    last: str,
    batch_first: bool,
    seed: int,
) -> None:
    """Whatever is accepted computes what onnxruntime computes."""
    g, rng = Graph(), np.random.default_rng(seed)
    width, value = 3, "x"
    for op in before:
        value = _apply(g, rng, op, value, width)
    if batch_first:
        value = g.op("Transpose", value, perm=[1, 0, 2])
    for index, (hidden, reset_after) in enumerate(layers):
        y, y_h = g.gru(value, rng, width, hidden, linear_before_reset=int(reset_after))
        value, width = g.op("Squeeze", y, g.constant([1], np.int64)), hidden
        if between and index + 1 < len(layers):
            value = _apply(g, rng, "Mul", value, width)
    if batch_first:
        value = g.op("Transpose", value, perm=[1, 0, 2])
    if last == "Gather":
        value = g.op("Gather", value, g.constant(-1, np.int64), axis=int(batch_first))
    elif last == "Slice":
        limits = (-1, 2**31 - 1, int(batch_first))
        value = g.op("Slice", value, *(g.constant([n], np.int64) for n in limits))
    elif last == "Y_h":
        value = g.op("Squeeze", y_h, g.constant([0], np.int64))
    for op in after:
        if op == "Gemm2":
            out = int(rng.integers(1, 5))
            value = g.op("MatMul", value, g.constant(rng.normal(size=(width, out))))
            width = out
        elif op == "MatMul":
            value = g.op("MatMul", value, g.constant(rng.normal(size=(width, width))))
        elif op == "Clip":
            value = g.op("Clip", value, g.constant(-0.3), g.constant(0.5))
        elif op == "Max":
            value = g.op("Max", g.constant(0.1), value)
        elif op in ("Max2", "Min2"):
            other = g.op("MatMul", value, g.constant(rng.normal(size=(width, width))))
            value = g.op(op[:3], value, other)
        elif op == "PRelu":
            value = g.op("PRelu", value, g.constant(rng.normal(size=width)))
        elif op in AFTER:
            value = g.op(op, value)
        else:
            value = _apply(g, rng, op, value, width)
    shape = ("B", "T", 3) if batch_first else ("T", "B", 3)
    check(g.build({"x": shape}, [value]), batch_first)


def _apply(g: Graph, rng: np.random.Generator, op: str, value: str, width: int) -> str:
    numbers = rng.uniform(0.5, 2.0, size=int(rng.choice([1, width])))
    operand = g.constant(numbers if rng.random() < 0.5 else numbers.reshape(1, 1, -1)[0])
    if op == "Neg":
        return str(g.op("Neg", value))
    if op == "from":
        return str(g.op("Sub", operand, value))
    pair = (value, operand) if op in ("Sub", "Div") or rng.random() < 0.5 else (operand, value)
    return str(g.op(op, *pair))


def test_output_is_chosen_by_name_or_asked_for() -> None:
    g, rng = Graph(), np.random.default_rng(1)
    y, _ = g.gru("x", rng, 2, 4)
    flat = g.op("Squeeze", y, g.constant([1], np.int64))
    answers = [g.op("MatMul", flat, g.constant(rng.normal(size=(4, n)))) for n in (1, 3)]
    content = g.build({"x": ("T", "B", 2)}, [*answers, flat])
    with pytest.raises(InputError, match="--output"):
        read_imported_bytes(content, "net.onnx")
    chosen = read_imported_bytes(content, "net.onnx", answers[1])
    assert chosen.network.head.shape == (3, 4)
    with pytest.raises(InputError, match="has no output 'drift'"):
        read_imported_bytes(content, "net.onnx", "drift")


def test_state_alone_is_an_answer() -> None:
    g = Graph()
    _, y_h = g.gru("x", np.random.default_rng(1), 2, 4)
    imported = read_imported_bytes(g.build({"x": (9, 1, 2)}, [y_h]), "net.onnx")
    np.testing.assert_array_equal(imported.network.head, np.eye(4))
    assert imported.window == 9


def test_learned_initial_state_is_noticed() -> None:
    g, rng = Graph(), np.random.default_rng(1)
    y, _ = g.gru("x", rng, 2, 4, g.constant(rng.normal(size=(1, 1, 4))))
    answer = g.op("MatMul", y, g.constant(rng.normal(size=(4, 1))))
    imported = read_imported_bytes(g.build({"x": (9, 1, 2)}, [answer]), "net.onnx")
    assert imported.initial_state == "constant"


def refused(g: Graph, answer: str, domains: tuple[str, ...] = ()) -> str:
    """Return the message that refuses a graph."""
    with pytest.raises(InputError) as caught:
        read_imported_bytes(g.build({"x": ("T", "B", 3)}, [answer], domains), "net.onnx")
    assert "net.onnx" in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("direction", ["reverse", "bidirectional"])
def test_network_that_sees_the_future_is_refused(direction: str) -> None:
    g, rng = Graph(), np.random.default_rng(1)
    count = 2 if direction == "bidirectional" else 1
    shapes = ((count, 12, 3), (count, 12, 4), (count, 24))
    weights = [g.constant(rng.normal(size=s)) for s in shapes]
    y = g.op("GRU", "x", *weights, hidden_size=4, direction=direction)
    message = refused(g, y)
    assert f"GRU 'GRU_0': it is {direction}" in message and "only forward" in message


def test_other_recurrence_is_refused() -> None:
    g, rng = Graph(), np.random.default_rng(1)
    weights = [g.constant(rng.normal(size=(1, 4, n))) for n in (3, 4)]
    message = refused(g, g.op("RNN", "x", *weights, hidden_size=4))
    assert "RNN 'RNN_0'" in message and "upported are forward GRUs and LSTMs" in message


@pytest.mark.parametrize(
    ("build", "told"),
    [
        (lambda g, y: g.op("Softmax", y), "Softmax 'Softmax_1'"),
        (lambda g, y: g.op("Elu", y), "Elu 'Elu_1'"),
        (lambda g, y: g.op("Mul", y, y), "a product of two signals"),
        (lambda g, y: g.op("Mul", y, "x"), "a product of two signals"),
        (lambda g, y: g.op("Div", g.constant(1.0), y), "divides by data"),
        (lambda g, y: g.op("Div", y, g.constant(0.0)), "divides by 0"),
        (lambda g, y: g.op("Add", y, g.constant(np.ones((5, 1, 1, 1)))), "along the time axis"),
        (lambda g, y: g.op("Gather", y, g.constant(2, np.int64), axis=0), "not the last"),
        (lambda g, y: g.op("ReduceMean", y, axes=[0]), "ReduceMean"),
        (
            lambda g, y: g.op("ReduceMean", y, axes=[3]),
            "mean or a deviation over the features of a sample outside a layer normalisation",
        ),
        (
            lambda g, y: g.op("LayerNormalization", y, g.constant(np.ones(4)), axis=2),
            "LayerNormalization 'LayerNormalization_1': it normalises over the axes [2, 3]",
        ),
        (
            lambda g, y: g.op("MeanVarianceNormalization", y, axes=[3]),
            "MeanVarianceNormalization 'MeanVarianceNormalization_1': not supported: it divides by"
            " what it computes anew at every sample",
        ),
        (lambda g, y: g.op("MeanVarianceNormalization", y, axes=[3]), "Train with LayerNorm"),
        (lambda g, y: g.op("CumSum", y, g.constant(0, np.int64)), "minGRU"),
        (lambda g, y: g.op("Mul", y, g.op("Sigmoid", "x")), "train a GRU or an LSTM"),
        (lambda g, y: g.op("Reshape", y, g.constant([2, -1], np.int64)), "Reshape"),
        (lambda g, y: g.op("Cast", y, to=onnx.TensorProto.INT32), "whole numbers"),
        (lambda g, y: g.op("MatMul", y, g.constant(np.ones((7, 2)))), "not the features"),
        (lambda g, y: g.op("Clip", y, g.constant(1.0), g.constant(-1.0)), "are empty"),
    ],
)
def test_operator_without_counterpart_is_refused_by_name(build: object, told: str) -> None:
    g, rng = Graph(), np.random.default_rng(1)
    y, _ = g.gru("x", rng, 3, 4)
    assert told in refused(g, build(g, y))  # type: ignore[operator]


def test_part_of_the_input_is_refused_where_it_would_be_data() -> None:
    g, rng = Graph(), np.random.default_rng(1)
    limits = [g.constant([n], np.int64) for n in (0, 5, 0)]
    y, _ = g.gru(g.op("Slice", "x", *limits), rng, 3, 4)
    assert "a part of input 'x'" in refused(g, y)


def test_gru_details_that_differ_are_refused() -> None:
    rng = np.random.default_rng(1)
    for attributes, told in (
        ({"clip": 3.0}, "clips its cells"),
        ({"activations": ["Relu", "Tanh"]}, "activations"),
    ):
        g = Graph()
        y, _ = g.gru("x", rng, 3, 4, **attributes)
        assert told in refused(g, y)
    g = Graph()
    weights = [g.constant(rng.normal(size=s)) for s in ((1, 12, 3), (1, 12, 4))]
    lengths = g.constant([5], np.int32)
    y = g.op("GRU", "x", *weights, "", lengths, hidden_size=4)
    assert "sequence_lens" in refused(g, y)


def test_custom_operator_is_refused_by_domain() -> None:
    g, rng = Graph(), np.random.default_rng(1)
    y, _ = g.gru("x", rng, 3, 4)
    message = refused(g, g.op("Gelu", y, domain="com.microsoft"), ("com.microsoft",))
    assert "com.microsoft" in message


def test_graph_without_a_gru_is_refused() -> None:
    g = Graph()
    message = refused(g, g.op("MatMul", "x", g.constant(np.ones((3, 2)))))
    assert "does not come from a GRU" in message
