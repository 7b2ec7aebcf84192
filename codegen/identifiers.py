"""C identifiers and comments from whatever a user's columns are called."""

import re
from collections.abc import Callable, Iterable

from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_DAMAGED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TARED,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    IntegerModel,
)

_KEYWORDS = frozenset(
    {
        "auto",
        "break",
        "case",
        "char",
        "const",
        "continue",
        "default",
        "do",
        "double",
        "else",
        "enum",
        "extern",
        "float",
        "for",
        "goto",
        "if",
        "inline",
        "int",
        "long",
        "register",
        "restrict",
        "return",
        "short",
        "signed",
        "sizeof",
        "static",
        "struct",
        "switch",
        "typedef",
        "union",
        "unsigned",
        "void",
        "volatile",
        "while",
        "_bool",
        "_complex",
        "_imaginary",
        "bool",
        "true",
        "false",
        "asm",
        "class",
        "new",
        "delete",
        "this",
        "template",
        "namespace",
        "operator",
        "private",
        "public",
        "protected",
        "virtual",
        # further words of C++, and its other spellings of operators, which C has as macros
        *(
            "alignas",
            "alignof",
            "and",
            "and_eq",
            "bitand",
            "bitor",
            "catch",
            "char16_t",
            "char32_t",
        ),
        *("char8_t", "compl", "concept", "const_cast", "consteval", "constexpr", "constinit"),
        *("co_await", "co_return", "co_yield", "decltype", "dynamic_cast", "explicit", "export"),
        *("friend", "mutable", "noexcept", "not", "not_eq", "nullptr", "or", "or_eq"),
        *("reinterpret_cast", "requires", "static_assert", "static_cast", "thread_local", "throw"),
        *("try", "typeid", "typename", "using", "wchar_t", "xor", "xor_eq"),
        # macros of the standard headers in lower case
        *("complex", "errno", "imaginary", "math_errhandling", "stderr", "stdin", "stdout"),
        "main",
        "linux",  # macros of compilers that run with their extensions
        "unix",
    }
)
"""Of C99 and C++, since the header may be included from either."""
_STANDARD_HEADERS = re.compile(
    "assert|complex|ctype|errno|fenv|inttypes|iso646|limits|locale|math|memory|setjmp|signal|stdarg"
    "|stdbool|stddef|stdint|stdio|stdlib|stdalign|stdatomic|stdnoreturn|string|strings|tgmath|threads|time|wchar|wctype"
)
"""The model's own header must not hide one of these."""
_STANDARD_FUNCTIONS = frozenset({"atomic", "cnd", "mtx", "sem"})
"""Prefixes with an ..._init in threads.h, stdatomic.h or semaphore.h."""
_NUMBERS = (
    r"(U?INT(8|16|32|64|MAX|PTR|_(LEAST|FAST)(8|16|32|64))?|[SU]?CHAR|U?(SHRT|LONG|LLONG)|S?SIZE"
    r"|PTRDIFF|SIG_ATOMIC|WCHAR|WINT|BOOL)_(MIN|MAX|C|BIT|WIDTH)"
)
_FLOATS = (
    r"(FLT|DBL|LDBL)_(\w*DIG|\w*(MIN|MAX)(_10)?(_EXP)?|EPSILON|RADIX|ROUNDS|EVAL_METHOD|HAS_SUBNORM"
    r"|IS_IEC_60559|SNAN)|DECIMAL_DIG"
    r"|FP_(INFINITE|(SUB)?NORMAL|NAN|ZERO|ILOGB0|ILOGBNAN|FAST_FMA[FL]?)"
    r"|FE_(ALL_EXCEPT|DFL_ENV|DIVBYZERO|INEXACT|INVALID|OVERFLOW|UNDERFLOW|DOWNWARD|TONEAREST"
    r"|TOWARDZERO|UPWARD)|HUGE_VAL[FL]?|MATH_(ERRNO|ERREXCEPT)"
    r"|M_(E|PI|[12]_PI|PI_[24]|2_SQRTPI|SQRT2|SQRT1_2|LN2|LN10|LOG2E|LOG10E)"
)
_OTHERS = (
    r"CLOCKS_PER_SEC|TIME_UTC|EXIT_(SUCCESS|FAILURE)|SEEK_(SET|CUR|END)|MB_(CUR|LEN)_MAX"
    r"|(RAND|TMP|FILENAME|FOPEN|PATH|NAME|OPEN|IOV|ARG)_MAX|PIPE_BUF|SIG_(DFL|ERR|IGN)"
    r"|LC_(ADDRESS|ALL|COLLATE|CTYPE|IDENTIFICATION|MEASUREMENT|MESSAGES|MONETARY|NAME|NUMERIC|PAPER"
    r"|TELEPHONE|TIME)|ATOMIC_\w+_(LOCK_FREE|INIT)|ONCE_FLAG_INIT|TSS_DTOR_ITERATIONS"
)
_STANDARD_MACROS = re.compile(f"{_NUMBERS}|{_FLOATS}|{_OTHERS}")
"""Of the headers of C, and of limits.h and math.h on POSIX."""
RESERVED_OUTPUTS = re.compile(
    r"h|format|manifest|forced|model_hash|model_id|code_id|channels|outputs|sample_period_us"
    r"|saved_bytes|flag_.*|fault_.*|.*_lsb_per_unit"
)
"""Macros of the header that the macro of an output's index must not take."""
_LONGEST = 31  # characters that C99 promises to tell apart in external names


