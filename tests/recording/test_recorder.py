"""Readings become rows, rows are followed, and the command ends as it should."""

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import polars as pl
import pytest
from click.testing import CliRunner, Result

from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.recording.coverage import Coverage, Wanted
from zerodrift.recording.recorder import Keeper, Recording, RowRules, check_rules
from zerodrift.recording.sources import Reading
from zerodrift.recording.status import explain_missing

TOML = """\
[sensor]
name = "barometer"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.p]
measured = "p_mbar"
unit = "mbar"
full_scale = 2000

[logs]
train = ["logs/*.parquet"]

[[effect]]
kind = "zero_tempco"

[firmware]
out = "firmware"
"""


class Given:
    """A source of readings that are known beforehand."""

    has_times = False

    def __init__(self, readings: Iterable[tuple[float, dict[str, float]]], *, rows: bool) -> None:
        self.is_rows = rows
        self._left = [Reading(at, values) for at, values in readings]
        self._now_s = 0.0

    def tell_time(self) -> float:
        return self._now_s

    def read(self, timeout_s: float) -> list[Reading] | None:
        if not self._left:
            return None
        self._now_s = self._left[0].at_s
        return [self._left.pop(0)]

    def explain_wait(self) -> str:
        return ""

    def list_strays(self) -> list[str]:
        return []

    def close(self) -> None:
        pass


def record(
    readings: Iterable[tuple[float, dict[str, float]]], path: Path, *, rows: bool, **rules: float
) -> pl.DataFrame:
    with Keeper(path) as keeper:
        source = Given(readings, rows=rows)
        following = Coverage("T", Wanted())
        Recording(source, keeper, following, RowRules(**rules), source.tell_time).run(  # type: ignore[arg-type]
            lambda *_: None
        )
    return pl.read_parquet(path)


def test_rows_keep_their_times(tmp_path: Path) -> None:
    frame = record([(100.0, {"T": 20.0}), (100.25, {"T": 21.0})], tmp_path / "a.parquet", rows=True)
    assert frame["time_s"].to_list() == [0.0, 0.25]
    assert frame["clock_s"].to_list()[1] - frame["clock_s"].to_list()[0] == pytest.approx(0.25)
    own = [(1.0, {"time_s": 7.0}), (2.0, {"time_s": 9.0}), (3.0, {"time_s": 8.0})]
    frame = record(own, tmp_path / "b.parquet", rows=True)
    assert frame.to_dict(as_series=False) == {"time_s": [7.0, 9.0]}


def test_parts_make_rows_at_the_period_and_grow_old(tmp_path: Path) -> None:
    parts = [(-100.0, {"T": 20.0}), (-99.5, {"F": 1.0}), (-95.2, {"F": 2.0}), (-94.0, {"F": 3.0})]
    frame = record(parts, tmp_path / "a.parquet", rows=False, period_s=1.0, hold_s=3.0)
    rows = frame.select("time_s", "T", "F").to_dicts()[:6]
    assert rows[0] == {"time_s": 0.0, "T": 20.0, "F": 1.0}
    assert rows[2] == {"time_s": 2.0, "T": 20.0, "F": 1.0}
    assert rows[3] == {"time_s": 4.0, "T": None, "F": 2.0}
    assert rows[4] == {"time_s": 5.0, "T": None, "F": 2.0}  # the next part comes with this row
    assert rows[5] == {"time_s": 6.0, "T": None, "F": 3.0}


def test_a_hold_shorter_than_the_period_is_refused() -> None:
    with pytest.raises(InputError, match="is shorter than the period"):
        check_rules(RowRules(period_s=2.0, hold_s=1.0))


def test_coverage_counts_ranges_rates_and_time() -> None:
    wanted = Wanted((10.0, 30.0), 2.0, 2.0, {"load": (0.0, 50.0)}, 600.0, "log 1 of the last plan")
    coverage = Coverage("T", wanted)
    assert coverage.describe().enough is False
    for second in range(601):  # up by 2 K/min for 10 min
        coverage.add(
            float(second), {"T": 10.0 + second / 30.0, "load": 25.0 if second > 300 else 0}
        )
    told = coverage.describe()
    shares = {one.what: one.share for one in told.wanted}
    assert shares["T"] == 1.0 and shares["time"] == 1.0 and shares["load"] == 0.5
    assert told.heating_K_per_min == pytest.approx(2.0, abs=0.01) and shares["cooling"] == 0.0
    assert explain_missing(told) == ["load: 0 to 25 so far; go up to 50", "cooling: 0 of 2 K/min"]
    for second in range(601, 1201):
        coverage.add(float(second), {"T": 30.0 - (second - 600) / 30.0, "load": 50.0})
    assert coverage.describe().enough is True


def test_noise_of_a_thermometer_is_no_rate() -> None:
    coverage = Coverage("T", Wanted())
    for second in range(300):
        coverage.add(float(second), {"T": 20.0 + (0.05 if second % 2 else -0.05)})
    told = coverage.describe()
    assert told.heating_K_per_min is not None and told.heating_K_per_min < 0.11
    assert told.enough is None


def test_no_reading_is_counted() -> None:
    coverage = Coverage("T", Wanted())
    coverage.add(0.0, {"T": math.nan})
    coverage.add(1.0, {"T": 20.0, "late": 1.0})
    columns = {column.name: column for column in coverage.describe().columns}
    assert columns["T"].missing == 1 and columns["late"].missing == 1
    assert columns["T"].low == columns["T"].high == 20.0


