"""Instructions of a step on every core, beside the marks to beat and a plain float GRU in C."""

import importlib.util
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from platform import machine

import numpy as np

from benchmarks.bench_kernels import alternate, build_float, draw_fast_model
from zerodrift.c_runtime.compilers import Compiler, find_compilers
from zerodrift.c_runtime.cores import CORES, find_cross_compilers
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.c_runtime.host import HostModel
from zerodrift.c_runtime.qemu import QemuModel, is_available
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.tables import T_MAX, T_MIN, sigmoid_q31, tanh_q30

FLOAT_C = Path(__file__).with_name("float_gru.c")
INPUTS = 4
STEPS = 64
HARD_FLOAT = ("-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")


@dataclass(frozen=True)
class Mark:
    """What was to be reached on one core, in instructions per multiply-accumulate; None if told
    without one."""

    core: str
    flags: tuple[str, ...]
    what: str
    target: float | None = None
    beat: float | None = None
    hidden: int = 16


MARKS = (
    Mark("cortex-m4", ("-O2",), "assembly", 1.20, 1.25),
    Mark("cortex-m4", ("-O2",), "assembly", 0.98, 1.00, hidden=32),
    Mark("cortex-m33", ("-O2",), "assembly", 1.20, 1.25),
    Mark("cortex-m7", ("-O2",), "assembly", 1.20, 1.25),
    Mark("cortex-m4", ("-O2", "-DZD_NO_ASSEMBLY"), "C, intrinsics", 1.60, 1.65),
    Mark("cortex-m55", ("-O2",), "C, MVE", 0.78, 0.79),
    Mark("cortex-m3", ("-O2",), "portable C", 3.9, 3.9),
    Mark("rv32imc", ("-O2",), "portable C", 5.0, 5.0),
    Mark("cortex-m0plus", ("-O2",), "assembly", 7.2, 7.2),
    Mark("cortex-m0plus", ("-O2",), "assembly", hidden=32),
    Mark("cortex-m0plus", ("-O2", "-DZD_NO_ASSEMBLY"), "portable C", 7.2, 7.2),
    Mark("cortex-m4", ("-Os",), "assembly, -Os"),
    Mark("cortex-m0plus", ("-Os",), "assembly, -Os"),
)
FLOAT_HARNESS = """#include <stddef.h>
#include <stdint.h>
int errno_of_libm;
int *__errno(void);
int *__errno(void) {{ return &errno_of_libm; }}
#include "float_gru.c"
static const float weights[{weights}];
static const float bias[{bias}];
static const float head[OUTPUTS * {hidden}];
static const float scale[{inputs}] = {{0.001f, 0.001f, 0.001f, 0.001f}};
static void gru_step(const int16_t *x, int32_t *h_q30, int32_t keep) {{
    static float h[{hidden}];
    float drift[OUTPUTS];
    (void)h_q30;
    (void)keep;
    float_gru_run(weights, bias, head, scale, x, h, drift, 1);
}}
static uint32_t zd_selftest(void) {{ return 0; }}
static void zd_start(void *state, const int16_t *codes, int settled) {{
    (void)state, (void)codes, (void)settled;
}}
static void zd_run(void *state, const int16_t *codes, uint32_t steps, int32_t *drift,
                   uint32_t *flags, int32_t *trace) {{
    (void)state, (void)codes, (void)steps, (void)drift, (void)flags, (void)trace;
}}
"""


def main(quick: bool) -> None:
    """Print every figure; `quick` times the host less often."""
    print_cores()
    print_float_on_boards()
    time_host(rounds=5 if quick else 21)
    print_sizes()
    print_table_errors()


def draw(hidden: int) -> tuple[IntegerModel, GeneratedCode]:
    """Return a model with 4 inputs and 6 outputs, and its C."""
    model = draw_fast_model("int16", hidden)
    return model, generate(model)


def print_cores() -> None:
    """Print instructions of the layer and of the whole step, per compiler."""
    print(
        "instructions of one step: GRU(H), 4 inputs; MACs 3 H (H + 4); per MAC of the GRU's part,"
    )
    print("call and return included; 'step' is the whole one, 6 outputs, checks and flags included")
    print(f"  {'core':13} {'code':14} {'by':4} {'H':>2} {'GRU':>6} {'per MAC':>8} {'step':>6}")
    for mark in MARKS:
        model, code = draw(mark.hidden)
        for name, layer, step in count(mark, model, code):
            per_mac = layer / (3 * mark.hidden * (mark.hidden + INPUTS))
            verdict = ""
            if mark.target is not None:
                outcome = "reached" if per_mac <= mark.target else "MISSED"
                verdict = f"{outcome}: {mark.target:.2f}, mark {mark.beat}"
            print(
                f"  {mark.core:13} {mark.what:14} {name:4} {mark.hidden:2} {layer:6.0f}"
                f" {per_mac:8.3f} {step or '':>6}  {verdict}"
            )


