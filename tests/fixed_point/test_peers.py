"""The benchmark that runs other libraries' layers beside zerodrift's."""

from pathlib import Path
from shutil import which

import flatbuffers
import numpy as np
import pytest
from benchmarks.bench_kernels import HIDDEN, INPUTS
from benchmarks.peers.__main__ import PEERS, has_kind, try_peer
from benchmarks.peers.c_text import split_scale
from benchmarks.peers.chip import CORE, Program, measure
from benchmarks.peers.layers import Task, draw_task
from benchmarks.peers.lstm_16x8 import INPUT_SCALE, Lstm16x8, decode, encode, quantize_16x8
from benchmarks.peers.nnom import order_weights
from benchmarks.peers.ours import write_ours
from benchmarks.peers.tflite_file import write_tflite
from benchmarks.peers.tflm import list_libraries
from numpy.typing import NDArray

from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.operations.lstm.cell import FloatLstm

HAS_GCC = any(c.name == "gcc" for c in find_cross_compilers(CORE))


@pytest.mark.skipif(not HAS_GCC, reason="no arm-none-eabi-gcc")
@pytest.mark.spread(0, "kind", ["gru", "lstm"])
def test_own_layer_is_measured_and_the_same_on_both(kind: str, tmp_path: Path) -> None:
    task = draw_task(kind, 0)
    task = Task(kind, task.cell, task.x[:200])
    found = measure(task, write_ours(task, "int16", tmp_path), tmp_path)
    assert (found.different, found.numbers) == (0, 200 * 16)
    assert found.error_pct < 0.2  # a wrong format would be far off
    macs = {"gru": 3, "lstm": 4}[kind] * 16 * (16 + 4)
    assert macs < found.instructions < 1.5 * macs
    assert found.ram_bytes == {"gru": 64, "lstm": 128}[kind]
    assert found.flash_bytes > 2 * macs


@pytest.mark.parametrize("scale", [1.0, 2.0**-15, 0.75, 1.0 - 2.0**-40, 3.3e-5])
def test_scale_is_split_as_the_kernels_read_it(scale: float) -> None:
    multiplier, shift = split_scale(scale)
    assert 2**30 <= multiplier < 2**31
    assert multiplier * 2.0 ** (shift - 31) == pytest.approx(scale, rel=2.0**-30)


def test_weights_are_read_by_the_kernel_as_rows() -> None:
    """The kernel takes two columns of four rows at a time: 1, 2 of column 1, of column 2, 3, 4."""
    rows = np.arange(8 * 6, dtype=np.int8).reshape(8, 6)
    order, found = iter(order_weights(rows).tolist()), np.zeros_like(rows)
    for first in range(0, 8, 4):
        for column in range(0, 6, 2):
            for pair in (first, first + 2):
                for c in (column, column + 1):
                    found[pair, c], found[pair + 1, c] = next(order), next(order)
    assert (found == rows).all()


def test_library_without_the_layer_or_without_sources_is_said_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    peer = next(p for p in PEERS if p.name == "CMSIS-NN")
    tasks = [draw_task("gru", 0)]
    try_peer(peer, None, tasks)
    assert "left out: no --cmsis-nn" in capsys.readouterr().out
    try_peer(peer, tmp_path, tasks)
    assert f"left out: {tmp_path} is no checkout of it" in capsys.readouterr().out
    (tmp_path / peer.needed).parent.mkdir(parents=True)
    (tmp_path / peer.needed).write_text("")
    try_peer(peer, tmp_path, tasks)
    assert "has none (of no known version)" in capsys.readouterr().out
    assert has_kind(peer, tmp_path, "lstm")


_ECHO = """
#include <stdint.h>
extern "C" {
int16_t peer_in[4], peer_out[16];
uint32_t peer_withheld;
int16_t told(void);
void peer_step(void);
}
static volatile uint8_t arena[1000];
void peer_step(void) {
    arena[0] = 1;
    if (peer_withheld > 900) { __builtin_trap(); }
    if (peer_withheld > 700) { peer_in[0]++; }
    for (int k = 0; k < 16; k++) { peer_out[k] = peer_in[0]; }
    peer_out[3] += told();
}
"""


