"""The second pass over a file: line and text of a row that failed a check."""

from dataclasses import dataclass

from zerodrift.base.errors import InputError
from zerodrift.dataset.tables import PARSER_ERRORS, Source, mend_source, write_text
from zerodrift.dataset.text_format import list_lines


@dataclass(frozen=True)
class RowPlace:
    """Where a row stands in its file."""

    text: str
    """`chamber_1.csv:17`, or `chamber_1.parquet: row 16` (rows count from 1)."""
    values: dict[str, str | None]
    """The row's fields as text; None where there is none."""


def locate_row(source: Source, position: int) -> RowPlace:
    """Return the place of the row at `position` (from 0) among the rows that the filter keeps.

    Raises:
        InputError: the row cannot be read as text either: it is not UTF-8, or its fields are
            quoted so that the lines cannot be separated.
    """
    try:
        frame = source.scan().slice(position, 1)
        names = frame.collect_schema().names()
        found = frame.select(write_text(name, frame) for name in names).collect()
    except PARSER_ERRORS as error:
        return locate_row(mend_source(source, error), position)
    if found.is_empty():
        raise InputError(_explain_quotes(source))
    values: dict[str, str | None] = found.row(0, named=True)
    record = int(values.pop("_row") or 0)
    if not source.is_csv:
        return RowPlace(f"{source.label}: row {record + 1}", values)
    return RowPlace(f"{source.label}:{_find_line(source, record)}", values)


def find_blank_rows(source: Source) -> list[int]:
    """Return the positions of a CSV's blank lines, which the parser takes for rows without fields.

    Where a row filter is set there is nothing to find: blank lines do not pass it.
    """
    if not source.is_csv or source.where:
        return []
    lines = list_lines(*source.parsed)
    return [row for row, (_, line) in enumerate(lines) if not line.strip()]


def _explain_quotes(source: Source) -> str:
    """Return the message for a file whose rows depend on how its quotation marks are read."""
    opened, is_open = 1, False
    with source.path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if line.count(b'"') % 2 == 1:
                opened, is_open = (number, True) if not is_open else (opened, False)
    if not is_open:
        return (
            f"{source.label}: its quotation marks leave open where rows end; expected none but "
            "around whole fields. Write the log anew without them."
        )
    return (
        f"{source.label}:{opened}: a quotation mark opens a field that is not closed; expected "
        "them in pairs around a field. Close or remove it."
    )


def _find_line(source: Source, record: int) -> int:
    """Return the 1-based line on which a record ends; a quoted field may hold line breaks."""
    current, last, is_quoted = -1, 1, False
    for number, line in list_lines(*source.parsed):
        last = number
        current += not is_quoted
        is_quoted ^= line.count(b'"') % 2 == 1
        if current == record and not is_quoted:
            break
    return last
