"""Logs that stopped at the door once: units by name or row, times by any name, odd columns."""

import datetime as dt
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from tests.projects import FORCE, render_toml

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.cli.init import command
from zerodrift.dataset.guess import guess_project
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.survey import write_range
from zerodrift.dataset.units import read_unit

COUNT = 200
T = 25 + 8 * np.sin(np.arange(COUNT) / 30)
FORCE_N = 3 * (T - 25)
BEGIN = dt.datetime(2024, 10, 21)


def write(path: Path, header: str, *columns: object) -> Path:
    rows = zip(*columns, strict=True)  # type: ignore[arg-type]
    lines = [header, *(",".join(str(field) for field in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def load(
    folder: Path, time: str, temperature: str = '"temp_c"', log: str = "log.csv"
) -> np.ndarray:
    """Return the temperatures of a project by the log, its force against 0."""
    text = render_toml(f'[logs]\ntrain = ["{log}"]\n', outputs=(FORCE,))
    text = text.replace('"time_s"', time).replace('"temperature_degC"', temperature)
    text = text.replace('"Fz_N"', '"F_N"').replace('reference = "ref_Fz_N"\n', "")
    (folder / "zerodrift.toml").write_text(text)
    return load_dataset(load_config(folder)).train[0].temperature_degC


@pytest.mark.parametrize("name", ["temp_F", "T_F", "Temperature [F]", "oven (°F)", "room_F"])
def test_f_is_fahrenheit_where_a_temperature_is_meant(tmp_path: Path, name: str) -> None:
    log = write(tmp_path / "log.csv", f"time_s,{name},F_N", range(COUNT), T * 1.8 + 32, FORCE_N)
    guess = guess_project([log])
    assert (guess.temperature, guess.temperature_unit) == (name, "degF")
    found = load(tmp_path, '"time_s"', f'{{ column = "{name}", unit = "degF" }}')
    np.testing.assert_allclose(found, T, atol=1e-9)


def test_f_of_anything_else_is_no_unit_that_is_known() -> None:
    assert [read_unit(name) for name in ("Fz_F", "cap_F", "temperature_coefficient_F")] == [""] * 3


@pytest.mark.parametrize(("unit", "per"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
@pytest.mark.parametrize("name", ["ts", "x", "stamp"])
def test_unix_times_are_known_by_their_size_whatever_they_are_called(
    tmp_path: Path, name: str, unit: str, per: int
) -> None:
    times = [(1_700_000_000 + k) * per for k in range(COUNT)]
    log = write(tmp_path / "log.csv", f"{name},temp_c,F_N", times, T, FORCE_N)
    guess = guess_project([log])
    assert guess.time.name == name and guess.sample_period_s == 1.0
    assert guess.time.unit == ("" if unit == "s" else unit)


def test_a_counter_that_does_not_rise_throughout_is_no_time(tmp_path: Path) -> None:
    times = [1_700_000_000 + k % 50 for k in range(COUNT)]
    log = write(tmp_path / "log.csv", "x,temp_c,F_N", times, T, FORCE_N)
    with pytest.raises(InputError, match=r"expected times"):
        guess_project([log])


def test_times_as_durations_and_columns_without_text(tmp_path: Path) -> None:
    """Of lists, structs and bytes nothing is read; a row is located beside them all the same."""
    frame = pl.DataFrame(
        {
            "el": [dt.timedelta(seconds=k) for k in range(COUNT)],
            "temp_c": T,
            "F_N": FORCE_N,
            "list": [[1, 2]] * COUNT,
            "struct": [{"a": 1}] * COUNT,
            "bytes": [b"x"] * COUNT,
        }
    )
    frame.write_parquet(tmp_path / "log.parquet")
    guess = guess_project([tmp_path / "log.parquet"])
    assert (guess.time.name, guess.sample_period_s) == ("el", 1.0)
    found = load(tmp_path, '"el"', log="log.parquet")
    assert found.tobytes() == T.tobytes()
    holed = frame.with_columns(pl.Series("F_N", [None, *FORCE_N[1:]]))
    holed.write_parquet(tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"log\.parquet: row 1: column 'F_N' is empty"):
        load(tmp_path, '"el"', log="log.parquet")


def test_midnight_in_a_spreadsheet_is_a_time_as_the_others_are(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    book = openpyxl.Workbook()
    for row in (["Logger", 4711], ["when", "temp_c", "F_N"], ["", "degC", "N"]):
        book.active.append(row)
    for k in range(COUNT):
        at = BEGIN - dt.timedelta(seconds=50 - k)
        book.active.append([at, float(T[k]), float(FORCE_N[k])])
    book.save(tmp_path / "log.xlsx")
    found = load(tmp_path, '"when"', log="log.xlsx")
    np.testing.assert_allclose(found, T, atol=1e-12)  # the format's writer rounds


def test_the_hour_that_is_there_twice_asks_for_the_zone(tmp_path: Path) -> None:
    start = dt.datetime(2024, 10, 27, 2, 58, 20)
    walls = [start + dt.timedelta(seconds=k - 3600 * (k >= 100)) for k in range(COUNT)]
    write(tmp_path / "log.csv", "when,temp_c,F_N", walls, T, FORCE_N)
    told = (
        r"log\.csv:102: when goes back from 2024-10-27 02:59:59 to 2024-10-27 02:00:00; expected "
        r'rising .*put back here in autumn.*zone = "Europe/Berlin"'
    )
    with pytest.raises(InputError, match=told):
        load(tmp_path, '"when"')
    zoned = '{ column = "when", zone = "Europe/Berlin" }'
    assert load(tmp_path, zoned).tobytes() == T.tobytes()


def test_codes_that_are_no_temperature_are_marked(tmp_path: Path) -> None:
    log = write(tmp_path / "log.csv", "time_s,temp_raw,F_N", range(COUNT), T * 100, FORCE_N)
    guess = guess_project([log])
    scaled = '{ column = "temp_raw", scale = 0.01, unit = "degC" }'
    assert guess.alternatives["temperature"] == (scaled,)
    assert any("which is no temperature in degC" in check for check in guess.checks)
    np.testing.assert_allclose(load(tmp_path, '"time_s"', scaled), T, atol=1e-9)


def test_what_holds_text_is_shown_where_something_lacks(tmp_path: Path) -> None:
    force = [f'"{1000 + f:,.3f}"' for f in FORCE_N]
    log = write(tmp_path / "log.csv", "time_s,temp_c,F_N", range(COUNT), T, force)
    with pytest.raises(InputError, match=r"F_N holds text, such as '1,0\d+\.\d+'\); expected a"):
        guess_project([log])
    force = ["abc" if row == 3 else f"{f:.3f}" for row, f in enumerate(FORCE_N[:8])]
    log = write(tmp_path / "short.csv", "time_s,temp_c,F_N", range(8), T[:8], force)
    with pytest.raises(InputError, match=r"F_N holds text, such as 'abc'\);.* or mend the text"):
        guess_project([log])


def test_a_topic_of_text_alone_is_named(tmp_path: Path) -> None:
    writer_of = pytest.importorskip("mcap_ros2.writer")
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = writer_of.Writer(file)
        schema = writer.register_msgdef("std_msgs/msg/String", "string data")
        writer.write_message("/chatter", schema, {"data": "hello"}, 10**18, 10**18)
        writer.finish()
    told = r"log\.mcap: MCAP without a table that has numbers \(found: /chatter, without a number"
    with pytest.raises(InputError, match=told):
        guess_project([tmp_path / "log.mcap"])


@pytest.mark.parametrize(
    ("units", "told"),
    [
        ("s,K,N", r"'temp_c' is in K, as the log states, and .*toml:4 takes it as degC; expected"),
        ("s,F,N", r"'temp_c' is in degF, as the log states, .* unit = \"degF\" } in \[sensor\]"),
        ("ms,degC,N", r"'t' is in ms, as the log states, and .*toml:3 takes it as s; expected one"),
        ("s,degC,mN", r"'F_N' is in mN, .* takes it as N; .*measured = { column = \"F_N\", unit ="),
    ],
)
def test_units_that_contradict_the_logs_own_are_refused(
    tmp_path: Path, units: str, told: str
) -> None:
    log = write(tmp_path / "log.csv", "t,temp_c,F_N", range(COUNT), T, FORCE_N)
    text = log.read_text().replace("F_N\n", f"F_N\n{units}\n", 1)
    log.write_text(text)
    with pytest.raises(InputError, match=rf"^log\.csv:2: column {told}"):
        load(tmp_path, '"t"')


def test_units_that_a_table_states_are_left_to_it(tmp_path: Path) -> None:
    log = write(tmp_path / "log.csv", "t,temp_c,F_N", range(COUNT), T + 273.15, FORCE_N)
    log.write_text(log.read_text().replace("F_N\n", "F_N\ns,K,N\n", 1))
    found = load(tmp_path, '"t"', '{ column = "temp_c", unit = "K" }')
    np.testing.assert_allclose(found, T, atol=1e-9)
    guess = guess_project([log])
    assert any("in K by the row of units and in degC by its name" in c for c in guess.checks)


def test_a_row_of_units_says_what_times_count(tmp_path: Path) -> None:
    log = write(tmp_path / "log.csv", "t,temp_c,F_N", range(0, 500 * COUNT, 500), T, FORCE_N)
    log.write_text(log.read_text().replace("F_N\n", "F_N\nms,degC,N\n", 1))
    guess = guess_project([log])
    assert (guess.time.unit, guess.sample_period_s) == ("ms", 0.5)


@pytest.mark.parametrize(
    ("ends", "told"),
    [
        ((1_700_000_000, 1_700_000_400), "1700000000 to 1700000400"),
        ((1_700_000_000_000, 1_700_000_400_000), "1700000000000 to 1700000400000"),
        ((10000103.5, 10000297.0), "10000103.5 to 10000297"),
        ((17.0001, 32.9999), "17.0001 to 32.9999"),
        ((5.0, 5.0), "5 to 5"),
        ((0.0, 0.0), "0 to 0"),
    ],
)
def test_a_range_has_the_digits_that_tell_its_ends_apart(
    ends: tuple[float, float], told: str
) -> None:
    assert write_range(*ends) == told


@pytest.mark.parametrize("names", [("when", "ts"), ("time", "time")])
@pytest.mark.parametrize("files", [("a_meter", "b_env"), ("b_meter", "a_env")])
def test_a_local_clock_beside_unix_time_gets_its_zone_whatever_the_columns_are_called(
    tmp_path: Path, names: tuple[str, str], files: tuple[str, str]
) -> None:
    """`init` writes what `compare` can read: the zone stands with the file that needs it."""
    run = tmp_path / "run1"
    run.mkdir()
    local = [dt.datetime(2024, 5, 1, 12) + dt.timedelta(seconds=k) for k in range(COUNT)]
    begin = int(dt.datetime(2024, 5, 1, 10, tzinfo=dt.UTC).timestamp())
    write(run / f"{files[0]}.csv", f"{names[0]},F_N", local, FORCE_N)
    write(run / f"{files[1]}.csv", f"{names[1]},temp_c", range(begin, begin + COUNT), T)
    result = CliRunner().invoke(command, ["-C", str(tmp_path), str(run)])
    assert result.exit_code == 0, result.output
    dataset = load_dataset(load_config(tmp_path))
    found = np.concatenate([run.temperature_degC for run in (*dataset.train, *dataset.test)])
    assert found.tobytes() == T.tobytes()


def test_a_file_that_is_not_there_and_bytes_that_do_not_print(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nosuch\.csv: there is no such file; expected a log"):
        guess_project([tmp_path / "nosuch.csv"])
    log = write(tmp_path / "log.csv", "time_s,temp_c,F_N", range(COUNT), T, FORCE_N)
    log.write_bytes(log.read_bytes() + b"\0" * 500)
    with pytest.raises(InputError) as caught:
        load(tmp_path, '"time_s"')
    assert "log.csv:202: column 'time_s' holds '\\x00\\x00" in str(caught.value)
    assert str(caught.value).isprintable()
