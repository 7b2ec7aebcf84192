"""The C in real builds: warnings are errors on every core, mixed sets refused, links."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from tests.golden.model_factory import Shape, draw_model
from tests.golden.vectors import load

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import RUNTIME_FILES, WARNINGS, Compiler, find_compilers
from zerodrift.c_runtime.cores import CORES, GCC_CORES, find_cross_compilers
from zerodrift.c_runtime.host import render_sources, write_sources
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel

PHYSICS = Shape(hidden=0, front_end=("lowpass", "product", "delay", "root"), outputs=2)
NETWORK = Shape(hidden=5, inputs=3, outputs=2, front_end=("lowpass", "exp2"))
BEFORE = Shape(weights="int8", reset="before", hidden=5, inputs=3)
SHAPES = {"physics": PHYSICS, "network": NETWORK, "before": BEFORE}
CROSS = [
    pytest.param(core, compiler, id=f"{core} {compiler.name}")
    for core in dict.fromkeys((*CORES, *GCC_CORES))
    for compiler in find_cross_compilers(core)
]
MAIN = """
#include <stdint.h>
{includes}
int main(void) {{ return (int)({calls}); }}
"""


def write_model(
    shape: Shape, folder: Path, name: str = "golden", seed: int = 5, prefix: str = ""
) -> IntegerModel:
    """Write a model's C into a folder of its own and return it."""
    model = replace(draw_model(shape, seed), name=name, prefix=prefix)
    folder.mkdir(exist_ok=True)
    write_sources(generate(model), folder)
    return model


@pytest.mark.parametrize("size", [pytest.param("-O2", marks=pytest.mark.slow), "-Os"])
@pytest.mark.spread(4, ("core", "compiler"), CROSS)
def test_every_warning_is_an_error_on_every_core(
    core: str, compiler: Compiler, size: str, tmp_path: Path
) -> None:
    sources = [tmp_path / "zd_runtime.c"]
    for name, shape in SHAPES.items():
        sources.append(tmp_path / f"{write_model(shape, tmp_path, name).name}.c")
    for source in sources:
        target = ["-ffreestanding", "-c", str(source), "-o", str(tmp_path / "object.o")]
        compiler.run([*WARNINGS, size, *target])


@pytest.mark.skipif(not shutil.which("avr-gcc"), reason="needs avr-gcc: `make setup-qemu`")
def test_every_warning_is_an_error_on_an_8_bit_core(tmp_path: Path) -> None:
    compiler = Compiler("avr-gcc", ("avr-gcc", "-mmcu=atmega328p"))
    write_model(PHYSICS, tmp_path)
    for source in tmp_path.glob("*.c"):
        compiler.run([*WARNINGS, "-Os", "-c", str(source), "-o", str(tmp_path / "object.o")])


def list_undefined(compiler: Compiler, flags: tuple[str, ...], sources: list[Path]) -> list[str]:
    """Compile and link sources as they are told; return what the linker says."""
    main = sources[0].parent / "main.elf"
    try:
        compiler.run([*flags, *map(str, sources), "-o", str(main)])
    except CheckError as error:
        return [str(error)]
    return []


