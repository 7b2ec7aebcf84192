"""The Python package, built as users build it and installed elsewhere: the reference's bits."""

import json
import os
import shlex
import shutil
import subprocess
import sys
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.golden.vectors import load
from tests.variable_step.models import make_model

from zerodrift.c_runtime.compilers import RUNTIME_FILES, find_compiler
from zerodrift.codegen.generate import generate
from zerodrift.codegen.packages import render_package
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference

pytestmark = pytest.mark.long

RUNTIME = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}


def build(model: IntegerModel, folder: Path) -> Path:
    """Return the folder that the wheel of a model was installed into."""
    source = folder / "source"
    for name, text in render_package("python", model, generate(model), RUNTIME).items():
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    own = ["--no-build-isolation", "--no-deps", "--no-index"]
    surroundings = os.environ | {"CC": shlex.join(find_compiler().command)}
    wheels = folder / "wheels"
    made = subprocess.run(
        [*pip, "wheel", *own, "--wheel-dir", str(wheels), str(source)],
        env=surroundings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    (wheel,) = wheels.iterdir()
    assert "-cp39-abi3-" in wheel.name
    target = folder / "installed"
    subprocess.run([*pip, "install", "--no-deps", "--target", str(target), str(wheel)], check=True)
    shutil.rmtree(source)
    return target


def run(place: Path, program: str, given: Mapping[str, object]) -> dict[str, object]:
    """Run a program where nothing but the wheel can be imported; return what it prints."""
    told = subprocess.run(
        [sys.executable, "-S", "-c", program, json.dumps(given)],
        env={"PYTHONPATH": str(place)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr
    answer = json.loads(told.stdout)
    assert isinstance(answer, dict)
    return answer


REPLAY = """
import json, sys, zlib
from array import array
import NAME_drift as package
given = json.loads(sys.argv[1])
rows = given["codes"]
def crc(answers):
    out = array("i")
    for a in answers:
        out.extend((*a.codes, a.flags))
    return zlib.crc32(out.tobytes())
def begin():
    model = package.Compensator()
    if given["settled"]:
        model.settle_codes(*rows[0])
    return model
first, model = begin(), begin()
half = [model.step_codes(*row) for row in rows[: len(rows) // 2]]
other = package.Compensator()
saved = model.save()
goes_on = other.restore(saved)
damaged = package.Compensator().restore(saved[:-1] + bytes([saved[-1] ^ 1]))
rest = [other.step_codes(*row) for row in rows[len(rows) // 2 :]]
print(json.dumps({"at_once": crc(first.run_codes(rows)), "in_halves": crc(half + rest),
                  "goes_on": goes_on, "damaged": damaged, "hash": package.MODEL_HASH}))
"""


@pytest.mark.parametrize("name", ["front_end", "no_reading", "lstm_int8"])
def test_bits_are_those_of_the_reference(name: str, tmp_path: Path) -> None:
    golden = load(name)
    codes = golden.codes[:4000]
    trace = Reference(golden.model).run(codes[None], settled=golden.settled)
    rows = np.column_stack([trace.drift[0], trace.flags[0].astype(np.int32)]).astype("<i4")
    wanted = zlib.crc32(np.ascontiguousarray(rows).tobytes())
    prefix = generate(golden.model).prefix
    told = run(
        build(golden.model, tmp_path),
        REPLAY.replace("NAME", prefix),
        {"codes": codes.tolist(), "settled": golden.settled},
    )
    assert told == {
        "at_once": wanted,
        "in_halves": wanted,
        "goes_on": True,
        "damaged": False,
        "hash": golden.model.hash,
    }


UNITS = """
import json, sys
import NAME_drift as package
given = json.loads(sys.argv[1])
one, other = package.Compensator(), package.Compensator()
told = {}
for values, codes in zip(given["values"], given["codes"]):
    names = [c.name for c in package.CHANNELS]
    same = one.step(**dict(zip(names, values))) == other.step_codes(*codes)
    told["same"] = told.get("same", True) and same
def refuse(call):
    try:
        call()
    except ValueError as error:
        return str(error)
first = package.CHANNELS[0].name
rest = dict(zip(names[1:], given["values"][0][1:]))
told["far"] = refuse(lambda: one.step(**{first: 1e9}, **rest))
told["nan"] = refuse(lambda: one.step(**{first: float("nan")}, **rest))
told["few"] = refuse(lambda: one.step_codes(1))
told["wide"] = refuse(lambda: one.step_codes(*([2**40] * len(names))))
told["lacks"] = [c.no_reading for c in package.CHANNELS]
told["names"] = one.step(**{first: None}, **rest).explain()
print(json.dumps(told))
"""


def test_values_in_units_become_the_codes_of_the_chip(tmp_path: Path) -> None:
    model = load("no_reading").model
    rng = np.random.default_rng(3)
    codes = rng.integers(-3000, 3000, (50, len(model.channels)))
    wanted = [
        [c.offset + c.lsb * code for c, code in zip(model.channels, row, strict=True)]
        for row in codes.tolist()
    ]
    near = [[v + 0.3 * c.lsb for c, v in zip(model.channels, row, strict=True)] for row in wanted]
    program = UNITS.replace("NAME", generate(model).prefix)
    told = run(build(model, tmp_path), program, {"codes": codes.tolist(), "values": near})
    name, unit = model.channels[0].name, model.channels[0].unit
    assert told["same"] is True
    assert str(told["far"]).startswith(f"{name}: 1000000000.0 {unit} has no code; expected ")
    assert str(told["nan"]).startswith(f"{name}: nan {unit} has no code")
    assert str(told["few"]).startswith(f"1 codes; expected {len(model.channels)}")
    assert str(told["wide"]).startswith(
        f"{name}: code {2**40}; expected {model.channels[0].least} "
    )
    assert told["lacks"] == [c.no_reading for c in model.channels]
    assert "NO_READING" in told["names"]


AFTER = """
import json, sys
import NAME_drift as package
given = json.loads(sys.argv[1])
model = package.Compensator()
model.settle_codes(*given["codes"][0])
answers = []
for row, elapsed in zip(given["codes"], given["elapsed_us"]):
    values = [c.offset + c.lsb * code for c, code in zip(package.CHANNELS, row)]
    answers.append(model.step_after(elapsed / 1e6, *values))
before = answers[-1]
model.tare()
after = model.step_after(1e-6, *values)
print(json.dumps({"drift": [a.codes for a in answers], "flags": [a.flags for a in answers],
                  "tared": after.codes, "told": after.explain()}))
"""


def test_steps_that_are_told_their_time_and_the_tare(tmp_path: Path) -> None:
    model = replace(make_model(), tare=True)
    rng = np.random.default_rng(5)
    codes = rng.integers(-2000, 2000, (200, len(model.channels))).cumsum(axis=0) // 40
    elapsed = rng.integers(1, 20_000_000, 200)
    given = np.column_stack([codes, elapsed])
    trace = Reference(model).run(given[None].astype(model.code_type), settled=True)
    told = run(
        build(model, tmp_path),
        AFTER.replace("NAME", generate(model).prefix),
        {"codes": codes.tolist(), "elapsed_us": elapsed.tolist()},
    )
    assert told["drift"] == trace.drift[0].tolist()
    assert told["flags"] == trace.flags[0].tolist()
    assert "TARED" in told["told"]
