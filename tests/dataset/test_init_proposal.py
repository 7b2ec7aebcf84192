"""What `init` proposes has been tried on the logs: the next command it names works."""

import math
import random
from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from tests.surroundings.conftest import Command

from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.times import find_zone

STEPS = 900
"""Of 20 s: five hours, the night's change of clocks among them."""


def write_logs(folder: Path, head: str, form: str, zone: str = "Europe/Berlin") -> None:
    """Write two runs by a local clock; in the second it is put back."""
    place, rng = ZoneInfo(zone), random.Random(zone)
    for number, day in enumerate((24, 25)):
        begin = datetime(2026, 10, day - 1, 22, tzinfo=UTC)
        rows = [head]
        for step in range(STEPS):
            at = (begin + timedelta(seconds=20 * step)).astimezone(place)
            degc = 25 + 8 * math.sin(step / 100 + number) + rng.gauss(0.0, 0.01)
            counts = 8000 + round(150 * (degc - 25) + rng.gauss(0.0, 3.0))
            rows.append(f"{at.strftime(form)};{degc:.2f};{counts}")
        (folder / f"run_{number}.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize(
    ("head", "form"),
    [("Zeit;Temp;HX711", "%d.%m.%Y %H:%M:%S"), ("Date;Time;Temp;HX711", "%d.%m.%Y;%H:%M:%S")],
)
def test_a_clock_that_is_put_back_gets_a_zone_and_loads(
    head: str, form: str, tmp_path: Path, zerodrift: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TZ", "Europe/Vienna")
    write_logs(tmp_path, head, form)
    told = zerodrift("init", "run_0.csv", "run_1.csv", "-C", tmp_path)
    assert told.code == 0 and told.out.endswith("next: zerodrift compare\n"), told.err
    text = (tmp_path / "zerodrift.toml").read_text()
    (line,) = [line for line in text.splitlines() if line.startswith("time = ")]
    assert 'zone = "Europe/Vienna"' in line and "# check: or the zone" in line
    runs = load_dataset(load_config(tmp_path)).train
    assert [round(float(run.time_s[-1] - run.time_s[0])) for run in runs] == [20 * (STEPS - 1)] * 2


def test_the_key_that_the_loader_proposes_names_the_columns_there_are(
    tmp_path: Path, zerodrift: Command
) -> None:
    write_logs(tmp_path, "Date;Time;Temp;HX711", "%d.%m.%Y;%H:%M:%S")
    zerodrift("init", "run_0.csv", "run_1.csv", "-C", tmp_path)
    toml = tmp_path / "zerodrift.toml"
    lines = toml.read_text().splitlines()
    time = 'time = { column = ["Date", "Time"] }'
    toml.write_text("\n".join(time if line.startswith("time") else line for line in lines))
    told = zerodrift("compare", "-C", tmp_path)
    proposed = 'time = { column = ["Date", "Time"], zone = '
    assert told.code == 2 and proposed in told.err
    zone = told.err.partition(proposed)[2].partition(" }")[0]
    toml.write_text(toml.read_text().replace(time, f"{proposed}{zone} }}"))
    assert len(load_dataset(load_config(tmp_path)).train) == 2


def test_a_role_that_nothing_states_is_to_be_checked(tmp_path: Path, zerodrift: Command) -> None:
    write_logs(tmp_path, "Zeit;Temp;HX711", "%d.%m.%Y %H:%M:%S")
    zerodrift("init", "run_0.csv", "run_1.csv", "-C", tmp_path)
    assert 'measured = "HX711"  # check: or an input' in (tmp_path / "zerodrift.toml").read_text()


def test_what_the_logs_do_not_allow_is_told_with_the_proposal(
    tmp_path: Path, zerodrift: Command
) -> None:
    rows = "".join(f"{k if k < 5 else k - 1},{20 + k},{k}\n" for k in range(9))
    (tmp_path / "log.csv").write_text(f"time_s,temperature_degC,y_N\n{rows}")
    told = zerodrift("init", "log.csv", "-C", tmp_path)
    assert told.code == 0
    assert "check: the logs cannot be used yet: log.csv:7: time_s repeats 4 s" in told.out
    assert told.out.endswith("next: mend what the logs do not allow yet, then zerodrift compare\n")


def test_a_zone_is_found_where_its_clocks_go_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "UTC")
    hour = np.arange(0.0, 3600.0, 600.0)
    back = np.concatenate([hour, hour])
    assert find_zone(1792893600.0 + back) == "Europe/Berlin"  # 2026-10-25 02:00 twice
    assert find_zone(1793494800.0 + back) == "America/New_York"  # 2026-11-01 01:00 twice
    assert find_zone(1793000000.0 + back) == ""
    assert find_zone(hour) == ""
