"""A bad log or a contradiction is told: file, place, found, expected, remedy."""

from pathlib import Path

import pytest
from tests.projects import FORCE, render_toml

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.logs import open_sources

HEADER = "time_s,temperature_degC,Fz_N,ref_Fz_N"


def write_rows(path: Path, times: list[object], header: str = HEADER) -> None:
    path.parent.mkdir(exist_ok=True)
    width = header.count(",")
    rows = [
        ",".join([str(t), *(f"{20 + k / 4 + c}" for c in range(width))])
        for k, t in enumerate(times)
    ]
    path.write_text("\n".join([header, *rows]) + "\n")


def refuse(folder: Path, old: str = "", new: str = "", train: str = "log.csv") -> str:
    """Return what is said of a project."""
    text = render_toml(f'[logs]\ntrain = ["{train}"]\n', outputs=(FORCE,))
    assert old in text
    (folder / "zerodrift.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        load_dataset(load_config(folder))
    return str(caught.value)


def check(told: str, place: str, found: str, expected: str, remedy: str) -> None:
    """Hold a message against the five things that it has to say."""
    for part in (place, found, expected, remedy):
        assert part in told, (part, told)
    assert told.index(place) <= told.index(found)
    assert "Traceback" not in told


def test_contradictory_units(tmp_path: Path) -> None:
    write_rows(tmp_path / "log.csv", list(range(60)))
    new = 'temperature = { column = "temperature_degC", unit = "V", convert = "pt100" }'
    told = refuse(tmp_path, 'temperature = "temperature_degC"', new)
    check(told, "zerodrift.toml:4:", "is 'V', but", 'expected unit = "ohm"', "Bring it to ohm by")
    new = 'measured = { column = "Fz_N", unit = "mV" }'
    told = refuse(tmp_path, 'measured = "Fz_N"', new)
    check(told, "zerodrift.toml:", "'mV', and the output's unit 'N'", "expected units", "State")


def test_a_zone_that_does_not_exist(tmp_path: Path) -> None:
    write_rows(tmp_path / "log.csv", [f"2024-05-01 10:{k:02}:00" for k in range(60)])
    new = 'time = { column = "time_s", zone = "Europe/Berin" }'
    told = refuse(tmp_path, 'time = "time_s"', new)
    check(told, "zerodrift.toml:3:", "'Europe/Berin'", "expected a name such as", "Europe/Berlin")


def test_times_that_run_backwards(tmp_path: Path) -> None:
    times: list[object] = [*range(30), 12, *range(31, 60)]
    write_rows(tmp_path / "log.csv", times)
    told = refuse(tmp_path)
    check(told, "log.csv:32:", "12", "expected", "--skip-invalid")


def test_files_that_do_not_overlap(tmp_path: Path) -> None:
    write_rows(tmp_path / "run" / "meter.csv", list(range(60)), "time_s,Fz_N,ref_Fz_N")
    write_rows(tmp_path / "run" / "env.csv", list(range(900, 960)), "time_s,temperature_degC")
    told = refuse(tmp_path, train="run")
    check(
        told, "run: its files do not overlap", "env.csv from 900 s", "expected", "[logs] offset_s"
    )


def test_a_table_that_is_not_monotonic(tmp_path: Path) -> None:
    write_rows(tmp_path / "log.csv", list(range(60)))
    column = '{ column = "temperature_degC", convert = "table", points = %s%s }'
    old = 'temperature = "temperature_degC"'
    points = "[[0, 1], [2, 2], [1, 3]]"
    told = refuse(tmp_path, old, f"temperature = {column % (points, '')}")
    check(told, "zerodrift.toml:4:", "[[0, 1], [2, 2], [1, 3]]", "expected", "x rising or falling")
    raw = ', raw = "uint16"'
    points = "[[0, 1], [1, 3], [2, 2]]"
    told = refuse(tmp_path, old, f"temperature = {column % (points, raw)}")
    check(told, "zerodrift.toml:4:", "[1.0, 3.0] to [2.0, 2.0]", "expected y that rises", "Correct")


def test_a_topic_without_numbers(tmp_path: Path) -> None:
    writer_of = pytest.importorskip("mcap.writer")
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = writer_of.Writer(file)
        writer.start()
        schema = writer.register_schema("text", "protobuf", b"")
        channel = writer.register_channel("/chatter", "protobuf", schema)
        writer.add_message(channel, 0, b"hello", 0)
        writer.finish()
    with pytest.raises(InputError) as caught:
        open_sources(tmp_path / "log.mcap", "log.mcap", {})
    told = str(caught.value)
    check(told, "log.mcap:", "/chatter (protobuf)", "expected ROS 2 (cdr) or JSON", "Record or")