@pytest.mark.skipif(not (HAS_GCC and which("g++")), reason="no arm-none-eabi-gcc, or no g++")
def test_program_in_cpp_is_linked_with_what_was_built_for_chip_and_for_host(tmp_path: Path) -> None:
    task = draw_task("lstm", 0)
    task = Task("lstm", task.cell, task.x[:50])
    libraries = []
    for name, value in (("chip", 0), ("host", 1)):
        libraries.append(tmp_path / f"{name}.c")
        libraries[-1].write_text(f"short told(void); short told(void) {{ return {value}; }}")
    chip, host = libraries
    program = Program(
        _ECHO,
        (),
        (),
        encode,
        decode,
        "i2",
        main="main.cc",
        chip_libraries=(chip,),
        host_libraries=(host,),
        arena_bytes=1000,
    )
    found = measure(task, program, tmp_path)
    assert (found.different, found.numbers) == (50, 50 * HIDDEN)  # one of the 16 at every step
    assert 300 <= found.ram_bytes < 320  # of 1000 bytes 700 are spare, in steps of 16


def test_lstm_is_rounded_to_the_nearest_counts() -> None:
    task = draw_task("lstm", 1)
    cell, lstm = task.cell, quantize_16x8(task)
    assert isinstance(cell, FloatLstm)
    for k, gate in enumerate(lstm.gates):
        for counts, scale, weights in (
            (gate.w_x, gate.scale_x, cell.w_x[k]),
            (gate.w_h, gate.scale_h, cell.w_h[k]),
            (gate.bias, INPUT_SCALE * gate.scale_x, cell.bias[k]),
        ):
            assert np.abs(counts * scale - weights).max() <= (0.5 + 1e-9) * scale
        assert np.abs(gate.w_x).max() == np.abs(gate.w_h).max() == 127
    assert 2.0 ** (lstm.power + 14) < task.largest_carry <= 2.0 ** (lstm.power + 15)


class _Table:
    """A table of a file of flatbuffers, read by the numbers of its fields."""

    def __init__(self, data: bytes, place: int) -> None:
        self.data = data
        self.table = flatbuffers.table.Table(bytearray(data), place)

    def at(self, field: int) -> int:
        offset = int(self.table.Offset(4 + 2 * field))
        return offset and offset + int(self.table.Pos)

    def number(self, field: int, kind: str) -> float:
        place = self.at(field)
        if not place:
            return 0
        return np.frombuffer(self.data, kind, 1, place)[0].item()

    def child(self, field: int) -> "_Table":
        return _Table(self.data, int(self.table.Indirect(self.at(field))))

    def children(self, field: int) -> list["_Table"]:
        offset = int(self.table.Offset(4 + 2 * field))
        first = int(self.table.Vector(offset))
        places = range(first, first + 4 * int(self.table.VectorLen(offset)), 4)
        return [_Table(self.data, int(self.table.Indirect(place))) for place in places]

    def numbers(self, field: int, kind: str) -> NDArray[np.generic]:
        offset = int(self.table.Offset(4 + 2 * field))
        if not offset:
            return np.zeros(0, dtype=kind)
        first = int(self.table.Vector(offset))
        return np.frombuffer(self.data, kind, int(self.table.VectorLen(offset)), first)


def _write_lstm() -> tuple[Lstm16x8, _Table]:
    lstm = quantize_16x8(draw_task("lstm", 0))
    data = write_tflite(lstm)
    assert data[4:8] == b"TFL3"
    return lstm, _Table(data, int.from_bytes(data[:4], "little"))


