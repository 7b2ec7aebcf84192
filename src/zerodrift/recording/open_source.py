"""Opens a source by what is written on the command line."""

from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.extras import RECORD_MCAP, require
from zerodrift.recording.sources import LineReader, LiveSource, parse_source
from zerodrift.recording.streams import (
    CanSource,
    LineSource,
    MqttSource,
    open_command,
    open_input,
    open_serial,
)

BAUD = 115_200


def open_source(
    text: str, columns: tuple[str, ...], dbc: Path | None, wanted_columns: tuple[str, ...] = ()
) -> LiveSource:
    """Open a source.

    Args:
        text: as it is written on the command line.
        columns: names of the columns, where its lines have numbers alone.
        dbc: the DBC file that describes the frames of a CAN bus.
        wanted_columns: what the project reads, by its own names.

    Raises:
        InputError: it cannot be opened; says why and what helps.
    """
    wanted = parse_source(text)
    if dbc is not None and wanted.kind != "can":
        raise InputError(f"--dbc {dbc}: is for a source can:...; found '{text}'. Leave --dbc out.")
    if wanted.kind == "can":
        return CanSource(wanted, dbc)
    if wanted.kind == "mcap":
        if columns:
            raise InputError(
                f"--columns: is for lines of numbers alone; found '{text}', whose fields have "
                "names. Leave --columns out."
            )
        for extra in RECORD_MCAP:
            require(extra, text)
        from zerodrift.recording.mcap_file import McapSource

        return McapSource(wanted, wanted_columns)
    if wanted.kind == "mqtt":
        return MqttSource(wanted, columns)
    if wanted.kind == "serial":
        stream = open_serial(wanted.place, wanted.number or BAUD)
    elif wanted.kind == "command":
        stream = open_command(wanted.place)
    else:
        stream = open_input()
    return LineSource(text, stream, LineReader(columns))