def count(
    mark: Mark, model: IntegerModel, code: GeneratedCode
) -> list[tuple[str, float, int | None]]:
    """Return compiler, instructions of the layer, instructions of the step, by every compiler."""
    codes = np.random.default_rng(4).integers(-20_000, 20_000, size=(STEPS, INPUTS))
    codes = codes.astype(np.int16)
    found: list[tuple[str, float, int | None]] = []
    with tempfile.TemporaryDirectory() as scratch:
        if mark.core in CORES:
            if importlib.util.find_spec("unicorn") is None:
                print("  unicorn is not installed: `pip install unicorn`")
                return found
            from zerodrift.c_runtime.emulator import EmulatedModel

            for compiler in find_cross_compilers(mark.core):
                folder = Path(scratch) / compiler.name
                folder.mkdir()
                chip = EmulatedModel(model, code, mark.core, folder, mark.flags, compiler)
                step = max(chip.count_instructions(codes[:8]))
                found.append((compiler.name, chip.count_layer(codes[0]), step))
        elif is_available(mark.core):
            run = QemuModel(model, code, mark.core, Path(scratch), mark.flags).run(codes)
            found.append(("gcc", run.layer_instructions, None))
        else:
            print(f"  {mark.core}: not measured, `make setup-qemu` brings what it needs")
    return found


def print_float_on_boards() -> None:
    """Print a plain float GRU with libm, what one would write instead, on QEMU's boards."""
    print("the same shape as plain float C with newlib's expf and tanhf, 6 outputs included:")
    for core, flags in (("cortex-m4", HARD_FLOAT), ("cortex-m3", ())):
        if not is_available(core):
            print(f"  {core}: not measured, `make setup-qemu` brings what it needs")
            continue
        model, code = draw(16)
        text = FLOAT_HARNESS.format(weights=16 * 3 * 20, bias=64, hidden=16, inputs=INPUTS)
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            (folder / "float_gru.c").write_text(FLOAT_C.read_text(encoding="utf-8"))
            plain = replace(code, harness=text)
            board = QemuModel(model, plain, core, folder, ("-O2", *flags), ("-lm", "-lc"))
            told = board.run(np.zeros((0, INPUTS), dtype=np.int16)).layer_instructions
        kind = "hardware float" if flags else "software float"
        print(f"  {core:13} {kind}: {told:.0f} instructions, {told / 960:.1f} per MAC")


def time_host(rounds: int) -> None:
    """Print the host's time of a step against plain float C by the same compiler and flags."""
    steps = 20_000
    codes = np.random.default_rng(2).integers(-20_000, 20_000, size=(steps, INPUTS))
    codes = codes.astype(np.int16)
    model, code = draw(16)
    print(
        "host, a whole step of GRU(16) against a plain float GRU with libm, same flags, in turns;"
    )
    print("CPU time, the best of the turns; target 8 times as fast, mark 9 with AVX2")
    avx2 = "avx2" in Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else False
    for compiler in find_compilers():
        plain_flags = list_host_flags(compiler)
        for flags in (plain_flags, (*plain_flags, "-mavx2"))[: 1 + avx2]:
            with tempfile.TemporaryDirectory() as scratch:
                folder = Path(scratch)
                plain = build_float(compiler, folder, codes, flags)
                host = HostModel(model, code, folder / "host", compiler, flags, observe=False)
                seconds = alternate({"float": plain, "own": lambda h=host: h.run(codes)}, rounds)
            own, other = (min(seconds[k]) / steps * 1e9 for k in ("own", "float"))
            print(
                f"  {compiler.name:5} {' '.join(flags):26} {own:5.0f} ns, float {other:5.0f} ns:"
                f" {other / own:.1f} times as fast"
            )


def list_host_flags(compiler: Compiler) -> tuple[str, ...]:
    """Return -O3 for the lowest common x86-64; zig would build for this very processor."""
    if machine() not in ("x86_64", "AMD64"):
        return ("-O3",)
    return ("-O3", "-march=x86_64" if compiler.name == "zig" else "-march=x86-64")


def print_sizes() -> None:
    """Print flash, RAM and stack on a Cortex-M4, of the layer and of everything."""
    _, code = draw(16)
    print("Cortex-M4, GRU(16), 4 inputs, 6 outputs, bytes; layer: its step, weights and activation")
    print("table; target 3.7 KB of flash, 160 B of RAM and stack")
    for what, flags in (("-Os", ()), ("ZD_FAST", ("-DZD_FAST",)), ("-O2", ("-O2",))):
        size = measure_footprint(code, "cortex-m4", flags)
        print(
            f"  {what:8} layer: flash {size.layer_flash_bytes}, RAM 64 + stack"
            f" {size.layer_stack_bytes}; all: flash {size.flash_bytes}, RAM {size.ram_bytes},"
            f" stack {size.stack_bytes}"
        )


def print_table_errors() -> None:
    """Print the worst error of the activations over every input."""
    t = np.arange(T_MIN, T_MAX + 1)
    x = t / 2.0**16
    tanh_lsb = np.abs(tanh_q30(t) / 2.0**30 - np.tanh(x)).max() * 2.0**15
    sigmoid_lsb = np.abs(sigmoid_q31(t) / 2.0**31 - 1.0 / (1.0 + np.exp(-2.0 * x))).max() * 2.0**15
    print(f"activations, all {t.size} inputs: worst error of tanh {tanh_lsb:.2f} LSB of Q0.15,")
    print(f"of the sigmoid {sigmoid_lsb:.2f}; targets 2.1 and 1.1")


if __name__ == "__main__":
    main(False)
