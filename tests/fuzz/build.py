"""Builds the fuzz targets of the generated C; `python -m tests.fuzz` runs them."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel

HERE = Path(__file__).parent
GOLDEN = HERE.parent / "golden"
TARGETS = {"step": 0, "state": 1, "restore": 2}
MODELS = ("front_end", "windowed", "int8_before", "effects", "no_reading")
"""Filters and a delay; a window; 8-bit weights; a load, a counter and an input of 32 bits; codes
that mean no reading."""
TABLES = {"": (), "_small": ("-DZD_SMALL",)}
"""End of a job's name -> how the table of tanh is chosen, see docs/reference/kernels.md."""
SANITIZERS = "address,undefined"
_PROBE = """int LLVMFuzzerTestOneInput(const unsigned char *data, unsigned long size);
int LLVMFuzzerTestOneInput(const unsigned char *data, unsigned long size) {
    return (data != 0) && (size > 1000000u);
}
"""


def build(
    model: IntegerModel, target: str, compiler: Compiler, folder: Path, extra: tuple[str, ...]
) -> Path:
    """Return the program of one target for one model.

    Args:
        model: the integer model.
        target: one of `TARGETS`.
        compiler: of the host.
        folder: is made; holds sources and program.
        extra: "-fsanitize=..." and what else the compiler is to be told.
    """
    folder.mkdir(parents=True, exist_ok=True)
    code = generate(model)
    write_sources(code, folder)
    (folder / f"{code.prefix}_harness.c").write_text(code.harness, encoding="utf-8")
    limits = [
        ",".join(f"({int(v)})" for v in values) for values in (model.drift.low, model.drift.high)
    ]
    program = folder / f"fuzz_{target}"
    compiler.run(
        ["-std=c99", "-O1", "-g", "-fno-sanitize-recover=all", "-DZD_PLAIN", *extra,
         f"-DTARGET={TARGETS[target]}", f'-DHARNESS="{code.prefix}_harness.c"',
         f"-DMODEL_STATE={code.prefix}_state_t", f"-DMODEL_SAVE={code.prefix}_save",
         f"-DMODEL_RESTORE={code.prefix}_restore", f"-DIDENTITY={code.prefix.upper()}_MODEL_ID",
         f"-DCODE={np.dtype(model.code_type).name}_t",
         f"-DCHANNELS={len(model.channels)}", f"-DOUTPUTS={len(model.outputs)}",
         f"-DLOWEST={{{limits[0]}}}", f"-DHIGHEST={{{limits[1]}}}", f"-I{folder}",
         str(HERE / "fuzz_model.c"), str(folder / "zd_runtime.c"), "-o", str(program)]
    )  # fmt: skip
    return program


def find_clang() -> Compiler | None:
    """Return a clang that links libFuzzer: $FUZZ_CC, clang, or one with a version in its name."""
    names = [os.environ.get("FUZZ_CC"), "clang", *(f"clang-{n}" for n in range(21, 10, -1))]
    for path in filter(None, (shutil.which(name) for name in names if name)):
        with tempfile.TemporaryDirectory() as scratch:
            source = Path(scratch) / "probe.c"
            source.write_text(_PROBE, encoding="ascii")
            probe = [path, f"-fsanitize=fuzzer,{SANITIZERS}", source, "-o", source.with_suffix("")]
            if subprocess.run(probe, capture_output=True, check=False).returncode == 0:
                return Compiler("clang", (path,))
    return None
