"""Rows of a log that hold nothing but plain numbers between commas: told without splitting them.

Most loggers write so. What is told here is what `text_format` finds of such rows field by field.
"""

from collections.abc import Sequence

FEWEST_ROWS = 8
"""Fewer rows, the header among them, are looked at field by field."""
_PLAIN = b"0123456789.-,\n"
_DIGITS = b"0123456789-"
_WRONG = (",,", ",.", ".,", "-,", "-.", "..")
"""With a minus only behind a comma, what makes a field that is no number."""
_OTHERS = '\t;| "\r\0'
"""What might split or quote a header, beside commas."""


def find_plain_header(lines: Sequence[str]) -> list[str] | None:
    """Return the fields of the first line if all others are as many plain numbers each.

    A plain number is digits, perhaps with a minus before them and a point between them.

    Args:
        lines: the first ones of a log that hold something.

    Returns:
        None where it takes a closer look.
    """
    if len(lines) < FEWEST_ROWS:
        return None
    header, *rows = lines
    commas = header.count(",")
    if commas == 0 or len(header.split()) != 1 or any(mark in header for mark in _OTHERS):
        return None
    if {row.count(",") for row in rows} != {commas}:
        return None
    written = "\n".join(rows)
    if written.encode().translate(None, _PLAIN):
        return None
    fields = f",{written.replace(chr(10), ',')},"
    if fields.count("-") != fields.count(",-") or any(wrong in fields for wrong in _WRONG):
        return None
    # Of each field its point is left, of all fields a point and a comma in turn at most.
    if b".." in fields.encode().translate(None, _DIGITS):
        return None
    return header.split(",")
