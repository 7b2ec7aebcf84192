"""Changes of meaning that hide behind C's lexical grammar, its preprocessor and its redefinitions.

Each trick takes a model's two files and returns one of them changed: a compiler, one at least,
sees other tokens, another type or another definition than somebody who reads the text as the
generator writes it. Nothing here knows how zerodrift's checkers read C.
"""

import random
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

MACROS = (
    *("__STDC__", "__STDC_VERSION__", "__STDC_HOSTED__", "__LINE__", "__FILE__", "__GNUC__"),
    *("__OPTIMIZE__", "__CHAR_BIT__", "__SIZEOF_INT__", "__SIZEOF_LONG__", "__x86_64__", "__arm__"),
    *("__ARM_ARCH", "__thumb__", "__linux__", "__ELF__", "__unix__", "__VERSION__", "__DATE__"),
    *("INT32_MAX", "INT64_MAX", "UINT8_MAX", "INT32_C", "NDEBUG", "__BYTE_ORDER__", "__INT_MAX__"),
    *("__SANITIZE_ADDRESS__", "__NO_INLINE__", "__COUNTER__", "__INCLUDE_LEVEL__", "__BASE_FILE__"),
)
"""Names that some compiler defines; `#ifdef` on one is a condition of its own."""
HARMS = (
    "drift[0] += 1;",
    "drift[0] ^= 1;",
    "drift[0] = drift[0] * 65537 + 1;",
    "drift[0] = -drift[0] - 1;",
    "flags ^= 8u;",
    "s->steps = 1u;",
)
"""Statements that change what a step answers, some of them by an overflow."""
WIDTHS = (("int64_t", "int32_t"), ("int32_t", "int16_t"), ("uint32_t", "uint64_t"))


@dataclass(frozen=True)
class Pair:
    """A model's own two files."""

    prefix: str
    header: str
    source: str

    @property
    def upper(self) -> str:
        """The prefix of its macros."""
        return self.prefix.upper()


Change = tuple[str, str]
"""h or c, and the whole text."""
Trick = Callable[[Pair, random.Random], Change | None]


def read_pair(files: Mapping[str, str], prefix: str) -> Pair:
    """Return the two files of a firmware folder that are the model's own."""
    return Pair(prefix, files[f"{prefix}.h"], files[f"{prefix}.c"])


def _find_end(pair: Pair) -> int | None:
    """Return where the step's last line stands, `return flags;` of the function that computes."""
    begin = re.search(rf"^static uint32_t {pair.prefix}_advance\(", pair.source, re.M)
    place = pair.source.find("\n    return flags;\n", begin.end() if begin else 0)
    return None if place < 0 else place + 1


def _find_statement(pair: Pair, rng: random.Random) -> tuple[int, int] | None:
    """Return the span of a whole line of the step that assigns something."""
    begin = re.search(rf"^static uint32_t {pair.prefix}_advance\(", pair.source, re.M)
    end = _find_end(pair)
    if begin is None or end is None:
        return None
    lines = [
        (m.start() + begin.end(), m.end() + begin.end())
        for m in re.finditer(
            r"^ {4,}(?!const |return |int|for |if |\})[\w>\[\]-]+ (?:[|+^]?=) [^\n]*;\n"
            r"|^ {4,}gru_step\([^\n]*;\n",
            pair.source[begin.end() : end],
            re.M,
        )
    ]
    return rng.choice(lines) if lines else None


def _put(pair: Pair, text: str) -> Change | None:
    """Return the source with some text before the step's last line."""
    end = _find_end(pair)
    return None if end is None else ("c", pair.source[:end] + text + pair.source[end:])


def _after_includes(pair: Pair, text: str) -> Change:
    """Return the source with some text after its last `#include`."""
    end = max(m.end() for m in re.finditer(r"^#include [^\n]*\n", pair.source, re.M))
    return "c", pair.source[:end] + text + pair.source[end:]


def _wrap(*ways: tuple[str, str]) -> Trick:
    """Return a trick that adds a statement between two texts."""

    def trick(pair: Pair, rng: random.Random) -> Change | None:
        before, after = rng.choice(ways)
        return _put(pair, f"{before}    {rng.choice(HARMS)}\n{after}")

    return trick


def _drop(*ways: tuple[str, str]) -> Trick:
    """Return a trick that takes a statement away between two texts."""

    def trick(pair: Pair, rng: random.Random) -> Change | None:
        span = _find_statement(pair, rng)
        if span is None:
            return None
        before, after = rng.choice(ways)
        line = pair.source[slice(*span)]
        return "c", pair.source[: span[0]] + before + line + after + pair.source[span[1] :]

    return trick


