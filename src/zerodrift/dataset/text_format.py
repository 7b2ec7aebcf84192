"""The format of a log of text: encoding, delimiter, decimals, comments, header, row of units.

All of it is found from the file's beginning. What the parser cannot read as it is (another
encoding, runs of spaces, fields with spaces around them) is written anew once, line by line, as
UTF-8 in a temporary file; messages name lines, which are the same in both.
"""

import csv
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count, islice
from pathlib import Path

from zerodrift.base.errors import InputError

DELIMITERS = ("\t", ";", "|", ",", " ")
"""In the order in which they are preferred where a file could be split by several."""
COMMENTS = ("#", "%", "//")
SPACES = " "
"""Stands for one or more spaces or tabs between fields."""
SAMPLE_LINES = 400
LONGEST_FIELD = csv.field_size_limit()
"""Of the csv module, which refuses a longer one."""
UNNAMED = "\0"
"""Begins the names of columns that have none, which no config can hold."""
_UTF16 = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)
_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_TIME = re.compile(
    r"(\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}|\d{1,2}[- ][A-Za-z]{3}[- ]\d{2,4}|\d{8}T\d{4,6})"
    r"([T _,-]+\d{1,2}:\d\d.*)?|\d+:\d\d(:\d\d([.,]\d+)?)?( ?[AaPp][Mm])?"
)
_DATE_THEN_TIME = re.compile(
    r"(\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})[ \t]+(\d\d?:\d)"
)
_UNIT = re.compile(r"[\[(<]?\s*[A-Za-z0-9%°µμ/*^²³·.\- ]{0,12}\s*[\])>]?")
_MISSING = ("", "na", "n/a", "nan", "null", "none", "-", "--", "---")


@dataclass(frozen=True)
class TextFormat:
    """How a CSV, or what is like one, is written."""

    names: tuple[str, ...]
    """All columns in order; unnamed ones begin with `UNNAMED`, those without a header are numbers
    from 1."""
    separator: str
    """The character between fields; `SPACES` for runs of spaces and tabs."""
    decimal_comma: bool = False
    comment: str = ""
    """What lines begin with that hold none of the rows; empty: there are none."""
    head_lines: int = 1
    """Lines before the first record."""
    header_line: int = 1
    """Line of the columns' names; 0 where there is none."""
    units: tuple[str, ...] = ()
    """The row of units; empty where there is none."""
    encoding: str = "utf-8"
    padded: bool = False
    """Fields have spaces around them."""
    notes: tuple[str, ...] = ()
    """What the user should know of it."""

    @property
    def is_plain(self) -> bool:
        """Tell whether Polars reads the file as it is."""
        awkward = self.separator == SPACES or (self.decimal_comma and self.separator == ",")
        return self.encoding == "utf-8" and not awkward and not self.padded


def sniff_text(head: bytes, label: str, is_whole: bool) -> TextFormat:
    """Find out from its beginning how a log is written.

    Args:
        head: its first bytes.
        label: how messages name it.
        is_whole: whether these bytes are the whole file.

    Raises:
        InputError: it has no line of text, or names a column twice.
    """
    encoding, text = _decode(head, is_whole)
    lines = text.replace("\r\n", "\n").split("\n") if "\n" in text else text.split("\r")
    if not is_whole and len(lines) > 1:
        lines.pop()
    comment = _find_comment(lines) if any(mark in text for mark in COMMENTS) else ""
    written = (
        (number, line)
        for number, line in enumerate(lines)
        if line.strip() and not (comment and line.startswith(comment))
    )
    rows = list(islice(written, SAMPLE_LINES))
    if "\0" in text[:1000] or (len(lines) == 1 and not is_whole):
        raise InputError(
            f"{label}:1: the first line is not text ({text[:40]!r}); expected the columns' "
            "names, and lines that end in a line feed. Save the log as CSV text."
        )
    if not rows:
        raise InputError(
            f"{label}:1: the first line is blank, as is every other; expected the columns' names "
            "and rows. Record the log again, or take it out of [logs]."
        )
    separator = _find_separator([line for _, line in rows])
    fields = [split_fields(line, separator) for _, line in rows]
    comma = separator != "." and _has_decimal_comma(fields, separator)
    first, header, units = _find_table(fields, comma)
    width = _usual([len(each) for each in fields[first:]] or [len(fields[header or 0])])
    header_line = 0 if header is None else rows[header][0] + 1
    if header is None and (named := _read_commented_header(lines, comment, separator, width)):
        header_line, given = named
    else:
        given = [] if header is None else [name.strip() for name in fields[header]]
    names = _name_columns(given, width, label, header_line)
    head_lines = rows[first][0] if first < len(rows) else rows[-1][0] + 1
    is_padded = separator != SPACES and any(
        field != field.strip() and _is_value(field.strip(), comma)
        for each, (_, line) in zip(fields[first:], rows[first:], strict=True)
        if line.split(None, 1)[0] != line
        for field in each
    )
    found = TextFormat(
        names=names,
        separator=separator,
        decimal_comma=comma,
        comment=comment,
        head_lines=head_lines,
        header_line=header_line,
        units=() if units is None else tuple(clean_unit(field) for field in fields[units]),
        encoding=encoding,
        padded=is_padded or "\n" not in text,
    )
    return replace(found, notes=_tell(found, label, given))


