"""Texts that no checker may take for a model's: each is a generated one with a piece changed."""

from pathlib import Path

from zerodrift_proof.certificate.preprocessor import CLAIM

NAME = "front_end"
H, C = f"{NAME}.h", f"{NAME}.c"
FILES = {name: (Path(__file__).parents[1] / "golden" / name).read_text() for name in (H, C)}

STEP = "    uint32_t flags = 0;\n    const int32_t in_0"
REST = "    front_end_init(s);\n    front_end_rest"
IF_PAIRS = "#if ZD_KERNEL == ZD_KERNEL_PAIRS\nstatic"
INCLUDE = '#include "zd_network.h"\n'
INDEX = "#define FRONT_END_FX 0 "
LSB = "#define FRONT_END_FX_LSB_PER_UNIT 1\n"
STRUCT = "/** Owned by the caller"
INIT = "void front_end_init(front_end_state_t *s) {"
HEAD = "static const int16_t head_weights[24] = {"
OBSERVE = "ZD_OBSERVE(&in_0, 1u);"
REFUSED: dict[str, tuple[str, str, str, str]] = {
    # comments, and what a compiler takes for one or for none
    "a character constant opens a comment": (
        C,
        STEP,
        "    (void)'/*';\n" + STEP + "/* done */",
        "a comment",
    ),
    "a macro that is a character constant": (
        H,
        LSB,
        LSB + "#define FRONT_END_NOTE '/*'\n",
        "a comment",
    ),
    "a comment ends by a continued line": (
        C,
        STEP,
        "/* x *\\\n/ s->steps = 0u; /* y */\n" + STEP,
        "backslash",
    ),
    "a comment of one line goes on": (C, STEP, "// x \\\n" + STEP, "backslash"),
    "a comment of one line": (C, STEP, "// x\n" + STEP, "'//'"),
    "a slash before a comment": (C, "    /* one comparison", "    //* one", "'//'"),
    "a comment in a comment": (C, STEP, "/* a /* b */\n" + STEP, "within a comment"),
    "a comment without an end": (
        H,
        "#endif /* FRONT_END_H */",
        "#endif /* FRONT_END_H",
        "without an end",
    ),
    "a comment's end alone": (C, STEP, "*/\n" + STEP, "did not begin"),
    "a comment within a line": (
        C,
        "flags = 0;\n    const",
        "flags /* x */ = 0;\n    const",
        "after a comment",
    ),
    "a macro that goes on after a comment": (
        H,
        LSB,
        LSB.rstrip() + " /* x\n */\n",
        "several lines",
    ),
    "a backslash in a comment": (C, STEP, "/* \\n */\n" + STEP, "backslash in a comment"),
    "a backslash in code": (C, STEP, "\\n" + STEP, "no operator"),
    "a trigraph": (C, STEP, "/* ??/\n*/\n" + STEP, "trigraph"),
    "a continued line": (C, STEP, "\\\n" + STEP, "backslash"),
    "a universal character name": (C, "int32_t in_0", "int32_t in_\\u0030", "backslash"),
    # characters
    "a tab": (C, STEP, "\t" + STEP, "printable ASCII"),
    "a carriage return": (C, STEP, "\r\n" + STEP, "printable ASCII"),
    "a form feed": (C, STEP, "\f" + STEP, "printable ASCII"),
    "a zero": (C, STEP, "\0" + STEP, "printable ASCII"),
    "a letter beyond ASCII": (C, STEP, "/* \u00b5 */\n" + STEP, "printable ASCII"),
    "a byte order mark": (C, "/* Drift", "\ufeff/* Drift", "printable ASCII"),
    "a dollar in a name": (C, "flags = 0;", "flags$ = 0;", "no operator"),
    "no end of the last line": (
        H,
        "#endif /* FRONT_END_H */\n",
        "#endif /* FRONT_END_H */",
        "has no end",
    ),
    # words
    "a digraph for a bracket": (C, "in_0, 1u);", "in_0, 1u); <% %>", "'<%'"),
    "a digraph for a square bracket": (C, "drift[k]", "drift<:k:>", "'<:'"),
    "a digraph for a hash": (C, STEP, "%:define x\n" + STEP, "'%:'"),
    "two hashes": (C, "flags = 0;", "fl ## ags = 0;", "'##'"),
    "a decrement": (C, "k++", "k--", "'--'"),
    "an octal number": (C, "    -11813,", "    -011813,", "octal"),
    "a long number": (C, "flags = 0;", "flags = 0l;", "no integer"),
    "a number of capital U": (C, "flags = 0;", "flags = 0U;", "no integer"),
    "hexadecimal of small letters": (C, "flags = 0;", "flags = 0xfu;", "no integer"),
    "a number of fractions": (C, "flags = 0;", "flags = .5;", "no integer"),
    "a number with an exponent": (C, "flags = 0;", "flags = 0xE+1;", "no integer"),
    "a binary number": (C, "flags = 0;", "flags = 0b1;", "no integer"),
    "a string": (C, "flags = 0;", 'flags = "x"[0];', "front_end.c"),
    "an escape in a string": (C, '"push {', '"\\x70ush {', "backslash"),
    "a string that does not end": (C, STEP, '    "\n' + STEP, "no line of assembly"),
    "a goto": (C, STEP, "    goto x;\n" + STEP, "'goto'"),
    "another loop": (C, STEP, "    while (1) { }\n" + STEP, "'while'"),
    "another type": (C, "uint32_t flags = 0;", "unsigned flags = 0;", "'unsigned'"),
    "a macro of another compiler": (C, STEP, "    (void)linux;\n" + STEP, "'linux'"),
    "__LINE__": (C, "flags = 0;", "flags = __LINE__;", "a name that"),
    "_Pragma": (C, STEP, '_Pragma("x")\n' + STEP, "a name that"),
    "__asm__": (C, STEP, '    __asm__("nop");\n' + STEP, "a name that"),
    "a macro of the runtime that is no number of a model": (
        C,
        "flags = 0;",
        "flags = ZD_TANH_LINES;",
        "a macro that",
    ),
    "a macro that is not there": (C, "flags = 0;", "flags = FRONT_END_NONE;", "a macro that"),
    "the include guard in code": (C, "flags = 0;", "flags = FRONT_END_H 0;", "a macro that"),
    "a macro beside the observed ones": (C, STEP, "    ZD_QUIET(1);\n" + STEP, "a macro that"),
    # conditions: whatever a compiler may define
    **{
        f"#ifdef {macro}": (C, STEP, f"#ifdef {macro}\n#endif\n" + STEP, "no directive")
        for macro in (
            "__STDC__",
            "__STDC_VERSION__",
            "INT32_MAX",
            "__LINE__",
            "__GNUC__",
            "__OPTIMIZE__",
            "__ARM_ARCH",
            "NDEBUG",
            "ZD_KERNEL",
            "ZD_SMALL",
            "ZD_TANH_HALF_LINES",
        )
    },
    **{
        f"#if {condition}": (
            C,
            STEP,
            f"#if {condition}\n#endif\n" + STEP,
            "no rule for the condition",
        )
        for condition in (
            "0",
            "1",
            "defined(__arm__)",
            "ZD_KERNEL",
            "ZD_KERNEL == 1",
            "defined(ZD_ASSEMBLY)",
            "ZD_KERNEL_PAIRS == 1",
            "ZD_TANH_LINES == 512",
            "ZD_RUNTIME_FORMAT == 3",
            "ZD_KERNEL==ZD_KERNEL_PAIRS",
            "defined ZD_SMALL",
            "FRONT_END_OUTPUTS == 3",
        )
    },
    "#elif of something else": (
        C,
        "#elif ZD_KERNEL == ZD_KERNEL_ROWS\nstatic",
        "#elif 1\nstatic",
        "no rule",
    ),
    "#else twice": (
        C,
        "#else\nstatic const int16_t gru",
        "#else\n#else\nstatic const int16_t gru",
        "after #else",
    ),
    "#endif alone": (C, STEP, "#endif\n" + STEP, "without #if"),
    "#else with something": (
        C,
        "#else\nstatic const int16_t gru",
        "#else x\nstatic const int16_t gru",
        "without #endif",
    ),
    "an #if without #endif": (C, INIT, "#if defined(ZD_SMALL)\n" + INIT, "without #endif"),
    "a header for some chips": (
        H,
        LSB,
        f"#ifdef __arm__\n{LSB.replace(' 1', ' 10')}#else\n{LSB}#endif\n",
        "FRONT_END_FX",
    ),
    "a header by the kernel, which it does not know yet": (
        H,
        STRUCT,
        "#if ZD_KERNEL == ZD_KERNEL_PAIRS\n#endif\n" + STRUCT,
        "FRONT_END_...",
    ),
    "another include guard": (H, "#ifndef FRONT_END_H", "#ifndef INT32_MAX", "#ifndef FRONT_END_H"),
    "C++ that sees more": (H, 'extern "C" {\n', 'extern "C" {\nint x;\n', "#endif"),
    "after the header's end": (
        H,
        "#endif /* FRONT_END_H */\n",
        "#endif\nvoid f(void);\n",
        "after the header",
    ),
    # other directives
    "#undef": (C, STEP, "#undef INT32_MAX\n" + STEP, "no directive"),
    "#pragma": (C, STEP, "#pragma pack(1)\n" + STEP, "no directive"),
    "#line": (C, STEP, "#line 7\n" + STEP, "no directive"),
    "#error": (C, STEP, '#error "x"\n' + STEP, "no directive"),
    "#include of a file": (C, INCLUDE, INCLUDE + '#include "more.h"\n', "is written"),
    "#include of the system": (C, INCLUDE, INCLUDE + "#include <stdlib.h>\n", "is written"),
    "#include that is not in the certificate": (
        C,
        INCLUDE,
        '#include "zd_more.h"\n',
        "not in the certificate",
    ),
    "#include twice": (C, INCLUDE, INCLUDE * 2, "twice"),
    "#include in the code": (C, STEP, INCLUDE + STEP, "no directive"),
    "#include of the header": (
        H,
        "#include <stdint.h>",
        "#include <stdlib.h>",
        "#include <stdint.h>",
    ),
    "a directive after a comment": (
        C,
        STEP,
        "/* x */ #define in_0 in_1\n" + STEP,
        "after a comment",
    ),
    "a directive after a blank": (C, STEP, " #define in_0 in_1\n" + STEP, "'#'"),
    "a directive with blanks": (H, INDEX, "#  define" + INDEX[7:], "FRONT_END_..."),
    # macros
    "a name replaced in the source": (
        C,
        STEP,
        "#define in_0 in_0_deadbeef\n" + STEP,
        "no directive",
    ),
    "a name replaced in the header": (
        H,
        INDEX,
        "#define in_0 in_0_deadbeef\n" + INDEX,
        "FRONT_END_...",
    ),
    "a type replaced": (H, INDEX, "#define int32_t int16_t\n" + INDEX, "FRONT_END_..."),
    "a keyword replaced": (H, INDEX, "#define const\n" + INDEX, "FRONT_END_..."),
    "a macro defined twice": (H, LSB, LSB + "#define FRONT_END_OUTPUTS 3\n", "a second time"),
    "a scale defined twice": (H, LSB, LSB * 2, "a second time"),
    "a macro with parameters": (H, LSB, LSB + "#define FRONT_END_F(x) x\n", "FRONT_END_..."),
    "a macro that nobody knows": (
        H,
        LSB,
        LSB + "#define FRONT_END_MORE 3\n",
        "no macro of a model's header",
    ),
    "a macro that is code": (H, "FRONT_END_CHANNELS 3", "FRONT_END_CHANNELS 3; x", "no value"),
    "a macro beyond 32 bits": (H, "UINT32_C(500000)", "UINT32_C(5000000000)", "no value"),
    "a macro of 8 digits in octal": (H, "FX_LSB_PER_UNIT 1", "FX_LSB_PER_UNIT 01", "no macro"),
    "an index that is a sum": (H, "FRONT_END_FX 0 ", "FRONT_END_FX (0) ", "no index"),
    "another observer": (
        C,
        "#define ZD_OBSERVE(values, count)\n",
        "#define ZD_OBSERVE(values, count) s->steps = 0\n",
        "is written",
    ),
    "claims that claim nothing": (C, CLAIM, "#define ZD_CLAIM(name, holds)", "no directive"),
    "claims of some builds": (C, CLAIM, f"#if defined(ZD_SMALL)\n{CLAIM}\n#endif", "no directive"),
    # what the runtime's macros are given
    "a call where nothing is compiled": (
        C,
        OBSERVE,
        "ZD_OBSERVE(front_end_state_is_sound(s), 1u);",
        "a place and its length",
    ),
    "a choice by a number": (
        C,
        STEP,
        "    drift[0] = 1 ? drift[0] + 1 : drift[0];\n" + STEP,
        "no comparison",
    ),
    "a choice by a comparison of numbers": (
        C,
        STEP,
        "    drift[0] = (1 > 0) ? drift[0] + 1 : drift[0];\n" + STEP,
        "one way only",
    ),
    "a choice by a comparison with itself": (
        C,
        STEP,
        "    drift[0] = (drift[0] == drift[0]) ? drift[0] + 1 : drift[0];\n" + STEP,
        "one way only",
    ),
    "a condition that is one number of two": (
        C,
        STEP,
        "    if ((s->steps != 0u) || (2 == 2)) {\n        s->steps = 0u;\n    }\n" + STEP,
        "one way only",
    ),
    "a condition that is a number": (
        C,
        STEP,
        "    if (s->steps) {\n        s->steps = 0u;\n    }\n" + STEP,
        "no comparison",
    ),
    "a place in brackets": (C, STEP, "    (drift)[0] += 1;\n" + STEP, "a place in brackets"),
    "a field of what is in brackets": (
        C,
        STEP,
        "    (s)->steps = 0u;\n" + STEP,
        "a place in brackets",
    ),
    "a sum in brackets that is assigned to": (
        C,
        STEP,
        "    (drift[0]) = 1;\n" + STEP,
        "a place in brackets",
    ),
    "a claim in a function": (C, STEP, "    ZD_CLAIM(x, 1);\n" + STEP, "outside of functions"),
    "a size that is a sum": (
        C,
        "ZD_PAIR_SCRATCH(3u, 8u)",
        "ZD_PAIR_SCRATCH(3u + 0u, 8u)",
        "is given integers",
    ),
    # declarations
    "attributes of a function in C": (
        C,
        "static uint32_t front_end_state_is_sound(const front_end_state_t *s) {",
        "static uint32_t front_end_state_is_sound(const front_end_state_t *s)\n"
        "    __attribute__((naked, noinline, used));\n"
        "static uint32_t front_end_state_is_sound(const front_end_state_t *s) {",
        "no function in C",
    ),
    "another attribute": (C, HEAD, HEAD.replace(" =", ' __attribute__((section("x"))) ='), "where"),
    "assembly without its attributes": (
        C,
        "int32_t u_keep)\n    __attribute__((naked, noinline, used));",
        "int32_t u_keep);",
        "no function of assembly",
    ),
    "assembly that is given its mask otherwise": (
        C,
        "const int16_t *x, int32_t u_keep)\n    __attribute__((naked, noinline, used));\n"
        "static void gru_assembly(const int32_t *stream ZD_IN_REGISTER,"
        " int32_t *h_q30 ZD_IN_REGISTER, const int16_t *x ZD_IN_REGISTER,"
        " int32_t u_keep ZD_IN_REGISTER) {",
        "const int16_t *x, uint8_t u_keep)\n    __attribute__((naked, noinline, used));\n"
        "static void gru_assembly(const int32_t *stream ZD_IN_REGISTER,"
        " int32_t *h_q30 ZD_IN_REGISTER, const int16_t *x ZD_IN_REGISTER,"
        " uint8_t u_keep ZD_IN_REGISTER) {",
        "no function of assembly",
    ),
    "no parameters named": (C, "gru_is_sound(void)", "gru_is_sound()", "(void) is written"),
    "parameters after the brackets": (
        C,
        INIT,
        "void front_end_init(s) front_end_state_t *s; {",
        "front_end.c",
    ),
    "a typedef once more": (
        C,
        INIT,
        "typedef struct {\n    int32_t x;\n} front_end_state_t;\n" + INIT,
        "a name was expected",
    ),
    "a struct of its own": (
        C,
        INIT,
        "typedef struct { int32_t x; } own_t;\n" + INIT,
        "no struct of a model",
    ),
    "a function that the compiler calls by itself": (
        C,
        INIT,
        "void memset(front_end_state_t *s) {\n    s->steps = 0u;\n}\n" + INIT,
        "are static",
    ),
    "the same, static": (
        C,
        INIT,
        "static void memset(front_end_state_t *s) {\n    s->steps = 0u;\n}\n" + INIT,
        "no function in C",
    ),
    "a table that the compiler calls": (
        C,
        INIT,
        "static const int32_t memset = 7;\n" + INIT,
        "NODE_PART",
    ),
    "a function of the runtime": (
        C,
        INIT,
        "static int32_t zd_asr32(int32_t x, uint32_t n) {\n    return x;\n}\n" + INIT,
        "the runtime's",
    ),
    "a variable of the runtime": (
        C,
        "uint32_t flags = 0;\n    const",
        "uint32_t zd_tanh_crc = 0;\n    const",
        "the runtime's",
    ),
    "an entry that is static": (C, INIT, "static " + INIT, "are static"),
    "a function of other files": (
        C,
        "static uint32_t front_end_advance",
        "uint32_t front_end_advance",
        "are static",
    ),
    "a body in the header": (
        H,
        "uint32_t front_end_selftest(void);",
        "uint32_t front_end_selftest(void) {\n    return 0u;\n}",
        "twice",
    ),
    "a constant in the header": (
        H,
        STRUCT,
        "static const int32_t x_y = 1;\n" + STRUCT,
        "in the header",
    ),
    "a name of two things": (
        C,
        INIT,
        "static const int32_t gru_step = 1;\n" + INIT,
        "of two things",
    ),
    "a variable that begins with itself": (
        C,
        "uint32_t flags = 0;\n    const",
        "uint32_t flags = flags;\n    const",
        "begins with itself",
    ),
}
"""What is tried -> (file, text, what it becomes, a part of the reason)."""
