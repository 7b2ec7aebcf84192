"""The registry's file: one SQLite file in write-ahead mode, its tables, and what it refuses."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.files import write_new

FILE_NAME = "registry.sqlite"
"""Beside zerodrift.toml: unlike build/ it cannot be made again."""
VERSION = 1
APPLICATION = 0x7A64_7267
"""`zdrg`, by which a file says that it is a registry."""
WAIT_S = 30.0
"""How long a writer waits for another."""

SCHEMA = """
CREATE TABLE unit (
    serial TEXT PRIMARY KEY CHECK (length(serial) BETWEEN 1 AND 64),
    design TEXT NOT NULL,
    added_at TEXT NOT NULL
) STRICT;
CREATE TABLE calibration (
    serial TEXT NOT NULL REFERENCES unit (serial),
    model_hash TEXT NOT NULL,
    calibrated_at TEXT NOT NULL,
    PRIMARY KEY (serial, model_hash)
) STRICT;
CREATE TABLE block (
    sha256 TEXT PRIMARY KEY CHECK (length(sha256) = 64),
    serial TEXT NOT NULL REFERENCES unit (serial),
    model_hash TEXT NOT NULL,
    added_at TEXT NOT NULL,
    content BLOB NOT NULL
) STRICT;
CREATE TABLE loaded (
    number INTEGER PRIMARY KEY,
    serial TEXT NOT NULL REFERENCES unit (serial),
    sha256 TEXT NOT NULL REFERENCES block (sha256),
    loaded_at TEXT NOT NULL
) STRICT;
CREATE INDEX loaded_of_unit ON loaded (serial, number);
CREATE TABLE log (
    sha256 TEXT NOT NULL,
    serial TEXT NOT NULL REFERENCES unit (serial),
    name TEXT NOT NULL,
    purpose TEXT NOT NULL CHECK (purpose IN ('calibration', 'monitor')),
    added_at TEXT NOT NULL,
    PRIMARY KEY (sha256, serial, purpose)
) STRICT;
CREATE TABLE finding (
    number INTEGER PRIMARY KEY,
    serial TEXT NOT NULL REFERENCES unit (serial),
    output TEXT NOT NULL,
    state TEXT NOT NULL,
    told TEXT NOT NULL,
    found_at TEXT NOT NULL
) STRICT;
CREATE INDEX finding_of_unit ON finding (serial, output, number);
"""


@contextmanager
def open_connection(
    path: Path, *, make: bool = False, wait_s: float = WAIT_S
) -> Iterator[sqlite3.Connection]:
    """Open a registry's file for as long as the block lasts.

    Args:
        path: the file.
        make: make it where it is missing.
        wait_s: how long to wait for another writer.

    Raises:
        InputError: it is missing, no registry, of a later version, damaged, or locked.
    """
    if not make and not path.is_file():
        raise InputError(
            f"{path}: there is no registry; expected the file that `zerodrift registry init` makes."
            " Make it, or name it by --registry."
        )
    if make:
        write_new(path, _write_empty())
    try:
        connection = sqlite3.connect(path, timeout=wait_s, isolation_level=None)
    except sqlite3.DatabaseError as error:
        raise explain(path, error) from error
    try:
        _prepare(path, connection)
        yield connection
    finally:
        connection.close()


def _write_empty() -> bytes:
    """Return the bytes of a registry without units, in write-ahead mode."""
    connection = sqlite3.connect(":memory:", isolation_level=None)
    try:
        connection.execute("BEGIN")
        for statement in SCHEMA.split(";\n"):
            connection.execute(statement)
        connection.execute(f"PRAGMA application_id = {APPLICATION}")
        connection.execute(f"PRAGMA user_version = {VERSION}")
        connection.execute("COMMIT")
        content = bytearray(connection.serialize())
    finally:
        connection.close()
    content[18:20] = b"\x02\x02"  # https://www.sqlite.org/fileformat.html: 2 for write-ahead
    return bytes(content)


def _prepare(path: Path, connection: sqlite3.Connection) -> None:
    def ask(name: str) -> int:
        return int(connection.execute(f"PRAGMA {name}").fetchone()[0])

    try:
        connection.execute("PRAGMA foreign_keys = ON")
        if ask("application_id") != APPLICATION:
            raise _refuse_other(path)
        if ask("user_version") != VERSION:
            raise InputError(
                f"{path}: is a registry of version {ask('user_version')}; expected {VERSION}. Use"
                " the zerodrift that wrote it, or a later one."
            )
        connection.execute("PRAGMA synchronous = FULL")
    except sqlite3.DatabaseError as error:
        raise explain(path, error) from error


def _refuse_other(path: Path) -> InputError:
    return InputError(
        f"{path}: is an SQLite file of another program; expected a registry. Name another file."
    )


def explain(path: Path, error: sqlite3.DatabaseError) -> InputError:
    """Return one message for an error of SQLite."""
    if "locked" in str(error) or "busy" in str(error):
        return InputError(
            f"{path}: another program holds it ({error}); nothing was written."
            " Try again when it has ended."
        )
    if "not a database" in str(error) or "malformed" in str(error):
        return InputError(
            f"{path}: is damaged, or no registry ({error}); expected an SQLite file that zerodrift"
            " wrote. Take it from a backup, or name another by --registry."
        )
    return InputError(
        f"{path}: SQLite refuses it ({error}); expected a file that this user may read and write,"
        " on a disk of this machine. Nothing was written."
    )
