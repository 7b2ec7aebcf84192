"""The integer model as an ONNX graph of standard integer operators.

onnxruntime computes with it the same bits as the reference and the C, states included. The format
of the file is described in `docs/reference/integer-onnx.md`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper

from zerodrift.errors import CheckError
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_RATE_RANGE,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    IntegerModel,
)
from zerodrift.export.integer_onnx_nodes import (
    RESTS,
    SETTLES,
    STEPS,
    write_drift_sum,
    write_zeros,
)
from zerodrift.export.onnx_writer import IR_VERSION, OPSET, OnnxWriter, Shape
from zerodrift.export.reference import Reference
from zerodrift.files import write_whole
from zerodrift.operations.load import START_PASSES
from zerodrift.operations.node import CODES, PREVIOUS_DRIFT

START_GO_ON, START_COLD, START_SETTLED = 0, 1, 2
"""Values of the input `start`."""
LAST_DRIFT = "last_drift"
"""Name of the state that a load is computed with."""


def list_state(model: IntegerModel) -> dict[str, tuple[int, ...]]:
    """Return the state's fields with their shapes after the batch, in the order of `pack`."""
    codes = np.zeros((1, len(model.channels)), dtype=np.int64)
    state = Reference(model).start(codes, settled=False)
    fields: dict[str, tuple[int, ...]] = {"steps": (), "previous": ()}
    if model.feeds_back:
        fields[LAST_DRIFT] = (len(model.outputs),)
    for node, arrays in state.nodes.items():
        for key in sorted(arrays):
            fields[f"{node}.{key}"] = arrays[key].shape[1:]
    return fields


