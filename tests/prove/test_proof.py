"""Golden models are proven; C that means something else is not."""

import re
from dataclasses import replace

import pytest
from benchmarks.mutants.subjects import draw_subject

from tests.golden.models import CASES
from tests.golden.vectors import load
from tests.prove.models import as_read, prove
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.generate import generate
from zerodrift.codegen.identifiers import name_prefix
from zerodrift.export.integer_model import IntegerModel
from zerodrift_proof import is_proven
from zerodrift_proof.equality import machine
from zerodrift_proof.equality.build import OPEN, TESTED, ShownPart
from zerodrift_proof.equality.prove import show_kernels
from zerodrift_proof.object.program import ProvenKernels

pytestmark = pytest.mark.long

Texts = dict[str, str]
GUARDED = ("ordinary", "effects", "no_reading", "lstm")


def write(model: IntegerModel) -> Texts:
    code = generate(model)
    runtime = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    return {**runtime, code.header_name: code.header, code.source_name: code.source}


def tell(shown: tuple[ShownPart, ...]) -> list[str]:
    return [f"{one.what} ({one.build}): {one.why}" for one in shown if one.verdict == OPEN]


@pytest.mark.parametrize("name", CASES)
def test_golden_models_are_proven(name: str) -> None:
    model = load(name).model
    shown = prove(model, write(model))
    assert tell(shown) == []
    assert is_proven(shown)
    nodes = {one.what for one in shown if one.what.startswith("node ")}
    assert nodes == {f"node {node.name}" for node in model.nodes[:-1]}


@pytest.mark.parametrize("name", GUARDED)
def test_guarded_models_are_proven(name: str) -> None:
    model = replace(load(name).model, guarded=True)
    assert tell(prove(model, write(model))) == []


def test_kernels_of_intrinsics_and_assembly_are_told_as_tested() -> None:
    model = load("front_end").model
    shown = prove(model, write(model))
    tested = [one for one in shown if one.verdict == TESTED and one.build]
    builds = " ".join(one.build for one in tested)
    assert all(k in builds for k in ("PAIRS", "ROWS", "COLUMNS", "ZD_GRU_ASSEMBLY"))


def show_rows(name: str, pattern: str = "", becomes: str = "") -> list[ShownPart]:
    """Return what is shown of the rows kernels of a golden model, one text of its C replaced."""
    model = load(name).model
    texts = write(model)
    prefix = name_prefix(model)
    texts[f"{prefix}.c"], count = re.subn(pattern, becomes, texts[f"{prefix}.c"], count=1)
    assert count == 1
    shown = show_kernels(as_read(model), texts, prefix, ProvenKernels(), small=True)
    return [one for one in shown if "KERNEL_ROWS" in one.build]


@pytest.mark.parametrize("name", ["reset_before", "int8", "int8_before", "lstm", "lstm_int8"])
def test_rows_of_every_layer_are_told_as_tested(name: str) -> None:
    assert [(one.verdict, one.why) for one in show_rows(name)] == [(TESTED, "")]


ROWS_CHANGES = {
    "a weight of r": ("reset_before", r"(gru_rows\[\d+\] = \{[^\d-]*)(-?\d+)", r"\g<1>\g<2>1"),
    "other biases": ("reset_before", r"(    0,\n    )gru_bias(,\n    0)", r"\1gru_rows\2"),
    "a shift": ("reset_before", r"(gru_bias,\n    0,\n    \{)\d+", r"\g<1>9"),
    "scratch": ("reset_before", r"v\[16u \*", "v[15u *"),
    "scratch of u": ("reset_before", r"u_q31\[ZD_ROW_UNITS\(\d+u\)", r"\g<0> - 1u"),
    "reset": ("reset_before", r"rows_before\((.*), u_q31, u_keep", r"rows(\1, u_keep"),
    "a weight of 8 bits": ("int8", r"(gru_bytes\[\d+\] = \{[^\d-]*)(-?\d+)", r"\g<1>3"),
    "a multiplier": ("int8", r"(four units \*/[^\d-]*)(-?\d+)", r"\g<1>77"),
    "a multiplier's shift": ("int8", r"(gru_multiplier,\n.*\n    \{)\d+", r"\g<1>9"),
    "a weight beyond the units": ("lstm", r"0(\n\};\nstatic const int32_t lstm_bias)", r"1\1"),
    "a bit of the cell state": ("lstm", r"(lstm_bias,(?:\n.*){3}\}, )2\d", r"\g<1>23"),
    "relaxing": ("lstm", r"rows\((.*), relaxing\)", r"rows(\1, 0u)"),
    "another layer": ("lstm_int8", r"(lstm_1_bytes,\n    )lstm_1_bias", r"\1lstm_0_bias"),
}  # fmt: skip