@pytest.mark.parametrize("call", ["golden_step(&s, &in, drift)", "golden_selftest()"])
@pytest.mark.parametrize("core", ["cortex-m0plus", "cortex-m4", "cortex-m33"])
@pytest.mark.parametrize("size", ["-O2", pytest.param("-Os", marks=pytest.mark.slow)])
def test_links_with_link_time_optimisation(core: str, call: str, size: str, tmp_path: Path) -> None:
    """Tables that only the assembly names must be there, with and without the self-test."""
    found = [c for c in find_cross_compilers(core) if c.name == "gcc"]
    if not found:
        pytest.skip("needs the GNU cross-compilers: `make setup-qemu`")
    write_model(NETWORK, tmp_path)
    main = tmp_path / "main.c"
    main.write_text(
        '#include "golden.h"\ngolden_state_t s;\ngolden_input_t in;\n'
        f"int32_t drift[GOLDEN_OUTPUTS];\nint main(void) {{ return (int){call}; }}\n"
    )
    flags = (size, "-flto", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections")
    sources = [main, tmp_path / "golden.c", tmp_path / "zd_runtime.c"]
    assert list_undefined(found[0], (*flags, "--specs=nosys.specs"), sources) == []


@pytest.mark.spread(1, "compiler", find_compilers(), ids=lambda compiler: compiler.name)
def test_two_designs_link_into_one_firmware(compiler: Compiler, tmp_path: Path) -> None:
    """Each with the runtime that lies beside it."""
    names = ("first", "second", "third")
    for name, shape, seed in zip(names, (NETWORK, PHYSICS, NETWORK), (1, 2, 3), strict=True):
        write_model(shape, tmp_path / name, name, seed)
    main = tmp_path / "main.c"
    includes = "\n".join(f'#include "{name}/{name}.h"' for name in names)
    calls = " | ".join(f"{name}_selftest()" for name in names)
    main.write_text(MAIN.format(includes=includes, calls=calls))
    sources = sorted(tmp_path.glob("*/*.c"))
    assert len(sources) == 6
    compiler.run([*WARNINGS, "-O1", str(main), *map(str, sources), "-o", f"{tmp_path}/main"])
    assert subprocess.run([f"{tmp_path}/main"], check=False).returncode == 0


@pytest.mark.spread(1, "compiler", find_compilers(), ids=lambda compiler: compiler.name)
def test_two_units_of_a_design_with_prefixes_link(compiler: Compiler, tmp_path: Path) -> None:
    """In one folder with one runtime; without prefixes they have the same names."""
    for unit, seed in (("Left arm", 1), ("right-arm", 2)):
        write_model(NETWORK, tmp_path, "design", seed, unit)
    main = tmp_path / "main.c"
    includes = '#include "left_arm.h"\n#include "right_arm.h"'
    main.write_text(
        MAIN.format(includes=includes, calls="left_arm_selftest() | right_arm_selftest()")
    )
    sources = [str(tmp_path / f"{name}.c") for name in ("left_arm", "right_arm", "zd_runtime")]
    compiler.run([*WARNINGS, "-O1", str(main), *sources, "-o", f"{tmp_path}/main"])
    assert subprocess.run([f"{tmp_path}/main"], check=False).returncode == 0


@pytest.mark.long
def test_two_versions_of_the_runtime_link_into_one_firmware(tmp_path: Path) -> None:
    """Neither takes the other's functions and tables, though they have the same names in the C."""
    for name in ("old", "young"):
        write_model(NETWORK, tmp_path / name, name)
    identity = (tmp_path / "old" / "zd_runtime.h").read_text().split("ZD_RUNTIME_ID 0x")[1][:8]
    for path in (tmp_path / "old").iterdir():
        path.write_text(path.read_text().replace(identity, "01d01d01"))
    table = tmp_path / "old" / "zd_tanh_table.h"
    table.write_text(table.read_text().replace("67584", "67585"))  # its own self-test notices
    main = tmp_path / "main.c"
    includes = '#include "old/old.h"\n#include "young/young.h"'
    main.write_text(MAIN.format(includes=includes, calls="old_selftest() + 8u * young_selftest()"))
    sources = [str(p) for p in (main, *sorted(tmp_path.glob("*/*.c")))]
    find_compilers()[0].run([*WARNINGS, "-O2", *sources, "-o", f"{tmp_path}/main"])
    assert subprocess.run([f"{tmp_path}/main"], check=False).returncode == 2


@pytest.mark.spread(3, "name", ["golden.h", "golden.c", *(path.name for path in RUNTIME_FILES)])
def test_a_file_of_another_set_does_not_compile(name: str, tmp_path: Path) -> None:
    """As after a copy that was interrupted: one file is still the old one."""
    code = generate(draw_model(NETWORK, 5))
    every = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    texts = {**every, **render_sources(code)}
    if name in (
        "zd_lstm.h",
        "zd_lstm_rows.h",
        "zd_layer_norm.h",
    ):  # read by models with such a layer alone
        texts["golden.c"] += f'#include "{name.replace("_rows", "")}"\n'
    if name.startswith("golden"):
        other = render_sources(generate(draw_model(NETWORK, 6)))[name]
    else:
        identity = texts["zd_runtime.h"].split("ZD_RUNTIME_ID 0x")[1][:8]
        other = texts[name].replace(identity, "01d01d01")
    assert other != texts[name]
    for which, text in {**texts, name: other}.items():
        (tmp_path / which).write_text(text)
    builds = ((), ("-mavx2",), ("-DZD_KERNEL=1",))
    said = [
        text
        for flags in builds
        for source in ("golden.c", "zd_runtime.c")
        for text in list_undefined(
            find_compilers()[0], ("-c", "-DZD_SMALL" if flags[1:] else "-O1", *flags),
            [tmp_path / source],
        )
    ]  # fmt: skip
    if name in ("zd_gru_rows.h", "zd_lstm_rows.h"):  # read for MVE alone
        found = find_cross_compilers("cortex-m55")
        if not found:
            pytest.skip("needs the GNU cross-compilers: `make setup-qemu`")
        said = list_undefined(found[0], ("-c", "-O2"), [tmp_path / "golden.c"])
    assert any("copy all files again" in text for text in said)


def test_a_model_without_a_network_holds_no_table_of_one(tmp_path: Path) -> None:
    write_model(PHYSICS, tmp_path)
    text = (tmp_path / "golden.c").read_text()
    assert "zd_network.h" not in text and "zd_exp2.h" not in text
    compiler = find_compilers()[0]
    target = tmp_path / "object.o"
    compiler.run(["-O0", "-c", str(tmp_path / "golden.c"), "-o", str(target)])
    assert b"zd_tanh" not in target.read_bytes() and b"zd_exp2" not in target.read_bytes()
    assert "zd_exp2.h" in generate(load("effects").model).source
