"""CMSIS-NN's LSTM: int16 inputs and states, int8 weights with a scale for each matrix."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_kernels import HIDDEN, INPUTS
from benchmarks.peers.c_text import split_scale, write_array
from benchmarks.peers.chip import Program
from benchmarks.peers.layers import LARGEST, Array, Task
from zerodrift.operations.lstm.cell import FloatLstm

NEEDED = "Source/LSTMFunctions/arm_lstm_unidirectional_s16.c"
_SOURCES = ("LSTMFunctions", "NNSupportFunctions", "BasicMathFunctions", "ActivationFunctions")
_GATES = ("input", "forget", "cell", "output")
"""In the order of `FloatLstm`: i, f, g, o."""
_MAIN = """#include "arm_nnfunctions.h"
#include <string.h>
{arrays}
int16_t peer_in[{inputs}];
int16_t peer_out[{hidden}];
static int16_t gate_1[{hidden}], gate_2[{hidden}], cell_state[{hidden}], hidden_state[{hidden}];
static const cmsis_nn_lstm_params params = {{
    .time_major = 1, .batch_size = 1, .time_steps = 1, .input_size = {inputs},
    .hidden_size = {hidden}, .input_offset = 0,
    .forget_to_cell_multiplier = {forget[0]}, .forget_to_cell_shift = {forget[1]},
    .input_to_cell_multiplier = {cell[0]}, .input_to_cell_shift = {cell[1]},
    .cell_clip = 32767, .cell_scale_power = {power},
    .output_multiplier = {forget[0]}, .output_shift = {forget[1]}, .output_offset = 0,
{gates}}};
void peer_step(void) {{
    cmsis_nn_lstm_context buffers = {{gate_1, gate_2, cell_state, hidden_state}};
    (void)arm_lstm_unidirectional_s16(peer_in, peer_out, &params, &buffers);
}}
"""
_GATE = """    .{name}_gate = {{
        .input_multiplier = {x[0]}, .input_shift = {x[1]}, .input_weights = {name}_w_x,
        .input_effective_bias = {name}_bias, .hidden_multiplier = {h[0]},
        .hidden_shift = {h[1]}, .hidden_weights = {name}_w_h,
        .hidden_effective_bias = no_bias, .bias = 0, .activation_type = {bend}}},
"""
_GATE_SCALE = 2.0**-12
"""Of a gate before its activation, by the library's definition."""


def write_cmsis_nn(task: Task, place: Path) -> Program:
    """Return the LSTM by CMSIS-NN, quantized as TensorFlow Lite's converter does (16x8)."""
    lstm = task.cell
    assert isinstance(lstm, FloatLstm)
    input_scale, state_scale = LARGEST / 2**15, 2.0**-15
    power = int(np.ceil(np.log2(task.largest_carry))) - 15
    arrays = write_array("int64_t", "no_bias", np.zeros(HIDDEN, dtype=np.int64))
    gates = ""
    for k, name in enumerate(_GATES):
        w_x, scale_x = _round_weights(lstm.w_x[k])
        w_h, scale_h = _round_weights(lstm.w_h[k])
        bias = np.round(lstm.bias[k] / (input_scale * scale_x)).astype(np.int64)
        for kind, what, values in (
            ("int8_t", "w_x", w_x),
            ("int8_t", "w_h", w_h),
            ("int64_t", "bias", bias),
        ):
            arrays += write_array(kind, f"{name}_{what}", values)
        gates += _GATE.format(
            name=name,
            x=split_scale(input_scale * scale_x / _GATE_SCALE),
            h=split_scale(state_scale * scale_h / _GATE_SCALE),
            bend="ARM_TANH" if name == "cell" else "ARM_SIGMOID",
        )
    text = _MAIN.format(
        arrays=arrays,
        gates=gates,
        inputs=INPUTS,
        hidden=HIDDEN,
        forget=split_scale(2.0**-15),
        cell=split_scale(2.0**-30 / 2.0**power),
        power=power,
    )
    sources = sorted(
        path
        for folder in _SOURCES
        for path in (place / "Source" / folder).glob("*.c")
        if not path.stem.endswith(("_f16", "_f32"))
    )

    def encode(x: Array) -> NDArray[np.generic]:
        return np.clip(np.round(x / input_scale), -32768, 32767).astype("<i2")

    def decode(out: NDArray[np.generic]) -> Array:
        return out.astype(np.float64) * state_scale

    return Program(text, tuple(sources), (f"-I{place / 'Include'}",), encode, decode, "i2")


def _round_weights(weights: Array) -> tuple[NDArray[np.int8], float]:
    """Return a matrix in 8 bits and what one count is worth."""
    scale = float(np.abs(weights).max()) / 127.0
    return np.round(weights / scale).astype(np.int8), scale
