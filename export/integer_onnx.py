"""The integer model as an ONNX graph of standard integer operators.

onnxruntime computes with it the same bits as the reference and the C, states included. The format
of the file is described in `docs/reference/integer-onnx.md`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper

from zerodrift.base.files import write_whole
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TARED,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    IntegerModel,
    order_conversions,
)
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN
from zerodrift.operations.load import START_PASSES
from zerodrift.operations.node import CODES, ELAPSED, PREVIOUS_DRIFT
from zerodrift.operations.onnx_writer import IR_VERSION, OPSET, OnnxWriter, Shape
from zerodrift.operations.times import LONGEST_US, MOST_HELD_US

# What the integer ONNX has more where the drift can be counted from a moment on.

TARE = "tare"
"""Name of the state: the last answers, what is taken off, and whether it is."""


def write_count_from(
    w: OnnxWriter, tare: str, drift: str, flags: str, clamped: str, outputs: int
) -> tuple[str, str, str]:
    """Write the state after a step, drift [B, K] from the tare on, and flags [B].

    Args:
        w: the writer.
        tare: [B, 2 K + 1] the state before it.
        drift: [B, K] as the model gives it.
        flags: [B] without those of the tare.
        clamped: [B] 1 where the flag of a limited drift is among them.
        outputs: K.
    """
    with w.label(TARE):
        _, off, kept = w.split(tare, (outputs, outputs, 1))
        tared = w.op("Equal", kept, w.constant(2))  # [B, 1]
        wide = w.sub(drift, off)
        counted = w.op("Where", tared, w.saturate(wide, INT32_MIN, INT32_MAX), drift)
        differs = w.flag(w.op("And", tared, w.op("Not", w.op("Equal", counted, wide))))
        limited = w.op("ReduceMax", differs, axes=[1], keepdims=0)
        more = w.mul(w.mul(limited, w.sub(w.constant(1), clamped)), w.constant(FLAG_CLAMPED))
        told = w.op("Squeeze", w.flag(tared, FLAG_TARED), w.constant([1]))
        state = w.op("Where", tared, w.constant(2), w.constant(1))
        after = w.op("Concat", drift, off, state, axis=1)
        return after, counted, w.add(w.add(flags, more), told)


# Additions to the integer ONNX for a variable step: the time of a step, and the rate flag.

SLEPT = "slept"
"""Name of the state that is added to the next step's time."""


def split_time(w: OnnxWriter, model: IntegerModel, given: str) -> tuple[str, str]:
    """Write codes [B, C] and, of a variable step, its time [B] of what a step is given."""
    if not model.variable_step:
        return given, ""
    channels = len(model.channels)
    codes = w.split(given, (channels, 1))[0]
    time = w.column(given, channels)
    longest = w.constant(LONGEST_US)
    negative = w.op("Less", time, w.constant(0))
    return codes, w.op("Where", negative, longest, w.minimum(time, longest))


def write_span(w: OnnxWriter, state: Mapping[str, str], time: str) -> str:
    """Write the time [B] since the last step, 0 before the first; "" without a variable step."""
    if not time:
        return ""
    slept = w.op("Squeeze", state[SLEPT], w.constant([1]))
    span = w.minimum(w.add(time, slept), w.constant(LONGEST_US))
    return w.op("Where", w.op("Equal", state["steps"], w.constant(0)), w.constant(0), span)


def write_rate(w: OnnxWriter, model: IntegerModel, moved: str, span: str) -> str:
    """Write whether the temperature [B] moved by more than the model allows."""
    most = w.constant(model.guards.rate_max)
    if not span:
        return w.op("Greater", moved, most)
    held = w.saturate(span, model.period_us, MOST_HELD_US)
    change = w.mul(w.minimum(moved, w.constant(INT32_MAX)), w.constant(model.period_us))
    fast = w.op("Greater", change, w.mul(most, held))
    return w.op("And", fast, w.op("LessOrEqual", span, w.constant(MOST_HELD_US)))


# The integer model as an ONNX graph of standard integer operators.

START_GO_ON, START_COLD, START_SETTLED = 0, 1, 2
"""Values of the input `start`."""
LAST_DRIFT = "last_drift"
"""Name of the state that a load is computed with."""


