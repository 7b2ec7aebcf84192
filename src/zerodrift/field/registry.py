"""The registry: which units there are, how each was calibrated, and which block is on it.

Readers are never held up, writers take turns. What was written stays: a unit's history is a list of
events, of which none is changed. Other programs read it with any SQLite client.
"""

import hashlib
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from zerodrift.base.errors import InputError, nearest
from zerodrift.base.files import write_new
from zerodrift.blocks.editions import Edition, load_units, read_edition

# The registry's file: one SQLite file in write-ahead mode, its tables, and what it refuses.

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


# The registry: which units there are, how each was calibrated, and which block is on it.

LEARNING, SOUND, NO_REFERENCE = NO_ALARM = ("learning", "sound", "no reference")
"""States of an output without an alarm; else the alarm's cause is its state."""
HOW_TO_ENTER = (
    "`zerodrift fleet` enters each unit whose firmware was written, `zerodrift registry add SERIAL`"
    " any other; `zerodrift monitor` then enters what it reads and finds."
)


@dataclass(frozen=True)
class Unit:
    """A unit as it stands."""

    serial: str
    design: str
    added_at: str
    calibrated_at: str
    """"" before the first calibration."""
    model_hash: str
    """Of the last calibration; "" before it."""
    block: str
    """SHA-256 of the block that is on it; "" where none was loaded."""


@dataclass(frozen=True)
class LoadedBlock:
    """A block that is on a unit."""

    sha256: str
    loaded_at: str
    """ISO 8601, UTC."""
    content: bytes


@dataclass(frozen=True)
class UnitFinding:
    """What `monitor` said last of an output."""

    output: str
    state: str
    """learning | sound | no reference, or the cause of an alarm."""
    text: str
    """The same in a sentence."""
    since: str
    """When it was first said of those said without a break, ISO 8601, UTC."""

    @property
    def is_alarm(self) -> bool:
        """Whether it is the cause of an alarm."""
        return self.state not in NO_ALARM


@dataclass(frozen=True)
class UnitStanding:
    """A unit with all that is known of it today."""

    unit: Unit
    loaded_at: str
    """When its block was loaded; "" where none was."""
    watched_at: str
    """When `monitor` last read a log of it; "" where it read none."""
    watched_log: str
    """That log's name."""
    findings: tuple[UnitFinding, ...]
    """By output; empty before `monitor` said anything."""

    @property
    def is_alarm(self) -> bool:
        """Whether an output carries an alarm."""
        return any(finding.is_alarm for finding in self.findings)

    @property
    def told(self) -> str:
        """What `monitor` said last, in a few words: one state, or that of each output."""
        states = dict.fromkeys(finding.state for finding in self.findings)
        if len(states) < 2:
            return "".join(states) or "not watched"
        return ", ".join(f"{finding.output} {finding.state}" for finding in self.findings)


@dataclass(frozen=True)
class Event:
    """One thing that happened to a unit."""

    at: str
    """ISO 8601, UTC."""
    kind: str
    """added | calibrated | block | loaded | log | finding."""
    text: str


