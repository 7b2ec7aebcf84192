"""Codes that mean no reading, and inputs beyond their range: the same on every back end."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.golden.model_factory import Shape, draw_model
from tests.golden.models import LOWEST

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.application import render_application
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import (
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    FORMAT,
    OLDER_FORMAT,
    IntegerModel,
)
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference
from zerodrift.verify.certificate import certify
from zerodrift.verify.firmware import recheck
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.host_check import check_host, check_starts
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_sequences

NONE = (LOWEST, LOWEST)
SHAPE = Shape(
    inputs=2, hidden=5, outputs=2, front_end=("lowpass", "delay"), code_limit=12000,
    no_reading=NONE, ranges=((1, -3000, 3000),),
)  # fmt: skip
SHAPES = {
    "network": SHAPE,
    "physics": replace(SHAPE, hidden=0),
    "window": replace(SHAPE, window=4),
    "32 bits": replace(SHAPE, wide=(0, 1), no_reading=(-(2**31), 2**31 - 1)),
    "an input alone": replace(SHAPE, no_reading=(None, LOWEST)),
    "load": replace(
        SHAPE, outputs=2, front_end=("lowpass", "load"), measured=(1,),
        no_reading=(LOWEST, None, -(2**31)), ranges=((2, -(10**6), 10**6),),
    ),
}  # fmt: skip


def walk(steps: int = 60, seed: int = 3) -> np.ndarray[tuple[int, int], np.dtype[np.int16]]:
    """Return two channels that move slowly within all ranges."""
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.integers(-40, 41, (steps, 2)), axis=0).astype(np.int16)


def test_last_reading_stands_for_one_that_is_missing() -> None:
    reference = Reference(draw_model(SHAPE, 1))
    codes = walk()
    lacks = codes.copy()
    lacks[20:23, 0] = LOWEST
    lacks[22:30, 1] = LOWEST
    codes[20:23, 0], codes[22:30, 1] = codes[19, 0], codes[21, 1]
    held, full = reference.run(lacks[None]), reference.run(codes[None])
    np.testing.assert_array_equal(held.drift, full.drift)
    np.testing.assert_array_equal(held.hidden, full.hidden)
    told = np.zeros(60, dtype=np.uint32)
    told[20:30] = FLAG_NO_READING
    np.testing.assert_array_equal(held.flags[0], full.flags[0] | told)


@pytest.mark.parametrize("settled", [True, False])
def test_model_begins_with_its_first_readings(settled: bool) -> None:
    model = draw_model(SHAPE, 1)
    codes = walk()
    late = np.concatenate([codes[:4].copy(), codes])
    late[:2, 0], late[1:4, 1] = LOWEST, LOWEST
    trace = Reference(model).run(late[None], settled=settled)
    assert not trace.drift[0, :4].any() and not trace.hidden[0, :4].any()
    assert set(trace.flags[0, :4]) == {FLAG_NO_READING | FLAG_WARMING_UP}
    from_there = Reference(model).run(codes[None], settled=False)
    np.testing.assert_array_equal(trace.drift[0, 4:], from_there.drift[0])
    np.testing.assert_array_equal(trace.flags[0, 4:], from_there.flags[0])


def test_flags_trip_on_both_sides_of_every_channel() -> None:
    shape = replace(SHAPE, inputs=3, no_reading=(), ranges=((1, -3000, 3000), (2, 100, 200)))
    model = draw_model(shape, 1)
    guards = replace(model.guards, temperature_low=-500, temperature_high=700)
    model = replace(model, guards=guards)
    inside = [0, 0, 150]
    for channel, flag, low, high in (
        (0, FLAG_TEMPERATURE_RANGE, -500, 700),
        (1, FLAG_INPUT_RANGE, -3000, 3000),
        (2, FLAG_INPUT_RANGE, 100, 200),
    ):
        for code, outside in ((low, False), (high, False), (low - 1, True), (high + 1, True)):
            row = inside.copy()
            row[channel] = code
            flags = Reference(model).run(np.array([[row]])).flags[0, 0]
            assert flags == (flag if outside else 0), (channel, code)


@pytest.mark.spread(1, "name", SHAPES)
def test_host_and_onnx_equal_the_reference(name: str, tmp_path: Path) -> None:
    model = draw_model(SHAPES[name], 2)
    code = generate(model)
    host = HostModel(model, code, tmp_path, observe=True)
    runtime = OnnxModel(model)
    sequences = draw_sequences(model, 1500)
    lacking = sum((c[:, i] == model.channels[i].no_reading).sum()
                  for c in sequences.values() for i in model.optional)  # fmt: skip
    assert lacking > 100, "else nothing is shown"
    for settled in (True, False):
        assert check_starts(host, sequences, 40, settled=settled).mismatch is None
        for codes in sequences.values():
            assert check_host(host, codes, settled=settled).mismatch is None
            assert check_onnx(runtime, host, codes, settled=settled).mismatch is None
    assert host.selftest() == 0
    scratch = tmp_path / "certificate"
    scratch.mkdir()
    assert not recheck(code, certify(model, code), scratch).failures


@pytest.mark.skipif(
    any(importlib.util.find_spec(n) is None for n in ("unicorn", "ziglang")),
    reason="emulation needs the unicorn and ziglang wheels",
)
@pytest.mark.parametrize("name", ["network", "32 bits"])
@pytest.mark.spread(1, "core", ["cortex-m0plus", "cortex-m4"])
def test_emulated_core_equals_the_reference(name: str, core: str, tmp_path: Path) -> None:
    from zerodrift.c_runtime.emulator import EmulatedModel

    model = draw_model(SHAPES[name], 2)
    chip = EmulatedModel(model, generate(model), core, tmp_path)
    for sequence, codes in draw_sequences(model, 500).items():
        for settled in (True, False):
            trace = Reference(model).run(codes[None], settled=settled)
            drift, flags = chip.run(codes, settled=settled)
            np.testing.assert_array_equal(drift, trace.drift[0], err_msg=sequence)
            np.testing.assert_array_equal(flags, trace.flags[0], err_msg=sequence)
    assert chip.selftest() == 0


FAULTS = {
    "holds nothing": (r"== -32768\) \? s->\w+ : in->in0", "== -32768) ? in->in0 : in->in0"),
    "holds another": (r"\? s->last_in1", "? s->previous_temperature"),
    "starts from nothing": (r"if \(lacks != 0u\) \{ /\* nothing", "if (lacks > 1u) { /* nothing"),
    "settles on nothing": (r"golden_lacks_reading\(in\) != 0u", "golden_lacks_reading(in) > 1u"),
    "forgets the flag": (r"(FLAG_NO_READING;\n    }\n)", r"FLAG_NO_READING & 0u;\n    }\n"),
    "keeps an old reading": (r"s->last_in1 = now\.in1", "s->last_in1 = s->last_in1"),
    "range off by one": (r"now\.in1 > 3000", "now.in1 > 3001"),
}
"""What is wrong -> (pattern in the generated source, what it becomes)."""


@pytest.mark.spread(3, "fault", FAULTS)
def test_faults_are_found(fault: str, tmp_path: Path) -> None:
    model = draw_model(SHAPE, 2)
    code = generate(model)
    source, count = re.subn(*FAULTS[fault], code.source)
    assert count > 0
    host = HostModel(model, replace(code, source=source), tmp_path, observe=True)
    sequences = draw_sequences(model, 3000)
    checks = [check_host(host, codes) for codes in sequences.values()]
    checks += [check_starts(host, sequences, 40, settled=s) for s in (True, False)]
    assert any(check.mismatch is not None for check in checks)


CHEATS = {
    "an input is left out": (r"    now->in1 = .*\n", ""),
    "used before it is filled in": (r"    golden_hold\(&now, s, in\);\n", ""),
}


@pytest.mark.spread(1, "cheat", CHEATS)
def test_certificate_check_wants_every_input_filled_in(cheat: str, tmp_path: Path) -> None:
    model = draw_model(SHAPE, 2)
    code = generate(model)
    source, count = re.subn(*CHEATS[cheat], code.source)
    assert count == 1
    with pytest.raises(CheckError, match="certificate does not hold"):
        recheck_edited(model, replace(code, source=source), tmp_path)


def recheck_edited(model: IntegerModel, code: GeneratedCode, tmp_path: Path) -> None:
    """Check edited C by someone who wrote the certificate for it."""
    recheck(code, certify(model, code), tmp_path)


def test_models_of_the_older_format_are_read_and_keep_their_hash(tmp_path: Path) -> None:
    older = draw_model(Shape(inputs=2, hidden=4), 1)
    newer = draw_model(SHAPE, 1)
    for model, version in ((older, OLDER_FORMAT), (newer, FORMAT)):
        path = tmp_path / f"{version}.json"
        model.save(path)
        assert f'"format":{version},' in path.read_text(encoding="utf-8")
        found = load_model(path)
        assert found.hash == model.hash and found.channels == model.channels
        assert found.guards == model.guards


def test_application_reads_a_thermometer_that_is_no_tmp117_as_a_channel_of_the_board() -> None:
    tmp117 = render_application(draw_model(SHAPE, 1))
    assert "tmp117_read(board_i2c(), &in.in0)" in tmp117
    wide = render_application(draw_model(SHAPES["32 bits"], 1))
    assert "tmp117" not in wide
    assert "in.in0 = board_read_channel(0u);" in wide
