"""The proof reads what the generator writes, and refuses all else with file, line and column."""

import re
from functools import cache

import pytest
from benchmarks.mutants.subjects import draw_subject
from benchmarks.random_models import draw_case

from tests.blocks.test_blocks import find_code as find_block
from tests.blocks.test_gru import find_code as find_gru_block
from tests.golden.models import CASES
from tests.golden.vectors import load
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift_proof.equality.parser import parse_all
from zerodrift_proof.equality.prove import BUILDS, list_ways
from zerodrift_proof.equality.reader import RefusedError, preprocess, split
from zerodrift_proof.known_runtime import is_known

Texts = dict[str, str]


def add_runtime(code: GeneratedCode) -> Texts:
    runtime = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    return {**runtime, code.header_name: code.header, code.source_name: code.source}


def read(texts: Texts, prefix: str) -> None:
    for _, defined in BUILDS:
        parse_all(preprocess(texts, prefix, defined), prefix)
    assert list(list_ways(texts, prefix))


@pytest.mark.spread(4, "name", CASES)
def test_golden_models_are_read(name: str) -> None:
    code = generate(load(name).model)
    read(add_runtime(code), code.prefix)


@pytest.mark.spread(2, "number", range(6))
def test_random_models_are_read(number: int) -> None:
    code = generate(draw_case(4127, number).model)
    read(add_runtime(code), code.prefix)


def test_blocks_are_read() -> None:
    """They have no rules in the proof; of their C nothing is refused."""
    for code in (find_block(True), find_block(False), find_gru_block()):
        read(add_runtime(code), code.prefix)


@pytest.mark.spread(2, "name", ["raw", "asleep", "layer_norm", "stack", "guarded"])
def test_conversions_steps_of_any_time_and_layers_are_read(name: str) -> None:
    code = generate(draw_subject(name))
    read(add_runtime(code), code.prefix)


@cache
def write_front_end() -> Texts:
    return add_runtime(generate(load("front_end").model))


