"""Packages for boards: built by what the board's own build does, and run where a simulator is."""

import contextlib
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from tests.chips.test_packages import MAIN, MODEL, configure, write

from zerodrift.export.reference import Reference

pytestmark = pytest.mark.long

ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")
MCU = "atmega2560"
USER = "cmake_minimum_required(VERSION 3.21)\nproject(user LANGUAGES C)\n"


def write_user(folder: Path, text: str) -> Path:
    user = folder / "user"
    user.mkdir()
    (user / "main.c").write_text(MAIN)
    (user / "CMakeLists.txt").write_text(USER + text)
    return user


def run_user(folder: Path, *arguments: str) -> int:
    configure(folder / "user", folder / "build", *arguments)
    return subprocess.run([folder / "build" / "user"], check=False).returncode


def test_pico_library_joins_a_programs_sources(tmp_path: Path) -> None:
    """As the Pico SDK's own libraries do; no function of the SDK is called."""
    source = write("pico", tmp_path)
    write_user(
        tmp_path,
        f"add_subdirectory({source} pico)\nadd_executable(user main.c)\n"
        "target_link_libraries(user PRIVATE front_end)\n",
    )
    assert run_user(tmp_path) == 0


def test_esp_idf_component_builds_where_idfs_function_is_stood_in_for(tmp_path: Path) -> None:
    """ESP-IDF is not installed here: `idf_component_register` is replaced by what it does."""
    source = write("esp-idf", tmp_path)
    write_user(
        tmp_path,
        "function(idf_component_register)\n"
        '  cmake_parse_arguments(C "" "" "SRCS;INCLUDE_DIRS" ${ARGN})\n'
        "  add_library(component STATIC ${C_SRCS})\n"
        "  target_include_directories(component PUBLIC ${C_INCLUDE_DIRS})\n"
        "endfunction()\n"
        f"add_subdirectory({source} component)\nadd_executable(user main.c)\n"
        "target_link_libraries(user PRIVATE component)\n",
    )
    assert run_user(tmp_path) == 0
    manifest = (source / "idf_component.yml").read_text()
    assert re.search(r'^version: "\d+\.\d+\.\d+"$', manifest, re.MULTILINE)


def test_cmake_package_as_a_shared_library(tmp_path: Path) -> None:
    source = write("cmake", tmp_path)
    write_user(
        tmp_path,
        f"add_subdirectory({source} model)\nadd_executable(user main.c)\n"
        "target_link_libraries(user PRIVATE front_end::front_end)\n",
    )
    assert run_user(tmp_path, "-DBUILD_SHARED_LIBS=ON") == 0
    assert list((tmp_path / "build").rglob("libfront_end.*"))
    assert not list((tmp_path / "build").rglob("libfront_end.a"))


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The objects of Arduino's core for a Mega, without the class String, which nothing uses."""
    needed = ("avr-gcc", "avr-g++", "simavr")
    if not ARDUINO.is_dir() or not all(map(shutil.which, needed)):
        pytest.skip("no Arduino core, avr-g++ or simavr; `make setup-qemu` installs them")
    folder = tmp_path_factory.mktemp("core")
    sources = [p for p in sorted((ARDUINO / "cores/arduino").iterdir()) if p.stem != "WString"]
    return [compile_avr(p, folder) for p in sources if p.suffix in (".c", ".cpp", ".S")]


def compile_avr(source: Path, folder: Path, *options: str) -> Path:
    """Compile a source as Arduino's own build does for a Mega; its core's warnings are its own."""
    languages = {
        ".c": ["avr-gcc", "-std=gnu11"],
        ".S": ["avr-gcc", "-x", "assembler-with-cpp"],
        ".cpp": ["avr-g++", "-std=gnu++11", "-fno-exceptions", "-fno-threadsafe-statics"],
    }
    made = folder / f"{source.name}.o"
    common = [f"-mmcu={MCU}", "-DF_CPU=16000000L", "-DARDUINO=10807", "-DARDUINO_ARCH_AVR", "-w"]
    common += ["-DARDUINO_AVR_MEGA2560", "-Os", "-ffunction-sections", "-fdata-sections"]
    common += [f"-I{ARDUINO / 'cores/arduino'}", f"-I{ARDUINO / 'variants/mega'}", *options]
    subprocess.run(
        [*languages[source.suffix], *common, "-c", str(source), "-o", str(made)], check=True
    )
    return made


def run_sketch(text: str, library: Path, core: list[Path], folder: Path, lines: int) -> list[str]:
    """Return what a sketch prints on a simulated Mega."""
    main = folder / "sketch.cpp"
    main.write_text(f"#include <Arduino.h>\n{text}")
    own = f"-I{library / 'src'}"
    made = [compile_avr(path, folder, own) for path in (*(library / "src").glob("*.c"), main)]
    program = folder / "sketch.elf"
    subprocess.run(
        ["avr-gcc", "-Os", "-Wl,--gc-sections", f"-mmcu={MCU}", *map(str, (*made, *core)), "-lm",
         "-o", str(program)], check=True,
    )  # fmt: skip
    printed: list[str] = []
    with subprocess.Popen(
        ["simavr", "-m", MCU, "-f", "16000000", str(program)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    ) as chip:
        assert chip.stderr is not None
        with contextlib.suppress(StopIteration):
            while len(printed) < lines:
                line = next(chip.stderr).decode()
                printed += re.findall(r"\x1b\[32m(.*?)\.*\n", line)
        chip.kill()
    return printed


def test_arduino_sketch_on_a_simulated_mega_gives_the_references_bits(
    core: list[Path], tmp_path: Path
) -> None:
    library = write("arduino", tmp_path)
    text = (library / "examples" / "Compensate" / "Compensate.ino").read_text()
    steps = 40
    codes = np.zeros((steps, len(MODEL.channels)), dtype=np.int16)
    codes[:, 0] = [(i * 997) % 3001 - 1500 for i in range(steps)]
    # the reading of the thermometer, where the sketch has a zero; and no waiting between samples
    reading = "static int32_t i = 0;\n    in.temperature = (int16_t)((i++ * 997) % 3001 - 1500);"
    assert text.count("in.temperature = 0;") == text.count("delay(500);") == 1
    text = text.replace("in.temperature = 0;", reading).replace("delay(500);", "")
    printed = run_sketch(text, library, core, tmp_path, steps)
    reference = Reference(MODEL)
    rest = reference.start(np.zeros((1, codes.shape[1]), dtype=np.int64), settled=True)
    trace = reference.run(codes[None], state=rest)
    expected = [
        " ".join(map(str, (*drift, flags)))
        for drift, flags in zip(trace.drift[0].tolist(), trace.flags[0].tolist(), strict=True)
    ]
    assert printed == expected
