"""The effect of the recurrent operators of a float ONNX graph on the reader's values."""

from dataclasses import replace

import numpy as np
import onnx

from zerodrift.export.onnx_shapes import Attributes, pick_array
from zerodrift.export.onnx_values import (
    Axis,
    Constant,
    Dims,
    Fill,
    OnnxSignal,
    OnnxSource,
    RawInput,
    Refused,
    Unsupported,
    Value,
    bind,
)
from zerodrift.operations.gru import onnx as gru_onnx
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.lstm import onnx as lstm_onnx
from zerodrift.operations.lstm.cell import FloatLstm


def gru(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """GRU: a new source of signals, its states."""
    values = values + [None] * (6 - len(values))
    w, r = pick_array(values[1], "W"), pick_array(values[2], "R")
    b = None if values[3] is None else pick_array(values[3], "B")
    try:
        layer = gru_onnx.from_onnx_gates(attributes, w, r, b)
    except ValueError as error:
        raise Unsupported(str(error)) from error
    return list(_add_layer(node, attributes, values, layer))


def lstm(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """LSTM: a new source of signals, its outputs h; c may not be used elsewhere."""
    values = values + [None] * (8 - len(values))
    w, r = pick_array(values[1], "W"), pick_array(values[2], "R")
    b, p = (
        None if v is None else pick_array(v, n) for v, n in ((values[3], "B"), (values[7], "P"))
    )
    try:
        layer = lstm_onnx.from_onnx_gates(attributes, w, r, b, p)
    except ValueError as error:
        raise Unsupported(str(error)) from error
    cell = Refused(
        f"LSTM '{node.name or ', '.join(node.output)}': its cell state Y_c is read by another node;"
        " only its outputs Y and Y_h may be"
    )
    return [*_add_layer(node, attributes, values, layer), cell]


def _add_layer(
    node: onnx.NodeProto,
    attributes: Attributes,
    values: list[Value],
    layer: FloatGru | FloatLstm,
) -> tuple[OnnxSignal, OnnxSignal]:
    """Return all outputs and the last one of a recurrent layer over X."""
    data, layout = values[0], attributes.get("layout", 0)
    inputs = layer.w_x.shape[2]
    if isinstance(data, RawInput):
        data = bind(data, inputs, 2) if len(data.axes) == 3 else data
    if not isinstance(data, OnnxSignal) or len(data.axes) != 3:
        raise Unsupported("its input X is not data of three axes")
    if data.last and not data.of_one:
        raise Unsupported("its input is the last sample of another layer; expected all of them")
    time, batch = data.axes[layout], data.axes[1 - layout]
    if data.axes[2].role != "feature" or data.matrix.shape[0] != inputs:
        raise Unsupported(f"it reads {inputs} values that are not the features")
    time.take_role("time")
    batch.take_role("batch")
    _check_lengths(values[4], time)
    outside = layer.bias.copy()
    outside[: len(layer.w_x)] += layer.w_x @ data.bias
    layer = replace(layer, w_x=layer.w_x @ data.matrix, bias=outside)
    hidden = layer.w_h.shape[1]
    source = OnnxSource(hidden, data.source, layer, node.name or node.op_type, time)
    one, feature = Axis(1, "one"), Axis(hidden, "feature")
    axes = (batch, time, one, feature) if layout else (time, one, batch, feature)
    states = OnnxSignal(source, axes, np.eye(hidden), np.zeros(hidden))
    end = (batch, one, feature) if layout else (one, batch, feature)
    return states, replace(states, axes=end, last=True)


def _check_lengths(lengths: Value, time: Axis) -> None:
    """Refuse lengths of sequences that are not all of the sequence."""
    if lengths is None:
        return
    if isinstance(lengths, Constant):
        found = {int(n) for n in lengths.array.ravel()}
    elif isinstance(lengths, Fill):
        found = {int(lengths.value)}
    elif isinstance(lengths, Dims) and all(e is time for e in lengths.entries):
        return
    else:
        raise Unsupported(
            "it is given lengths of sequences (sequence_lens) that are computed, or an input; the"
            " firmware has one sequence that does not end. Export it without"
        )
    if time.size is None:
        raise Unsupported(
            f"it is given sequence_lens of {sorted(found)}, and the file does not state the length"
            " of the sequence. Export it without sequence_lens, or with a fixed length"
        )
    if found != {time.size}:
        raise Unsupported(
            f"it is given sequence_lens of {sorted(found)} for sequences of {time.size} samples;"
            " only all of them can be. Export it without sequence_lens"
        )
