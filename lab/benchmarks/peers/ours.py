"""The layer as zerodrift generates it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_kernels import HIDDEN, OUTPUTS, draw_fast_float
from benchmarks.peers.chip import Program
from benchmarks.peers.layers import Array, Task
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import generate
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.quantize import choose_feature_exponents, quantize

_MAIN = """#include "{prefix}.c"
#include "zd_runtime.c"
int16_t peer_in[4];
int32_t peer_out[16];
int32_t peer_cell[16];
void peer_step(void);
void peer_step(void) {{ {call}; }}
"""
CALLS = {
    "gru": "gru_step(peer_in, peer_out, -1)",
    "lstm": "lstm_step(peer_in, peer_out, peer_cell, 0u)",
}


def write_ours(task: Task, weights: str, folder: Path) -> Program:
    """Return the layer of a generated model with weights "int16" or "int8"."""
    drawn, head = draw_fast_float(), np.ones((OUTPUTS, HIDDEN))
    network = FloatNetwork.stack((task.cell,), head, np.zeros(OUTPUTS))
    model = replace(drawn.model, network=network)
    code = generate(quantize(model, drawn.calibration, weights))
    write_sources(code, folder)
    exponent = int(choose_feature_exponents(drawn.calibration).min())

    def encode(x: Array) -> NDArray[np.generic]:
        return np.round(x * 2.0**exponent).astype("<i2")

    def decode(out: NDArray[np.generic]) -> Array:
        return out.astype(np.float64) * 2.0**-30

    text = _MAIN.format(prefix=code.prefix, call=CALLS[task.kind])
    return Program(text, (), (f"-I{folder}",), encode, decode, "i4", keeps_in_out=True)