def build_integer_onnx(model: IntegerModel, *, observe: bool = False) -> bytes:
    """Return the ONNX file of an integer model; the same model gives the same bytes.

    Args:
        model: proven beforehand.
        observe: also give every node's value at every step, as `node:NAME`.

    Raises:
        CheckError: a node's kind has no form in ONNX.
    """
    unknown = sorted({node.kind for node in model.nodes} - set(STEPS))
    if unknown:
        raise CheckError(f"nodes of the kinds {unknown} have no form in ONNX; no file is written")
    model.prove()
    w = OnnxWriter()
    fields = list_state(model)
    shapes: dict[str, Shape] = {name: ("B", *shape) for name, shape in fields.items()}
    codes = w.op("Cast", "codes", to=TensorProto.INT64)
    started = _write_start(w, model, codes, shapes)
    channels, outputs = len(model.channels), len(model.outputs)
    code_type = helper.np_dtype_to_tensor_dtype(np.dtype(model.code_type))
    collected: list[tuple[str, int, Shape]] = [
        ("drift", TensorProto.INT32, ("B", outputs)),
        ("flags", TensorProto.UINT32, ("B",)),
    ]
    if observe:
        collected += [
            (f"node:{n.name}", TensorProto.INT64, ("B", n.width) if n.width else ("B",))
            for n in model.nodes
        ]

    def body(carried: Sequence[str], slices: Sequence[str]) -> tuple[list[str], list[str]]:
        state = dict(zip(fields, carried, strict=True))
        after, values, drift, flags = _write_step(w, model, state, slices[0])
        rows = [
            w.op("Cast", drift, to=TensorProto.INT32),
            w.op("Cast", flags, to=TensorProto.UINT32),
        ]
        return [after[name] for name in fields], rows + (
            [values[node.name] for node in model.nodes] if observe else []
        )

    results = w.scan(
        body,
        [(name, shapes[field]) for field, name in zip(fields, started, strict=True)],
        [(codes, ("B", channels))],
        [(kind, shape) for _, kind, shape in collected],
    )
    ends = [f"{name}.next" for name in fields]
    for value, name in zip(results, [*ends, *(name for name, _, _ in collected)], strict=True):
        w.rename(value, name)
    graph = helper.make_graph(
        w.nodes,
        "zerodrift_integer",
        [
            helper.make_tensor_value_info("codes", code_type, ("T", "B", channels)),
            helper.make_tensor_value_info("start", TensorProto.INT64, []),
            *(
                helper.make_tensor_value_info(name, TensorProto.INT64, shape)
                for name, shape in shapes.items()
            ),
        ],
        [
            *(
                helper.make_tensor_value_info(name, kind, ("T", *shape))
                for name, kind, shape in collected
            ),
            *(
                helper.make_tensor_value_info(f"{name}.next", TensorProto.INT64, shape)
                for name, shape in shapes.items()
            ),
        ],
        list(w.initializers.values()),
        doc_string=f"integer model {model.hash}",
    )
    proto = helper.make_model(
        graph,
        producer_name="zerodrift",
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    helper.set_model_props(proto, {"model_hash": model.hash})
    onnx.checker.check_model(proto, full_check=True)
    return bytes(proto.SerializeToString(deterministic=True))


def save_integer_onnx(model: IntegerModel, path: Path) -> None:
    """Write the ONNX file of an integer model, whole or not at all."""
    write_whole(path, build_integer_onnx(model))


def _write_step(
    w: OnnxWriter, model: IntegerModel, state: Mapping[str, str], codes: str
) -> tuple[dict[str, str], dict[str, str], str, str]:
    """Write one step; return the next state, all nodes' values, drift [B, K] and flags [B]."""
    values = {CODES: codes}
    if model.feeds_back:
        values[PREVIOUS_DRIFT] = state[LAST_DRIFT]
    after: dict[str, str] = {}
    for node in model.nodes[:-1]:
        with w.label(node.name):
            own = _fields_of(node.name, state)
            fields, values[node.name] = STEPS[node.kind](w, node, values, own)
            after.update({f"{node.name}.{key}": name for key, name in fields.items()})
    last, guards = model.drift, model.guards
    with w.label(last.name):
        unlimited = write_drift_sum(w, last, values)
        drift = w.saturate(unlimited, last.low, last.high)
        values[last.name] = drift
    with w.label("guards"):
        temperature = w.column(codes, guards.temperature_channel)
        moved = w.op("Abs", w.sub(temperature, state["previous"]))
        differs = w.flag(w.op("Not", w.op("Equal", unlimited, drift)))
        flags = [
            w.flag(w.op("Less", state["steps"], w.constant(guards.warm_up_steps)), FLAG_WARMING_UP),
            w.flag(
                w.op(
                    "Or",
                    w.op("Less", temperature, w.constant(guards.temperature_low)),
                    w.op("Greater", temperature, w.constant(guards.temperature_high)),
                ),
                FLAG_TEMPERATURE_RANGE,
            ),
            w.flag(w.op("Greater", moved, w.constant(guards.rate_max)), FLAG_RATE_RANGE),
            w.mul(w.op("ReduceMax", differs, axes=[1], keepdims=0), w.constant(FLAG_CLAMPED)),
        ]
        total = flags[0]
        for flag in flags[1:]:
            total = w.add(total, flag)
        full = w.constant(max(guards.warm_up_steps, 1))
        after["steps"] = w.minimum(w.add(state["steps"], w.constant(1)), full)
        after["previous"] = temperature
        if model.feeds_back:
            after[LAST_DRIFT] = drift
    return after, values, drift, total


def _fields_of(node: str, state: Mapping[str, str]) -> dict[str, str]:
    """Return the state of one node: field -> value's name."""
    return {
        name.removeprefix(f"{node}."): value
        for name, value in state.items()
        if name.startswith(f"{node}.")
    }


def _write_start(
    w: OnnxWriter, model: IntegerModel, codes: str, shapes: Mapping[str, Shape]
) -> list[str]:
    """Write the state before the first step: the one given, or that of a start at codes[0]."""

    def restart() -> list[str]:
        first = w.op("Gather", codes, w.constant(0), axis=0)
        settled = w.flag(w.op("Equal", "start", w.constant(START_SETTLED)))
        return _write_rest(w, model, first, settled, list(shapes))

    goes_on = w.op("Equal", "start", w.constant(START_GO_ON))
    return w.either(goes_on, lambda: list(shapes), restart, list(shapes.values()))


def _write_rest(
    w: OnnxWriter, model: IntegerModel, first: str, settled: str, fields: Sequence[str]
) -> list[str]:
    """Write the state at rest at codes `first` [B, C]; `settled` is 1 or, for `init`, 0."""
    zero = w.mul(w.column(first, 0), w.constant(0))
    full = max(model.guards.warm_up_steps, 1)
    state = {
        "steps": w.add(zero, w.mul(settled, w.constant(full))),
        "previous": w.column(first, model.guards.temperature_channel),
    }
    if not model.feeds_back:
        state |= _write_nodes_at_rest(w, model, {CODES: first}, settled)[0]
        return [state[name] for name in fields]
    drift = write_zeros(w, first, len(model.outputs))
    for _ in range(START_PASSES):
        drift = _write_nodes_at_rest(w, model, {CODES: first, PREVIOUS_DRIFT: drift}, settled)[1]
    values = {CODES: first, PREVIOUS_DRIFT: drift}
    state |= _write_nodes_at_rest(w, model, values, settled)[0]
    state[LAST_DRIFT] = drift
    return [state[name] for name in fields]


def _write_nodes_at_rest(
    w: OnnxWriter, model: IntegerModel, given: Mapping[str, str], settled: str
) -> tuple[dict[str, str], str]:
    """Write all nodes' states at rest; return them, and the drift there where it is needed."""
    values, state = dict(given), {}
    needed = _needed_at_rest(model)
    for node in model.nodes:
        with w.label(node.name):
            own = RESTS[node.kind](w, node, values) if node.kind in RESTS else {}
            if node.kind in SETTLES:
                warm = SETTLES[node.kind](w, node, values)
                is_settled = w.op("Equal", settled, w.constant(1))
                own = {key: w.op("Where", is_settled, warm[key], own[key]) for key in own}
            state.update({f"{node.name}.{key}": name for key, name in own.items()})
            if node.name in needed:
                _, values[node.name] = STEPS[node.kind](w, node, values, own)
    return state, values.get(model.drift.name, "")


def _needed_at_rest(model: IntegerModel) -> set[str]:
    """Return the names of the nodes whose values some state at rest is made from."""
    if model.feeds_back:
        return {node.name for node in model.nodes}
    nodes = {node.name: node for node in model.nodes}
    stack = [name for n in model.nodes if n.kind in RESTS for name in n.inputs]
    needed: set[str] = set()
    while stack:
        name = stack.pop()
        if name not in needed:
            needed.add(name)
            stack.extend(nodes[name].inputs)
    return needed