@pytest.mark.parametrize("what", ROWS_CHANGES)
def test_rows_that_mean_something_else_are_not_proven(what: str) -> None:
    assert [one.verdict for one in show_rows(*ROWS_CHANGES[what])] == [OPEN]


CHANGES = {
    "a limit of an input": ("in->temperature, -12000, 12000)", "in->temperature, -12000, 12001)"),
    "a filter's coefficient": ("in_0, 803, 1683121056, 22u)", "in_0, 804, 1683121056, 22u)"),
    "a filter at rest": ("zd_lowpass_rest(in_0, 803)", "zd_lowpass_rest(in_0, 802)"),
    "a product's shift": ("offset_9 * offset_9, 25u)", "offset_9 * offset_9, 24u)"),
    "operands": ("in_0 - lowpass_7", "lowpass_7 - in_0"),
    "an offset": ("in_1 - (786432)", "in_1 - (786433)"),
    "a ring's end": ("s->delay_6_oldest == 4u", "s->delay_6_oldest == 3u"),
    "an entry of the features": ("729933130, 68032686", "729933131, 68032686"),
    "a bias of the features": ("INT64_C(-1857043304325458)", "INT64_C(-1857043304325459)"),
    "order of signals": ("lowpass_3, product_5, delay_6, difference_8, product_11};",
                         "product_5, lowpass_3, delay_6, difference_8, product_11};"),
    "a weight of the plain kernel": ("8944, 3105, 11529, -3715", "8944, 3105, 11529, -3716"),
    "a weight in pairs": ("203498224, 11529, -1072565891", "203498224, 11528, -1072565891"),
    "the type of a table": ("static const int16_t gru_rows", "static const int64_t gru_rows"),
    "scratch of the pairs": (
        "v[ZD_PAIR_SCRATCH(3u, 8u)]",
        "v[ZD_PAIR_SCRATCH(3u, 8u) - 1u]",
    ),
    "scratch of the rows, too narrow": ("int16_t v[8u * (ZD_ROW", "int8_t v[8u * (ZD_ROW"),
    "scratch of the pairs, too narrow": ("int32_t v[ZD_PAIR_SCRATCH", "int16_t v[ZD_PAIR_SCRATCH"),
    "scratch of the columns, too narrow": ("int32_t wide[", "int16_t wide["),
    "scratch that is used twice": ("h_q30, wide, v, u_keep", "h_q30, wide, wide, u_keep"),
    "a size that no memory has": ("v[ZD_PAIR_SCRATCH(3u, 8u)]", "v[4000000000u]"),
    "a shift of the kernel": ("gru_stream, {11, 11, 10}", "gru_stream, {11, 11, 11}"),
    "a step relaxes": ("s->gru_h_q30, -1)", "s->gru_h_q30, 0)"),
    "relaxing steps": ("k < ZD_GRU_RELAX_STEPS", "k < (ZD_GRU_RELAX_STEPS - 1u)"),
    "a coefficient of the drift": ("301052314 * lowpass_3", "301052315 * lowpass_3"),
    "a bias of the drift": ("INT64_C(1775521964752896)", "INT64_C(1775521964752898)"),
    "a limit of the drift": ("INT64_C(750000))", "INT64_C(5))"),
    "the flag of a limit": ("if (limited != wide)", "if (limited == wide)"),
    "warming up": ("if (s->steps < 5u) {\n        flags", "if (s->steps <= 5u) {\n        flags"),
    "a range's flag": ("(temperature - (-12000)) > ", "(temperature - (-12001)) > "),
    "a range's flag, signed": ("((uint32_t)(temperature - (-12000)) > ",
                               "((temperature - (-12000)) > (int32_t)"),
    "a rate's flag": ("previous_temperature + 1000) > 2000u",
                      "previous_temperature + 1001) > 2000u"),
    "a rate's upper end": ("previous_temperature + 1000) > 2000u",
                           "previous_temperature + 1000) > 2001u"),
    "a rate's flag, signed": ("((uint32_t)(temperature - s->previous_temperature + 1000) > 2000u)",
                              "((temperature - s->previous_temperature + 1000) > 2000)"),
    "the last temperature": ("s->previous_temperature = (int16_t)temperature;", ""),
    "counting": ("s->steps++", "s->steps += 2u"),
    "the test of a filter": ("INT64_C(-824594253883605)", "INT64_C(-824594253883606)"),
    "the test of the steps": ("if (s->steps > 5u)", "if (s->steps > 6u)"),
    "the answer to damage": ("drift[k] = 0;", "drift[k] = 1;"),
    "restoring": ("refused = 1u;", "refused = 0u;"),
    "the identity of a copy": (
        "zd_restore((uint8_t *)s, saved, (uint32_t)sizeof(*s), FRONT_END_MODEL_ID)",
        "zd_restore((uint8_t *)s, saved, (uint32_t)sizeof(*s), -1)",
    ),
    "the identity": ("s->identity = FRONT_END_MODEL_ID;", "s->identity = FRONT_END_MODEL_ID + 1u;"),
    "the self-test's answer": ("UINT32_C(1948274182)", "UINT32_C(1948274183)"),
}  # fmt: skip


