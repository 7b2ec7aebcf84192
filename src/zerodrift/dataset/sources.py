"""Opens a file as the tables that it holds: one for text, Parquet and Arrow, else several."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from zerodrift.dataset.formats.registry import find_format, read_tables
from zerodrift.dataset.tables import Source, open_source, refuse_no_file


def open_sources(path: Path, label: str, where: Mapping[str, str]) -> list[Source]:
    """Return the tables of a file; those of a file with several are called `LABEL[NAME]`.

    Raises:
        InputError: the file cannot be read, or its library is not installed.
    """
    known = find_format(path)
    if known is None:
        return [open_source(path, label, where)]
    refuse_no_file(path, label)
    tables = read_tables(path, label, known)
    sources = []
    for table in tables:
        who = f"{label}[{table.name}]" if len(tables) > 1 else label
        if table.text is not None:
            inner = open_source(table.text, who, where)
            sources.append(replace(inner, path=path, data=inner.data or table.text))
        elif table.frame is not None:
            names = tuple(table.frame.columns)
            sources.append(
                Source(path, who, names, where, frame=table.frame, stated_units=table.units)
            )
    named = [table.name if len(tables) > 1 else "" for table in tables]
    return [replace(each, part=part) for each, part in zip(sources, named, strict=True)]
