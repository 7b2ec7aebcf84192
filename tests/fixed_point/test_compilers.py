"""The same bits from every compiler, at every optimisation, and nothing undefined on the way."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.c_runtime.compilers import Compiler, find_compilers
from zerodrift.c_runtime.host import HostModel, write_sources
from zerodrift.codegen.generate import generate
from zerodrift.export.reference import Reference
from zerodrift.verify.host_check import check_host

pytestmark = pytest.mark.long

SHAPES = {
    "everything": Shape(
        front_end=("lowpass", "product", "delay", "difference", "power"), hidden=9, gain=20.0
    ),
    "int8 before": Shape(weights="int8", reset="before", hidden=13, inputs=3, gain=20.0),
    "window int8": Shape(weights="int8", window=5, hidden=6, inputs=2),
}
COMPILERS = find_compilers()
MAIN = """
#include <stdio.h>
#include <stdlib.h>
int main(int count, char **arguments) {
    const uint32_t steps = (count == 4) ? (uint32_t)atoi(arguments[3]) : 0u;
    const size_t values = (size_t)steps * CHANNELS;
    int16_t *codes = malloc(values * sizeof *codes);
    int32_t *drift = malloc((size_t)steps * OUTPUTS * sizeof *drift);
    uint32_t *flags = malloc((size_t)steps * sizeof *flags);
    void *state = malloc(zd_state_size());
    FILE *in = fopen(arguments[1], "rb");
    FILE *out = fopen(arguments[2], "wb");
    if (fread(codes, sizeof *codes, values, in) != values || zd_selftest() != 0u) {
        return 2;
    }
    zd_start(state, codes, 0);
    zd_run(state, codes, steps, drift, flags, NULL);
    fwrite(drift, sizeof *drift, (size_t)steps * OUTPUTS, out);
    fwrite(flags, sizeof *flags, steps, out);
    free(codes), free(drift), free(flags), free(state);
    return fclose(in) + fclose(out);
}
"""


def name_of(compiler: Compiler) -> str:
    return compiler.name


@pytest.mark.parametrize("flags", [("-O0",), ("-Os",), ("-O3",), ("-O2", "-DZD_LANES=2u")])
@pytest.mark.parametrize("compiler", COMPILERS, ids=name_of)
def test_bits_do_not_depend_on_the_compiler(
    compiler: Compiler, flags: tuple[str, ...], tmp_path: Path
) -> None:
    shape = SHAPES["everything"]
    model = draw_model(shape, 21)
    host = HostModel(model, generate(model), tmp_path, compiler, flags)
    codes = Draw(1).codes(-32768, 32767, 3000, shape.inputs)
    assert check_host(host, codes, settled=False).mismatch is None
    assert host.selftest() == 0


def sanitizers_of(compiler: Compiler) -> str:
    """Return the sanitizers that link: zig brings the one for undefined behaviour only."""
    return "undefined" if compiler.name == "zig" else "address,undefined"


def build_sanitized(compiler: Compiler, source: Path, program: Path) -> None:
    compiler.run(
        ["-std=c99", "-O1", f"-fsanitize={sanitizers_of(compiler)}",
         "-fno-sanitize-recover=all", f"-I{source.parent}", str(source), "-o", str(program)]
    )  # fmt: skip


@pytest.mark.parametrize(
    "shape", ["everything", *(pytest.param(name, marks=pytest.mark.slow) for name in [*SHAPES][1:])]
)
@pytest.mark.parametrize("compiler", COMPILERS, ids=name_of)
def test_sanitizers_find_nothing_at_the_rails(
    compiler: Compiler, shape: str, tmp_path: Path
) -> None:
    model = draw_model(SHAPES[shape], 22)
    code = generate(model)
    write_sources(code, tmp_path)
    (tmp_path / f"{code.prefix}_harness.c").write_text(code.harness)
    main = tmp_path / "main.c"
    main.write_text(
        f'#include "{code.prefix}_harness.c"\n#include "zd_runtime.c"\n'
        f"#define CHANNELS {len(model.channels)}u\n#define OUTPUTS {len(model.outputs)}u\n{MAIN}"
    )
    build_sanitized(compiler, main, tmp_path / "main")
    draw = Draw(2)
    rails = np.where(draw.uniform(0, 1, 800, len(model.channels)) < 0.5, -32768, 32767)
    codes = np.concatenate([rails, draw.codes(-32768, 32767, 800, len(model.channels))])
    codes = codes.astype(np.int16)
    (tmp_path / "codes").write_bytes(codes.tobytes())
    done = subprocess.run(
        [str(tmp_path / "main"), str(tmp_path / "codes"), str(tmp_path / "out"), str(len(codes))],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    expected = Reference(model).run(codes[None], settled=False)
    found = (tmp_path / "out").read_bytes()
    assert found == expected.drift[0].tobytes() + expected.flags[0].tobytes()


@pytest.mark.parametrize("compiler", COMPILERS, ids=name_of)
def test_sanitizer_would_find_an_overflow(compiler: Compiler, tmp_path: Path) -> None:
    """Guards the test above against sanitizers that are switched off."""
    source = tmp_path / "overflow.c"
    source.write_text(
        "#include <stdint.h>\nint main(int n, char **a) {\n"
        "    (void)a;\n    volatile int32_t x = INT32_MAX;\n    x = x + n;\n    return 0;\n}\n"
    )
    build_sanitized(compiler, source, tmp_path / "overflow")
    assert subprocess.run([str(tmp_path / "overflow")], capture_output=True, check=False).returncode


def test_two_builds_in_one_folder_are_both_used(tmp_path: Path) -> None:
    """The loader knows a library by its name: a second build must not be taken for the first."""
    model = draw_model(SHAPES["int8 before"], 23)
    code = generate(model)
    HostModel(model, code, tmp_path, flags=("-O1",)).run(np.zeros((5, 3), dtype=np.int16))
    bad = type(code)(
        code.prefix,
        code.header,
        code.source.replace("drift[0] = (int32_t)limited;", "drift[0] = 7;"),
        code.harness,
    )
    trace = HostModel(model, bad, tmp_path, flags=("-O1",)).run(np.zeros((5, 3), dtype=np.int16))
    assert (trace.drift[:, 0] == 7).all()