def split_fields(line: str, separator: str) -> list[str]:
    """Return the fields of one line; none when it cannot be split."""
    if separator == SPACES:
        bare = line.strip()
        return (_DATE_THEN_TIME.sub(r"\1T\2", bare) if ":" in bare else bare).split()
    if _is_unquoted(line):
        return line.split(separator) if line else []
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def _count_fields(line: str, separator: str) -> int:
    """Return how many fields `split_fields` finds."""
    if separator != SPACES and line and _is_unquoted(line):
        return line.count(separator) + 1
    return len(split_fields(line, separator))


def _is_unquoted(line: str) -> bool:
    """Tell whether nothing in a line has a meaning for the csv module but the separator."""
    return '"' not in line and "\r" not in line and len(line) <= LONGEST_FIELD


def clean_unit(text: str) -> str:
    """Return a unit without the brackets and spaces that it is written in."""
    return text.strip().strip("[](){}<>").strip()


def write_plain(path: Path, found: TextFormat) -> Path:
    """Write a log anew as UTF-8 with tabs between the fields, line by line; return where."""
    target = _temporary_folder() / f"{next(_NUMBERS)}.tsv"
    with (
        path.open(encoding=found.encoding, errors="replace", newline=None) as source,
        target.open("w", encoding="utf-8", newline="\n") as plain,
    ):
        for number, line in enumerate(source):
            text = line.rstrip("\n")
            if number < found.head_lines or (found.comment and text.startswith(found.comment)):
                plain.write(text.replace('"', "") + "\n")
                continue
            fields = split_fields(text, found.separator) if text.strip() else []
            plain.write("\t".join(field.strip().replace("\t", " ") for field in fields) + "\n")
    return target


_NUMBERS = count()


@cache
def _temporary_folder() -> Path:
    """Return a folder for this process, removed when it ends."""
    folder = tempfile.TemporaryDirectory(prefix="zerodrift-logs-", ignore_cleanup_errors=True)
    _KEPT.append(folder)
    return Path(folder.name)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []


def _decode(head: bytes, is_whole: bool) -> tuple[str, str]:
    """Return the encoding and the text of a file's beginning."""
    for mark, name in _UTF16.items():
        if head.startswith(mark):
            return "utf-16", head[2:].decode(name, "replace")
    if len(head) > 3 and 0.3 < head[:4096].count(0) / len(head[:4096]) < 0.6:
        name = "utf-16-le" if head[1] == 0 else "utf-16-be"
        return name, head.decode(name, "replace")
    try:
        return "utf-8", head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if not is_whole and error.start > len(head) - 4:
            return "utf-8", head[: error.start].decode("utf-8-sig")
        return "cp1252", head.decode("cp1252", "replace")


def _find_comment(lines: Sequence[str]) -> str:
    """Return what comment lines begin with, or nothing."""
    marked = [line for line in lines if line.startswith(COMMENTS)]
    starts = Counter(mark for line in marked for mark in COMMENTS if line.startswith(mark))
    return starts.most_common(1)[0][0] if starts else ""


def _find_separator(lines: Sequence[str]) -> str:
    """Return the character that splits the lines most evenly, the header included."""
    best, best_share = ",", 0.0
    for separator in DELIMITERS:
        if separator != SPACES and not any(separator in line for line in lines):
            continue
        if separator == SPACES and len(" ".join(lines).split()) == len(lines):
            continue  # no line has two fields
        counts = [_count_fields(line, separator) for line in lines]
        body = counts[1:] or counts
        width = _usual(body)
        if width < 2:
            continue
        share = sum(abs(each - width) <= 1 and each > 1 for each in body) / len(body)
        # A header that it does not split speaks against a separator, as does a preamble, less.
        share -= 0.3 * (counts[0] < 2)
        if share > best_share + 0.1:
            best, best_share = separator, share
    return best


def _usual(counts: Sequence[int]) -> int:
    return Counter(counts).most_common(1)[0][0]


