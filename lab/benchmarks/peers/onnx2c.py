"""onnx2c's LSTM: float C made from an ONNX file."""

import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from benchmarks.bench_kernels import HIDDEN, INPUTS
from benchmarks.peers.chip import Program
from benchmarks.peers.layers import Array, Task
from zerodrift.base.errors import CheckError
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.operations.lstm.onnx import to_onnx_gates

NEEDED = "src/nodes/lstm.cc"
_MAIN = """#include "net.c"
#include <string.h>
float peer_in[{inputs}];
float peer_out[{hidden}];
static float h[1][1][{hidden}], c[1][1][{hidden}], h_after[1][1][{hidden}], c_after[1][1][{hidden}];
void peer_step(void) {{
    entry((const float (*)[1][{inputs}])peer_in, h, c, h_after, c_after);
    memcpy(h, h_after, sizeof h);
    memcpy(c, c_after, sizeof c);
    memcpy(peer_out, h, sizeof h);
}}
"""


def find_generator(place: Path) -> Path | None:
    """Return the built program in a checkout, None where it is not built."""
    found = sorted(p for p in place.glob("*/onnx2c") if p.is_file())
    return found[0] if found else None


def write_onnx2c(task: Task, place: Path, folder: Path) -> Program:
    """Return the LSTM as onnx2c writes it from a graph of one step.

    Raises:
        CheckError: onnx2c refused the file.
    """
    generator = find_generator(place)
    assert generator is not None and isinstance(task.cell, FloatLstm)
    (folder / "net.onnx").write_bytes(_write_step(task.cell))
    done = subprocess.run([generator, folder / "net.onnx"], capture_output=True, check=False)
    if done.returncode:
        raise CheckError(f"onnx2c: {done.stderr.decode(errors='replace')[-500:]}")
    (folder / "net.c").write_bytes(done.stdout)

    def encode(x: Array) -> NDArray[np.generic]:
        return x.astype("<f4")

    def decode(out: NDArray[np.generic]) -> Array:
        return out.astype(np.float64)

    text = _MAIN.format(inputs=INPUTS, hidden=HIDDEN)
    return Program(text, (), (f"-I{folder}",), encode, decode, "f4")


def _write_step(lstm: FloatLstm) -> bytes:
    """Return a graph of one step whose states are inputs and outputs."""
    tensors = [
        numpy_helper.from_array(a[None].astype(np.float32), n)
        for n, a in zip("WRB", to_onnx_gates(lstm), strict=True)
    ]
    node = helper.make_node(
        "LSTM",
        ["x", "W", "R", "B", "", "h", "c"],
        ["", "h_after", "c_after"],
        hidden_size=HIDDEN,
    )
    shapes = {"x": INPUTS, "h": HIDDEN, "c": HIDDEN, "h_after": HIDDEN, "c_after": HIDDEN}
    values = [
        helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, 1, size])
        for n, size in shapes.items()
    ]
    graph = helper.make_graph([node], "step", values[:3], values[3:], tensors)
    opsets = [helper.make_opsetid("", 13)]
    return bytes(helper.make_model(graph, opset_imports=opsets, ir_version=8).SerializeToString())
