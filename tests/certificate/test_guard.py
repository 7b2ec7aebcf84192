"""The checksum over the live state, where a model has one: what it covers, who asks, who writes."""

import json
import re
from dataclasses import replace
from functools import cache

import pytest

from tests.certificate.test_check import build_files, find_fault
from tests.golden.model_factory import Shape, draw_model
from zerodrift.codegen import generate
from zerodrift_proof.certificate.check import compare

SHAPES = {
    "stream": Shape(front_end=("lowpass", "delay"), hidden=6, inputs=2, outputs=2),
    "window": Shape(window=3, hidden=4, inputs=3, outputs=1),
    "loops": Shape(front_end=("delay",), window=3, hidden=4, inputs=3, outputs=1),
    "stack": Shape(inputs=2, hidden=4, outputs=2, upper=(3,)),
    "fed back": Shape(hidden=0, inputs=2, outputs=2, front_end=("lowpass", "load"), measured=(0,)),
    "effects": Shape(front_end=("play", "late", "exp2"), hidden=0, inputs=2, outputs=1),
}
C, HEADER = "golden.c", "golden.h"
FAULTS = {
    "a number left out": ("stream", C, r"    check = zd_check_number\(.*\n", ""),
    "a filter left out": ("stream", C, r"    check = zd_check_i64\(.*\n", ""),
    "a layer left out": ("stream", C, r"(    check = .*gru_h_q30\[\d\]\);\n)+", ""),
    "a ring's place left out": ("stream", C, r" \| \(\(uint32_t\).*oldest << 16\)", ""),
    "a number twice": ("stream", C, r"(    check = zd_check_number\(.*\n)", r"\1\1"),
    "the identity left out": ("stream", C, r"(zd_check_word\()s->identity", r"\1s->steps"),
    "a unit left out": ("stream", C, r"    check = .*gru_h_q30\[5\]\);\n", ""),
    "one unit for another": ("stream", C, r"(check, s->gru_h_q30\[)4", r"\g<1>3"),
    "a unit too many": ("stream", C, r"(check, s->gru_h_q30\[)5", r"\g<1>6"),
    "a half left out": ("stream", C, r"\(uint16_t\)s->previous_temperature \| ", ""),
    "a half of one byte": ("stream", C, r"\(uint16_t\)(s->previous)", r"(uint8_t)\1"),
    "two halves in one place": ("stream", C, "oldest << 16", "oldest << 8"),
    "halves masked": ("stream", C, r"(previous_temperature) \|", r"\1 &"),
    "a half with its sign": ("window", C, r"\(uint32_t\)\(uint16_t\)s", "(uint32_t)(int16_t)s"),
    "a half too narrow to turn": ("window", C, r"\(uint32_t\)\(uint16_t\)s", "(uint16_t)s"),
    "a number as a half": (
        "stream",
        C,
        r"zd_check_number(.*)(s->gru)",
        r"zd_check_word\1(uint16_t)\2",
    ),
    "a row left out": ("window", C, r"(    check = .*s->gru_window\[2\].*\n)+", ""),
    "one row again": ("window", C, r"(s->gru_window\[)1(\]\[0\])", r"\g<1>0\2"),
    "one number of a row again": ("window", C, r"(s->gru_window\[1\]\[)2", r"\g<1>1"),
    "a row too many": ("window", C, r"(s->gru_window\[)2(\]\[2\])", r"\g<1>3\2"),
    "a long row left out": ("loops", C, r"(k < )3u(.*\n.*zd_check_i16)", r"\g<1>2u\2"),
    "a long row of one feature less": ("loops", C, r"(gru_window\[k\], )3u", r"\g<1>2u"),
    "one long row again and again": ("loops", C, r"(check, s->gru_window\[)k\]", r"\g<1>0]"),
    "the lower layer left out": ("stack", C, r"(    check = .*lower_q30.*\n)+", ""),
    "the drift left out": ("fed back", C, r"(    check = .*s->drift.*\n)+", ""),
    "half of a filter": ("stream", C, r"zd_check_i64\(check, ", "zd_check_number(check, (int32_t)"),
    "a sum begun anew": ("stream", C, r"zd_check_number\(check", "zd_check_number(0u"),
    "a sum thrown away": ("stream", C, r"check = (zd_check_number)", r"(void)\1"),
    "a sum of nothing": ("stream", C, "return check;", "return 0u;"),
    "not asked by step": ("stream", C, r" \|\| \(s->check != golden_sum_up\(s\)\)(\) \{ /)", r"\1"),
    "asked by step, and not used": (
        "stream",
        C,
        r" \|\| \(s->check != golden_sum_up\(s\)\)(\) \{ /)",
        r" || ((s->check + 1u) == golden_sum_up(s))\1",
    ),
    "asked of what is not sound": ("stream", C, r"\|\| (\(s->check.*/\*)", r"&& \1"),
    "asked the wrong way round": ("stream", C, r"s->check != (g.*/\*)", r"s->check == \1"),
    "asked for less": ("stream", C, r"s->check != (g.*/\*)", r"s->check < \1"),
    "asked after a change": (
        "stream",
        C,
        r"(    if \(\(golden_state_is_sound)",
        r"    s->previous_temperature = 0;\n\1",
    ),
    "restart without init": ("stream", C, r"(value \*/\n) +golden_init\(s\);\n", r"\1"),
    "not written by init": ("stream", C, r"(MODEL_ID;\n)    s->check = .*\n", r"\1"),
    "not written by settle": ("stream", C, r"(steps = \d+u;\n)    s->check = .*\n", r"\1"),
    "not written by step": ("stream", C, r"    s->check = .*\n(    return flags)", r"\1"),
    "written by step too early": (
        "stream",
        C,
        r"(    s->check = .*\n)(    return flags)",
        r"\1    s->previous_temperature = 0;\n\2",
    ),
    "not asked by restore": (
        "stream",
        C,
        r" \|\| \(s->check != golden_sum_up\(s\)\)(\) \{\n)",
        r"\1",
    ),
    "of 16 bits": ("stream", HEADER, "uint32_t check;", "uint16_t check;"),
    "without a place": ("stream", HEADER, r"    uint32_t check;.*\n", ""),
    "a field more in the state": ("stream", HEADER, "(    uint32_t check;)", r"    int8_t x;\n\1"),
}
"""What is wrong -> (shape, file, pattern, what it becomes)."""