HIDDEN = "    s->previous_temperature = (int16_t)temperature;\n"
CODE = {
    "a character constant that begins a comment": (
        HIDDEN, "'/*'\n" + HIDDEN + "/* done */\n", "a character constant"),
    "a macro of a character constant": (
        "#if ZD_RUNTIME_ID", "#define S1_NOTE '/*'\n#if ZD_RUNTIME_ID", "a character constant"),
    "a comment's end behind a joined line": (
        HIDDEN, "/* x *\\\n/ s->steps = 0u; /* y */\n" + HIDDEN, "a line joined with the next"),
    "a statement behind a joined comment": (
        HIDDEN, "// x \\\n" + HIDDEN, "a line joined with the next"),
    "a joined line with a space": (HIDDEN, "/* x \\ \n*/" + HIDDEN, "a line joined with the next"),
    "a comment to the end of the line": (HIDDEN, "// x\n" + HIDDEN, "a comment to the end"),
    "a comment in a comment": (HIDDEN, "/* /* */" + HIDDEN, "a comment within a comment"),
    "a comment that stays open": (
        "return refused;\n}\n", "return refused;\n}\n/* x", "a comment that does not end"),
    "a trigraph": (HIDDEN, "/* ??/\n*/" + HIDDEN, "a trigraph"),
    "a digraph": ("drift[k] = 0;", "drift<:k:> = 0;", "'<:'"),
    "a number sign as a digraph": (HIDDEN, "%:define X 1\n" + HIDDEN, "'%:'"),
    "another letter": (HIDDEN, HIDDEN.replace("temp", "t\u0435mp"), "a letter beyond ASCII"),
    "a letter in a comment": (HIDDEN, "/* \u2028 */" + HIDDEN, "a letter beyond ASCII"),
    "a carriage return": (HIDDEN, "\r" + HIDDEN, "a carriage return"),
    "a tab": (HIDDEN, "\t" + HIDDEN, "a tab"),
    "a form feed": (HIDDEN, "\f" + HIDDEN, "a control character"),
    "an end of the text": (HIDDEN, "\0" + HIDDEN, "a control character"),
    "a raw text": (HIDDEN, 'R"(/*)";' + HIDDEN + '/*")"*/', "'R' before a quotation mark"),
    "a universal name": (HIDDEN, "\\u0041 = 1;" + HIDDEN, "a backslash"),
    "a long number": ("s->steps > 5u", "s->steps > 5ul", "'5ul'"),
    "an octal number": ("s->steps > 5u", "s->steps > 05u", "'05u'"),
    "a fraction": ("s->steps > 5u", "s->steps > 5.0", "'5.0'"),
    "an exponent that takes a sign in": ("s->steps > 5u", "s->steps > 0xe+5u", "'0xe\\+5u'"),
    "a typed expression": ("INT64_C(750000))", "INT64_C(700000 + 50000))", "'\\+'"),
    "a typed number with a suffix": ("INT64_C(750000))", "INT64_C(750000u))", "without a suffix"),
    "__STDC__": (HIDDEN, f"#ifdef __STDC__\n#else\n{HIDDEN}#endif\n", "'# ifdef __STDC__'"),
    "a number of the compiler": (
        HIDDEN, f"#if __STDC_VERSION__ > 0\n#else\n{HIDDEN}#endif\n", "'# if __STDC_VERSION__"),
    "a limit": (HIDDEN, f"#ifndef INT32_MAX\n{HIDDEN}#endif\n", "'# ifndef INT32_MAX'"),
    "the line": (HIDDEN, f"#if __LINE__ == 1\n{HIDDEN}#endif\n", "'# if __LINE__ == 1'"),
    "the optimiser": (HIDDEN, f"#ifndef __OPTIMIZE__\n{HIDDEN}#endif\n", "__OPTIMIZE__"),
    "NDEBUG": (HIDDEN, f"#ifndef NDEBUG\n{HIDDEN}#endif\n", "NDEBUG"),
    "code for C++ alone": (HIDDEN, f"#ifdef __cplusplus\n{HIDDEN}#endif\n", "__cplusplus"),
    "code for the harness alone": (
        "#define ZD_OBSERVE(values, count)\n", "int32_t x;\n#define ZD_OBSERVE(values, count)\n",
        "code behind #ifndef ZD_OBSERVE"),
    "a condition that is always true": (
        HIDDEN, f"#if ZD_RUNTIME_ID != 0x1\n#else\n{HIDDEN}#endif\n", "#else behind"),
    "an undefined macro": (HIDDEN, "#undef FRONT_END_OUTPUTS\n" + HIDDEN, "#"),
    "a line number": (HIDDEN, "#line 7\n" + HIDDEN, "'# line 7'"),
    "a pragma": (HIDDEN, "#pragma pack(1)\n" + HIDDEN, "'# pragma pack"),
    "a pragma as an operator": (HIDDEN, '_Pragma("x")\n' + HIDDEN, "'_Pragma'"),
    "a file of another": ('#include "zd_network.h"', '#include "other.h"', "other.h is no file"),
    "a header of C": ('#include "zd_network.h"', "#include <math.h>", "'# include < math . h >'"),
    "a macro of the source": (
        HIDDEN, "#define in_0 in_0_deadbeef\n" + HIDDEN, "'# define in_0 in_0_deadbeef'"),
    "a macro of C": (HIDDEN, "#define INT16_MAX 5\n" + HIDDEN, "'# define INT16_MAX 5'"),
    "a macro again": (
        "#define ZD_CLAIM(", "#define ZD_OBSERVE(values, count)\n#define ZD_CLAIM(", "again"),
    "what a claim is": ("[(holds) ? 1 : -1]", "[(holds) ? 1 : 1]", "'# define ZD_CLAIM"),
    "a condition within a call": (
        "ZD_OBSERVE(drift, 3u);", "ZD_OBSERVE(drift,\n#if defined(ZD_SMALL)\n#endif\n2u);",
        "within brackets"),
    "an attribute": (
        "static uint32_t front_end_state_is_sound(",
        "__attribute__((constructor)) static uint32_t front_end_state_is_sound(",
        "'__attribute__' is no type"),
    "an attribute of a table": (
        "features_bias[3] =", "features_bias[3] __attribute__((section(\"x\"))) =",
        "'__attribute__' where '=' was expected"),
    "assembly": (HIDDEN, '    __asm volatile("nop");\n' + HIDDEN, "'__asm' where a name"),
    "a global variable": (
        "static uint32_t front_end_state_is_sound(",
        "static int32_t front_end_kept = 0;\nstatic uint32_t front_end_state_is_sound(",
        "front_end_kept is no constant"),
    "a static variable": (HIDDEN, "    static int32_t kept = 0;\n" + HIDDEN, "'static'"),
    "a type of the target": (HIDDEN, "    int kept = 0;\n" + HIDDEN, "'int'"),
    "a type again": (
        "static uint32_t front_end_state_is_sound(",
        "typedef struct {\n    int8_t v;\n} int32_t;\nstatic uint32_t front_end_state_is_sound(",
        "'int32_t' where a name was expected"),
    "a name that hides another": (HIDDEN, "    const int32_t flags = 3;\n" + HIDDEN, "second time"),
    "a name of the runtime": (HIDDEN, "    const int32_t zd_x = 3;\n" + HIDDEN, "'zd_x' is a name"),
    "a function of the runtime": (
        "static uint32_t front_end_state_is_sound(",
        "static int64_t zd_asr64(int64_t x, uint32_t shift) {\n    return x;\n}\n"
        "static uint32_t front_end_state_is_sound(",
        "'zd_asr64' is a name"),
    "a function of another name": (
        "static uint32_t front_end_state_is_sound(",
        "static uint32_t strlen(const int8_t *x) {\n    return 0u;\n}\n"
        "static uint32_t front_end_state_is_sound(",
        "strlen is no function of the model"),
    "a function that others see": (
        "static uint32_t front_end_state_is_sound(", "uint32_t front_end_state_is_sound(",
        "not static, and not in the header"),
    "a loop without a count": (HIDDEN, "    while (s->steps != 0u) {\n    }\n" + HIDDEN, "'while'"),
    "an empty statement": (HIDDEN, "    ;\n" + HIDDEN, "';'"),
    "a jump": (HIDDEN, "    goto end;\n" + HIDDEN, "'goto'"),
    "two expressions": ("flags |= FRONT_END_FLAG_CLAMPED;", "flags |= 1u, flags = 0u;", "','"),
    "a count within an expression": ("drift[k] = 0;", "drift[k++] = 0;", "'\\+\\+'"),
}  # fmt: skip


