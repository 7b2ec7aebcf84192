"""Names in the C from names that a user chose (docs/reference/c-interface.md)."""

import re
from collections.abc import Callable, Iterable

_WORDS = frozenset(
    [
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
        "asm",
        "bool",
        "true",
        "false",
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
        "alignas",
        "alignof",
        "and",
        "and_eq",
        "bitand",
        "bitor",
        "catch",
        "char16_t",
        "char32_t",
        "char8_t",
        "compl",
        "concept",
        "const_cast",
        "consteval",
        "constexpr",
        "constinit",
        "co_await",
        "co_return",
        "co_yield",
        "decltype",
        "dynamic_cast",
        "explicit",
        "export",
        "friend",
        "mutable",
        "noexcept",
        "not",
        "not_eq",
        "nullptr",
        "or",
        "or_eq",
        "reinterpret_cast",
        "requires",
        "static_assert",
        "static_cast",
        "thread_local",
        "throw",
        "try",
        "typeid",
        "typename",
        "using",
        "wchar_t",
        "xor",
        "xor_eq",
        "complex",
        "errno",
        "imaginary",
        "math_errhandling",
        "stderr",
        "stdin",
        "stdout",
        "main",
        "linux",
        "unix",
    ]
)
"""Words of C and C++, and macros of headers and compilers: no name is one of them."""
_HEADERS = frozenset(
    [
        "assert",
        "complex",
        "ctype",
        "errno",
        "fenv",
        "inttypes",
        "iso646",
        "limits",
        "locale",
        "math",
        "memory",
        "setjmp",
        "signal",
        "stdarg",
        "stdbool",
        "stddef",
        "stdint",
        "stdio",
        "stdlib",
        "stdalign",
        "stdatomic",
        "stdnoreturn",
        "string",
        "strings",
        "tgmath",
        "threads",
        "time",
        "wchar",
        "wctype",
        "atomic",
        "cnd",
        "mtx",
        "sem",
    ]
)
"""Headers and families of functions of C: no prefix is one of them."""
_INTEGERS = (
    r"(U?INT(8|16|32|64|MAX|PTR|_(LEAST|FAST)(8|16|32|64))?|[SU]?CHAR|U?(SHRT|LONG|LLONG)|S?SIZE"
    r"|PTRDIFF|SIG_ATOMIC|WCHAR|WINT|BOOL)_(MIN|MAX|C|BIT|WIDTH)"
)
_FLOATS = (
    r"(FLT|DBL|LDBL)_(\w*DIG|\w*(MIN|MAX)(_10)?(_EXP)?|EPSILON|RADIX|ROUNDS|EVAL_METHOD|HAS_SUBNORM"
    r"|IS_IEC_60559|SNAN)|DECIMAL_DIG|FP_(INFINITE|(SUB)?NORMAL|NAN|ZERO|ILOGB0|ILOGBNAN"
    r"|FAST_FMA[FL]?)|FE_(ALL_EXCEPT|DFL_ENV|DIVBYZERO|INEXACT|INVALID|OVERFLOW|UNDERFLOW|DOWNWARD"
    r"|TONEAREST|TOWARDZERO|UPWARD)|HUGE_VAL[FL]?|MATH_(ERRNO|ERREXCEPT)"
    r"|M_(E|PI|[12]_PI|PI_[24]|2_SQRTPI|SQRT2|SQRT1_2|LN2|LN10|LOG2E|LOG10E)"
)
_OTHERS = (
    r"CLOCKS_PER_SEC|TIME_UTC|EXIT_(SUCCESS|FAILURE)|SEEK_(SET|CUR|END)|MB_(CUR|LEN)_MAX"
    r"|(RAND|TMP|FILENAME|FOPEN|PATH|NAME|OPEN|IOV|ARG)_MAX|PIPE_BUF|SIG_(DFL|ERR|IGN)"
    r"|LC_(ADDRESS|ALL|COLLATE|CTYPE|IDENTIFICATION|MEASUREMENT|MESSAGES|MONETARY|NAME|NUMERIC"
    r"|PAPER|TELEPHONE|TIME)|ATOMIC_\w+_(LOCK_FREE|INIT)|ONCE_FLAG_INIT|TSS_DTOR_ITERATIONS"
)
_MACROS = re.compile(f"{_INTEGERS}|{_FLOATS}|{_OTHERS}")
"""Macros of C's headers."""
_OWN = re.compile(
    r"h|format|manifest|forced|model_hash|model_id|code_id|channels|outputs|sample_period_us"
    r"|saved_bytes|flag_.*|fault_.*|.*_lsb_per_unit"
)
"""Macros that every model's header has, behind the prefix."""
LONGEST = 31
"""Characters that C99 tells apart in names of several files."""


def _shorten(name: str, ending: str = "") -> str:
    return name[: LONGEST - len(ending)] + ending


def sanitize_name(text: str, fallback: str) -> str:
    """Return a text's letters and digits as a lower-case name that C, C++ and the runtime lack."""
    name = _shorten(re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")).rstrip("_") or fallback
    if name[0] in "0123456789":
        name = _shorten(f"x{name}").rstrip("_")
    if re.match(r"zd(_|$)", name):
        name = _shorten(f"x_{name}").rstrip("_")
    return _shorten(name, "_x") if name in _WORDS else name


def sanitize_prefix(text: str) -> str:
    """Return what a model's files and functions are called."""
    name = sanitize_name(text, "sensor")
    return f"{name}_x" if name in _HEADERS else name


def sanitize_outputs(texts: Iterable[str], prefix: str) -> list[str]:
    """Return the outputs' names, none of which makes a macro that is there already."""

    def is_taken(name: str) -> bool:
        return bool(_MACROS.fullmatch(f"{prefix}_{name}".upper()) or _OWN.fullmatch(name))

    return sanitize_names(texts, "output", is_taken)


def sanitize_names(
    texts: Iterable[str], fallback: str, is_taken: Callable[[str], bool] = lambda _: False
) -> list[str]:
    """Return a name for each text, in order; of equal ones the later get _2, _3, ..."""
    names: list[str] = []
    for text in texts:
        first = sanitize_name(text, fallback)
        if is_taken(first):
            first = _shorten(first, "_x")
        name, count = first, 1
        while name in names:
            count += 1
            name = _shorten(first, f"_{count}")
        names.append(name)
    return names