def _add(*texts: str) -> Trick:
    """Return a trick that adds a statement of its own before the step's last line."""
    return lambda pair, rng: _put(pair, f"    {rng.choice(texts)}\n")


def _define(*texts: str) -> Trick:
    """Return a trick that adds directives after the includes; @P@ and @U@ are the prefix."""

    def trick(pair: Pair, rng: random.Random) -> Change:
        text = rng.choice(texts).replace("@P@", pair.prefix).replace("@U@", pair.upper)
        return _after_includes(pair, text + "\n")

    return trick


def _known_macro(pair: Pair, rng: random.Random) -> Change | None:
    name = rng.choice(MACROS)
    condition = rng.choice(
        [f"#ifdef {name}", f"#if defined({name})", f"#if defined {name}", f"#ifndef {name}"]
    )
    return _put(pair, f"{condition}\n    {rng.choice(HARMS)}\n#endif\n")


def _known_macro_else(pair: Pair, rng: random.Random) -> Change | None:
    span = _find_statement(pair, rng)
    if span is None:
        return None
    name = rng.choice(MACROS)
    line = pair.source[slice(*span)]
    other = f"    {rng.choice(HARMS)}\n"
    both = [f"#ifndef {name}\n{line}#else\n{other}#endif\n", f"#ifndef {name}\n{line}#endif\n"]
    return "c", pair.source[: span[0]] + rng.choice(both) + pair.source[span[1] :]


def _known_macro_define(pair: Pair, rng: random.Random) -> Change | None:
    """The header says another number where a compiler defines a name."""
    found = list(re.finditer(rf"^#define {pair.upper}_\w+_LSB_PER_UNIT (\d+)\n", pair.header, re.M))
    if not found:
        return None
    one, name = rng.choice(found), rng.choice(MACROS)
    other = one[0].replace(f" {one[1]}\n", f" {10 * int(one[1])}\n")
    text = f"#ifdef {name}\n{other}#else\n{one[0]}#endif\n"
    return "h", pair.header[: one.start()] + text + pair.header[one.end() :]


def _second_define(pair: Pair, rng: random.Random) -> Change | None:
    """A macro of the header is defined once more."""
    pattern = rf"^#define ({pair.upper}_(?:\w+_LSB_PER_UNIT|FLAG_\w+|FAULT_\w+|SAMPLE_PERIOD_US)) "
    found = list(re.finditer(pattern + r"(?:UINT32_C\()?(\d+)\)?", pair.header, re.M))
    if not found:
        return None
    one = rng.choice(found)
    undo = rng.choice(["", f"#undef {one[1]}\n", f"#  undef {one[1]} /* once */\n"])
    line = f"{undo}#define {one[1]} {2 * int(one[2])}\n"
    end = pair.header.index("\n", one.end()) + 1
    if rng.random() < 0.5:
        return "h", pair.header[:end] + line + pair.header[end:]
    return _after_includes(pair, line)


def _octal(pair: Pair, rng: random.Random) -> Change | None:
    """A number written in another base, or in pieces, or as a character."""
    begin = re.search(rf"^static uint32_t {pair.prefix}_advance\(", pair.source, re.M)
    if begin is None:
        return None
    found = [
        m
        for m in re.finditer(r"(?<![\w.])([1-7][0-7]{1,9})(?=[u,);\]])", pair.source)
        if m.start() > begin.end() or re.match(r"    -?\d", pair.source[m.start() - 4 :])
    ]
    if not found:
        return None
    one = rng.choice(found)
    text = one[1]
    new = rng.choice([f"0{text}", f"0x{text}", f"{text}\\\n0", f"{text}e1", f"{text}??/\n0"])
    return "c", pair.source[: one.start()] + new + pair.source[one.end() :]


def _rename(pair: Pair, rng: random.Random) -> Change | None:
    """A macro gives one name of the step the meaning of another."""
    begin = re.search(rf"^static uint32_t {pair.prefix}_advance\(", pair.source, re.M)
    names = re.findall(r"^    const int32_t (\w+) =", pair.source, re.M)
    if begin is None or len(names) < 2:
        return None
    one, other = rng.sample(list(dict.fromkeys(names)), 2)
    end = pair.source.find(f"    ZD_OBSERVE(&{one},", begin.end())
    if end < 0:
        return None
    text = rng.choice(
        [f"#define {one} {other}\n", f"#define {one} (-{one})\n", f"#define {one} 7\n"]
    )
    return "c", pair.source[:end] + text + pair.source[end:]


