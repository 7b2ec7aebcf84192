"""The independent check agrees with the prover, and notices whatever is changed."""

import hashlib
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fixed_point.strategies import shapes
from tests.golden.model_factory import Shape, draw_model
from tests.golden.models import CASES
from zerodrift.base import fleet_config
from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import RUNTIME_FILES, find_compilers
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import FORMAT, IntegerModel
from zerodrift.verify.certificate import certify
from zerodrift_proof import known_runtime
from zerodrift_proof.certificate import check as certificate_check
from zerodrift_proof.certificate.check import check_certificate, compare, judge, judge_each
from zerodrift_proof.certificate.model import Model, read_models

FRONT = ("lowpass", "product", "delay", "difference", "power")
C, TABLE, RUNTIME = "golden.c", "zd_tanh_table.h", "zd_runtime.h"
FULL = Shape(front_end=FRONT, inputs=3, hidden=4, code_limit=12000)
LONG = ("eight_inputs", "int8", "odd_hidden", "one_input", "rails", "saturation", "long_dwell")
"""Golden models that are one more of what the others are, and take long."""


@cache
def build(shape: Shape, seed: int = 3) -> tuple[str, dict[str, str]]:
    """Return a certificate's text and the files it is about."""
    model = draw_model(shape, seed)
    return build_files(model)


def build_files(model: IntegerModel) -> tuple[str, dict[str, str]]:
    code = generate(model)
    return certify(model, code), list_texts(code)


def list_texts(code: GeneratedCode) -> dict[str, str]:
    """Return the files that a certificate is about."""
    texts = {code.header_name: code.header, code.source_name: code.source}
    return texts | {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}


def run_portable(texts: dict[str, str], prefix: str) -> Model:
    """Return what the portable kernel's C reaches."""
    machine = read_models(texts, prefix)[0]
    machine.run()
    return machine


def count_claims(claims: dict[str, Any]) -> int:
    return sum(len(claims[key]) for key in ("bounds", "shifts", "invariants", "tables"))


def check_edited(shape: Shape, name: str, pattern: str, becomes: str, count: int = 1) -> list[str]:
    """Return what the check says of C edited by someone who also corrected the hashes."""
    certificate, texts = build(shape)
    edited, found = re.subn(pattern, becomes, texts[name], count=count)
    assert found and edited != texts[name], (
        "the fault has no place in the C any more: plant it anew"
    )
    return find_fault(json.loads(certificate), texts | {name: edited})


def find_fault(claims: dict[str, Any], texts: dict[str, str]) -> list[str]:
    """Return what the check says, with all hashes corrected, of the first way to compile in which
    it finds anything."""
    for name in claims["files"]:
        claims["files"][name] = hashlib.sha256(texts[name].encode()).hexdigest()
    found = (outcome.failures for outcome in judge_each(claims, texts) if outcome.failures)
    return list(next(found, ()))


@pytest.mark.spread(
    1, "name", [pytest.param(n, marks=[pytest.mark.slow] if n in LONG else []) for n in CASES]
)
def test_every_claim_of_the_golden_models_holds(name: str) -> None:
    certificate, texts = build_files(draw_model(CASES[name].shape, sum(name.encode())))
    claims = json.loads(certificate)
    outcome = compare(claims, texts)
    assert outcome.failures == ()
    assert outcome.holds == count_claims(claims)


