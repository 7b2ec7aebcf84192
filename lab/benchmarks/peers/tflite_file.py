"""A .tflite file of one LSTM, as TensorFlow Lite's converter lays it out.

Fields are named by their numbers in the tables of TensorFlow's schema.fbs, version 3.
"""

from collections.abc import Sequence

import flatbuffers
import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_kernels import HIDDEN, INPUTS
from benchmarks.peers.lstm_16x8 import INPUT_SCALE, STATE_SCALE, Lstm16x8

_VERSION, _IDENTIFIER = 3, b"TFL3"
_UNIDIRECTIONAL_SEQUENCE_LSTM, _LSTM_OPTIONS, _TANH = 44, 71, 4
_TYPES = {"int8": 9, "int16": 7, "int64": 4}
_CELL_CLIP = 10.0
"""What the converter writes for a Keras LSTM."""
_ABSENT = -1
"""Peepholes, projections, layer normalization."""
_INPUTS = (0, *range(1, 9), *[_ABSENT] * 3, *range(9, 13), *[_ABSENT] * 2, 13, 14, *[_ABSENT] * 4)
"""The operator's 24 inputs by number of tensor: x, four w_x, four w_h, four biases, h, c."""
_OUTPUT = 15


class _File:
    """Tables of a file, written from its end to its beginning."""

    def __init__(self) -> None:
        self.builder = flatbuffers.Builder(8192)
        self.buffers = [self.table()]  # the first one is empty, and stands for none
        self.tensors: list[int] = []

    def table(self, **fields: int | float | bool) -> int:
        """Write a table from values by kind and number, such as `i32_2=1`; "at" refers."""
        numbers = [(name.split("_")[0], int(name.split("_")[1]), v) for name, v in fields.items()]
        b = self.builder
        put = {
            "at": b.PrependUOffsetTRelativeSlot,
            "bool": b.PrependBoolSlot,
            "i8": b.PrependInt8Slot,
            "u8": b.PrependUint8Slot,
            "i32": b.PrependInt32Slot,
            "u32": b.PrependUint32Slot,
            "f32": b.PrependFloat32Slot,
        }
        b.StartObject(max((n for _, n, _ in numbers), default=-1) + 1)
        for kind, n, value in numbers:
            put[kind](n, value, 0)
        return int(b.EndObject())

    def tables(self, places: Sequence[int]) -> int:
        """Write a vector of tables."""
        self.builder.StartVector(4, len(places), 4)
        for place in reversed(places):
            self.builder.PrependUOffsetTRelative(place)
        return int(self.builder.EndVector())

    def numbers(self, kind: str, values: Sequence[float]) -> int:
        """Write a vector of numbers."""
        return int(self.builder.CreateNumpyVector(np.array(values, dtype=kind)))

    def add_tensor(
        self, kind: str, shape: Sequence[int], scale: float, values: NDArray[np.generic] | None
    ) -> None:
        """Add a tensor; without values it is computed."""
        buffer = 0
        if values is not None:
            buffer = len(self.buffers)
            raw = values.astype(np.dtype(kind).newbyteorder("<")).tobytes()
            self.builder.StartVector(1, len(raw), 16)  # the runtime reads them where they lie
            self.builder.head -= len(raw)
            self.builder.Bytes[self.builder.head : self.builder.head + len(raw)] = raw
            self.buffers.append(self.table(at_0=int(self.builder.EndVector())))
        state = values is None and len(shape) == 2
        quantization = self.table(at_2=self.numbers("<f4", [scale]), at_3=self.numbers("<i8", [0]))
        place = self.numbers("<i4", shape)
        self.tensors.append(
            self.table(at_0=place, i8_1=_TYPES[kind], u32_2=buffer, at_4=quantization, bool_5=state)
        )


def write_tflite(lstm: Lstm16x8) -> bytes:
    """Return a file whose graph is the LSTM: one step of int16 inputs in, the states out."""
    file = _File()
    file.add_tensor("int16", (1, 1, INPUTS), INPUT_SCALE, None)
    for gate in lstm.gates:
        file.add_tensor("int8", gate.w_x.shape, gate.scale_x, gate.w_x)
    for gate in lstm.gates:
        file.add_tensor("int8", gate.w_h.shape, gate.scale_h, gate.w_h)
    for gate in lstm.gates:
        file.add_tensor("int64", gate.bias.shape, INPUT_SCALE * gate.scale_x, gate.bias)
    file.add_tensor("int16", (1, HIDDEN), STATE_SCALE, None)
    file.add_tensor("int16", (1, HIDDEN), 2.0**lstm.power, None)
    file.add_tensor("int16", (1, 1, HIDDEN), STATE_SCALE, None)
    options = file.table(i8_0=_TANH, f32_1=_CELL_CLIP)
    outputs = file.numbers("<i4", [_OUTPUT])
    operator = file.table(
        at_1=file.numbers("<i4", _INPUTS), at_2=outputs, u8_3=_LSTM_OPTIONS, at_4=options
    )
    code = _UNIDIRECTIONAL_SEQUENCE_LSTM
    graph = file.table(
        at_0=file.tables(file.tensors),
        at_1=file.numbers("<i4", [0]),
        at_2=outputs,
        at_3=file.tables([operator]),
    )
    model = file.table(
        u32_0=_VERSION,
        at_1=file.tables([file.table(i8_0=code, i32_2=1, i32_3=code)]),
        at_2=file.tables([graph]),
        at_4=file.tables(file.buffers),
    )
    file.builder.Finish(model, _IDENTIFIER)
    return bytes(file.builder.Output())