class Registry:
    """An open registry; `open_registry` makes it."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path, self._connection = path, connection

    def add_unit(self, serial: str, design: str) -> None:
        """Enter a unit.

        Raises:
            InputError: the serial number is taken.
        """
        with self._write() as cursor:
            known = _find_unit(cursor, serial)
            if known is not None:
                since = f"since {known[1][:19]} UTC, design {known[0]}"
                raise InputError(
                    f"{self.path}: {serial} is there {since}; expected a serial number that no"
                    " unit has yet. Correct it, or go on with that unit."
                )
            cursor.execute("INSERT INTO unit VALUES (?, ?, ?)", (serial, design, _now()))

    def add_calibration(
        self, serial: str, design: str, model_hash: str, logs: tuple[tuple[str, str], ...] = ()
    ) -> None:
        """Enter that a unit was calibrated, and the unit where it is new; again changes nothing.

        Args:
            serial: of the unit.
            design: of the unit.
            model_hash: of the model that came out.
            logs: (SHA-256, name) of what it was learnt from.

        Raises:
            InputError: the unit is of another design.
        """
        with self._write() as cursor:
            known = _find_unit(cursor, serial)
            if known is None:
                cursor.execute("INSERT INTO unit VALUES (?, ?, ?)", (serial, design, _now()))
            elif known[0] != design:
                raise InputError(
                    f"{self.path}: {serial} is of the design {known[0]}; expected {design}. Two"
                    " units have one serial number, or the design was renamed: give one another."
                )
            cursor.execute(
                "INSERT OR IGNORE INTO calibration VALUES (?, ?, ?)", (serial, model_hash, _now())
            )
            _add_logs(cursor, serial, "calibration", logs)

    def add_block(self, serial: str, content: bytes, model_hash: str = "") -> str:
        """Enter a block of coefficients for a unit; return its SHA-256.

        Raises:
            InputError: there is no such unit, the block is another unit's or none, or the unit
                has another block of the same sequence, so that no chip knew which is the newer.
        """
        own = read_edition(content, f"block of {serial}")[1]
        sha256 = hashlib.sha256(content).hexdigest()
        with self._write() as cursor:
            self._require(cursor, serial)
            row = cursor.execute("SELECT serial FROM block WHERE sha256 = ?", (sha256,)).fetchone()
            if row is not None and row[0] != serial:
                raise InputError(
                    f"{self.path}: block {sha256[:12]} is of {row[0]}; expected one of {serial}."
                    " A block belongs to one unit: name the right file."
                )
            blocks = cursor.execute(
                "SELECT sha256, content FROM block WHERE serial = ?", (serial,)
            ).fetchall()
            for known, other in blocks:
                edition = read_edition(bytes(other), f"{self.path}, block {known[:12]}")[1]
                if known != sha256 and edition.sequence == own.sequence:
                    raise InputError(
                        f"{self.path}: {serial} has another block of sequence {own.sequence},"
                        f" {known[:12]} of {edition.calibrated}; expected a larger sequence than"
                        " that, as a chip that holds both cannot know which is the newer. Make the"
                        " block again with `zerodrift firmware` or `fleet`, which count it."
                    )
            cursor.execute(
                "INSERT OR IGNORE INTO block VALUES (?, ?, ?, ?, ?)",
                (sha256, serial, model_hash, _now(), content),
            )
        return sha256

    def load_block(self, serial: str, sha256: str) -> str:
        """Enter that a block was loaded into a unit; return the block's whole SHA-256.

        Args:
            serial: of the unit.
            sha256: of the block; its first digits suffice.

        Raises:
            InputError: there is no such unit or block, or the block is another unit's.
        """
        with self._write() as cursor:
            self._require(cursor, serial)
            rows = cursor.execute(
                "SELECT sha256, serial FROM block WHERE substr(sha256, 1, ?) = ?",
                (len(sha256), sha256.lower()),
            ).fetchall()
            if len(rows) != 1 or not sha256:
                raise InputError(
                    f"{self.path}: {len(rows)} blocks begin with '{sha256}'; expected one. Enter"
                    " the block first, or write out more of its hash."
                )
            whole, owner = rows[0]
            if owner != serial:
                raise InputError(
                    f"{self.path}: block {whole[:12]} is of {owner}; expected one of {serial}. What"
                    " is on the unit would compensate another: load its own block."
                )
            cursor.execute(
                "INSERT INTO loaded (serial, sha256, loaded_at) VALUES (?, ?, ?)",
                (serial, whole, _now()),
            )
        return str(whole)

    def add_logs(self, serial: str, logs: tuple[tuple[str, str], ...]) -> None:
        """Enter logs that a unit was watched by, (SHA-256, name); again changes nothing.

        Raises:
            InputError: there is no such unit.
        """
        with self._write() as cursor:
            self._require(cursor, serial)
            _add_logs(cursor, serial, "monitor", logs)

    def add_finding(self, serial: str, output: str, state: str, told: str) -> None:
        """Enter what `monitor` found for an output; entering the same again changes nothing.

        Args:
            serial: of the unit.
            output: its name.
            state: learning | sound | no reference, or the cause of an alarm.
            told: the same in a sentence.

        Raises:
            InputError: there is no such unit.
        """
        with self._write() as cursor:
            self._require(cursor, serial)
            last = cursor.execute(
                "SELECT state, told FROM finding WHERE serial = ? AND output = ?"
                " ORDER BY number DESC LIMIT 1",
                (serial, output),
            ).fetchone()
            if last == (state, told):
                return
            cursor.execute(
                "INSERT INTO finding (serial, output, state, told, found_at)"
                " VALUES (?, ?, ?, ?, ?)",
                (serial, output, state, told, _now()),
            )

    def list_blocks(self, design: str) -> dict[str, bytes]:
        """Return serial number -> the block that was entered last, of the units of a design."""
        rows = self._read(
            "SELECT u.serial, b.content FROM unit u JOIN block b ON b.rowid ="
            " (SELECT max(rowid) FROM block WHERE serial = u.serial)"
            " WHERE u.design = :s ORDER BY u.serial",
            design,
        )
        return {str(serial): bytes(content) for serial, content in rows}  # type: ignore[call-overload]  # a blob

    def list_contents(self) -> tuple[bytes, ...]:
        """Return the bytes of all blocks, those that were entered first before others."""
        rows = self._read("SELECT content FROM block ORDER BY rowid")
        return tuple(bytes(content) for (content,) in rows)  # type: ignore[call-overload]  # a blob

    def find_newer(self, serial: str, sha256: str) -> str | None:
        """Return the SHA-256 of a newer block that was loaded into a unit before; None without one.

        Args:
            serial: of the unit.
            sha256: of the block that was loaded last, in full.
        """
        rows = self._read(
            "SELECT b.sha256, b.content FROM loaded l JOIN block b USING (sha256)"
            " WHERE l.serial = :s ORDER BY l.number",
            serial,
        )
        sequences = {
            str(name): read_edition(bytes(content), str(self.path))[1].sequence  # type: ignore[call-overload]  # a blob
            for name, content in rows
        }
        newest = max(sequences, key=lambda name: sequences[name], default=sha256)
        return newest if sequences.get(newest, 0) > sequences.get(sha256, 0) else None

    def find_loaded(self, serial: str) -> LoadedBlock | None:
        """Return the block on a unit; None without one."""
        rows = self._read(
            "SELECT b.sha256, l.loaded_at, b.content FROM loaded l JOIN block b USING (sha256)"
            " WHERE l.serial = :s ORDER BY l.number DESC LIMIT 1",
            serial,
        )
        for sha256, loaded_at, content in rows:
            assert isinstance(content, bytes)
            return LoadedBlock(str(sha256), str(loaded_at), content)
        return None

    def knows(self, serial: str) -> bool:
        """Return whether a unit is entered."""
        return bool(self._read("SELECT 1 FROM unit WHERE serial = :s", serial))

    def list_units(self) -> tuple[Unit, ...]:
        """Return all units, sorted by serial number."""
        rows = self._read(
            "SELECT u.serial, u.design, u.added_at, coalesce(c.calibrated_at, ''),"
            " coalesce(c.model_hash, ''), coalesce(l.sha256, '') FROM unit u"
            " LEFT JOIN calibration c ON c.rowid ="
            " (SELECT max(rowid) FROM calibration WHERE serial = u.serial)"
            " LEFT JOIN loaded l ON l.number ="
            " (SELECT max(number) FROM loaded WHERE serial = u.serial)"
            " ORDER BY u.serial"
        )
        return tuple(Unit(*(str(value) for value in row)) for row in rows)

    def list_standings(self) -> tuple[UnitStanding, ...]:
        """Return all units with what is known of them today, sorted by serial number."""
        findings = self._list_findings()
        more = {
            str(serial): (str(loaded_at), str(watched_at), str(watched_log))
            for serial, loaded_at, watched_at, watched_log in self._read(
                "SELECT u.serial, coalesce(l.loaded_at, ''), coalesce(g.added_at, ''),"
                " coalesce(g.name, '') FROM unit u"
                " LEFT JOIN loaded l ON l.number ="
                " (SELECT max(number) FROM loaded WHERE serial = u.serial)"
                " LEFT JOIN log g ON g.rowid ="
                " (SELECT max(rowid) FROM log WHERE serial = u.serial AND purpose = 'monitor')"
            )
        }
        return tuple(
            UnitStanding(unit, *more[unit.serial], tuple(findings.get(unit.serial, ())))
            for unit in self.list_units()
        )

    def _list_findings(self) -> dict[str, list[UnitFinding]]:
        """Return serial number -> what was said last, by output."""
        last: dict[tuple[str, str], UnitFinding] = {}
        for row in self._read(
            "SELECT serial, output, state, told, found_at FROM finding"
            " ORDER BY serial, output, number"
        ):
            serial, output, state, told, at = map(str, row)
            before = last.get((serial, output))
            since = before.since if before is not None and before.state == state else at
            last[serial, output] = UnitFinding(output, state, told, since)
        found: dict[str, list[UnitFinding]] = {}
        for (serial, _), finding in last.items():
            found.setdefault(serial, []).append(finding)
        return found

    def tell_history(self, serial: str) -> tuple[Event, ...]:
        """Return what happened to a unit, the oldest first.

        Raises:
            InputError: there is no such unit.
        """
        self._require(self._connection.cursor(), serial)
        rows = self._read(
            "SELECT added_at AS at, 0 AS rank, 'added', 'design ' || design FROM unit"
            " WHERE serial = :s"
            " UNION ALL SELECT added_at, 1, 'log', purpose || ': ' || name || ' ' ||"
            " substr(sha256, 1, 12) FROM log WHERE serial = :s"
            " UNION ALL SELECT calibrated_at, 2, 'calibrated', 'model ' ||"
            " substr(model_hash, 1, 12) FROM calibration WHERE serial = :s"
            " UNION ALL SELECT added_at, 3, 'block', substr(sha256, 1, 12) || ', ' ||"
            " length(content) || ' bytes' FROM block WHERE serial = :s"
            " UNION ALL SELECT loaded_at, 4, 'loaded', 'block ' || substr(sha256, 1, 12)"
            " FROM loaded WHERE serial = :s"
            " UNION ALL SELECT found_at, 5, 'finding', output || ', ' || state || ': ' || told"
            " FROM finding WHERE serial = :s ORDER BY at, rank, 4",
            serial,
        )
        return tuple(Event(str(at), str(kind), str(text)) for at, _, kind, text in rows)

    def _read(self, query: str, serial: str | None = None) -> list[tuple[object, ...]]:
        try:
            return self._connection.execute(query, {"s": serial}).fetchall()
        except sqlite3.DatabaseError as error:
            raise explain(self.path, error) from error

    def _require(self, cursor: sqlite3.Cursor, serial: str) -> None:
        if _find_unit(cursor, serial) is not None:
            return
        known = [str(row[0]) for row in cursor.execute("SELECT serial FROM unit")]
        number = f"{len(known)} unit{'s' if len(known) != 1 else ''}"
        raise InputError(
            f"{self.path}: there is no unit {serial}{nearest(serial, known) or '.'} The registry"
            f" has {number}. Correct it, or enter it by `zerodrift registry add {serial}`."
        )

    @contextmanager
    def _write(self) -> Iterator[sqlite3.Cursor]:
        """Hold the file against other writers; what is done becomes whole, or nothing of it."""
        cursor = self._connection.cursor()
        try:
            cursor.execute("BEGIN IMMEDIATE")
            try:
                yield cursor
            except BaseException:
                cursor.execute("ROLLBACK")
                raise
            cursor.execute("COMMIT")
        except sqlite3.DatabaseError as error:
            raise explain(self.path, error) from error


@contextmanager
def open_registry(path: Path, *, make: bool = False, wait_s: float = WAIT_S) -> Iterator[Registry]:
    """Open a registry for as long as the block lasts.

    Args:
        path: the file.
        make: make it where it is missing.
        wait_s: how long to wait for another writer.

    Raises:
        InputError: it is missing, no registry, of a later version, damaged, or locked.
    """
    with open_connection(path, make=make, wait_s=wait_s) as connection:
        yield Registry(path, connection)


def _find_unit(cursor: sqlite3.Cursor, serial: str) -> tuple[str, str] | None:
    """Return the design of a unit and when it was entered; None where there is no such unit."""
    query = "SELECT design, added_at FROM unit WHERE serial = ?"
    row = cursor.execute(query, (serial,)).fetchone()
    return None if row is None else (str(row[0]), str(row[1]))


def _add_logs(
    cursor: sqlite3.Cursor, serial: str, purpose: str, logs: tuple[tuple[str, str], ...]
) -> None:
    at = _now()
    cursor.executemany(
        "INSERT OR IGNORE INTO log VALUES (?, ?, ?, ?, ?)",
        [(sha256, serial, name, purpose, at) for sha256, name in logs],
    )


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="microseconds")


# Which editions of units' blocks are known: by units.json, the registry, and the blocks there.

Editions = Mapping[str, tuple[Edition, ...]]
"""Serial number -> editions of its blocks."""


def find_editions(directory: Path, files: Iterable[Path]) -> Editions:
    """Return the editions of all units that a project knows.

    Args:
        directory: of the project.
        files: of blocks in its firmware's folder; one that is missing or damaged tells nothing.

    Raises:
        InputError: units.json or the registry is damaged.
    """
    found: dict[str, set[Edition]] = {
        serial: {edition} for serial, edition in load_units(directory).items()
    }
    contents: list[bytes] = []
    if (directory / FILE_NAME).is_file():
        with open_registry(directory / FILE_NAME) as registry:
            contents += registry.list_contents()
    for path in files:
        try:
            contents.append(path.read_bytes())
        except OSError:
            continue
    for content in contents:
        try:
            serial, edition = read_edition(content, "block")
        except InputError:
            continue
        found.setdefault(serial, set()).add(edition)
    return {serial: tuple(editions) for serial, editions in found.items()}