def run_command(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["record", *arguments])


def write_device(folder: Path, rows: int, pause_s: float = 0.0) -> str:
    """Write a program that prints rows of a slow ramp; return it as a source."""
    path = folder / "device.py"
    path.write_text(
        "import time\nprint('temperature_degC,p_mbar', flush=True)\n"
        f"for k in range({rows}):\n"
        "    print(f'{20 + 0.01 * k:.3f},{1000 + 0.008 * k + 0.01 * (k % 3):.3f}', flush=True)\n"
        f"    time.sleep({pause_s})\n"
    )
    return f"command:{sys.executable} {path}"


def test_the_command_records_and_says_so(tmp_path: Path) -> None:
    out = tmp_path / "log.parquet"
    done = run_command(write_device(tmp_path, 50), "-C", str(tmp_path), "--out", str(out), "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["schema"] == "record/1" and told["rows"] == 50 and told["enough"] is None
    frame = pl.read_parquet(out)
    assert frame.columns == ["time_s", "temperature_degC", "p_mbar", "clock_s"]
    assert frame["temperature_degC"][49] == 20.49


@pytest.mark.long
def test_a_recorded_log_is_a_log_of_the_project(tmp_path: Path) -> None:
    (tmp_path / "zerodrift.toml").write_text(TOML)
    (tmp_path / "logs").mkdir()
    source = write_device(tmp_path, 60, 0.02)
    path = tmp_path / "device.py"
    text = path.read_text().replace("temperature_degC,p", "time_s,temperature_degC,p")
    path.write_text(text.replace("print(f'", "print(f'{k},"))
    done = run_command(source, "-C", str(tmp_path), "--out", str(tmp_path / "logs/a.parquet"))
    assert done.exit_code == 0, done.output
    assert pl.read_parquet(tmp_path / "logs/a.parquet").columns[0] == "time_s"
    compared = CliRunner().invoke(cli, ["compare", "-C", str(tmp_path), "--json"])
    assert json.loads(compared.stdout)["runs"]["a"]["p"]["rmse"] < 0.1


def test_experiment_says_what_is_enough(tmp_path: Path) -> None:
    (tmp_path / "zerodrift.toml").write_text(
        TOML + "\n[experiment]\ntemperature_degC = [20, 20.2]\n"
    )
    source = write_device(tmp_path, 100_000, 0.005)
    out = tmp_path / "log.parquet"
    done = run_command(source, "-C", str(tmp_path), "--out", str(out), "--until-enough")
    assert done.exit_code == 0, done.output
    assert "All that [experiment] asks for is covered." in done.output
    assert 20 <= pl.read_parquet(out).height < 2000


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--until-enough",), "nothing says what is enough"),
        (("--log", "1"), "this project has no plan"),
        (("--columns", "a,,b"), "one has no name"),
        (("--hold", "0.5", "--period", "2"), "is shorter than the period"),
    ],
)
def test_options_that_contradict(tmp_path: Path, arguments: tuple[str, ...], told: str) -> None:
    (tmp_path / "zerodrift.toml").write_text(TOML)
    out = tmp_path / "log.parquet"
    source = write_device(tmp_path, 5)
    done = run_command(source, "-C", str(tmp_path), "--out", str(out), *arguments)
    assert isinstance(done.exception, InputError) and told in str(done.exception)
    assert not out.exists() and not list(tmp_path.glob(".log*"))


def test_no_row_is_an_error_that_shows_what_came(tmp_path: Path) -> None:
    done = run_command(
        f"command:{sys.executable} -c 'print(1.5)'", "--out", str(tmp_path / "l.parquet")
    )
    assert "no row came" in str(done.exception)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.spread(0, "by", [signal.SIGINT, signal.SIGTERM])
def test_ended_by_hand_or_by_the_system(tmp_path: Path, by: signal.Signals) -> None:
    out = tmp_path / "log.parquet"
    source = write_device(tmp_path, 100_000, 0.01)
    process = subprocess.Popen(
        [sys.executable, "-m", "zerodrift", "record", source, "--out", str(out), "--json"],
        stdout=subprocess.PIPE, cwd=tmp_path,
    )  # fmt: skip
    journal = tmp_path / ".log.parquet.rows"
    until = time.monotonic() + 60.0
    while not (journal.exists() and journal.stat().st_size) and time.monotonic() < until:
        time.sleep(0.05)
    process.send_signal(by)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert json.loads(told)["interrupted"] is True
    assert pl.read_parquet(out).height == json.loads(told)["rows"] > 0
    assert not journal.exists()


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_splits_no_row(
    tmp_path: Path, by: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = Keeper.add

    def add(keeper: Keeper, values: dict[str, float]) -> None:
        if keeper.rows == 3:
            signal.raise_signal(by)  # before the row is kept, counted and followed
        own(keeper, values)

    monkeypatch.setattr(Keeper, "add", add)
    out = tmp_path / "log.parquet"
    done = run_command(write_device(tmp_path, 1000, 0.01), "--out", str(out), "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["interrupted"] is True
    assert told["rows"] == pl.read_parquet(out).height >= 4
