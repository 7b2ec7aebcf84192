"""Each package is built where its tool can be had; otherwise its metadata is held to the rules."""

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.fixed_point.test_cmake import run
from tests.golden.vectors import load
from tests.verify.conftest import write_firmware

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import RUNTIME_FILES, find_compiler
from zerodrift.cli.main import cli
from zerodrift.cli.package import KINDS
from zerodrift.codegen.generate import generate
from zerodrift.codegen.packages import PACKAGES, render_package

ROOT = Path(__file__).parents[2]
RUNTIME = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
MODEL = load("front_end").model
MAIN = """#include "front_end.h"
int main(void) { return (int)front_end_selftest(); }
"""


@pytest.fixture(params=PACKAGES)
def package(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return write(request.param, tmp_path)


def test_the_command_offers_every_package_that_there_is() -> None:
    assert sorted(KINDS) == sorted(PACKAGES)


def write(kind: str, folder: Path) -> Path:
    place = folder / kind
    for name, text in render_package(kind, MODEL, generate(MODEL), RUNTIME).items():
        path = place / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return place


def configure(source: Path, build: Path, *arguments: str) -> None:
    command = shlex.join(find_compiler().command)
    run("cmake", "-S", source, "-B", build, "-G", "Ninja", *arguments, CC=command)
    run("cmake", "--build", build, "-j", "1")


def test_every_package_is_whole_and_the_same_each_time(package: Path, tmp_path: Path) -> None:
    names = {path.name for path in package.rglob("*")}
    assert {"front_end.h", "front_end.c", *RUNTIME} <= names
    again = write(package.name, tmp_path / "again")
    for path in package.rglob("*"):
        if path.is_file():
            assert (again / path.relative_to(package)).read_bytes() == path.read_bytes()


@pytest.mark.long
def test_command_writes_a_package_and_replaces_it(tmp_path: Path) -> None:
    shutil.copy(ROOT / "examples" / "ft40" / "zerodrift.toml", tmp_path)
    missing = CliRunner().invoke(cli, ["package", "cmake", "-C", str(tmp_path)])
    assert missing.exit_code != 0 and not (tmp_path / "firmware").exists()
    shutil.rmtree(tmp_path)
    write_firmware(tmp_path)
    place = tmp_path / "firmware" / "packages" / "cmake"
    for _ in range(2):
        done = CliRunner().invoke(cli, ["package", "cmake", "-C", str(tmp_path), "--json"])
        assert done.exit_code == 0, done.output
        told = json.loads(done.stdout)
        assert all((tmp_path / name).is_file() for name in told["files"])
        (place / "notes.txt").write_text("of the user")
    manifest = json.loads((place / "manifest.json").read_text())
    manifest["firmware"]["src/of_an_earlier_name.c"] = ""
    (place / "manifest.json").write_text(json.dumps(manifest))
    (place / "src" / "of_an_earlier_name.c").write_text("")
    assert CliRunner().invoke(cli, ["package", "cmake", "-C", str(tmp_path)]).exit_code == 0
    assert not (place / "src" / "of_an_earlier_name.c").exists()
    assert (place / "notes.txt").read_text() == "of the user"
    assert [path.name for path in place.parent.iterdir()] == ["cmake"]


@pytest.mark.long
def test_package_of_spoilt_or_stale_firmware_is_refused(tmp_path: Path) -> None:
    project = write_firmware(tmp_path / "p")
    (project / "logs" / "test.csv").write_text("")
    (project / "firmware" / "zd_runtime.h").write_text("")
    refused = CliRunner().invoke(cli, ["package", "cmake", "-C", str(project)])
    assert isinstance(refused.exception, CheckError)
    told = str(refused.exception)
    assert "zd_runtime.h: was changed" in told and "logs/test.csv: was changed" in told
    assert not (project / "firmware" / "packages").exists()


@pytest.mark.long
def test_cmake_package_is_installed_found_and_passes_its_self_test(tmp_path: Path) -> None:
    source = write("cmake", tmp_path)
    configure(source, tmp_path / "build", f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'installed'}")
    run("cmake", "--install", tmp_path / "build")
    user = tmp_path / "user"
    user.mkdir()
    (user / "main.c").write_text(MAIN)
    (user / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.21)\nproject(user LANGUAGES C)\n"
        "find_package(front_end CONFIG REQUIRED)\nadd_executable(user main.c)\n"
        "target_link_libraries(user PRIVATE front_end::front_end)\n"
    )
    configure(user, tmp_path / "user_build", f"-DCMAKE_PREFIX_PATH={tmp_path / 'installed'}")
    assert subprocess.run([tmp_path / "user_build" / "user"], check=False).returncode == 0


def test_zephyr_module_builds_where_zephyrs_functions_are_stood_in_for(tmp_path: Path) -> None:
    """Zephyr itself is not installed here: its four functions are replaced by what they do."""
    source = write("zephyr", tmp_path)
    user = tmp_path / "user"
    user.mkdir()
    (user / "main.c").write_text(MAIN)
    (user / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.21)\nproject(user LANGUAGES C)\n"
        "set(CONFIG_FRONT_END y)\nset(CONFIG_FRONT_END_SMALL y)\n"
        "macro(zephyr_include_directories)\n  set(zephyr_includes ${ARGV})\nendmacro()\n"
        "macro(zephyr_library_named name)\n  add_library(${name} STATIC)\n"
        "  set(library ${name})\n"
        "  target_include_directories(${name} PUBLIC ${zephyr_includes})\nendmacro()\n"
        "macro(zephyr_library_sources)\n  target_sources(${library} PRIVATE ${ARGV})\nendmacro()\n"
        "macro(zephyr_compile_definitions)\n"
        "  target_compile_definitions(${library} PUBLIC ${ARGV})\nendmacro()\n"
        f'add_subdirectory("{source}" module)\n'
        "add_executable(user main.c)\ntarget_link_libraries(user PRIVATE front_end)\n"
    )
    configure(user, tmp_path / "build")
    assert subprocess.run([tmp_path / "build" / "user"], check=False).returncode == 0


