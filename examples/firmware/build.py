"""Builds the application for QEMU's mps2-an386: `python examples/firmware/build.py SENSOR_DIR`.

Takes the model that `zerodrift firmware` has left in SENSOR_DIR, writes the DBC file, lets cantools
make the CAN encoder from it, and links everything into build/flash/NAME.elf and NAME.bin.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
from elftools.elf.elffile import ELFFile
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift.c_runtime.compilers import WARNINGS
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.application import render_application, render_dbc
from zerodrift.codegen.generate import generate
from zerodrift.codegen.identifiers import sanitize_prefix
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.verify.vectors import draw_sequences

HERE = Path(__file__).parent
CORE = "cortex-m4"
SOURCES = ("startup.c", "board_mps2.c", "tmp117.c")


def build_image(
    model: IntegerModel,
    codes: CodeArray,
    raw: NDArray[np.int32],
    folder: Path,
) -> Path:
    """Write all sources into `folder`, build them, and return the ELF; a BIN lies beside it.

    Args:
        model: the integer model.
        codes: [T, C] what the simulated board's inputs read.
        raw: [T, K] what its sensor measures, in counts.
        folder: is made.

    Raises:
        InputError: there is no compiler for a Cortex-M4, or cantools is missing.
        CheckError: something does not compile.
    """
    folder.mkdir(parents=True, exist_ok=True)
    prefix = sanitize_prefix(model.name)
    write_sources(generate(model), folder)
    write_can(model, folder)
    (folder / "main.c").write_text(render_application(model), encoding="utf-8")
    (folder / "samples.h").write_text(render_samples(model, codes, raw), encoding="utf-8")
    compilers = find_cross_compilers(CORE)
    if not compilers:
        raise InputError("no compiler for a Cortex-M4: `pip install ziglang`, or `make setup-qemu`")
    own = [str(HERE / name) for name in SOURCES]
    made = [str(folder / f"{name}.c") for name in ("main", prefix, f"{prefix}_can", "zd_runtime")]
    elf = folder / f"{prefix}.elf"
    # zig brings its own routines and leaves them out with -nostdlib; gcc's are in libgcc
    library = ["-nostdlib", "-lgcc"] if compilers[0].name == "gcc" else []
    compilers[0].run(
        [*WARNINGS, "-O2", "-g", "-ffreestanding", "-ffunction-sections", "-fdata-sections",
         f"-I{folder}", f"-I{HERE}", f"-I{HERE / 'freestanding'}", *own, *made,
         "-T", str(HERE / "mps2.ld"), "-Wl,--gc-sections", *library, "-o", str(elf)]
    )  # fmt: skip
    elf.with_suffix(".bin").write_bytes(read_flash(elf))
    return elf


def write_can(model: IntegerModel, folder: Path) -> None:
    """Write NAME.dbc and, made from it by cantools, NAME_can.h and NAME_can.c."""
    prefix = sanitize_prefix(model.name)
    (folder / f"{prefix}.dbc").write_text(render_dbc(model), encoding="ascii")
    command = [sys.executable, "-m", "cantools", "generate_c_source", f"{prefix}.dbc"]
    command += ["--database-name", f"{prefix}_can", "--no-floating-point-numbers"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InputError(
            f"cantools made no C from {prefix}.dbc; is it installed (`pip install cantools`)?\n"
            f"{done.stderr[-2000:]}"
        )


def render_samples(model: IntegerModel, codes: CodeArray, raw: NDArray[np.int32]) -> str:
    """Return the simulated board's inputs as a C header."""
    lines = [f"#define SAMPLES {len(codes)}u"]
    lines += [f"#define SAMPLE_THERMOMETER {model.guards.temperature_channel}u"]
    for kind, name, values in ((f"{codes.dtype.name}_t", "codes", codes), ("int32_t", "raw", raw)):
        rows = ",\n".join("    {" + ", ".join(str(int(v)) for v in row) + "}" for row in values)
        shape = f"[{values.shape[0]}][{values.shape[1]}]"
        lines.append(f"static const {kind} sample_{name}{shape} = {{\n{rows}}};")
    return "\n".join(lines) + "\n"


def read_flash(elf: Path) -> bytes:
    """Return the bytes to flash from address 0 on."""
    with elf.open("rb") as file:
        parts = [
            (s["p_paddr"], s.data())
            for s in ELFFile(file).iter_segments()
            if s["p_type"] == "PT_LOAD" and s["p_filesz"]
        ]
    image = bytearray(max(at + len(data) for at, data in parts))
    for at, data in parts:
        image[at : at + len(data)] = data
    return bytes(image)


def main() -> None:
    """Build for the sensor directory on the command line."""
    directory = Path(sys.argv[1]) if len(sys.argv) == 2 else HERE.parent / "ft40"
    model = load_model(directory / "build" / "model.json")
    codes = draw_sequences(model, 1000)["walk"]
    rng = np.random.default_rng(1)
    raw = rng.integers(-(10**6), 10**6, size=(len(codes), len(model.outputs))).astype(np.int32)
    elf = build_image(model, codes, raw, directory / "build" / "flash")
    print(f"{elf}\n{elf.with_suffix('.bin')}: {elf.with_suffix('.bin').stat().st_size} bytes")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"flash-image: {error}")
