"""TensorFlow Lite Micro's LSTM: int16 inputs and states, int8 weights, run by its interpreter.

Its library is linked as its own makefile built it, `BUILD_TYPE=release`: for the chip (target
`cortex_m_generic`, `cortex-m4`) and for this host.
"""

import platform
from pathlib import Path

import numpy as np

from benchmarks.bench_kernels import HIDDEN, INPUTS
from benchmarks.peers.c_text import write_array
from benchmarks.peers.chip import Program
from benchmarks.peers.layers import Task
from benchmarks.peers.lstm_16x8 import decode, encode, quantize_16x8
from benchmarks.peers.tflite_file import write_tflite

NEEDED = "tensorflow/lite/micro/micro_interpreter.h"
_DOWNLOADS = "tensorflow/lite/micro/tools/make/downloads"
_HEADERS = ("flatbuffers/include/flatbuffers/flatbuffers.h", "gemmlowp/fixedpoint/fixedpoint.h")
_LIBRARY = "lib/libtensorflow-microlite.a"
_HOSTS = {"Linux": "linux", "Darwin": "osx"}
_FLAGS = (
    *("-std=c++17", "-fno-rtti", "-fno-exceptions", "-fno-threadsafe-statics"),
    *("-DTF_LITE_STATIC_MEMORY", "-DNDEBUG", "-DTF_LITE_STRIP_ERROR_STRINGS"),
)
"""Of the makefile's release build; the first three shape what its headers declare."""
_ARENA_BYTES = 16384
_MAIN = """#include <new>
#include <string.h>
#include "tensorflow/lite/micro/micro_interpreter.h"
#include "tensorflow/lite/micro/micro_mutable_op_resolver.h"
alignas(16) {model}
extern "C" {{
int16_t peer_in[{inputs}];
int16_t peer_out[{hidden}];
uint32_t peer_withheld;
void peer_step(void);
}}
alignas(16) static uint8_t arena[{arena}];
using Resolver = tflite::MicroMutableOpResolver<1>;
using Interpreter = tflite::MicroInterpreter;
alignas(Resolver) static uint8_t resolver_at[sizeof(Resolver)];
alignas(Interpreter) static uint8_t interpreter_at[sizeof(Interpreter)];
static Interpreter *interpreter;
static void check(bool good) {{ if (!good) {{ __builtin_trap(); }} }}
static void build() {{
    Resolver *resolver = new (resolver_at) Resolver;
    check(resolver->AddUnidirectionalSequenceLSTM() == kTfLiteOk);
    interpreter = new (interpreter_at)
        Interpreter(tflite::GetModel(model), *resolver, arena, sizeof arena - peer_withheld);
    check(interpreter->AllocateTensors() == kTfLiteOk);
}}
void peer_step(void) {{
    if (interpreter == nullptr) {{ build(); }}
    memcpy(interpreter->input(0)->data.raw, peer_in, sizeof peer_in);
    check(interpreter->Invoke() == kTfLiteOk);
    memcpy(peer_out, interpreter->output(0)->data.raw, sizeof peer_out);
}}
"""


def list_libraries(place: Path, kernels: str) -> tuple[Path, Path]:
    """Return where the makefile puts the libraries for the chip and for this host.

    Args:
        place: the checkout.
        kernels: "" for TFLM's own, or the makefile's name of others.
    """
    system = platform.system()
    host = f"{_HOSTS.get(system, system)}_{platform.machine()}"
    builds = (
        "_".join(filter(None, (target, "release", kernels, "gcc")))
        for target in ("cortex_m_generic_cortex-m4", host)
    )
    chip, ours = (place / "gen" / build / _LIBRARY for build in builds)
    return chip, ours


def find_lack(place: Path) -> str:
    """Return what a checkout lacks to be run, "" if nothing."""
    needed = [place / _DOWNLOADS / header for header in _HEADERS]
    needed += list_libraries(place, "")
    missing = [str(path.relative_to(place)) for path in needed if not path.is_file()]
    if not missing:
        return ""
    return f"is not built by its makefile for chip and host (release), there is no {missing[0]}"


def write_tflm(task: Task, place: Path, kernels: str = "") -> Program:
    """Return the LSTM as a .tflite file, and what has the interpreter run it step by step."""
    model = write_tflite(quantize_16x8(task))
    text = _MAIN.format(
        model=write_array("unsigned char", "model", np.frombuffer(model, dtype=np.uint8)),
        inputs=INPUTS,
        hidden=HIDDEN,
        arena=_ARENA_BYTES,
    )
    folders = [place, *(place / _DOWNLOADS / name for name in ("flatbuffers/include", "gemmlowp"))]
    chip, host = list_libraries(place, kernels)
    flags = (*_FLAGS, *(f"-I{folder}" for folder in folders))
    return Program(
        text,
        (),
        flags,
        encode,
        decode,
        "i2",
        main="main.cc",
        chip_libraries=(chip,),
        host_libraries=(host,),
        arena_bytes=_ARENA_BYTES,
    )