@pytest.mark.spread(20, "what", CODE)
def test_what_the_generator_never_writes_is_refused(what: str) -> None:
    before, after, told = CODE[what]
    texts = {**write_front_end()}
    assert before in texts["front_end.c"]
    texts["front_end.c"] = texts["front_end.c"].replace(before, after, 1)
    with pytest.raises(RefusedError, match=rf"^front_end\.c:\d+:\d+: .*{told}") as found:
        read(texts, "front_end")
    row, column = map(int, re.findall(r"\d+", str(found.value).split(" ")[0]))
    assert 0 < row <= texts["front_end.c"].count("\n") + 1 and column > 0


LSB = "#define FRONT_END_FY_LSB_PER_UNIT 10\n"
HEADER = {
    "another scale for a core": (
        LSB, f"#ifdef __arm__\n{LSB.replace('10', '100')}#else\n{LSB}#endif\n", "__arm__"),
    "another scale for C++": (
        LSB, f"#ifdef __cplusplus\n{LSB.replace('10', '100')}#else\n{LSB}#endif\n", "defined else"),
    "a scale twice": (LSB, LSB + LSB, "is defined again"),
    "a scale with brackets": (LSB, LSB.replace("UNIT ", "UNIT() "), "'# define"),
    "a scale that is an expression": (LSB, LSB.replace("10", "5 + 5"), "'# define"),
    "a macro of another prefix": (LSB, LSB + "#define OTHER 1\n", "'# define OTHER 1'"),
    "no guard": ("#define FRONT_END_H\n", "", "a header without its FRONT_END_H"),
    "a guard that ends early": (
        "#include <stdint.h>\n", "#endif\n#include <stdint.h>\n#ifdef __cplusplus\n", "before its"),
    "a linkage": ('extern "C" {', 'extern "C" { typedef int32_t x;', "code behind"),
}  # fmt: skip


@pytest.mark.parametrize("what", HEADER)
def test_a_header_as_the_generator_never_writes_it_is_refused(what: str) -> None:
    before, after, told = HEADER[what]
    texts = {**write_front_end()}
    assert before in texts["front_end.h"]
    texts["front_end.h"] = texts["front_end.h"].replace(before, after, 1)
    with pytest.raises(RefusedError, match=rf"^front_end\.h:\d+:\d+: .*{told}"):
        read(texts, "front_end")


def test_a_header_of_c_that_lies_beside_the_model_is_refused() -> None:
    with pytest.raises(RefusedError, match=r"<stdint.h> is none of C's headers that are known"):
        read({**write_front_end(), "stdint.h": ""}, "front_end")


def test_a_place_counts_lines_and_columns_from_1() -> None:
    with pytest.raises(RefusedError, match=r"^m\.c:3:5: a tab"):
        split("/* two\nlines */\nint \tx;\n", "m.c", False)
    tokens = split("a /*\n*/ b\n  c\n", "m.c", False)
    assert [t.place for line in tokens for t in line] == ["m.c:1:1", "m.c:2:4", "m.c:3:3"]


def test_a_known_runtime_alone_joins_lines() -> None:
    texts = write_front_end()
    assert is_known(texts)
    assert any("\\\n" in text for name, text in texts.items() if name.startswith("zd_"))
    text = "#define A \\\n    1\nb\n"
    lines = split(text, "zd_a.h", True)
    assert [[t.text for t in line] for line in lines] == [["#", "define", "A", "1"], ["b"]]
    with pytest.raises(RefusedError):
        split(text, "a.h", False)
