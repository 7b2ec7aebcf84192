"""NNoM's GRU and LSTM: int8 inputs and weights, a power of two for each matrix, int16 states.

The formats are those that its converter (scripts/nnom.py) chooses, from the largest weight and from
the values of a float run, with one exception: before an activation a value is limited to 8, which
its tables cover, where the converter takes a wider format and the tables' index wraps around.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_kernels import HIDDEN, INPUTS
from benchmarks.peers.c_text import write_array
from benchmarks.peers.chip import Program
from benchmarks.peers.layers import LARGEST, Array, Task
from zerodrift.operations.gru.cell import FloatGru

NEEDED = "src/layers/nnom_gru_cell.c"
_TABLE_BITS = 4
"""Fractional bits of +-8 in 8 bits."""
_MAIN = """#include "nnom.h"
#include "layers/nnom_{kind}_cell.h"
{arrays}
int8_t peer_in[{inputs}];
int16_t peer_out[{hidden}];
static int16_t states[2][{carried}], scratch[{scratch}];
static int8_t shown[{hidden}];
static nnom_qformat_param_t q_x = {q_x}, q_w_x = {q_w_x}, q_w_h = {q_w_h}, q_bias = {q_bias};
static nnom_tensor_t x = {{.q_dec = &q_x}};
static nnom_tensor_t weights_x = {{.p_data = (void *)w_x, .q_dec = &q_w_x}};
static nnom_tensor_t weights_h = {{.p_data = (void *)w_h, .q_dec = &q_w_h}};
static nnom_tensor_t biases = {{.p_data = (void *)bias, .q_dec = &q_bias}};
static nnom_mem_block_t block = {{.blk = scratch}};
static nnom_buf_t buffer = {{.mem = &block}};
static nnom_layer_io_t in = {{.tensor = &x}};
static nnom_layer_t layer = {{.in = &in, .comp = &buffer}};
static nnom_{kind}_cell_t cell = {{
    .super = {{.layer = &layer, .in_data = peer_in, .out_data = shown, .units = {hidden},
              .feature_size = {inputs}}},
    .weights = &weights_x, .recurrent_weights = &weights_h, .bias = &biases, {formats}}};
static uint8_t turn, built;
void peer_step(void) {{
    if (!built) {{ (void){build}(&cell.super); built = 1; }}
    cell.super.in_state = states[turn];
    cell.super.out_state = states[1 - turn];
    (void){run}(&cell.super);
    turn = 1 - turn;
    memcpy(peer_out, states[turn], sizeof peer_out);
}}
"""
_FUNCTIONS = {
    "gru": ("gru_cell_build", "gru_cell_run"),
    "lstm": ("lstm_cell_q7_q15_build", "lstm_cell_q7_q15_run"),
}


def write_nnom(task: Task, place: Path) -> Program:
    """Return the layer by NNoM's cell, without its model and its heap."""
    cell = task.cell
    if isinstance(cell, FloatGru):  # gates z, r, n; z keeps
        order, signs = [1, 0, 2], np.array([-1.0, 1.0, 1.0])
        inside = np.zeros((3, HIDDEN))
        inside[2] = cell.bias[3]
        bias = np.stack([signs[:, None] * cell.bias[order], inside])
    else:
        order, signs = [0, 1, 2, 3], np.ones(4)
        bias = cell.bias
    w_x, q_w_x = _round(signs[:, None, None] * cell.w_x[order])
    w_h, q_w_h = _round(signs[:, None, None] * cell.w_h[order])
    q_x = 7 - int(np.ceil(np.log2(LARGEST)))
    q_bias = min(_choose_bits(bias), q_x + q_w_x)
    arrays = "".join(
        write_array("int8_t", name, values)
        for name, values in (
            ("w_x", order_weights(w_x.reshape(-1, INPUTS))),
            ("w_h", order_weights(w_h.reshape(-1, HIDDEN))),
            ("bias", _limit(bias * 2.0**q_bias)),
        )
    )
    formats = f".q_dec_h = 7, .q_dec_z = {_TABLE_BITS}"
    if task.kind == "lstm":
        formats += f", .q_dec_c = {7 - int(np.ceil(np.log2(task.largest_carry)))}"
    build, run = _FUNCTIONS[task.kind]
    text = _MAIN.format(
        kind=task.kind,
        arrays=arrays,
        inputs=INPUTS,
        hidden=HIDDEN,
        carried=HIDDEN * (2 if task.kind == "lstm" else 1),
        scratch=HIDDEN * (12 if task.kind == "lstm" else 9) + INPUTS,
        q_x=q_x,
        q_w_x=q_w_x,
        q_w_h=q_w_h,
        q_bias=q_bias,
        formats=formats,
        build=build,
        run=run,
    )
    sources = [place / f"src/layers/nnom_{task.kind}_cell.c"]
    sources += [place / f"src/backends/nnom_local{part}.c" for part in ("", "_q15")]

    def encode(x: Array) -> NDArray[np.generic]:
        return _limit(x * 2.0**q_x)

    def decode(out: NDArray[np.generic]) -> Array:
        return out.astype(np.float64) * 2.0**-15

    flags = (f"-I{place / 'inc'}", f"-I{place / 'port'}")
    return Program(text, tuple(sources), flags, encode, decode, "i2")


def _choose_bits(values: Array) -> int:
    """Return the fractional bits of int8, as `find_dec_bits_max_min` does."""
    return 7 - int(np.ceil(np.log2(np.abs(values).max() * (1.0 - 2.0**-8))))


def _limit(values: Array) -> NDArray[np.int8]:
    return np.clip(np.round(values), -128, 127).astype(np.int8)


def _round(weights: Array) -> tuple[NDArray[np.int8], int]:
    bits = _choose_bits(weights)
    return _limit(weights * 2.0**bits), bits


def order_weights(rows: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return rows [4 n, 2 m] in the order in which the kernel reads them: two columns of four."""
    four = rows.reshape(rows.shape[0] // 4, 2, 2, rows.shape[1] // 2, 2)  # [n, pair, row, m, col]
    return np.ascontiguousarray(four.transpose(0, 3, 1, 4, 2)).ravel()
