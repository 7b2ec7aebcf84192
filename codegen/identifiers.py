"""C identifiers and comments from whatever a user's columns are called."""

import re
from collections.abc import Iterable

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
        "main",
        "linux",  # macros of compilers that run with their extensions
        "unix",
    }
)
"""Of C99 and C++, since the header may be included from either."""
_STANDARD_HEADERS = re.compile(
    "assert|complex|ctype|errno|fenv|inttypes|iso646|limits|locale|math|memory|setjmp|signal|stdarg"
    "|stdbool|stddef|stdint|stdio|stdlib|string|strings|tgmath|time|wchar|wctype"
)
"""The model's own header must not hide one of these."""
RESERVED_OUTPUTS = re.compile(
    r"h|format|manifest|model_hash|model_id|channels|outputs|sample_period_us|saved_bytes|flag_.*|fault_.*"
    r"|.*_lsb_per_unit"
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

    Never the name of a standard header, which the model's own would hide.
    """
    name = sanitize_identifier(text)
    return f"{name}_x" if _STANDARD_HEADERS.fullmatch(name) else name


def sanitize_identifiers(
    texts: Iterable[str], fallback: str, reserved: re.Pattern[str] | None = None
) -> list[str]:
    """Return one distinct identifier per text, in order; equal ones get _2, _3, ...

    Args:
        texts: what the user calls them.
        fallback: for a text without letters and digits.
        reserved: names that the generated files give to other things; these get _x.
    """
    names: list[str] = []
    for text in texts:
        base = sanitize_identifier(text, fallback)
        if reserved is not None and reserved.fullmatch(base):
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
