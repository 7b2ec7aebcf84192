"""The ROS 2 node, built with stand-ins for ROS's headers, beside the reference."""

import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.chips.cxx import find_cxx
from tests.golden.vectors import load

from zerodrift.base.errors import InputError
from zerodrift.c_runtime.compilers import RUNTIME_FILES, find_compiler
from zerodrift.codegen.generate import generate
from zerodrift.codegen.packages import UNSURE, render_package
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference

pytestmark = pytest.mark.long

RUNTIME = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
STAND_IN = Path(__file__).parent / "ros2_stand_in"
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def write(model: IntegerModel, folder: Path) -> Path:
    for name, text in render_package("ros2", model, generate(model), RUNTIME).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def build(model: IntegerModel, folder: Path) -> Path:
    """Return the node as a program that reads lines in place of messages."""
    place = write(model, folder)
    prefix = generate(model).prefix
    objects = []
    for source in (*place.glob("src/*.c"), place / "src" / f"{prefix}_node.cpp"):
        is_c = source.suffix == ".c"
        command = find_compiler().command if is_c else find_cxx()
        language = ["-std=c99"] if is_c else ["-std=c++17", f"-I{STAND_IN}"]
        objects.append(folder / f"{source.name}.o")
        warnings = ["-Wall", "-Wextra", "-Werror"]
        options = [*language, *warnings, "-O1", f"-I{place / 'include'}", "-c", str(source)]
        subprocess.run([*command, *options, "-o", str(objects[-1])], check=True)
    program = folder / "node"
    subprocess.run([*find_cxx(), *map(str, objects), "-o", str(program)], check=True)
    return program


def talk(program: Path, lines: list[str]) -> dict[str, list[list[float]]]:
    """Return what was published: topic -> rows of numbers."""
    told = subprocess.run(
        [program], input="\n".join(lines) + "\n", capture_output=True, text=True, check=True
    )
    published: dict[str, list[list[float]]] = {}
    for line in told.stdout.splitlines():
        topic, *numbers = line.split()
        published.setdefault(topic, []).append([float(number) for number in numbers])
    return published


def name_wrench(model: IntegerModel) -> IntegerModel:
    """Return a golden model with outputs that are parts of a wrench."""
    units = {"F": "N", "M": "Nm"}
    outputs = tuple(
        replace(output, name=name, unit=units[name[0]])
        for output, name in zip(model.outputs, AXES[1:], strict=False)
    )
    return replace(model, outputs=outputs)


def test_drift_is_the_references_and_is_taken_off_the_wrench(tmp_path: Path) -> None:
    golden = load("front_end")
    model = name_wrench(golden.model)
    codes = golden.codes[:300]
    trace = Reference(model).run(codes[None], settled=True)
    lines = ["wrench 1 2 3 4 5 6"]  # before any input: as it is
    for row in codes.tolist():
        values = [c.offset + c.lsb * code for c, code in zip(model.channels, row, strict=True)]
        lines += [f"temperature {values[0]!r}"]
        lines += [
            f"input/{c.name} {v!r}" for c, v in zip(model.channels[1:], values[1:], strict=True)
        ]
        lines += ["step", "wrench 1 2 3 4 5 6"]
    told = talk(build(model, tmp_path), lines)
    assert told["period_us"] == [[500000]]
    assert [int(row[0]) for row in told["flags"]] == trace.flags[0].tolist()
    given = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert told["wrench_compensated"][0] == given.tolist()
    for k, drift in enumerate(trace.drift[0]):
        expected = np.zeros(6)
        for output, code in zip(model.outputs, drift.tolist(), strict=True):
            expected[AXES.index(output.name)] = code / output.lsb_per_unit
        assert told["drift"][k] == expected.tolist()
        assert told["wrench_compensated"][k + 1] == (given - expected).tolist()


def test_an_input_that_falls_silent_stops_the_steps_and_then_the_model_starts_at_rest(
    tmp_path: Path,
) -> None:
    model = name_wrench(load("front_end").model)
    code = [1000, 500, -200]
    values = [c.offset + c.lsb * n for c, n in zip(model.channels, code, strict=True)]
    inputs = [f"temperature {values[0]!r}"]
    inputs += [f"input/{c.name} {v!r}" for c, v in zip(model.channels[1:], values[1:], strict=True)]
    lines = [
        "step",
        *inputs,
        "step",
        "step",
        "wait 10",
        "step",
        *inputs,
        "step",
        "temperature nan",
        "step",
    ]
    told = talk(build(model, tmp_path), lines)
    answers = Reference(model).run(np.array([[code, code]], dtype=model.code_type), settled=True)
    flags = [int(row[0]) for row in told["flags"]]
    first = [UNSURE, *answers.flags[0].tolist(), UNSURE, int(answers.flags[0][0]), UNSURE]
    assert flags == first
    assert told["drift"][0] == [0.0] * 6
    assert told["drift"][3] == told["drift"][2] != [0.0] * 6
    assert told["drift"][4] == told["drift"][1]


def test_outputs_that_are_no_wrench_are_refused() -> None:
    model = load("front_end").model
    other = replace(model, outputs=(replace(model.outputs[0], unit="mV"), *model.outputs[1:]))
    with pytest.raises(
        InputError, match=r"output Fx in mV is no part of a wrench; expected .*Mz in Nm"
    ):
        render_package("ros2", other, generate(other), RUNTIME)


def test_the_manifest_names_the_package_and_what_the_node_includes(tmp_path: Path) -> None:
    place = write(name_wrench(load("front_end").model), tmp_path)
    root = ET.parse(place / "package.xml").getroot()
    assert (root.tag, root.get("format")) == ("package", "3")
    tags = [child.tag for child in root]
    order = ["name", "version", "description", "maintainer", "license"]
    assert tags[:5] == order
    needed = {child.text for child in root if child.tag == "depend"}
    listed = (place / "CMakeLists.txt").read_text()
    node = next(place.glob("src/*.cpp")).read_text()
    for name in needed:
        assert f"find_package({name} REQUIRED)" in listed
        assert f"<{name}/" in node