def _suffix(pair: Pair, rng: random.Random) -> Change | None:
    """A name with a tail, as if a linker had given it."""
    names = re.findall(r"^static const u?int\d+_t (\w+)\[", pair.source, re.M)
    if not names:
        return None
    name = rng.choice(names)
    declared = re.search(
        rf"^static const (\w+) {name}\[([^\]]*)\]((?:\[[^\]]*\])*) = ", pair.source, re.M
    )
    if declared is None:
        return None
    tail = f"{name}_{rng.randrange(16**8):08x}"
    zero = f"static const {declared[1]} {tail}[{declared[2]}]{declared[3]} = {{0}};\n"
    place = pair.source.find(f"static void {pair.prefix}_rest(")
    if place < 0:
        return None
    return "c", pair.source[:place] + f"{zero}#define {name} {tail}\n" + pair.source[place:]


def _shadow(pair: Pair, rng: random.Random) -> Change | None:
    """A block declares a name again."""
    place = pair.source.find("        drift[0] = (int32_t)limited;\n")
    if place < 0:
        return None
    text = rng.choice(
        [
            f"        int32_t drift[{pair.upper}_OUTPUTS];\n",
            "        typedef int16_t int32_t;\n",
            "        {int64_t limited = 1; drift[0] = (int32_t)limited; return flags; }\n",
            "        enum { limited = 3 };\n",
            "        static int32_t drift[9];\n",
            "        const int64_t sum = 5, limited = sum;\n",
        ]
    )
    if "enum" in text or "sum =" in text:
        rest = "        drift[0] = (int32_t)limited;\n        return flags;\n        }\n"
        text = f"        {{\n{text}{rest}"
    return "c", pair.source[:place] + text + pair.source[place:]


def _layout(pair: Pair, rng: random.Random) -> Change | None:
    """The header's structures are laid out in another way, or their fields are others."""
    header = pair.header
    field = re.search(r"^    int16_t (\w+);", header, re.M)
    state = re.search(r"^    int32_t (\w+)(\[\d+\])?;", header, re.M)
    ways = []
    if field:
        ways += [
            (field[0], field[0].replace("int16_t", "uint16_t")),
            (field[0], f"    int16_t {field[1]} : 9;"),
            (field[0], f"    int16_t {field[1]} __attribute__((mode(QI)));"),
            (field[0], f"    _Alignas(64) int16_t {field[1]};"),
            (field[0], f"    union {{ int16_t {field[1]}; int8_t low; }};"),
            (field[0], f"    signed char {field[1]};"),
        ]
    if state:
        ways += [
            (state[0], state[0].replace("int32_t", "volatile int32_t")),
            (state[0], state[0].replace("int32_t", "int64_t")),
            (state[0], f"{state[0]}\n    uint32_t more;"),
        ]
    ways.append(
        (f"}} {pair.prefix}_state_t;", f"}} __attribute__((packed)) {pair.prefix}_state_t;")
    )
    ways.append(
        (f"}} {pair.prefix}_state_t;", f"}} __attribute__((aligned(64))) {pair.prefix}_state_t;")
    )
    ways.append(("#include <stdint.h>\n", "#include <stdint.h>\n#pragma pack(1)\n"))
    ways.append(("#include <stdint.h>\n", '#include <stdint.h>\n_Pragma("pack(1)")\n'))
    before, after = rng.choice(ways)
    return None if before not in header else ("h", header.replace(before, after, 1))


def _retype(pair: Pair, rng: random.Random) -> Change:
    wide, narrow = rng.choice(WIDTHS)
    text = rng.choice([f"#define {wide} {narrow}\n", f"#define const\n#define {wide} {narrow}\n"])
    if rng.random() < 0.5:
        return _after_includes(pair, text)
    mark = "#include <stdint.h>\n"
    return "h", pair.header.replace(mark, mark + text, 1)


def _other_step(pair: Pair, rng: random.Random) -> Change | None:
    """Whoever links gets another function by the step's name."""
    p, out = pair.prefix, f"int32_t drift[{pair.upper}_OUTPUTS]"
    head = f"uint32_t {p}_step({p}_state_t *s, const {p}_input_t *in, {out})"
    call = f"    uint32_t flags = {p}_step_b(s, in, drift);\n"
    body = f"{{\n{call}    {rng.choice(HARMS)}\n    return flags;\n}}\n"
    place = pair.source.find(f"uint32_t {p}_step(")
    if place < 0:
        return None
    before, after = pair.source[:place], pair.source[place:]
    renamed = f"#define {p}_step {p}_step_b\n{after}\n#undef {p}_step\n"
    apart = f"static {after.replace(f'{p}_step(', f'{p}_step_b(', 1)}\n"
    return "c", f"{before}{rng.choice([renamed, apart])}{head} {body}"