def test_zephyr_metadata_keeps_to_the_schema(tmp_path: Path) -> None:
    """Keys and types of METADATA_SCHEMA in Zephyr's scripts/zephyr_module.py."""
    source = write("zephyr", tmp_path)
    lines = (source / "zephyr" / "module.yml").read_text().splitlines()
    assert lines == ["name: front_end", "build:", "  cmake: .", "  kconfig: Kconfig"]
    assert (source / "CMakeLists.txt").is_file(), "what build.cmake points to"
    assert (source / "Kconfig").is_file()


def test_zephyr_kconfig_is_read_by_kconfiglib(tmp_path: Path) -> None:
    kconfiglib = pytest.importorskip(
        "kconfiglib", reason="needs kconfiglib: pip install kconfiglib"
    )
    source = write("zephyr", tmp_path)
    found = kconfiglib.Kconfig(str(source / "Kconfig"), warn_to_stderr=False)
    assert found.warnings == []
    assert {"FRONT_END", "FRONT_END_SMALL"} <= set(found.syms)
    found.syms["FRONT_END_SMALL"].set_value("y")
    assert found.syms["FRONT_END_SMALL"].str_value == "n", "not without the module itself"
    found.syms["FRONT_END"].set_value("y")
    assert found.syms["FRONT_END_SMALL"].str_value == "y"


def test_arduino_metadata_keeps_to_the_specification(tmp_path: Path) -> None:
    """Arduino library specification 1.5: required fields, names, semantic version, category."""
    source = write("arduino", tmp_path)
    text = (source / "library.properties").read_text()
    fields = dict(line.split("=", 1) for line in text.splitlines())
    required = {"name", "version", "author", "maintainer", "sentence", "paragraph", "category",
                "url", "architectures"}  # fmt: skip
    assert required <= set(fields) and all(fields.values())
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,62}", fields["name"])
    assert re.fullmatch(r"\d+\.\d+\.\d+", fields["version"])
    assert fields["category"] in {
        "Display", "Communication", "Signal Input/Output", "Sensors", "Device Control", "Timing",
        "Data Storage", "Data Processing", "Other",
    }  # fmt: skip
    assert (source / "src" / fields["includes"]).is_file()


def test_arduino_sketch_compiles_as_cpp_and_runs(tmp_path: Path) -> None:
    """With a stand-in for Arduino.h; the library's C by the C compiler, the sketch as C++."""
    source = write("arduino", tmp_path)
    (tmp_path / "Arduino.h").write_text(
        "#include <cstdint>\n#include <cstdio>\n"
        "struct Port {\n  void begin(long) {}\n  void println(const char *s) { puts(s); }\n"
        '  void print(int32_t x) { printf("%ld", (long)x); }\n\n'
        "  void print(char c) { putchar(c); }\n"
        '  void println(uint32_t x) { printf("%lu\\n", (unsigned long)x); }\n};\n'
        "static Port Serial;\nstatic void delay(unsigned) {}\n"
    )
    compiler = find_compiler()
    objects = []
    for path in sorted((source / "src").glob("*.c")):
        objects.append(str(tmp_path / f"{path.stem}.o"))
        compiler.run(["-std=c99", "-O1", "-c", str(path), "-o", objects[-1]])
    sketch = source / "examples" / "Compensate" / "Compensate.ino"
    main = tmp_path / "main.cpp"
    main.write_text(
        f'#include "Arduino.h"\n{sketch.read_text()}\nint main() {{ setup(); loop(); }}\n'
    )
    plus = {"gcc": "g++", "clang": "clang++"}.get(compiler.name)
    if plus is None or shutil.which(plus) is None:
        pytest.skip("no C++ compiler beside the C compiler")
    program = tmp_path / "sketch"
    subprocess.run(
        [plus, "-std=c++11", "-Wall", "-Wextra", "-Werror", f"-I{tmp_path}", f"-I{source / 'src'}",
         str(main), *objects, "-o", str(program)], check=True,
    )  # fmt: skip
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert len(said.split()) == len(load("front_end").model.outputs) + 1


def test_platformio_metadata_keeps_to_the_manifest(tmp_path: Path) -> None:
    """Fields and limits of platformio/assets/schema/library.json in platformio-core."""
    source = write("platformio", tmp_path)
    manifest = json.loads((source / "library.json").read_text())
    assert set(manifest) <= {
        "$schema", "name", "version", "description", "keywords", "homepage", "repository",
        "authors", "license", "frameworks", "platforms", "headers", "dependencies", "export",
        "scripts", "build", "examples",
    }  # fmt: skip
    assert {"name", "version"} <= set(manifest)
    assert len(manifest["name"]) <= 50 and len(manifest["version"]) <= 20
    assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", manifest["name"])
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest["version"])
    assert len(manifest["description"]) <= 255
    assert all(re.fullmatch(r"[a-z0-9-]+", word) for word in manifest["keywords"])
    assert (source / manifest["build"]["includeDir"] / manifest["headers"]).is_file()


def test_platformio_itself_accepts_the_library(tmp_path: Path) -> None:
    program = shutil.which("pio")
    if program is None:
        pytest.skip("PlatformIO is not installed; the test above holds its metadata to the schema")
    source = write("platformio", tmp_path)
    done = subprocess.run(
        [program, "pkg", "pack", str(source), "-o", str(tmp_path / "packed.tar.gz")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
