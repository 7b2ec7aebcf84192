"""The registry: what it keeps, what it refuses, and many processes that write at a time."""

import json
import multiprocessing
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.blocks.test_blocks import find_design, list_units, make_block
from tests.field.conftest import BEGIN_S, make_bare_block, write_log

from zerodrift.base.errors import InputError
from zerodrift.blocks.block import seal
from zerodrift.blocks.files import render_block
from zerodrift.cli.main import cli
from zerodrift.field.registry import open_registry

WRITERS, UNITS = 6, 15


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "registry.sqlite"
    with open_registry(path, make=True):
        return path


def call(file: Path, *arguments: object):
    texts = [str(argument) for argument in arguments]
    return CliRunner().invoke(cli, ["registry", *texts, "--registry", str(file)])


def write_many(path: str, writer: int, design: str) -> int:
    """Enter the same units as every other writer does, and some of its own; return the refused."""
    refused = 0
    with open_registry(Path(path), make=True) as registry:
        for number in range(UNITS):
            try:
                registry.add_unit(f"SHARED{number}", design)
            except InputError as error:
                assert "is there since" in str(error)
                refused += 1
            registry.add_calibration(f"OWN{writer}-{number}", design, f"{writer:x}{number:x}" * 8)
            sha256 = registry.add_block(
                f"OWN{writer}-{number}", make_bare_block(f"OWN{writer}-{number}")
            )
            registry.load_block(f"OWN{writer}-{number}", sha256)
    return refused


