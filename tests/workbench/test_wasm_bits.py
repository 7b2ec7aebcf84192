"""The C as WebAssembly, in Chromium: bit for bit the golden vectors and the integer reference."""

from dataclasses import replace
from datetime import date

import numpy as np
import pytest
from benchmarks.chip_page import PlayedHost, open_chip_page
from tests.blocks.units import describe_unit
from tests.golden.models import CASES
from tests.golden.vectors import load
from tests.variable_step.models import make_lowpass

from zerodrift.base.errors import CheckError, InputError
from zerodrift.blocks.block import BlockNotes
from zerodrift.blocks.design import make_design
from zerodrift.c_runtime import wasm as module
from zerodrift.c_runtime.wasm import build_wasm
from zerodrift.codegen.generate import generate, generate_unit
from zerodrift.export.quantize import quantize
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

IMPORTS, EXPORTS = 2, 7
"""Sections of a module."""


@pytest.fixture(scope="module")
def chip(browser):
    """Return the page's worker in Chromium."""
    with open_chip_page(browser) as page:
        yield page


def list_sections(wasm: bytes) -> dict[int, bytes]:
    assert wasm[:8] == b"\0asm\1\0\0\0"
    found, at = {}, 8
    while at < len(wasm):
        kind, size, shift = wasm[at], 0, 0
        at += 1
        while True:
            size |= (wasm[at] & 127) << shift
            shift, at = shift + 7, at + 1
            if wasm[at - 1] < 128:
                break
        found[kind] = wasm[at : at + size]
        at += size
    return found


def draw(model, steps=2000):
    return np.concatenate(list(draw_sequences(model, steps).values()))


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_wasm_replays_golden_vectors(chip, name):
    golden = load(name)
    model = golden.model
    played = chip.play(model, build_wasm(generate(model)), golden.codes, settled=golden.settled)
    answers = np.column_stack([played.trace.drift, played.trace.flags.astype(np.int32)])
    wanted = golden.rows[:, : len(model.outputs) + 1]
    np.testing.assert_array_equal(answers[golden.every - 1 :: golden.every], wanted)
    assert played.fault == 0
    check = check_host(PlayedHost(played), golden.codes, settled=golden.settled)
    assert check.mismatch is None
    assert check.steps == len(golden.codes)


@pytest.mark.slow
def test_variable_step_and_block_run_too(chip):
    slow = make_lowpass((0.4, 95.0))
    own = quantize(*describe_unit(3))
    design = make_design([own, quantize(*describe_unit(4))])
    unit = design.fit(own)
    notes = BlockNotes("SN0042", date(2026, 1, 2), 1)
    for model, code in ((slow, generate(slow)), (unit, generate_unit(design, unit, notes))):
        codes = draw(model)
        played = chip.play(model, build_wasm(code), codes)
        assert check_host(PlayedHost(played), codes).mismatch is None


@pytest.mark.slow
def test_vectors_of_128_bits_give_the_same_bits(chip):
    model = load("eight_inputs").model
    codes = draw(model)
    played = chip.play(model, build_wasm(generate(model), ("-O3", "-msimd128")), codes)
    assert check_host(PlayedHost(played), codes).mismatch is None


@pytest.mark.slow
def test_another_number_in_the_c_is_noticed(chip):
    model = load("ordinary").model
    code = generate(model)
    at = code.source.index("{", code.source.index("gru_w_h["))
    number = next(  # of a recurrent weight
        word for word in code.source[at:].split() if word.strip(",").lstrip("-").isdigit()
    )
    first = code.source.index(number, at)
    other = str(int(number.strip(",")) ^ 64) + ","
    source = code.source[:first] + other + code.source[first + len(number) :]
    codes = draw(model)
    played = chip.play(model, build_wasm(replace(code, source=source)), codes)
    assert played.fault != 0
    assert check_host(PlayedHost(played), codes).mismatch is not None


@pytest.mark.long
def test_module_needs_nothing_and_has_the_headers_names():
    code = generate(load("front_end").model)
    sections = list_sections(build_wasm(code))
    assert IMPORTS not in sections
    for name in ("init", "settle", "step", "selftest"):
        assert f"{code.prefix}_{name}".encode() in sections[EXPORTS]
    assert build_wasm(code) == build_wasm(code)


def test_c_that_does_not_compile_is_told():
    code = generate(load("one_input").model)
    with pytest.raises(CheckError, match="error"):
        build_wasm(replace(code, source=code.source + "\nint x = ;\n"))


def test_missing_compiler_is_told(monkeypatch):
    monkeypatch.setattr(module.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(InputError, match="pip install ziglang"):
        build_wasm(generate(load("one_input").model))