@pytest.mark.parametrize("what", CHANGES)
def test_c_that_means_something_else_is_not_proven(what: str) -> None:
    model = load("front_end").model
    texts = write(model)
    before, after = CHANGES[what]
    assert before in texts["front_end.c"]
    texts["front_end.c"] = texts["front_end.c"].replace(before, after)
    assert tell(prove(model, texts))


HEADER = {
    "an index": ("#define FRONT_END_FX 0", "#define FRONT_END_FX 1"),
    "a unit": ("FRONT_END_FY_LSB_PER_UNIT 10", "FRONT_END_FY_LSB_PER_UNIT 100"),
    "a flag": ("RATE_RANGE UINT32_C(4)", "RATE_RANGE UINT32_C(2)"),
    "the size of a saved state": ("SAVED_BYTES (16u", "SAVED_BYTES (-16u"),
    "the sample period": ("SAMPLE_PERIOD_US UINT32_C(500000)", "SAMPLE_PERIOD_US UINT32_C(50000)"),
    "the inputs' order": (
        "    int16_t temperature; /* temperature: 0 + 0.0078125 degC per count */\n",
        "",
    ),
}


def test_a_self_test_without_an_end_is_not_proven(monkeypatch) -> None:
    monkeypatch.setattr(machine, "MOST_STATEMENTS", 60_000)
    model = load("ordinary").model
    texts = write(model)
    source = f"{name_prefix(model)}.c"
    loop = r"(_selftest\(void\).*?for \(uint32_t k = 0; k < )\d+u"
    texts[source], count = re.subn(loop, r"\g<1>4294967295u", texts[source], flags=re.DOTALL)
    assert count == 1
    told = tell(prove(model, texts))
    assert [one for one in told if one.startswith("selftest") and "60000 statements" in one]