def test_tflite_file_is_one_lstm_of_24_inputs() -> None:
    _, model = _write_lstm()
    assert model.number(0, "<u4") == 3
    (code,), (graph,) = model.children(1), model.children(2)
    assert (code.number(0, "i1"), code.number(3, "<i4")) == (44, 44)  # of schema.fbs
    (operator,) = graph.children(3)
    states, absent = [13, 14], -1
    inputs = [0, *range(1, 9), *[absent] * 3, *range(9, 13), *[absent] * 2, *states, *[absent] * 4]
    assert operator.numbers(1, "<i4").tolist() == inputs
    assert operator.numbers(2, "<i4").tolist() == graph.numbers(2, "<i4").tolist() == [15]
    assert operator.number(3, "u1") == 71
    options = operator.child(4)
    assert (options.number(0, "i1"), options.number(1, "<f4")) == (4, 10.0)
    tensors = graph.children(0)
    assert [k for k, tensor in enumerate(tensors) if tensor.number(5, "?")] == states
    shapes = [tensor.numbers(0, "<i4").tolist() for tensor in (tensors[0], *tensors[13:])]
    assert shapes == [[1, 1, INPUTS], [1, HIDDEN], [1, HIDDEN], [1, 1, HIDDEN]]


def test_tflite_file_holds_the_integers_and_their_scales() -> None:
    lstm, model = _write_lstm()
    buffers, tensors = model.children(4), model.children(2)[0].children(0)
    assert not buffers[0].numbers(0, "u1").size
    bias_scales = [np.float32(INPUT_SCALE * gate.scale_x) for gate in lstm.gates]
    wanted = [
        *((gate.w_x, np.float32(gate.scale_x), 9) for gate in lstm.gates),
        *((gate.w_h, np.float32(gate.scale_h), 9) for gate in lstm.gates),
        *((gate.bias, s, 4) for gate, s in zip(lstm.gates, bias_scales, strict=True)),
    ]
    for tensor, (values, scale, kind) in zip(tensors[1:13], wanted, strict=True):
        assert tensor.number(1, "i1") == kind
        assert tuple(tensor.numbers(0, "<i4")) == values.shape
        buffer = buffers[int(tensor.number(2, "<u4"))]
        raw = buffer.numbers(0, "u1")
        assert raw.tobytes() == values.astype(values.dtype.newbyteorder("<")).tobytes()
        at = int(buffer.table.Vector(buffer.table.Offset(4)))
        assert at % 16 == 0  # the kernel reads int64 there
        assert tensor.child(4).numbers(2, "<f4").tolist() == [scale]
        assert tensor.child(4).numbers(3, "<i8").tolist() == [0]
    scales = [t.child(4).numbers(2, "<f4").item() for t in (tensors[0], *tensors[13:])]
    assert scales == [4.0 * 2.0**-15, 2.0**-15, 2.0**lstm.power, 2.0**-15]


def test_tflm_that_is_not_built_is_said_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    peer = next(p for p in PEERS if p.name == "TFLM")
    downloads = tmp_path / "tensorflow/lite/micro/tools/make/downloads"
    chip, host = list_libraries(tmp_path, "")
    files = [
        tmp_path / peer.needed,
        tmp_path / "tensorflow/lite/micro/kernels/lstm_eval.cc",
        downloads / "flatbuffers/include/flatbuffers/flatbuffers.h",
        downloads / "gemmlowp/fixedpoint/fixedpoint.h",
        chip,
        host,
    ]
    for have, file in enumerate(files):
        try_peer(peer, tmp_path, [draw_task("lstm", 0)])
        said = capsys.readouterr().out
        if have >= 2:
            assert f"{tmp_path} is not built by its makefile for chip and host" in said
            assert f"there is no {file.relative_to(tmp_path)}" in said
        else:
            assert ("is no checkout of it", "has none")[have] in said
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("")
    assert peer.find_lack(tmp_path) == ""
    try_peer(peer, tmp_path, [draw_task("gru", 0)])
    assert "has none" in capsys.readouterr().out


def test_onnx2c_that_is_not_built_is_said_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    peer = next(p for p in PEERS if p.name == "onnx2c")
    (tmp_path / peer.needed).parent.mkdir(parents=True)
    (tmp_path / peer.needed).write_text("")
    try_peer(peer, tmp_path, [draw_task("lstm", 0)])
    assert "is not built, there is no */onnx2c" in capsys.readouterr().out
    (tmp_path / "build").mkdir()
    (tmp_path / "build/onnx2c").write_text("")
    assert peer.find_lack(tmp_path) == ""