@pytest.mark.long
@settings(
    max_examples=8,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(shape=shapes(most_hidden=10, most_outputs=4), seed=st.integers(0, 2**31))
def test_checker_derives_the_prover_s_bounds_exactly(shape: Shape, seed: int) -> None:
    """Two derivations that share no code give the same numbers, for any model."""
    certificate, texts = build_files(draw_model(shape, seed))
    claims = json.loads(certificate)
    machine = run_portable(texts, claims["prefix"])
    assert machine.failures == []
    for claim in claims["bounds"]:
        assert machine.bounds[claim["where"]] == (claim["low"], claim["high"], claim["bits"]), claim
    assert judge(claims, machine) == (count_claims(claims), [])


@pytest.mark.parametrize("side", ["low", "high"])
@pytest.mark.spread(
    1,
    "shape",
    [FULL, Shape(weights="int8", reset="before", hidden=3, window=4)],
    ids=["full", "int8"],
)
def test_any_bound_lowered_by_one_is_refused(shape: Shape, side: str) -> None:
    certificate, texts = build(shape)
    claims = json.loads(certificate)
    machine = run_portable(texts, claims["prefix"])
    for claim in claims["bounds"]:
        claim[side] -= 1 if side == "high" else -1
        holds, failures = judge(claims, machine)
        assert holds == count_claims(claims) - 1, claim
        assert len(failures) == 1 and failures[0].startswith(f"{claim['where']}: claimed")
        claim[side] += 1 if side == "high" else -1


def test_any_shift_or_table_claimed_otherwise_is_refused() -> None:
    certificate, texts = build(FULL)
    claims = json.loads(certificate)
    machine = run_portable(texts, claims["prefix"])
    for part, key in (("shifts", "shift"), ("invariants", "high"), ("tables", "lines")):
        for claim in claims[part]:
            claim[key] += 1
            assert len(judge(claims, machine)[1]) == 1, claim
            claim[key] -= 1
    for part in ("bounds", "shifts"):
        left_out = claims[part].pop(-1 if part == "shifts" else 40)
        assert any(left_out["where"] in failure for failure in judge(claims, machine)[1])


@pytest.mark.spread(2, "name", ["golden.c", "golden.h", "zd_runtime.c", "zd_runtime.h"])
def test_any_other_byte_is_noticed_by_the_hash(name: str) -> None:
    certificate, texts = build(FULL)
    for at in range(0, len(texts[name]), len(texts[name]) // 7):
        swapped = "1" if texts[name][at] != "1" else "2"
        edited = texts[name][:at] + swapped + texts[name][at + 1 :]
        of_files = next(judge_each(json.loads(certificate), texts | {name: edited}))
        assert any("its hash is" in failure for failure in of_files.failures)


@pytest.mark.spread(
    1,
    "table",
    [
        "gru_w_x",
        pytest.param("gru_w_h", marks=pytest.mark.slow),
        pytest.param("gru_bias", marks=pytest.mark.slow),
        "head_weights",
    ],
)
def test_any_weight_farther_from_zero_breaks_its_claim(table: str) -> None:
    """Even where the hashes are corrected; nearer to zero the claims remain true, and hold: what is
    wrong then is the CRC by which the self-test knows its tables."""
    certificate, texts = build(FULL)
    text = texts["golden.c"]
    start = text.index(f"{table}[")
    body = text[text.index("= {", start) : text.index("};", start)]
    clean = re.sub(r"/\*.*?\*/", lambda m: " " * len(m[0]), body)
    numbers = [m for m in re.finditer(r"-?\d+", clean) if int(m[0]) != 0]
    for place in numbers[:: max(1, len(numbers) // 2)]:
        for direction, expect in ((1, True), (-1, False)):
            value = int(place[0])
            value += direction if value > 0 else -direction
            edited = body[: place.start()] + str(value) + body[place.end() :]
            mutated = texts | {"golden.c": text.replace(body, edited)}
            failures = find_fault(json.loads(certificate), mutated)
            assert any("whose CRC is known" in failure for failure in failures)
            beyond = [f for f in failures if "whose CRC is known" not in f]
            assert bool(beyond) is expect, (table, place, beyond)


@pytest.mark.spread(0, "kernel", ["PAIRS", "ROWS", "COLUMNS"])
def test_every_kernel_s_own_table_is_checked(kernel: str) -> None:
    """A kernel that reads its weights in another order has them in a table of its own."""
    certificate, texts = build(Shape(inputs=3, hidden=5))
    text = texts["golden.c"]
    branch = re.search(rf"if ZD_KERNEL == ZD_KERNEL_{kernel}\n(.*?)\n#el", text, re.S)
    if branch is None:
        pytest.skip(f"this version has no kernel {kernel}")
    numbers = list(re.finditer(r"(?<=[ ,{])-?\d{3,}(?=[,\n])", branch[1]))
    for place in numbers[:: max(1, len(numbers) // 4)]:
        mutated = branch[1][: place.start()] + "2147483000" + branch[1][place.end() :]
        if (
            kernel == "ROWS"
            and abs(int(place[0])) < 32768
            and "gru_bias" not in branch[1][: place.start()]
        ):
            mutated = branch[1][: place.start()] + "32767" + branch[1][place.end() :]
        edited = texts | {"golden.c": text.replace(branch[1], mutated)}
        failures = find_fault(json.loads(certificate), edited)
        assert failures and all(f"ZD_KERNEL_{kernel}" in failure for failure in failures)


TANH = r"(zd_tanh_(?:nodes_q19|offset_q30)\[\w+\] = \{\s+)"
FAULTS = {
    "input limit widened": (C, r"(zd_clamp32\(in->in0, )-12000", r"\1-12001"),
    "input multiplied": (C, r"\* 4096;", "* 65536;"),
    "product not widened": (C, r"\(int64_t\)(offset_\d+ \* )", r"\1"),
    "product shifted less": (C, r"(\* lowpass_\d+, )\d+u", r"\g<1>2u"),
    "shift undefined in C": (C, r"zd_asr64\(sum, \d+u\)", "zd_asr64(sum, 64u)"),
    "feature shift": (C, r"(features_shift\[3\] = \{)\d+", r"\g<1>7"),
    "drift cut short": (C, r"\(int32_t\)limited", "(int8_t)limited"),
    "ring runs past its end": (C, r"== (\d)u\) \? 0u :", r"== 1\1u) ? 0u :"),
    "state check forgets the ring": (C, r"_oldest >= (\d)u", r"_oldest >= 3\1u"),
    "state check widened": (C, r"_line\[k\] < -", "_line[k] < -1"),
    "state check never fails": (C, "sound = 0u;", "sound = 1u;"),
    "low-pass check narrowed": (C, r"(_v < INT64_C\()-8\d", r"\1-1"),
    "low-pass that grows": (C, r"(zd_lowpass\(&.*?, \d+, \d+, )\d+u", r"\g<1>3u"),
    "low-pass share above one": (C, r"(zd_lowpass\(&.*?, in_\d, )\d+", r"\g<1>16777217"),
    "step without its state check": (C, r"golden_state_is_sound\(s\) == 0u", "s->steps > 9u"),
    "rest leaves a field": (C, r"    s->lowpass_\d+_v = zd_lowpass_rest.*\n", ""),
    "gate shift": (C, r"    \{\d+, \d+, \d+\},\n", "    {40, 12, 11},\n"),
    "more units than weights": (C, r"(zd_gru_step_after\(&gru, 3u, )4u", r"\g<1>5u"),
    "head reads too many": (C, r"gru_q15, 4u\);\n    \}", "gru_q15, 400u);\n    }"),
    "copy shorter than the state": (C, r"gru_q15\[4\]", "gru_q15[3]"),
    "scratch shorter than the state": (C, r"h_q15\[4\];", "h_q15[3];"),
    "state check of too few units": (C, r"(gru_h_q30, )4u\)", r"\g<1>3u)"),
    "state check of too many units": (C, r"(gru_h_q30, )4u\)", r"\g<1>9u)"),
    "state check beyond a ring": (
        C,
        r"k < (\d)u; k\+\+\) \{\n        if \(\(s->delay",
        r"k < 9\g<1>u; k++) {\n        if ((s->delay",
    ),
    "division": (C, r" - lowpass_(\d+);", r" / lowpass_\1;"),
    "macro over a variable": (C, r'#include "zd_runtime.h"', "#define in_0 7\n"),
    "macro over a kernel": (C, r'#include "zd_runtime.h"', "#define zd_asr64 3\n"),
    "unknown function": (C, r"zd_clamp32\(in", "wrap32(in"),
    "assembly": (C, r"    uint32_t flags = 0;", '    __asm__("nop");'),
    "head weights of 8 bits": (C, r"const int16_t head_weights", "const int8_t head_weights"),
    "weight table too short": (C, r"(gru_w_h\[)48\]", r"\g<1>40]"),
    "weight table of another length": (C, r"(gru_stream\[)\d+\]", r"\g<1>7]"),
    "bias of 16 bits": (C, r"(static const )int32_t gru_bias", r"\1int16_t gru_bias"),
    "entry beyond its type": (C, r"(head_weights\[12\] = \{[^\n]*\n    )-?\d+", r"\g<1>40000"),
    "table's entry octal": (C, r"(head_weights\[12\] = \{[^\n]*\n    )-?\d+", r"\g<1>077777"),
    "literal that C has not": (C, r"(zd_asr64\(sum, )\d+u", r"\g<1>09u"),
    "features of 8 bits": (C, r"int16_t features\[3\];", "int8_t features[3];"),
    "state of 16 bits": ("golden.h", r"int32_t gru_h_q30\[4\]", "int16_t gru_h_q30[4]"),
    "state shorter": ("golden.h", r"int32_t gru_h_q30\[4\]", "int32_t gru_h_q30[3]"),
    "ring shorter": ("golden.h", r"(int32_t delay_\d+_line\[)\d\]", r"\g<1>2]"),
    "share of u that is no mask": (C, r"(gru_step\(features, s->gru_h_q30, )-1\)", r"\g<1>7)"),
    "limits in the wrong order": (C, r"-12000, 12000\)", "12000, -12000)"),
    "shift of 64 for a product": (C, r"(zd_round_shift64\(.*?, )\d+u", r"\g<1>63u"),
    "state and scratch on each other": (C, r"x, h_q30, v, u_keep", "x, h_q30, h_q30, u_keep"),
    "init beyond the state": (
        C,
        r"(    s->identity = GOLDEN_MODEL_ID;)",
        r"\1\n    s->gru_h_q30[9] = 0;",
    ),
    "init of nothing": (C, r"    \*s = blank;\n", ""),
    "init as another model": (C, r"s->identity = GOLDEN_MODEL_ID;", "s->identity = 7u;"),
    "settle that leaves too many steps": (C, r"s->steps = 5u;", "s->steps = 6u;"),
    "saved with another size": (C, r"\(uint32_t\)sizeof\(\*s\), G", "(uint32_t)sizeof(*s) + 1u, G"),
    "copy too small": ("golden.h", r"\(16u \+ sizeof", "(8u + sizeof"),
    "restored without a look": (C, r" \|\| \(golden_state_is_sound\(s\) == 0u\)\) \{", ") {"),
    "self-test past its drift": (C, r"(i < )GOLDEN_OUTPUTS(; i\+\+\) \{\n +crc)", r"\g<1>20u\2"),
    "self-test of an unset state": (C, r"if \(k == 0u\)", "if (k == 1u)"),
    "answer of the guard thrown away": (
        C,
        r"if \(golden_state_is_sound\(s\) == 0u\)",
        "(void)golden_state_is_sound(s);\n    if (s->steps > 9u)",
    ),
    "guard asked the wrong way round": (C, r"(state_is_sound\(s\)) == 0u\) \{ /", r"\1 != 0u) { /"),
    "restart without init": (C, r"(value \*/\n)        golden_init\(s\);\n", r"\1"),
    "drift not set on a restart": (C, r"drift\[k\] = 0;", "(void)k;"),
    "guard that compares unsigned": (C, r"_line\[k\] > (\d+)\)", r"_line[k] > \1u)"),
    "loop without an end": (C, r"k < ZD_GRU_RELAX_STEPS", "k < 4294967295u"),
    "loop that cannot end": (C, r"k <( ZD_GRU_RELAX_STEPS; k)\+\+", r"k <\1--"),
    "read before written": (C, r"(int64_t sum) = features_bias\[i\];", r"\1;"),
    "octal size": (C, r"head_weights\[12\]", "head_weights[012]"),
    "assembly at -Os": (C, r'"movs r7, #78', '"movs r7, #79'),
    "assembly that reads neighbours": (C, r"ldr r9, \[r2, #0\]", "ldr r9, [r2, #2]"),
    "assembly of the smallest": (C, r"movs r5, #255", "movs r5, #254"),
    "assembly with another frame": (C, r'"add sp, sp, #\d+', '"add sp, sp, #4'),
    "arm of the preprocessor for others": (
        C,
        r"#if ZD_KERNEL == ZD_K",
        "#if defined(__riscv)\n#elif ZD_KERNEL == ZD_K",
    ),
    "tables for C++ alone": ("golden.h", r'extern "C" \{', 'extern "C" { int x;'),
    "function that nobody calls": (
        C,
        r"void golden_init",
        "static void f(void) {\n}\nvoid golden_init",
    ),
    "constant written": (
        C,
        r"    uint32_t flags = 0;",
        "    uint32_t flags = 0;\n    head_weights[0] = 1;",
    ),
    "CRC of other tables": (C, r"(crc == UINT32_C\()\d", r"\g<1>9"),
    "runtime of others": (RUNTIME, r"return x >> shift;", "return x >> (shift + 1u);"),
    "table not monotone": (TABLE, TANH + r"((?:-?\d+,\s+){200})-?\d+", r"\1\g<2>7"),
    "table beyond one": (
        TABLE,
        r"1073709056(\n\};\n\nZD_SHARED const int16_t zd_tanh_slope)",
        r"1073739776\1",
    ),
    "half of the table another one": (
        TABLE,
        r"(zd_tanh_half_slope_q19\[\w+\] = \{\s+)\d",
        r"\g<1>",
    ),
    "half of the table short": (TABLE, r"(zd_tanh_half_offset_q30\[\w+\] = \{\s+)0,", r"\1"),
    "half of the table not level": (TABLE, r" 0\n(\};\n#else)", r" 1\n\1"),
    "table short": (TABLE, TANH + r"-?\d+,\s", r"\1"),
    "invariant wider than 16 bits": (RUNTIME, "1073709057", "1073741824"),
    "invariant narrower than a step": (RUNTIME, "1073709057", "1073709055"),
}
"""What is wrong -> (file, pattern, what it becomes); hashes are corrected after each."""


@pytest.mark.spread(7, "fault", FAULTS)
def test_derivation_notices_a_planted_fault(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, pattern, becomes = FAULTS[fault]
    if name == TABLE or "invariant" in fault:  # not by the runtime's hash alone
        monkeypatch.setattr("zerodrift_proof.certificate.check.is_known", lambda texts: True)
    failures = check_edited(FULL, name, pattern, becomes)
    assert failures, f"not noticed: {fault}"


def test_runtime_as_it_is_now_is_known() -> None:
    """After a change of the runtime: `make golden`."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    assert (FORMAT, known_runtime.hash_runtime(texts)) == known_runtime.CURRENT


def test_compiler_refuses_a_claim_beyond_its_width(tmp_path: Path) -> None:
    """The claims in the C are asked of the compiler, whichever it is."""
    model = draw_model(FULL, 3)
    code = generate(model)
    write_sources(code, tmp_path)
    source = tmp_path / code.source_name
    text = source.read_text()
    places = [m.end() for m in re.finditer(r"_claim_\d+, \(INT64_C\(", text)]
    assert len(places) == len(model.prove())
    for compiler in find_compilers()[:2]:
        compiler.run(["-std=c99", "-Werror", "-c", str(source), "-o", str(tmp_path / "a.o")])
        beyond = text[: places[0]] + "-9223372036854775807" + text[text.index(")", places[0]) :]
        source.write_text(beyond)
        with pytest.raises(CheckError, match="claim_0"):
            compiler.run(["-std=c99", "-c", str(source), "-o", str(tmp_path / "b.o")])
        source.write_text(text)


def test_folder_is_checked_as_it_lies_and_anything_else_refused(tmp_path: Path) -> None:
    certificate, texts = build(FULL)
    for name, text in {**texts, "certificate.json": certificate}.items():
        (tmp_path / name).write_text(text)
    assert check_certificate(tmp_path).failures == ()
    for damage in ("", "[]", "{}", "null", '{"files": 3}', certificate[:-40], "\x00"):
        (tmp_path / "certificate.json").write_text(damage)
        assert check_certificate(tmp_path).failures
    (tmp_path / "certificate.json").write_text(certificate)
    (tmp_path / "golden.c").unlink()
    assert check_certificate(tmp_path).failures


@pytest.mark.parametrize("name", ["line", "window", "steps", "oldest", "y"])
def test_inputs_may_be_called_like_fields_of_the_state(name: str) -> None:
    shape = Shape(inputs=2, hidden=0, no_reading=(None, -32768), channel_names=("t", name))
    certificate, texts = build_files(draw_model(shape, 3))
    claims = json.loads(certificate)
    assert judge(claims, run_portable(texts, claims["prefix"])) == (count_claims(claims), [])


LSTM = Shape(inputs=3, layered=(("lstm", 4, (0,)),), code_limit=12000)
LSTM_FAULTS: dict[str, tuple[str, str]] = {
    "bias added before the last shift": (r"add r3, r3, #(\d+)", r"add r3, r3, #1\1"),
    "no limit of the cell state": (r"ssat r3, #31", "ssat r3, #32"),
    "another gate's shift": (r"ssat r4, #20, r4, asr #(\d)", r"ssat r4, #20, r4, asr #1\1"),
    "order of the weights": (r"smlad r2, r5, r9, r2", "smlad r2, r5, r10, r2"),
    "relaxing in time": (r"cbnz r6, 3f", "cbz r6, 3f"),
    "the lower limit of the smallest cores": (r"bics r1, r1, r3", "ands r1, r1, r3"),
    "a doubling less on the smallest cores": (r"lsrs r5, r4, #16", "lsrs r5, r4, #17"),
    "another gate on the smallest cores": (r"mov r1, r11", "mov r1, r9"),
    "rounding of i g on the smallest cores": (r"adds r1, #(\d+)", r"adds r1, #1\1"),
    "another's stream": (
        r"lstm_assembly\(lstm\.stream, h_q30, x, cell",
        r"lstm_assembly(lstm.stream, cell, x, h_q30",
    ),
    "cell state on the output": (r"x, cell, relaxing\);\n#else", "x, h_q30, relaxing);\n#else"),
    "a stream too long": (
        r"(lstm_stream\[)(\d+)\] = \{([^}]*)\n\}",
        r"\g<1>\2 + 1] = {\3,\n    0\n}",
    ),
    "fewer bits of the cell state": (
        r"(zd_lstm_pairs_t lstm = \{lstm_stream, \{[^}]*\}, )\d+",
        r"\g<1>25",
    ),
}
"""What is wrong with an LSTM's assembly or its weights -> (pattern, what it becomes)."""


@pytest.mark.spread(3, "fault", LSTM_FAULTS)
def test_a_fault_in_the_lstm_s_assembly_is_noticed(fault: str) -> None:
    assert check_edited(LSTM, C, *LSTM_FAULTS[fault]), f"not noticed: {fault}"


BEFORE = Shape(inputs=3, hidden=4, reset="before", code_limit=12000)
BYTES = Shape(inputs=3, hidden=5, weights="int8", code_limit=12000)
LSTM_BYTES = Shape(inputs=3, layered=(("lstm", 5, (0,)),), weights="int8", code_limit=12000)
NORM = Shape(inputs=3, layered=(("gru", 5, (0,)), ("norm", 5, (1,))), code_limit=12000)
FURTHER_FAULTS: dict[str, tuple[Shape, str, str]] = {
    "r h rounded elsewhere": (BEFORE, r"add r5, r5, #8192", "add r5, r5, #4096"),
    "u rounded": (BEFORE, r"smmul r2, r2, r3", "smmulr r2, r2, r3"),
    "u not 0 towards rest": (BEFORE, r"and r3, r3, #(\d+)", r"mov r3, #\1"),
    "r h cut off on the smallest": (BEFORE, r"lsls r2, r2, #13", "lsls r2, r2, #12"),
    "the reset after the product": (BEFORE, r"zd_gru_before_t gru", "zd_gru_pairs_t gru"),
    "a stream too long": (
        BEFORE,
        r"(gru_stream\[)(\d+)\] = \{([^}]*)\n\}",
        r"\g<1>\2 + 1] = {\3,\n    0\n}",
    ),
    "rows with the reset after": (BEFORE, r"rows_before\((.*), u_q31, u_keep", r"rows(\1, u_keep"),
    "scratch of rows": (BEFORE, r"v\[16u \*", "v[15u *"),
    "a weight of rows": (BEFORE, r"(gru_rows\[\d+\] = \{[^\d-]*)-?\d+", r"\g<1>32767"),
    "8 bits of rows": (BYTES, r"(gru_bytes\[\d+\] = \{[^\d-]*)-?\d+", r"\g<1>-128"),
    "a multiplier of rows": (BYTES, r"(four units \*/[^\d-]*)-?\d+", r"\g<1>2147483647"),
    "a unit more in rows": (LSTM, r"0(\n\};\nstatic const int32_t lstm_bias)", r"0, 0\1"),
    "8 bits of an lstm in rows": (LSTM_BYTES, r"(_bytes\[\d+\] = \{[^\d-]*)-?\d+", r"\g<1>-128"),
    "bytes in their own order": (BYTES, r"sxtb16 r5, r5, ror #8", "sxtb16 r5, r5, ror #16"),
    "a multiplier's other shift": (BYTES, r"lsrs r5, r5, #(\d)", r"lsrs r5, r5, #1\1"),
    "half of the four not cleared": (BYTES, r"mov r4, #0", "mov r4, #1"),
    "shifts of another layer": (BYTES, r"(zd_gru_bytes_t gru = .*, )\d+\}\};", r"\g<1>3}};"),
    "bytes of an lstm in their own order": (
        LSTM_BYTES,
        r"sxtb16 r10, r10, ror #8",
        "sxtb16 r10, r10, ror #16",
    ),
    "an lstm's multiplier with another shift": (
        LSTM_BYTES,
        r"lsrs r3, r3, #(\d)",
        r"lsrs r3, r3, #1\1",
    ),
    "an lstm's bias of another gate": (LSTM_BYTES, r"adcs r2, r2, r6", "adcs r2, r2, r5"),
    "half of an lstm's four not cleared": (LSTM_BYTES, r"mov r4, #0", "mov r4, #1"),
    "an lstm's multipliers as if of 16 bits": (
        LSTM_BYTES,
        r"zd_lstm_bytes_t (lstm = .*\}), \{[^}]*\}, (\d+\};)",
        r"zd_lstm_pairs_t \1, \2",
    ),
    "an lstm's multipliers shifted by another number": (
        LSTM_BYTES,
        r"(zd_lstm_bytes_t lstm = \{lstm_stream, \{[^}]*\}, )\{\d+",
        r"\g<1>{3",
    ),
    "an lstm's stream too long": (
        LSTM_BYTES,
        r"(lstm_stream\[)(\d+)\] = \{([^}]*)\n\}",
        r"\g<1>\2 + 1] = {\3,\n    0\n}",
    ),
    "a gain of a normalisation": (NORM, r"(_gain\[5\] = \{\s*)-?\d+", r"\g<1>2147483647"),
    "a bias of a normalisation": (
        NORM,
        r"(_bias\[5\] = \{\s*)-?\d+(?=[^;]*\};\n.*zd_layer)",
        r"\g<1>1",
    ),
    "no epsilon": (NORM, r"INT64_C\(\d+\), \d+, \d+, \d+\n", "INT64_C(0), 1, 1, 1\n"),
    "another epsilon": (NORM, r"(_bias, INT64_C\()\d+", r"\g<1>1152921504606846977"),
    "another root": (NORM, r"(INT64_C\(\d+\), \d+, )\d+", r"\g<1>999"),
    "more numbers than there are": (
        NORM,
        r"(_q15, result, )5u\);\n        zd_gru",
        r"\g<1>6u);\n        zd_gru",
    ),
    "a normalisation of its own result": (
        NORM,
        r"zd_layer_norm\(&layer_norm_p, gru_q15",
        "zd_layer_norm(&layer_norm_p, layer_norm_q15",
    ),
    "an accumulator's other shift": (
        BYTES,
        r"(zd_gru_bytes_t gru = \{gru_stream, )\{\d+",
        r"\g<1>{31",
    ),
}
"""What is wrong with further assembly -> (shape, pattern, what it becomes)."""


@pytest.mark.spread(6, "fault", FURTHER_FAULTS)
def test_a_fault_in_further_assembly_is_noticed(fault: str) -> None:
    shape, pattern, becomes = FURTHER_FAULTS[fault]
    assert check_edited(shape, C, pattern, becomes), f"not noticed: {fault}"


def test_the_folder_that_units_share_has_one_name() -> None:
    """The check imports the standard library alone, so that it has a literal of its own."""
    assert certificate_check.SHARED_RUNTIME == fleet_config.SHARED_RUNTIME
