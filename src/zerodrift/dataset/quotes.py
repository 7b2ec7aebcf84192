"""Checks that the quotation marks of a CSV leave no doubt where its rows end.

Polars takes a mark anywhere in a field for the start of quoted text, and all lines up to the next
mark for one row: one `5"` among remarks would silently cost every row between it and the next.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from zerodrift.base.errors import InputError

_MARK = b'"'
_BLOCK_BYTES = 1 << 22
_LONGEST_FIELD_BYTES = 1 << 20
_SHOWN = 60


def check_quotes(path: Path, label: str, separator: str) -> None:
    """Refuse a CSV in which a quotation mark runs over the end of a line without quoting a field.

    Marks in pairs within a line do no harm, nor does a quoted field that holds line breaks. A file
    without any mark, the usual case, is only searched for one.

    Args:
        path: the log.
        label: how messages name it.
        separator: the character between fields.

    Raises:
        InputError: with the line of the mark.
    """
    if not _holds_mark(path):
        return
    between = re.escape(separator.encode())
    quoted = re.compile(rb'(?:(?<=%b)|\A)[ \t]*"(?:[^"]|"")*"(?=%b|\r?\n|\Z)' % (between, between))
    for number, record, is_closed in _list_odd_records(path):
        first = record.split(b"\n", 1)[0].decode("utf-8", "replace").strip()[:_SHOWN]
        if not is_closed:
            raise InputError(
                f"{label}:{number}: a quotation mark opens a field that is not closed ({first}); "
                "expected them in pairs around a field. Close or remove it."
            )
        if _MARK in quoted.sub(b"", record):
            raise InputError(
                f"{label}:{number}: a quotation mark stands alone within a field ({first}); "
                "expected them in pairs around a field, as it would swallow the rows up to the "
                "next one. Remove it, or double it and quote the whole field."
            )


def _holds_mark(path: Path) -> bool:
    with path.open("rb") as file:
        return any(_MARK in block for block in iter(lambda: file.read(_BLOCK_BYTES), b""))


def _list_odd_records(path: Path) -> Iterator[tuple[int, bytes, bool]]:
    """Yield what begins on a line with an odd number of marks and ends on the next such line.

    Each as the number of its first line, its bytes, and whether a line that ends it comes within
    the greatest length of a field.
    """
    start, record = 0, b""
    with path.open("rb") as file:
        next(file)
        for number, line in enumerate(file, start=2):
            is_odd = line.count(_MARK) % 2 == 1
            if record:
                record += line
                if is_odd:
                    yield start, record, True
                    record = b""
                elif len(record) > _LONGEST_FIELD_BYTES:
                    break
            elif is_odd:
                start, record = number, line
    if record:
        yield start, record, False
