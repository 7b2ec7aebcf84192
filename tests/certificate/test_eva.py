"""Frama-C's Eva on golden models: no alarm, and one for whatever is planted."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.certificate.eva import annotate, check_model, find_frama_c, read_log
from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.host import render_sources
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.model_files import load_model

pytestmark = pytest.mark.long

GOLDEN = Path(__file__).parents[1] / "golden"
needs_frama_c = pytest.mark.skipif(
    find_frama_c() is None, reason="frama-c is not installed: make setup-frama-c"
)
PLANTED = {
    "no limit": (r"zd_clamp32\(in->in1, -10000, 10000\) \* 4096", "in->in1 * 131072", "overflow"),
    "shift": (r"features_shift\[4\] = \{\d+", "features_shift[4] = {64", "invalid RHS operand"),
    "index": (r"&head_weights\[k \* 8u\]", "&head_weights[k * 9u]", "out of bounds"),
    "state": (r"s->lowpass_4_v > INT64_C\(\d+\)", "s->lowpass_4_v == INT64_MAX", "overflow"),
    "narrow": (r"zd_clamp64\(zd_asr64\(sum, features_shift\[i\]\), -32768, 32767\)", "sum",
               "downcast"),
}  # fmt: skip
"""What is planted in the C of `ordinary`: what, by what, and what Eva calls it."""


def render(name: str) -> GeneratedCode:
    return generate(load_model(GOLDEN / f"{name}.model.json"))


def test_annotations_change_no_line() -> None:
    for name in ("ordinary", "effects", "lstm", "front_end"):
        code = render(name)
        files = render_sources(code)
        for file, text in annotate(files, code.source_name).items():
            kept = [line for line in text.splitlines() if not line.startswith("/*@")]
            assert kept == files[file].splitlines(), (name, file)


def test_a_place_that_is_not_found_is_refused() -> None:
    code = render("ordinary")
    files = {**render_sources(code), "zd_signals.h": "int x;\n"}
    with pytest.raises(CheckError, match=r"0 lines match .* expected one"):
        annotate(files, code.source_name)


def test_what_was_not_reached_is_told() -> None:
    log = "[eva:final-states] Values at end of function a:\n[eva] b.c:2: Warning: x\n"
    assert read_log(log, ["a", "b"]).list_findings() == ["b: its end was not reached"]
    alarm = "[eva:alarm] b.c:2: Warning: \n  signed overflow.\n  assert x;\n"
    assert read_log(alarm + log, ["a"]).alarms == ("b.c:2: Warning: signed overflow. assert x;",)


@needs_frama_c
def test_a_golden_model_has_no_alarm(tmp_path: Path) -> None:
    assert check_model(render("ordinary"), tmp_path).list_findings() == []


@needs_frama_c
@pytest.mark.parametrize("what", PLANTED)
def test_what_is_planted_is_reported(what: str, tmp_path: Path) -> None:
    pattern, by, told = PLANTED[what]
    code = render("ordinary")
    source, changed = re.subn(pattern, by, code.source)
    assert changed
    found = check_model(replace(code, source=source), tmp_path)
    assert any(told in alarm for alarm in found.alarms), found.list_findings()
