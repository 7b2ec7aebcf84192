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
    }
)
"""Of C99 and C++, since the header may be included from either."""
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
    if name in _KEYWORDS or name == "zd" or name.startswith("zd_"):
        name = f"{name[: _LONGEST - 2]}_x"
    return name


def sanitize_identifiers(texts: Iterable[str], fallback: str) -> list[str]:
    """Return one distinct identifier per text, in order; equal ones get _2, _3, ..."""
    names: list[str] = []
    for text in texts:
        base = sanitize_identifier(text, fallback)
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