def _designate(pair: Pair, rng: random.Random) -> Change | None:
    """A table's entries in another order, by C99's designators, or as an expression."""
    found = list(
        re.finditer(
            r"^(static const u?int\d+_t \w+\[\d+\] = \{[^\n]*\n?\s*)(-?\d+), (-?\d+),",
            pair.source,
            re.M,
        )
    )
    if not found:
        return None
    one = rng.choice(found)
    first, second = one[2], one[3]
    new = rng.choice(
        [
            f"[1] = {second}, [0] = {second},",
            f"{first}, [1] = {first},",
            f"({second}, {first}) + 1, {second},",
            f"{first} + 1, {second},",
            f"{first} -{second}, {second},"
            if not second.startswith("-")
            else f"{first} {second}, {second},",
            f"'\\1', {second},",
            f"(int8_t){first}, {second},",
            f"sizeof(int), {second},",
        ]
    )
    return "c", pair.source[: one.start(2)] + new + pair.source[one.end() :]


def _unicode(pair: Pair, rng: random.Random) -> Change | None:
    texts = (
        "    int32_t \\u0064rift_ = 0; drift_ = 1; drift[0] += \\u0064rift_;\n",
        "    int32_t dri\u0455t = 1; drift[0] += dri\u0455t;\n",
        "\f    drift[0] += 1;\n",
        "\v    drift[0] += 1;\n",
        "    drift[0]\t+=\t1;\r\n",
        "    drift[0] += L'a';\n",
        "    drift[0] += '\\x41';\n",
        '    drift[0] += "/*"[0];\n',
        "    drift[0] += 'ab';\n",
    )
    return _put(pair, rng.choice(texts))