@cache
def build_guarded(name: str, guarded: bool = True) -> tuple[str, dict[str, str]]:
    with pytest.MonkeyPatch.context() as patch:
        if name == "loops":
            patch.setattr(generate, "MOST_WRITTEN_OUT", 1)
        return build_files(replace(draw_model(SHAPES[name], 31), guarded=guarded))


@pytest.mark.spread(2, "name", SHAPES)
def test_guarded_code_is_understood_and_holds(name: str) -> None:
    certificate, texts = build_guarded(name)
    assert json.loads(certificate)["checksum"] == "check"
    assert compare(json.loads(certificate), texts).failures == ()


@pytest.mark.spread(8, "fault", FAULTS)
def test_fault_in_the_guard_is_noticed(fault: str) -> None:
    name, file, pattern, becomes = FAULTS[fault]
    certificate, texts = build_guarded(name)
    edited, found = re.subn(pattern, becomes, texts[file], count=1)
    assert found and edited != texts[file], "the fault has no place in the C any more"
    assert find_fault(json.loads(certificate), texts | {file: edited}), f"not noticed: {fault}"


@pytest.mark.parametrize("guarded", [True, False])
def test_guard_is_claimed_where_there_is_one(guarded: bool) -> None:
    """Otherwise all of it could be taken out of the C."""
    certificate, _ = build_guarded("effects", not guarded)
    claims = json.loads(certificate)
    _, texts = build_guarded("effects", guarded)
    model = re.search(r'_MODEL_HASH "(\w+)"', texts[HEADER])
    assert model
    claims["model"] = model[1]
    assert any("checksum" in failure for failure in find_fault(claims, texts))


@pytest.mark.long
def test_claimed_inputs_are_those_of_the_header() -> None:
    certificate, texts = build_guarded("stream", guarded=False)
    claims = json.loads(certificate)
    assert find_fault(claims, texts) == []
    for key, value in (("low", -32767), ("high", 32766), ("channel", "in1")):
        changed = json.loads(certificate)
        changed["inputs"][0][key] = value
        assert any("input" in failure for failure in find_fault(changed, texts)), key
    changed = json.loads(certificate)
    del changed["inputs"][1]
    assert any("1 inputs are claimed" in failure for failure in find_fault(changed, texts))
    wider = texts[HEADER].replace("int16_t in0;", "int32_t in0;")
    assert any("input in0" in failure for failure in find_fault(claims, texts | {HEADER: wider}))