@pytest.mark.long
def test_many_processes_write_and_nothing_is_lost_or_twice(tmp_path) -> None:
    path = tmp_path / "registry.sqlite"  # made by whoever is first
    context = multiprocessing.get_context("spawn")
    with context.Pool(WRITERS) as pool:
        jobs = [(str(path), writer, "ft40") for writer in range(WRITERS)]
        refused = pool.starmap(write_many, jobs)
    assert sum(refused) == (WRITERS - 1) * UNITS
    with open_registry(path) as registry:
        units = registry.list_units()
        kinds = [event.kind for event in registry.tell_history("OWN3-7")]
    assert len(units) == len({unit.serial for unit in units}) == (WRITERS + 1) * UNITS
    assert all(unit.block for unit in units if unit.serial.startswith("OWN"))
    assert kinds == ["added", "calibrated", "block", "loaded"]
    assert sqlite3.connect(path).execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert sqlite3.connect(path).execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_second_writer_is_told_who_waits_for_whom(file) -> None:
    other = sqlite3.connect(file, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with open_registry(file, wait_s=0.2) as registry:
        with pytest.raises(InputError, match="another program holds it"):
            registry.add_unit("SN1", "ft40")
        assert registry.list_units() == ()  # a reader is not held up
        other.execute("ROLLBACK")
        registry.add_unit("SN1", "ft40")
        assert registry.knows("SN1")


def test_a_serial_number_is_entered_once(file) -> None:
    assert call(file, "add", "SN1", "--design", "ft40").exit_code == 0
    again = call(file, "add", "SN1", "--design", "ft80")
    assert "SN1 is there since" in str(again.exception)
    with open_registry(file) as registry, pytest.raises(InputError, match="of the design ft40"):
        registry.add_calibration("SN1", "ft80", "a" * 64)


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a design and the files of the blocks of SN0 and SN1."""
    folder = tmp_path_factory.mktemp("blocks")
    design = find_design(network=False)
    (folder / "design.json").write_text(design.to_text(), encoding="utf-8")
    for number in (0, 1):
        serial = f"SN{number}"
        content = make_block(design, design.fit(list_units(False)[number]), number + 1, serial)
        for name, text in render_block(design, content, serial, 0).items():
            (folder / name).write_bytes(text)
    return folder


def test_a_block_is_on_its_own_unit_alone(file, blocks) -> None:
    for number in (0, 1):
        assert call(file, "add", f"SN{number}", "--design", "ft40").exit_code == 0
    assert call(file, "block", "SN0", blocks / "SN0.bin", "--loaded").exit_code == 0
    assert call(file, "block", "SN0", blocks / "SN0.hex").exit_code == 0  # the same bytes
    twice = call(file, "block", "SN1", blocks / "SN0.bin")
    assert "SN0.bin: is the block of 'SN0'; expected that of SN1" in str(twice.exception)
    assert call(file, "block", "SN1", blocks / "SN1.json").exit_code == 0
    units = json.loads(call(file, "list", "--json").stdout)["units"]
    loaded = {unit["serial"]: unit["block"] for unit in units}
    assert loaded["SN0"] and not loaded["SN1"]
    wrong = call(file, "loaded", "SN1", loaded["SN0"][:8])
    assert "would compensate another" in str(wrong.exception)
    events = json.loads(call(file, "history", "SN0", "--json").stdout)["events"]
    assert [event["kind"] for event in events] == ["added", "block", "loaded"]
    with open_registry(file) as registry, pytest.raises(InputError, match="expected one of SN1"):
        registry.add_block("SN1", (blocks / "SN0.bin").read_bytes())


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: b"", "0 bytes are no block"),
        (lambda c: c[:-8], "it was cut"),
        (lambda c: c[:4] + b"\0" + c[5:], "an older format, 0"),
        (lambda c: b"".join(c[k : k + 4][::-1] for k in range(0, len(c), 4)), "highest byte first"),
        (lambda c: c[:90] + bytes([c[90] ^ 1]) + c[91:], "damaged or edited"),
        (lambda c: seal(c[:12] + b"\1" + c[13:-4]), "a block of design"),
        (lambda c: b"time_s,y_N\n" * 20, "a block begins with b'ZDBK'"),
    ],
)
def test_a_block_that_no_chip_would_take_is_not_entered(
    file, blocks, tmp_path, change, told: str
) -> None:
    assert call(file, "add", "SN0", "--design", "ft40").exit_code == 0
    bad = tmp_path / "bad.bin"
    bad.write_bytes(change((blocks / "SN0.bin").read_bytes()))
    (tmp_path / "design.json").write_bytes((blocks / "design.json").read_bytes())
    message = str(call(file, "block", "SN0", bad, "--loaded").exception)
    assert message.startswith(f"{bad}: ")
    assert told in message
    assert any(word in message for word in ("again", "back", "Take", "Name"))  # what to do
    with open_registry(file) as registry:
        assert [event.kind for event in registry.tell_history("SN0")] == ["added"]


def test_a_folder_in_the_place_of_a_block_is_told(file, tmp_path) -> None:
    assert call(file, "add", "SN0", "--design", "ft40").exit_code == 0
    message = str(call(file, "block", "SN0", tmp_path).exception)
    assert message.startswith(f"{tmp_path}: cannot be read")


def test_what_fails_leaves_nothing(file) -> None:
    with open_registry(file) as registry:
        with pytest.raises(InputError, match="no unit SN9"):
            registry.add_block("SN9", make_bare_block("SN9"))
        with pytest.raises(InputError, match="SQLite refuses it"):
            registry.add_calibration("", "ft40", "a" * 64)
        assert registry.list_units() == ()
        registry.add_unit("SN1", "ft40")  # the connection still writes


@pytest.mark.parametrize(
    ("content", "told"),
    [(None, "there is no registry"), (b"no database at all" * 99, "is damaged, or no registry")],
)
def test_what_is_no_registry_is_refused(tmp_path, content: bytes | None, told: str) -> None:
    path = tmp_path / "r.sqlite"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=told), open_registry(path):
        pass
    assert (path.read_bytes() if content is not None else None) == content


def test_another_programs_file_and_a_later_version_are_left_alone(file, tmp_path) -> None:
    foreign = tmp_path / "other.sqlite"
    connection = sqlite3.connect(foreign)
    connection.execute("CREATE TABLE unit (a)")
    connection.commit()
    for make in (False, True):
        with pytest.raises(InputError, match="of another program"):  # noqa: SIM117
            with open_registry(foreign, make=make):
                pass
    later = sqlite3.connect(file)
    later.execute("PRAGMA user_version = 2")
    later.commit()
    with pytest.raises(InputError, match="of version 2"), open_registry(file):
        pass


@pytest.fixture
def place(unit) -> Iterator[Path]:
    """Return the registry beside the built unit while a test lasts."""
    with open_registry(unit / "registry.sqlite", make=True) as registry:
        yield registry.path
    for path in unit.glob("registry.sqlite*"):
        path.unlink()


def watch(unit: Path, tmp_path: Path, log: Path, *more: str):
    words = ["monitor", str(log), "-C", str(unit), "--state", str(tmp_path / "s.json"), *more]
    return CliRunner().invoke(cli, words)


def test_monitor_enters_its_logs_and_alarms(unit, place, tmp_path) -> None:
    log = write_log(tmp_path / "a.csv", 70, 4, begin_s=BEGIN_S, slope=0.5)
    with open_registry(place) as registry:
        registry.add_unit("small", "small")
    assert watch(unit, tmp_path, log).exit_code == 1
    with open_registry(place) as registry:
        told = registry.tell_history("small")
        (standing,) = registry.list_standings()
    assert [event.kind for event in told] == ["added", "log", "finding"]
    assert "other model" in told[-1].text
    assert standing.is_alarm and standing.told == "other model"
    assert (standing.watched_log, standing.watched_at) == ("a.csv", told[1].at)
    listed = call(place, "list").stdout
    assert listed.split("\n")[0].strip() == "1 unit" and "other model" in listed


def test_what_monitor_says_last_stands_since_it_was_first_said(unit, place, tmp_path) -> None:
    with open_registry(place) as registry:
        registry.add_unit("small", "small")
    times = []
    for part in range(3):  # 15 days are learnt from
        begin_s = BEGIN_S + part * 8 * 86_400.0
        log = write_log(tmp_path / f"{part}.csv", 80 + part, 8, begin_s=begin_s)
        assert watch(unit, tmp_path, log).exit_code == 0
        with open_registry(place) as registry:
            (standing,) = registry.list_standings()
        (finding,) = standing.findings
        times.append((finding.state, finding.since))
        assert not standing.is_alarm and standing.watched_log == f"{part}.csv"
    states, since = zip(*times, strict=True)
    assert states == ("learning", "sound", "sound")
    assert since[0] < since[1] == since[2]
    with open_registry(place) as registry:
        kinds = [event.kind for event in registry.tell_history("small")]
    assert kinds.count("finding") == 2


def test_a_single_project_is_entered_under_its_serial_number(unit, place, tmp_path) -> None:
    own = tmp_path / "own"
    shutil.copytree(unit, own)
    toml = own / "zerodrift.toml"
    toml.write_text(f'{toml.read_text()}\n[firmware]\nserial = "SN0042"\n')
    log = write_log(tmp_path / "a.csv", 90, 1, begin_s=BEGIN_S)
    missing = watch(own, tmp_path, log)
    assert "there is no unit SN0042; nothing was entered" in missing.stderr
    assert "registry add SN0042" in missing.stderr
    with open_registry(own / place.name) as registry:
        for serial in ("small", "SN0042"):
            registry.add_unit(serial, "small")
    entered = watch(own, tmp_path, log, "--reset")
    assert "entered under the serial number SN0042 of [firmware]" in entered.stderr
    with open_registry(own / place.name) as registry:
        watched = {one.unit.serial: one.watched_log for one in registry.list_standings()}
    assert watched == {"small": "", "SN0042": "a.csv"}


def test_a_list_without_units_says_how_they_get_there(file) -> None:
    assert "`zerodrift registry add SERIAL`" in call(file, "list").stdout
