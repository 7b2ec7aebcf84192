"""The smallest model: one output, a cubic in the temperature behind one lag, on a Cortex-M4."""

import tempfile
from pathlib import Path

import numpy as np
from elftools.elf.elffile import ELFFile
from numpy.typing import NDArray

from benchmarks.bench_kernels import draw_temperature
from zerodrift.base.config import EffectConfig
from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.emulator import EmulatedModel
from zerodrift.c_runtime.footprint import FLAGS
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.dataset.runs import Run
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations, evaluate
from zerodrift.operations.operation import list_nodes
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.signals import graph_inputs, name_signals, plan_signals, read_signals
from zerodrift.physics.terms import build_features, start_term

CORE = "cortex-m4"
EFFECTS = (
    EffectConfig("zero_tempco", {"order": 3}),
    EffectConfig("thermal_lag", {"tau_s": 60.0}),
)
OUTPUT, FULL_SCALE_N, DRIFT_N, LSB_DEGC = "Fz", 2000.0, 40.0, 2.0**-7
MOST_INSTRUCTIONS, MOST_BYTES, MOST_BYTES_WITH_ALL = 105, 600, 1229
ALWAYS = ("init", "settle", "step")
FURTHER = ("selftest", "save", "restore")
CLEARS = ("memset", "memcpy", "__aeabi_memclr", "__aeabi_memclr4", "__aeabi_memclr8")
"""Of the C library, which a firmware has; they stay in a section that is not counted."""


def main(quick: bool) -> None:
    """Print instructions of a step and flash beside their marks; `quick` changes nothing."""
    del quick
    model, codes = draw_model(steps=100_000)
    code = generate(model)
    print("one output, a cubic in the temperature behind one lag, simulated, on a Cortex-M4")
    counts = []
    for compiler in find_cross_compilers(CORE):
        for flags in (("-O2",), ("-O3",), ("-Os",)):
            with tempfile.TemporaryDirectory() as scratch:
                chip = EmulatedModel(model, code, CORE, Path(scratch), flags, compiler)
                counts.append(max(chip.count_instructions(codes[:200])))
            print(
                f"  {compiler.name:3} {flags[0]}: {counts[-1]} instructions a step, call included"
            )
    _judge("fewest instructions a step", min(counts), MOST_INSTRUCTIONS)
    for compiler in find_cross_compilers(CORE):
        least = link(code, compiler, ALWAYS)
        every = link(code, compiler, ALWAYS + FURTHER)
        _judge(f"{compiler.name} -Os: bytes of {', '.join(ALWAYS)}", least, MOST_BYTES)
        _judge(f"{compiler.name} -Os: with {', '.join(FURTHER)}", every, MOST_BYTES_WITH_ALL)


def _judge(what: str, found: int, most: int) -> None:
    print(f"  {what}: {found} ({'reached' if found <= most else 'MISSED'}: {most})")


def draw_model(steps: int) -> tuple[IntegerModel, NDArray[np.int16]]:
    """Return the integers of a drawn model, and the raw codes [steps, 1] that it is made for."""
    rng = np.random.default_rng(1)
    degc = draw_temperature(rng, steps)[:, 0] * LSB_DEGC
    run = Run(
        name="bench",
        group="bench",
        part=0,
        source=Path("bench"),
        sample_period_s=1.0,
        time_s=np.arange(steps, dtype=np.float64),
        temperature_degC=degc,
        measured=np.zeros((steps, 1)),
        reference=np.zeros((steps, 1)),
    )
    plan = plan_signals([run], (OUTPUT,), (FULL_SCALE_N,))
    catalogue = load_catalogue()
    terms = [start_term(catalogue, effect) for effect in EFFECTS]
    ops = GraphOperations(1.0)
    features = build_features(ops, name_signals(ops, plan), terms, tuple(catalogue))
    nodes = list_nodes([f.signal for f in features])
    found = evaluate(nodes, graph_inputs(read_signals(run, plan)), 1.0)
    values = dict(zip(nodes, found, strict=True))
    columns = np.stack([values[f.signal] for f in features], axis=1)
    coefficients = rng.uniform(-1.0, 1.0, (len(features), 1)) * DRIFT_N
    coefficients /= np.abs(columns).max(axis=0)[:, None]
    largest = 2.0 * np.abs(columns @ coefficients).max(axis=0)
    codes = np.round(degc / LSB_DEGC)[:, None].astype(np.int16)
    model = FloatModel(
        name="bench",
        sample_period_s=1.0,
        channels=(Channel("temperature", "degC", LSB_DEGC),),
        sources={"temperature_degC": 0},
        outputs=(OutputFormat(OUTPUT, "N", 1000, FULL_SCALE_N),),
        features=tuple(f.signal for f in features),
        coefficients=coefficients,
        offset=np.zeros(1),
        taps=(),
        tap_mean=None,
        whitening=None,
    )
    calibration = Calibration(
        code_limits=((int(codes.min()), int(codes.max())),),
        feature_max=np.zeros(0),
        drift_low=-largest,
        drift_high=largest,
        rate_max=1000,
        warm_up_steps=0,
        ranges={node: (float(v.min()), float(v.max())) for node, v in values.items()},
    )
    return quantize(model, calibration), codes


def link(code: GeneratedCode, compiler: Compiler, entries: tuple[str, ...]) -> int:
    """Return the bytes of code and constants that stay when only `entries` are called.

    Compiled with -Os; what the C library adds is left out.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_sources(code, folder)
        lines = (f'__attribute__((section("others"))) void {n}(void);' for n in CLEARS)
        bodies = (f"void {n}(void) {{}}" for n in CLEARS)
        (folder / "others.c").write_text("\n".join((*lines, *bodies, "")), encoding="utf-8")
        names = (code.source_name, "zd_runtime.c", "others.c")
        sources = [str(folder / name) for name in names]
        wanted = [f"-Wl,-u,{code.prefix}_{entry}" for entry in entries]
        linked = ["-nostdlib", "-fno-builtin", "-Wl,--gc-sections"]
        linked.append(f"-Wl,-e,{code.prefix}_step")
        target = folder / "small.elf"
        compiler.run([*FLAGS, *linked, *wanted, f"-I{folder}", *sources, "-o", str(target)])
        with target.open("rb") as file:
            sections = list(ELFFile(file).iter_sections())
    kept = (s["sh_size"] for s in sections if s.name.startswith((".text", ".rodata", ".data")))
    return sum(kept)


if __name__ == "__main__":
    main(quick=False)