def _has_decimal_comma(fields: Sequence[Sequence[str]], separator: str) -> bool:
    """Tell whether numbers are written with a comma; a point in one speaks against it."""
    with_comma = (row for row in fields if "," in "".join(row))
    held = [field.strip() for row in with_comma for field in row if "," in field]
    commas = sum(_COMMA_NUMBER.fullmatch(value) is not None for value in held)
    if not commas:
        return False
    values = [field.strip() for row in fields for field in row]
    points = sum("." in value and NUMBER.fullmatch(value) is not None for value in values)
    if separator == ",":
        # Quoted fields alone can hold one: a file in which one does is more likely a mistake.
        return commas > max(points, len(fields) // 2)
    return commas > points


def _is_value(field: str, comma: bool) -> bool:
    """Tell whether a field is a number or a time."""
    bare = field.strip()
    if comma and _COMMA_NUMBER.fullmatch(bare):
        return True
    return NUMBER.fullmatch(bare) is not None or _TIME.fullmatch(bare) is not None


def _is_mostly_values(rows: Sequence[Sequence[str]], column: int, comma: bool) -> bool:
    """Tell whether more than half of the rows have a value in a column."""
    held = [row[column] for row in rows if len(row) > column]
    enough = len(rows) // 2 + 1
    numbers = filter(None, map(NUMBER.fullmatch, held))  # in nearly all logs that is enough
    if sum(1 for _ in islice(numbers, enough)) == enough:
        return True
    return sum(_is_value(field, comma) for field in held) >= enough


def _find_table(fields: Sequence[Sequence[str]], comma: bool) -> tuple[int, int | None, int | None]:
    """Return the first row of data, the header's and the units' row, each counted among `fields`.

    The first row of data is the first one that has a value in more than half of the columns that
    have one in the rows after it.
    """
    width = _usual([len(row) for row in fields[1:]] or [len(fields[0])])
    body = [row for row in fields[len(fields) // 2 :] if abs(len(row) - width) <= 1]
    if len(fields) < 4:
        body = [row for row in fields[1:] if len(row) >= 1] or list(fields)
    typed = [k for k in range(width) if _is_mostly_values(body, k, comma)]
    if not typed:
        return 1, 0, None

    def is_data(row: Sequence[str]) -> bool:
        held = sum(len(row) > k and _is_value(row[k], comma) for k in typed)
        empty = sum(len(row) > k and row[k].strip().lower() in _MISSING for k in typed)
        return held > 0 and 2 * held + empty > len(typed)

    first = next((i for i, row in enumerate(fields) if is_data(row)), 1)
    if first == 0:
        return 0, None, None
    # The header is the top of the block of equally wide rows right above the data.
    top = first - 1
    while top > 0 and abs(len(fields[top - 1]) - width) <= 1 and len(fields[top - 1]) > 1:
        top -= 1
    while top < first - 1 and any(
        len(fields[top]) > k and _is_value(fields[top][k], comma) for k in typed
    ):
        top += 1
    below = top + 1
    if below < first and all(_UNIT.fullmatch(field.strip()) for field in fields[below]):
        return below + 1, top, below
    return below, top, None


def _read_commented_header(
    lines: Sequence[str], comment: str, separator: str, width: int
) -> tuple[int, list[str]] | None:
    """Return line and names of a header that is written as the last comment above the rows."""
    if not comment:
        return None
    above = []
    for number, line in enumerate(lines, start=1):
        if line.strip() and not line.startswith(comment):
            break
        above.append((number, line))
    for number, line in reversed(above):
        names = [name.strip() for name in split_fields(line.lstrip(comment + " \t"), separator)]
        if len(names) == width and not all(NUMBER.fullmatch(name) for name in names):
            return number, names
    return None


def _name_columns(given: Sequence[str], width: int, label: str, line: int) -> tuple[str, ...]:
    """Return a name for each column; those beyond a header's are unnamed."""
    if line == 0:
        return tuple(str(number) for number in range(1, width + 1))
    for name, times in Counter(given).items():
        if name and times > 1:
            raise InputError(
                f"{label}:{line}: the header names column '{name}' {times} times; expected each "
                "name once. Rename one of them."
            )
    padded = [*given, *([""] * (width - len(given)))]
    return tuple(name or f"{UNNAMED}unnamed{index}" for index, name in enumerate(padded))


def _tell(found: TextFormat, label: str, given: Sequence[str]) -> tuple[str, ...]:
    """Return notes on a log's format for the user."""
    notes = []
    if found.encoding == "cp1252":
        notes.append(f"{label}: is not UTF-8; read as Windows-1252 (latin-1)")
    if found.header_line == 0:
        notes.append(
            f"{label}: has no header; its columns are numbered, '1' to '{len(found.names)}'"
        )
    elif len(given) < len(found.names):
        notes.append(
            f"{label}: its rows have {len(found.names)} fields, the header {len(given)}; the last "
            "ones have no name"
        )
    return tuple(notes)


def list_lines(path: Path, found: TextFormat) -> Iterator[tuple[int, bytes]]:
    """Yield the lines from the first record on that are no comments, each with its number."""
    comment = found.comment.encode()
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if number > found.head_lines and not (comment and line.startswith(comment)):
                yield number, line