def sanitize_identifier(text: str, fallback: str = "sensor") -> str:
    """Return a lower-case C identifier made of the letters and digits of `text`.

    Never a keyword, never reserved (no leading or doubled underscore), never starting with `zd_`,
    which is the runtime's prefix.

    Example:
        >>> sanitize_identifier("*/ #include <stdio.h>"), sanitize_identifier("6 axis"), \
            sanitize_identifier("int")
        ('include_stdio_h', 'x6_axis', 'int_x')
    """
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:_LONGEST].rstrip("_")
    if not name:
        name = fallback
    if name[0].isdigit():
        name = f"x{name}"[:_LONGEST].rstrip("_")
    if name == "zd" or name.startswith("zd_"):
        name = f"x_{name}"[:_LONGEST].rstrip("_")
    if name in _KEYWORDS:
        name = f"{name[: _LONGEST - 2]}_x"
    return name


def sanitize_prefix(text: str) -> str:
    """Return the identifier that names a model's files and functions.

    Never the name of a standard header, which the model's own would hide, nor one whose functions
    C has already.
    """
    name = sanitize_identifier(text)
    taken = _STANDARD_HEADERS.fullmatch(name) or name in _STANDARD_FUNCTIONS
    return f"{name}_x" if taken else name


def sanitize_outputs(texts: Iterable[str], prefix: str) -> list[str]:
    """Return the outputs' names, whose macros are `prefix` and name in capitals.

    None is a macro of the header's own or of a standard header; one that would be gets _x.

    Example:
        >>> sanitize_outputs(["max", "Fz"], "int8"), sanitize_outputs(["max", "H"], "ft40")
        (['max_x', 'fz'], ['max', 'h_x'])
    """

    def is_taken(name: str) -> bool:
        standard = _STANDARD_MACROS.fullmatch(f"{prefix}_{name}".upper())
        return bool(standard or RESERVED_OUTPUTS.fullmatch(name))

    return sanitize_identifiers(texts, "output", is_taken)


def sanitize_identifiers(
    texts: Iterable[str], fallback: str, is_taken: Callable[[str], bool] = lambda _: False
) -> list[str]:
    """Return one distinct identifier per text, in order; equal ones get _2, _3, ...

    Args:
        texts: what the user calls them.
        fallback: for a text without letters and digits.
        is_taken: tells names that stand for other things; these get _x.
    """
    names: list[str] = []
    for text in texts:
        base = sanitize_identifier(text, fallback)
        if is_taken(base):
            base = f"{base[: _LONGEST - 2]}_x"
        name, count = base, 1
        while name in names:
            count += 1
            suffix = f"_{count}"
            name = base[: _LONGEST - len(suffix)] + suffix
        names.append(name)
    return names


def sanitize_comment(text: str) -> str:
    """Return printable ASCII that cannot end a comment, continue a line or form a trigraph."""
    clean = "".join(c if " " <= c <= "~" and c not in '*\\?"' else "_" for c in text)
    return clean[:80]


# Names of a model, its inputs and its outputs in the C.


def name_prefix(model: IntegerModel) -> str:
    """Return what every name of the model's C begins with."""
    return sanitize_prefix(model.prefix or model.name)


def name_channels(model: IntegerModel) -> list[str]:
    """Return the fields of the input struct, one per channel."""
    return sanitize_identifiers((c.name for c in model.channels), "input")


def name_outputs(model: IntegerModel) -> list[str]:
    """Return the outputs' names as the header and the CAN frames call them, in lower case."""
    return sanitize_outputs((o.name for o in model.outputs), name_prefix(model))


def list_flags(model: IntegerModel) -> dict[str, int]:
    """Return the flags that a step may return, by the names in the header."""
    flags = {
        "WARMING_UP": FLAG_WARMING_UP,
        "TEMPERATURE_RANGE": FLAG_TEMPERATURE_RANGE,
        "RATE_RANGE": FLAG_RATE_RANGE,
        "CLAMPED": FLAG_CLAMPED,
        "DAMAGED": FLAG_DAMAGED,
    }
    if model.guards.ranges:
        flags["INPUT_RANGE"] = FLAG_INPUT_RANGE
    if model.optional:
        flags["NO_READING"] = FLAG_NO_READING
    if model.tare:
        flags["TARED"] = FLAG_TARED
    return flags
