"""CMSIS-NN's LSTM: int16 inputs and states, int8 weights with a scale for each matrix."""

from pathlib import Path

import numpy as np

from benchmarks.bench_kernels import HIDDEN, INPUTS
from benchmarks.peers.c_text import split_scale, write_array
from benchmarks.peers.chip import Program
from benchmarks.peers.layers import Task
from benchmarks.peers.lstm_16x8 import INPUT_SCALE, STATE_SCALE, decode, encode, quantize_16x8

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
    lstm = quantize_16x8(task)
    arrays = write_array("int64_t", "no_bias", np.zeros(HIDDEN, dtype=np.int64))
    gates = ""
    for name, gate in zip(_GATES, lstm.gates, strict=True):
        for kind, what, values in (
            ("int8_t", "w_x", gate.w_x),
            ("int8_t", "w_h", gate.w_h),
            ("int64_t", "bias", gate.bias),
        ):
            arrays += write_array(kind, f"{name}_{what}", values)
        gates += _GATE.format(
            name=name,
            x=split_scale(INPUT_SCALE * gate.scale_x / _GATE_SCALE),
            h=split_scale(STATE_SCALE * gate.scale_h / _GATE_SCALE),
            bend="ARM_TANH" if name == "cell" else "ARM_SIGMOID",
        )
    text = _MAIN.format(
        arrays=arrays,
        gates=gates,
        inputs=INPUTS,
        hidden=HIDDEN,
        forget=split_scale(2.0**-15),
        cell=split_scale(2.0**-30 / 2.0**lstm.power),
        power=lstm.power,
    )
    sources = sorted(
        path
        for folder in _SOURCES
        for path in (place / "Source" / folder).glob("*.c")
        if not path.stem.endswith(("_f16", "_f32"))
    )
    return Program(text, tuple(sources), (f"-I{place / 'Include'}",), encode, decode, "i2")