def list_state(model: IntegerModel) -> dict[str, tuple[int, ...]]:
    """Return the state's fields with their shapes after the batch, in the order of `pack`."""
    codes = np.zeros((1, model.columns), dtype=np.int64)
    state = Reference(model).start(codes, settled=False)
    fields: dict[str, tuple[int, ...]] = {"steps": (), "previous": ()}
    fields |= dict.fromkeys(_name_held(model), ())
    if model.variable_step:
        fields[SLEPT] = (1,)
    if model.tare:
        fields[TARE] = (2 * len(model.outputs) + 1,)
    if model.feeds_back:
        fields[LAST_DRIFT] = (len(model.outputs),)
    for node, arrays in state.nodes.items():
        for key in sorted(arrays):
            fields[f"{node}.{key}"] = arrays[key].shape[1:]
    return fields


def _name_held(model: IntegerModel) -> list[str]:
    """Return the fields of the last readings of inputs beside the thermometer."""
    return [f"previous.{channel}" for channel in model.held]


def build_integer_onnx(model: IntegerModel, *, observe: bool = False) -> bytes:
    """Return the ONNX file of an integer model; the same model gives the same bytes.

    Args:
        model: proven beforehand.
        observe: also give every node's value at every step, as `node:NAME`.
    """
    model.prove()
    w = OnnxWriter()
    fields = list_state(model)
    shapes: dict[str, Shape] = {name: ("B", *shape) for name, shape in fields.items()}
    codes = w.op("Cast", "codes", to=TensorProto.INT64)
    started = _write_start(w, model, codes, shapes)
    columns, outputs = model.columns, len(model.outputs)
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
        after, values, drift, flags = _write_step(w, model, state, slices[0], shapes)
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
        [(codes, ("B", columns))],
        [(kind, shape) for _, kind, shape in collected],
    )
    ends = [f"{name}.next" for name in fields]
    for value, name in zip(results, [*ends, *(name for name, _, _ in collected)], strict=True):
        w.rename(value, name)
    graph = helper.make_graph(
        w.nodes,
        "zerodrift_integer",
        [
            helper.make_tensor_value_info("codes", code_type, ("T", "B", columns)),
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
    w: OnnxWriter,
    model: IntegerModel,
    state: Mapping[str, str],
    given: str,
    shapes: Mapping[str, Shape],
) -> tuple[dict[str, str], dict[str, str], str, str]:
    """Write one step; return the next state, all nodes' values, drift [B, K] and flags [B].

    The last reading stands for one that is missing; a new state waits for the first of all.
    """
    codes, time = split_time(w, model, given)
    codes = _write_conversions(w, model, codes)
    span = write_span(w, state, time)
    new = w.op("Equal", state["steps"], w.constant(0))
    if not model.optional:
        begun = _write_begin(w, model, state, codes, new, shapes)
        return _write_advance(w, model, begun, codes, span)
    with w.label("readings"):
        missing = _write_missing(w, model, codes)
        no_reading = _write_any(w, missing)
        held = w.op("Where", missing, _write_last(w, model, state, codes), codes)
        waits = w.op("And", new, no_reading)
        begins = w.op("And", new, w.op("Not", no_reading))
    begun = _write_begin(w, model, state, held, begins, shapes)
    after, values, drift, flags = _write_advance(w, model, begun, held, span)
    with w.label("waiting"):
        after = {
            name: _write_where(w, waits, state[name], after[name], shapes[name]) for name in shapes
        }
        blank = w.constant(0)
        wide = w.op("Unsqueeze", waits, w.constant([1]))
        values = {
            node.name: w.op("Where", wide if node.width else waits, blank, values[node.name])
            for node in model.nodes
        }
        drift = w.op("Where", wide, blank, drift)
        started = w.op("Where", waits, _write_start_flag(w, model, state), flags)
        return after, values, drift, w.add(started, w.flag(no_reading, FLAG_NO_READING))


def _write_conversions(w: OnnxWriter, model: IntegerModel, given: str) -> str:
    """Write the channels' codes [B, C] of what the chip is given [B, C]."""
    if not model.conversions:
        return given
    columns = [w.column(given, index) for index in range(len(model.channels))]
    for index in order_conversions(model.channels):
        by = model.channels[index].conversion
        assert by is not None
        cold = "" if by.junction is None else columns[by.junction.channel]
        with w.label(by.name):
            columns[index] = by.write(w, columns[index], cold)
    return w.stack(columns)


def _write_missing(w: OnnxWriter, model: IntegerModel, codes: str) -> str:
    """Write where codes [B, C] mean that there is no reading."""
    optional = np.array([channel.no_reading is not None for channel in model.channels])
    equal = w.op("Equal", codes, w.constant([c.no_reading or 0 for c in model.channels]))
    if optional.all():
        return equal
    return w.op("And", equal, w.op("Cast", w.constant(optional), to=TensorProto.BOOL))


def _write_any(w: OnnxWriter, conditions: str) -> str:
    """Write whether any of the conditions [B, n] of a row holds."""
    most = w.op("ReduceMax", w.flag(conditions), axes=[1], keepdims=0)
    return w.op("Equal", most, w.constant(1))


def _write_last(w: OnnxWriter, model: IntegerModel, state: Mapping[str, str], codes: str) -> str:
    """Write the last readings [B, C]; the present code where none is kept."""
    kept = {model.guards.temperature_channel: state["previous"]}
    kept |= {i: state[f] for i, f in zip(model.held, _name_held(model), strict=True)}
    columns = range(len(model.channels))
    return w.stack([kept[i] if i in kept else w.column(codes, i) for i in columns])


def _write_begin(
    w: OnnxWriter,
    model: IntegerModel,
    state: Mapping[str, str],
    codes: str,
    begins: str,
    shapes: Mapping[str, Shape],
) -> dict[str, str]:
    """Write the state, at rest at `codes` in the rows that begin (the network cold)."""
    if_any = w.op("ReduceMax", w.flag(begins), keepdims=0)

    def rest() -> list[str]:
        rested = _write_rest(w, model, codes, list(shapes), settled=False)
        pairs = zip(shapes, rested, strict=True)
        return [_write_where(w, begins, value, state[name], shapes[name]) for name, value in pairs]

    found = w.either(
        w.op("Equal", if_any, w.constant(1)),
        rest,
        lambda: [state[name] for name in shapes],
        list(shapes.values()),
    )
    return dict(zip(shapes, found, strict=True))


def _write_where(w: OnnxWriter, rows: str, a: str, b: str, shape: Shape) -> str:
    """Write a [B, ...] in the rows [B] where a condition holds, b in the others."""
    for axis in range(1, len(shape)):
        rows = w.op("Unsqueeze", rows, w.constant([axis]))
    return w.op("Where", rows, a, b)


def _write_start_flag(w: OnnxWriter, model: IntegerModel, state: Mapping[str, str]) -> str:
    steps = w.constant(model.guards.warm_up_steps)
    return w.flag(w.op("Less", state["steps"], steps), FLAG_WARMING_UP)


def _write_advance(
    w: OnnxWriter, model: IntegerModel, state: Mapping[str, str], codes: str, span: str
) -> tuple[dict[str, str], dict[str, str], str, str]:
    """Write what a step makes of readings: state, all nodes' values, drift [B, K], flags [B]."""
    values = {CODES: codes, ELAPSED: span}
    if model.feeds_back:
        values[PREVIOUS_DRIFT] = state[LAST_DRIFT]
    after: dict[str, str] = {}
    for node in model.nodes[:-1]:
        with w.label(node.name):
            own = _fields_of(node.name, state)
            fields, values[node.name] = node.write_step(w, values, own)
            after.update({f"{node.name}.{key}": name for key, name in fields.items()})
    last, guards = model.drift, model.guards
    with w.label(last.name):
        unlimited = last.write_sum(w, values)
        drift = w.saturate(unlimited, last.low, last.high)
        values[last.name] = drift
    with w.label("guards"):
        temperature = w.column(codes, guards.temperature_channel)
        moved = w.op("Abs", w.sub(temperature, state["previous"]))
        differs = w.flag(w.op("Not", w.op("Equal", unlimited, drift)))
        clamped = w.op("ReduceMax", differs, axes=[1], keepdims=0)
        flags = [
            _write_start_flag(w, model, state),
            w.flag(
                w.op(
                    "Or",
                    w.op("Less", temperature, w.constant(guards.temperature_low)),
                    w.op("Greater", temperature, w.constant(guards.temperature_high)),
                ),
                FLAG_TEMPERATURE_RANGE,
            ),
            w.flag(write_rate(w, model, moved, span), FLAG_RATE_RANGE),
            w.mul(clamped, w.constant(FLAG_CLAMPED)),
        ]
        flags += _write_input_range(w, model, codes)
        total = flags[0]
        for flag in flags[1:]:
            total = w.add(total, flag)
        full = w.constant(max(guards.warm_up_steps, 1))
        after["steps"] = w.minimum(w.add(state["steps"], w.constant(1)), full)
        after["previous"] = temperature
        for channel, name in zip(model.held, _name_held(model), strict=True):
            after[name] = w.column(codes, channel)
        if model.variable_step:
            after[SLEPT] = w.zeros(codes, 1)
        if model.feeds_back:
            after[LAST_DRIFT] = drift
    if model.tare:
        after[TARE], drift, total = write_count_from(
            w, state[TARE], drift, total, clamped, len(model.outputs)
        )
    return after, values, drift, total


def _write_input_range(w: OnnxWriter, model: IntegerModel, codes: str) -> list[str]:
    """Write the flag of inputs beyond their range, where there are such."""
    beyond = []
    for channel, low, high in model.guards.ranges:
        code = w.column(codes, channel)
        beyond += [
            w.op("Less", code, w.constant(low)),
            w.op("Greater", code, w.constant(high)),
        ]
    if not beyond:
        return []
    total = beyond[0]
    for condition in beyond[1:]:
        total = w.op("Or", total, condition)
    return [w.flag(total, FLAG_INPUT_RANGE)]


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
    """Write the state before the first step: the one given, at rest at codes[0], or a new one."""

    def restart() -> list[str]:
        given = split_time(w, model, w.op("Gather", codes, w.constant(0), axis=0))[0]
        first = _write_conversions(w, model, given)
        settled = w.flag(w.op("Equal", "start", w.constant(START_SETTLED)))
        if model.optional:
            missing = w.flag(_write_any(w, _write_missing(w, model, first)))
            settled = w.mul(settled, w.sub(w.constant(1), missing))
        rested = _write_rest(w, model, first, list(shapes), settled=True)
        rows = w.op(
            "Equal", w.add(w.mul(w.column(first, 0), w.constant(0)), settled), w.constant(1)
        )
        return [
            _write_where(w, rows, value, w.constant(0), shape)
            for value, shape in zip(rested, shapes.values(), strict=True)
        ]

    goes_on = w.op("Equal", "start", w.constant(START_GO_ON))
    return w.either(goes_on, lambda: list(shapes), restart, list(shapes.values()))


def _write_rest(
    w: OnnxWriter, model: IntegerModel, first: str, fields: Sequence[str], *, settled: bool
) -> list[str]:
    """Write the state at rest at codes `first` [B, C], the network too if `settled`."""
    zero = w.mul(w.column(first, 0), w.constant(0))
    full = max(model.guards.warm_up_steps, 1)
    state = {
        "steps": w.add(zero, w.constant(full if settled else 0)),
        "previous": w.column(first, model.guards.temperature_channel),
    }
    for channel, name in zip(model.held, _name_held(model), strict=True):
        state[name] = w.column(first, channel)
    if model.variable_step:
        state[SLEPT] = w.zeros(first, 1)
    if model.tare:
        state[TARE] = w.zeros(first, 2 * len(model.outputs) + 1)
    if not model.feeds_back:
        state |= _write_nodes_at_rest(w, model, {CODES: first}, settled)[0]
        return [state[name] for name in fields]
    drift = w.zeros(first, len(model.outputs))
    for _ in range(START_PASSES):
        drift = _write_nodes_at_rest(w, model, {CODES: first, PREVIOUS_DRIFT: drift}, settled)[1]
    values = {CODES: first, PREVIOUS_DRIFT: drift}
    state |= _write_nodes_at_rest(w, model, values, settled)[0]
    state[LAST_DRIFT] = drift
    return [state[name] for name in fields]


def _write_nodes_at_rest(
    w: OnnxWriter, model: IntegerModel, given: Mapping[str, str], settled: bool
) -> tuple[dict[str, str], str]:
    """Write all nodes' states at rest; return them, and the drift there where it is needed."""
    values, state = dict(given), {}
    if model.variable_step:
        values[ELAPSED] = w.mul(w.column(given[CODES], 0), w.constant(0))
    needed = _needed_at_rest(model)
    stacked = sum(layer.streams for layer in model.recurrents) > 1
    resting = dict(values) if stacked else values  # what settles stands on what is settled
    for node in model.nodes:
        with w.label(node.name):
            own = (node.write_settle if settled else node.write_rest)(w, resting)
            state.update({f"{node.name}.{key}": name for key, name in own.items()})
            if stacked and node.name in needed:
                resting[node.name] = node.write_at_rest(w, resting, own)
            if node.name in needed and (model.feeds_back or not stacked):
                _, values[node.name] = node.write_step(w, values, own)
    return state, values.get(model.drift.name, "")


def _needed_at_rest(model: IntegerModel) -> set[str]:
    """Return the names of the nodes whose values some state at rest is made from."""
    if model.feeds_back:
        return {node.name for node in model.nodes}
    nodes = {node.name: node for node in model.nodes}
    stack = [name for n in model.nodes if n.stateful for name in n.inputs]
    needed: set[str] = set()
    while stack:
        name = stack.pop()
        if name not in needed:
            needed.add(name)
            stack.extend(nodes[name].inputs)
    return needed