TRICKS: dict[str, Trick] = {
    "a comment that begins in a character constant": _wrap(
        ("#define NOTE_OPEN '/*'\n", "/* done */\n"),
        ("#define NOTE_OPEN (0, '/*')\n", "    /* ' */\n"),
        ("    (void)'/*';\n", "    /* done */\n"),
        ("#define NOTE '\"'\n    (void)\"/*\";\n", "    /* \" */\n"),
    ),
    "a comment that begins in a string": _wrap(
        ('    (void)"/*";\n', "    /* */\n"),
        ('    (void)"\\"/*";\n', '    /* " */\n'),
        ('    (void)"//"; ', ""),
        ("    static const char note[] = \"/*\"; (void)note;\n", "    (void)\"*/\";\n"),
    ),
    "a comment that ends across a line": _wrap(
        ("    /* x *\\\n/ ", "    /* y */\n"),
        ("    /\\\n* x */ ", "    /* y */\n"),
        ("    /* x *??/\n/ ", "    /* y */\n"),
        ("    /* x *\\  \n/ ", "    /* y */\n"),
    ),
    "a comment within a comment": _wrap(
        ("    /* /* */\n", "    /* */\n"),
        ("    /* /* x */\n", "    // */\n"),
        ("    // /*\n", "    // */\n"),
        ("    /*/*/\n", "    /*/ */\n"),
        ("    //*\n", "    //*/\n"),
    ),
    "a statement deleted by a line that goes on": _drop(
        ("    // note \\\n", ""),
        ("    // note ??/\n", ""),
        ("    // note \\ \n", ""),
        ("#define NOTE \\\n", ""),
        ("#define NOTE(x) x \\\n", ""),
        ("#pragma GCC poison nothing \\\n", ""),
    ),
    "a condition on a name that a compiler defines": _known_macro,
    "another statement where a compiler defines a name": _known_macro_else,
    "another number where a compiler defines a name": _known_macro_define,
    "a condition that is true": _wrap(
        ("#if 1\n", "#endif\n"),
        ("#if 0\n#else\n", "#endif\n"),
        ("#if 0\n#elif 1\n", "#endif\n"),
        ("#if ZD_KERNEL >= 0\n", "#endif\n"),
        ("#ifndef NEVER_DEFINED\n", "#endif\n"),
        ("#if 'a' == 97\n", "#endif\n"),
        ("#if (-1 > 0u)\n", "#endif\n"),
        ("#if 0 ? 0 : 1\n", "#endif\n"),
        ("#if !(010 == 10)\n", "#endif\n"),
        ("#ifdef ZD_OBSERVE\n", "#endif\n"),
        ("%:if 1\n", "%:endif\n"),
        ("??=if 1\n", "??=endif\n"),
        ("#\\\nif 1\n", "#endif\n"),
        ("/* */ # /* */ if 1\n", "#endif\n"),
        ("#if __has_include(<stdint.h>)\n", "#endif\n"),
        ("#if 0\n'/*'\n#endif\n", "    /* */\n"),
        ("#if 0\n#if 0\n#endif\n#else\n", "#endif\n"),
    ),
    "a statement under a condition that is false": _drop(
        ("#if 0\n", "#endif\n"),
        ("#ifdef NEVER_DEFINED\n", "#endif\n"),
        ("#if 1 - 1\n", "#endif\n"),
        ("#if ZD_KERNEL > 99\n", "#endif\n"),
        ("#if 0x0\n", "#endif\n"),
        ("%:if 0\n", "%:endif\n"),
    ),
    "digraphs and trigraphs": _wrap(
        ("    <% drift<:0:> += 1; %>\n", ""),
        ("    ??< drift??(0??) += 1; ??>\n", ""),
        ("%:define NOTE drift[0] += 1;\n    NOTE\n", ""),
        ("??=define NOTE drift[0] += 1;\n    NOTE\n", ""),
        ("    drift[0] ??'= 3;\n", ""),
    ),
    "tokens in pieces": _add(
        "drift[0] +\\\n= 1;",
        "dri\\\nft[0] += 1;",
        "drift[0] = drift[0] <\\\n< 1 | 1;",
        "drift[0] = drift[0] -\\\n- - 5 ? 3 : 4;",
        "drift[0] = drift[0]+++1;",
        "drift[0] = 1 ? drift[0] + 1 : drift[0];",
    ),
    "characters beyond the usual": _unicode,
    "another base": _octal,
    "a name that means another": _rename,
    "a table's name with a tail": _suffix,
    "a macro defined again": _second_define,
    "a function of the runtime as a macro": _define(
        "#define zd_asr64(x, n) ((x) >> ((n) + 1u))",
        "#define zd_clamp64(x, low, high) ((void)(low), (void)(high), (x) + 1)",
        "#define zd_clamp32(x, low, high) ((x) / 2)",
        "#define zd_round_shift64(x, n) ((x) >> (n))",
        "#define zd_clamp64(x, ...) ((x) ^ 1)",
        "#define zd_clamp64(...) (zd_clamp64)(__VA_ARGS__) + 1",
    ),
    "a macro of the standard defined again": _define(
        "#undef INT64_C\n#define INT64_C(x) (x##LL + 1)",
        "#undef UINT32_C\n#define UINT32_C(x) (x##u ^ 1u)",
        "#undef INT64_C\n#define INT64_C(x) INT64_C_(x)\n#define INT64_C_(x) ((int64_t)(x) - 1)",
        "#define INT64_C(x) (1 + x##LL)",
        "#pragma push_macro(\"INT64_C\")\n#undef INT64_C\n#define INT64_C(x) (x##LL + 1)",
    ),
    "a word of the language as a macro": _define(
        "#define static",
        "#define if(x) if ((x) && 0)",
        "#define for(x) for (x) if (0)",
        "#define return return 1u +",
        "#define const volatile",
        "#define else",
        "#define int64_t int",
        "#define uint8_t signed char",
        "#define int16_t signed char",
        "#define int32_t unsigned",
    ),
    "a type of another width": _retype,
    "a name declared again": _shadow,
    "another layout": _layout,
    "another function by the step's name": _other_step,
    "a table's entries by designators and expressions": _designate,
    "words of one compiler": _add(
        "drift[0] += __builtin_constant_p(1);",
        "drift[0] += _Generic(drift[0], int: 1, default: 0);",
        "drift[0] += ({ int x = 1; x; });",
        "drift[0] += __LINE__;",
        "drift[0] += __COUNTER__ + 1;",
        "drift[0] += (int)sizeof(long);",
        "drift[0] += (int)_Alignof(int64_t);",
        "drift[0] += __builtin_popcount(7u);",
        "drift[0] += __extension__ 1;",
        "drift[0] = drift[0] ?: 5;",
        "drift[0] += (__INT32_TYPE__)1;",
        "drift[0] += (int)__func__[0];",
        "drift[0] += (int)__alignof__(int64_t);",
        "drift[0] += __STDC__;",
        "drift[0] += __CHAR_BIT__;",
        "drift[0] += __BASE_FILE__[0];",
    ),
    "assembly": _add(
        '__asm__ volatile("" : "=r"(drift[0]) : "0"(drift[0] + 1));',
        '__asm volatile("" : "=r"(drift[0]) : "0"(7));',
        'asm("" : "=r"(drift[0]) : "0"(drift[0] ^ 1));',
        'register int32_t x __asm__("ebx") = 1; drift[0] += x;',
        '__asm__ goto("" : : : : away); drift[0] += 1; away: ;',
    ),
    "another control flow": _add(
        "goto away; away: drift[0] += 1;",
        "switch (drift[0] & 1) { case 0: drift[0] += 2; break; default: drift[0] -= 2; }",
        "do { drift[0] += 1; } while (0);",
        "while (drift[0] < 5) { drift[0] += 1; }",
        "if (drift[0] != 0) drift[0] += 1; else drift[0] -= 1;",
        "return flags ^ 8u;",
        "{ return 0; }",
        "(void)(drift[0]++, 0);",
        "(drift)[0] += 1;",
        "0[drift] += 1;",
        "*drift += 1;",
        "*&drift[0] += 1;",
        "*(drift + 0) += 1;",
        "((int16_t *)drift)[0] ^= 1;",
        "(&drift[1])[-1] += 1;",
        "drift[0] += (int32_t){1};",
        "int32_t *d = drift; d[0] += 1;",
        "for (uint32_t drift_ = 0; drift_ < 1u; drift_++) { drift[drift_] += 1; }",
    ),
    "attributes": _define(
        "__attribute__((constructor)) static void begin(void) { __builtin_trap(); }",
        ("static void late(int32_t *x) { x[0] = 5; }\n"
         "#define limited limited __attribute__((cleanup(late_)))\n"
         "static void late_(const int64_t *x) { *(int64_t *)x = 0; }"),
        ("static inline __attribute__((always_inline)) int64_t more(int64_t x) { return x + 1; }\n"
         "#define zd_asr64(x, n) more(zd_asr64((x), (n)))"),
        ("extern int32_t zd_hook; int32_t zd_hook = 1;\n"
         "#define zd_clamp64(x, a, b) zd_clamp64((x) + zd_hook, (a), (b))"),
        ("__attribute__((weak)) int32_t zd_shift = 1;\n"
         "#define zd_asr64(x, n) zd_asr64((x), (n) - (uint32_t)zd_shift)"),
    ),
    "another file": _define(
        "#include <iso646.h>\n#define zd_clamp64(x, a, b) zd_clamp64((x) xor 1, (a), (b))",
        ("#include <limits.h>\n"
         "#define zd_clamp64(x, a, b) zd_clamp64((x) + (CHAR_BIT == 8), (a), (b))"),
        ("#include <stddef.h>\n"
         "#define zd_clamp64(x, a, b) zd_clamp64((x) + (int)sizeof(size_t), (a), (b))"),
    ),
    "tokens pasted": _define(
        ("#define GLUE(a, b) a##b\n"
         "#define zd_clamp64(x, a, b) GLUE(zd_clamp, 64)((x) + 1, (a), (b))"),
        "#define EMPTY\n#define zd_asr64 EMPTY zd_asr64_\n#define zd_asr64_(x, n) ((x) >> (n) ^ 1)",
        "#define TEXT(x) #x\n#define zd_clamp64(x, a, b) ((x) + (TEXT(a)[0] == 'I'))",
    ),
}  # fmt: skip


def draw_lexical(
    files: Mapping[str, str], prefix: str, seed: int, number: int
) -> tuple[str, str, str]:
    """Return the trick's name, the file's name and its changed text.

    Args:
        files: name -> text of a firmware folder.
        prefix: of the model's own two files.
        seed: of all mutants.
        number: of this one; tricks follow each other, so that each has its turn.
    """
    pair = read_pair(files, prefix)
    names = list(TRICKS)
    for attempt in range(1000):
        rng = random.Random(f"{seed}/{number}/{attempt}")
        name = names[(number + attempt) % len(names)]
        change = TRICKS[name](pair, rng)
        if change is not None:
            file = f"{prefix}.{change[0]}"
            if change[1] != files[file]:
                return name, file, change[1]
    raise ValueError(f"{prefix}: no trick applies to these files")