def test_a_table_wider_than_the_self_test_reads_is_not_proven() -> None:
    """No drift differs: the sums are the same; the CRC over the table is not."""
    model = load("layered").model
    texts = write(model)
    name = next(name for name in texts if name.endswith(".c") and name != "zd_runtime.c")
    before, after = "static const int32_t dense_bias[", "static const int64_t dense_bias["
    changed = texts[name].replace(before, after)
    assert changed != texts[name]
    assert tell(prove(model, {**texts, name: changed}))


@pytest.mark.parametrize("what", HEADER)
def test_header_that_says_something_else_is_not_proven(what: str) -> None:
    model = load("front_end").model
    texts = write(model)
    before, after = HEADER[what]
    assert before in texts["front_end.h"]
    texts["front_end.h"] = texts["front_end.h"].replace(before, after)
    if what == "the inputs' order":
        last = "} front_end_input_t;"
        texts["front_end.h"] = texts["front_end.h"].replace(last, before + last)
    assert tell(prove(model, texts))


RUNTIME = {
    "a line of tanh": ("zd_tanh_table.h", "67584", "67585"),
    "a product's rounding": ("zd_runtime.h", "+ ((int64_t)1 << 31), 32)", ", 32)"),
    "a copy of the state": ("zd_runtime.h", "((int32_t)1 << 14), 15)", "((int32_t)1 << 13), 15)"),
    "the update gate": ("zd_gru_portable.h", "bias[1] + from_x[1]", "bias[1] + from_x[0]"),
    "a filter": ("zd_signals.h", "- y, 22)", "- y, 23)"),
    "a dot product": ("zd_runtime.h", "zd_mac(acc, &w[i], &x[i])", "zd_mac(acc, &w[i], &x[0])"),
}  # fmt: skip


@pytest.mark.parametrize("what", RUNTIME)
def test_runtime_that_computes_something_else_is_not_proven(what: str) -> None:
    """Its hash apart, which any change of its text changes."""
    model = load("front_end").model
    texts = write(model)
    name, before, after = RUNTIME[what]
    assert before in texts[name]
    texts[name] = texts[name].replace(before, after)
    found = [one for one in tell(prove(model, texts)) if not one.startswith("runtime, by its hash")]
    assert found


BUILDS = {
    "a small build": ("#if defined(ZD_SMALL)\n#else\n", "#endif\n"),
    "a build for words at any address": ("#if !defined(ZD_UNALIGNED)\n", "#endif\n"),
    "a build of another kernel": ("#if ZD_KERNEL == ZD_KERNEL_ROWS\n#else\n", "#endif\n"),
    "a build with assembly": ("#if ZD_ASSEMBLY == 7\n#else\n", "#endif\n"),
}


@pytest.mark.parametrize("build", BUILDS)
def test_a_statement_that_one_build_leaves_out_is_not_proven(build: str) -> None:
    """Of a model without recurrent layers, which has no choice of the generator's own."""
    model = draw_subject("physics")
    texts = write(model)
    source = f"{name_prefix(model)}.c"
    statement = re.search(r"    s->previous_temperature = \S*temperature;\n(?!\})", texts[source])
    assert statement is not None
    begin, end = BUILDS[build]
    changed = texts[source].replace(statement[0], f"{begin}{statement[0]}{end}")
    told = tell(prove(model, {**texts, source: changed}))
    assert any("is another than in plain C" in one for one in told)


def test_the_size_of_a_pointer_is_not_that_of_the_state() -> None:
    model = draw_subject("physics")
    texts = write(model)
    source = f"{name_prefix(model)}.c"
    changed = texts[source].replace("(uint32_t)sizeof(*s)", "(uint32_t)sizeof(s)")
    told = tell(prove(model, {**texts, source: changed}))
    assert [one for one in told if one.startswith("save ")]
    assert [one for one in told if one.startswith("restore ")]
