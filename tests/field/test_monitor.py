"""`monitor` on simulated logs of a unit in use: what it tells, keeps, writes and refuses."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from tests.field.conftest import BEGIN_S, DAY, write_log

from zerodrift.base.errors import InputError
from zerodrift.base.lock import LOCK, WAIT_VARIABLE, find_state, try_lock
from zerodrift.cli.main import cli
from zerodrift.dataset.log_steps import read_log_steps
from zerodrift.dataset.logs import open_sources
from zerodrift.dataset.tables import mend_source
from zerodrift.field.summary import MonitorResult
from zerodrift.report.results import read_result
from zerodrift.tasks import monitored_log


def watch(unit: Path, state: Path, *arguments: object) -> Result:
    texts = [str(argument) for argument in arguments]
    return CliRunner().invoke(
        cli, ["monitor", *texts, "-C", str(unit), "--state", str(state / "s.json"), "--json"]
    )


def read(result: Result) -> MonitorResult:
    told = read_result(result.stdout)
    assert isinstance(told, MonitorResult), result.output
    return told


def test_monitor_stays_silent_over_a_sound_month_and_says_what_was_used(unit, tmp_path) -> None:
    log = write_log(tmp_path / "a.csv", 10, 30, begin_s=BEGIN_S)
    result = watch(unit, tmp_path, log)
    assert result.exit_code == 0, result.output
    told = read(result)
    assert told.outputs["y"].state == "sound"
    assert told.steps == told.steps_in_all == 30 * DAY
    used = told.ranges["temperature"]
    assert used.low >= 14 and used.high <= 36
    assert used.calibrated_low < used.low + 1


@pytest.mark.spread(
    2,
    ("fault", "cause"),
    [("step", "step"), ("ageing", "ageing"), ("unit", "other unit"), ("model", "other model")],
)
def test_monitor_names_the_cause(unit, tmp_path, fault: str, cause: str) -> None:
    n = 30 * DAY
    day = np.arange(n) / DAY
    warm = 25 + 7 * np.sin(2 * np.pi * day) + 3 * np.sin(2 * np.pi * day / 5.3 + 11)
    zero = {
        "step": 0.5 * (day >= 20),
        "ageing": 0.02 * day,
        "unit": (day >= 20) * (1.0 + 0.05 * (warm - 25)),
        "model": 0.05 * (warm - 25),
    }[fault]
    log = write_log(tmp_path / "a.csv", 11, 30, begin_s=BEGIN_S, zero=zero)
    result = watch(unit, tmp_path, log)
    assert result.exit_code == 1, result.output
    verdict = read(result).outputs["y"].verdict
    assert verdict.cause == cause
    assert verdict.probability is not None and verdict.probability >= 0.95
    begin_s = BEGIN_S + (20 * 86_400.0 if fault in ("step", "unit") else 0.0)
    assert verdict.from_s is not None and verdict.to_s is not None
    assert verdict.from_s <= begin_s <= verdict.to_s
    if fault == "ageing":
        assert verdict.per_day == pytest.approx(0.02, rel=0.1)
    if fault == "step":
        assert verdict.size == pytest.approx(0.5, abs=0.05)
        assert verdict.to_s - verdict.from_s < 86_400.0
        assert " at once, between 2026-01-" in str(result.exception)
        assert verdict.since.startswith("2026-01-2")
        assert "recalibrate small: the zero of y moved by" in str(result.exception)


@pytest.mark.long
def test_monitor_goes_on_where_the_last_call_ended(unit, tmp_path) -> None:
    zero = 0.5 * (np.arange(30 * DAY) >= 20 * DAY)
    for part in range(6):
        own = slice(part * 5 * DAY, (part + 1) * 5 * DAY)
        begin_s = BEGIN_S + part * 5 * 86_400.0
        log = write_log(tmp_path / f"{part}.csv", 20 + part, 5, begin_s=begin_s, zero=zero[own])
        result = watch(unit, tmp_path, log)
        assert result.exit_code == (1 if part >= 4 else 0), result.output
        assert read(result).steps_in_all == (part + 1) * 5 * DAY
    assert read(result).outputs["y"].verdict.cause == "step"
    again = watch(unit, tmp_path, tmp_path / "5.csv")
    assert again.exit_code == 1
    assert read(again).steps == 0
    assert "read before" in " ".join(read(again).notes)


def write_with_gap(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> list[Path]:
    """Write logs of days 0 to 18 and 80 to 90, whose zero changes with the day."""
    logs = []
    for first, days in ((0, 18), (80, 10)):
        zero = change(first + np.arange(days * DAY) / DAY)
        begin_s = BEGIN_S + first * 86_400.0
        path = folder / f"{first}.csv"
        logs.append(write_log(path, 60 + first, days, begin_s=begin_s, zero=zero))
    return logs


def test_what_moved_in_a_gap_moved_at_once_or_slowly(unit, tmp_path) -> None:
    logs = write_with_gap(tmp_path, lambda day: 3.1 * (day > 50))
    result = watch(unit, tmp_path, *logs)
    verdict = read(result).outputs["y"].verdict
    assert (verdict.cause, verdict.per_day) == ("step", None)
    assert verdict.size == pytest.approx(3.1, abs=0.1)
    assert verdict.from_s is not None and verdict.to_s is not None
    assert verdict.from_s <= BEGIN_S + 18 * 86_400.0 and verdict.to_s >= BEGIN_S + 80 * 86_400.0
    assert verdict.to_s <= BEGIN_S + 81 * 86_400.0
    text = str(result.exception)
    assert "moved by 3.1 N between 2026-01-" in text and "at once or slowly: there are no" in text
    assert "of 62 days" in text


def test_ageing_over_a_gap_is_no_step_after_it(unit, tmp_path) -> None:
    logs = write_with_gap(tmp_path, lambda day: 0.05 * day)
    result = watch(unit, tmp_path, *logs)
    verdict = read(result).outputs["y"].verdict
    assert verdict.cause == "ageing"
    assert verdict.per_day == pytest.approx(0.05, rel=0.1)
    assert verdict.from_s is not None and verdict.from_s <= BEGIN_S
    assert " N a day along a line that began between 2026-01-01" in str(result.exception)


def test_a_log_without_its_load_is_read_again_with_it(unit, tmp_path) -> None:
    """What was counted before is not counted twice, and the means are those of one reading."""
    logs = [
        write_log(tmp_path / f"{k}.csv", 80 + k, 2, begin_s=BEGIN_S + k * 172_800, with_true=False)
        for k in range(3)
    ]
    for log in logs:
        told = read(watch(unit, tmp_path, log))
        assert told.outputs["y"].state == "no reference"
        assert any("read the log again with --load y=VALUE" in note for note in told.notes)
    told = read(watch(unit, tmp_path, logs[0]))
    assert any("was read before; it is passed over" in note for note in told.notes)
    told = read(watch(unit, tmp_path, logs[1], logs[0], logs[2], "--load", "y=0"))
    assert (told.steps, told.steps_in_all) == (0, 6 * DAY)
    assert any("now y is tested on it, too" in note for note in told.notes)
    at_once = tmp_path / "once"
    at_once.mkdir()
    assert watch(unit, at_once, *logs, "--load", "y=0").exit_code == 0
    kept = [json.loads((place / "s.json").read_text()) for place in (tmp_path, at_once)]
    assert kept[0]["outputs"] == kept[1]["outputs"]
    again = read(watch(unit, tmp_path, logs[1], "--load", "y=0"))
    assert any("was read before; it is passed over" in note for note in again.notes)


def test_times_that_begin_anew_follow_the_log_before(unit, tmp_path) -> None:
    for part in range(2):
        log = write_log(tmp_path / f"{part}.csv", 30 + part, 3)
        told = read(watch(unit, tmp_path, log))
    assert told.steps_in_all == 6 * DAY
    assert any("begin anew" in note for note in told.notes)


def test_a_known_load_replaces_the_reference(unit, tmp_path) -> None:
    log = write_log(tmp_path / "a.csv", 40, 3, begin_s=BEGIN_S, with_true=False)
    told = read(watch(unit, tmp_path, log))
    assert told.outputs["y"].state == "no reference"
    told = read(watch(unit, tmp_path, log, "--reset", "--load", "y=0"))
    assert told.outputs["y"].state == "learning"


def test_zero_checks_are_taken_from_the_named_rows_alone(unit, tmp_path) -> None:
    log = write_log(tmp_path / "a.csv", 41, 3, begin_s=BEGIN_S)
    told = read(watch(unit, tmp_path, log, "--load", "y=0", "--when", "true_N=0"))
    assert told.outputs["y"].rms_residual < 0.1  # 10 N of load are not among them


def test_spikes_alarm_nobody(unit, tmp_path) -> None:
    zero = np.zeros(30 * DAY)
    zero[:: DAY // 3] = 50.0
    log = write_log(tmp_path / "a.csv", 42, 30, begin_s=BEGIN_S, zero=zero)
    assert watch(unit, tmp_path, log).exit_code == 0


def test_metrics_are_what_prometheus_reads(unit, tmp_path) -> None:
    log = write_log(tmp_path / "a.csv", 43, 3, begin_s=BEGIN_S)
    assert watch(unit, tmp_path, log, "--metrics", tmp_path / "m.prom").exit_code == 0
    lines = (tmp_path / "m.prom").read_text().splitlines()
    samples = [line for line in lines if not line.startswith("#")]
    assert 'zerodrift_monitor_alarm{sensor="small",output="y",unit="N"} 0' in samples
    for line in samples:
        name, value = line.rsplit(" ", 1)
        float(value)
        family = name.split("{")[0]
        assert f"# TYPE {family} gauge" in lines or f"# TYPE {family} counter" in lines
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_live_source_gives_what_the_file_gives(unit, tmp_path) -> None:
    log = write_log(tmp_path / "a.csv", 44, 3, begin_s=BEGIN_S)
    from_file = read(watch(unit, tmp_path, log))
    live = tmp_path / "live"
    live.mkdir()
    told = read(watch(unit, live, f"command:cat {log}", "--every-s", "43200"))
    assert told.steps_in_all == from_file.steps_in_all
    kept = [json.loads((place / "s.json").read_text()) for place in (tmp_path, live)]
    one, other = (np.array(state["outputs"]["y"]["residual"]) for state in kept)
    assert one == pytest.approx(other, abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--load", "z=0"], "no output 'z'"),
        (["--load", "y"], "a name and a number"),
        (["--sensor", "SN1"], "{sensor}"),
        (["nowhere.csv"], "no such log"),
    ],
)
def test_wrong_usage_is_told_and_writes_nothing(unit, tmp_path, arguments, told: str) -> None:
    log = write_log(tmp_path / "a.csv", 45, 0.1, begin_s=BEGIN_S)
    result = watch(unit, tmp_path, *arguments, *([] if "nowhere.csv" in arguments else [log]))
    assert result.exception is not None
    assert told in str(result.exception)
    assert not (tmp_path / "s.json").exists()


def test_a_state_that_was_edited_or_begun_otherwise_is_refused(unit, tmp_path) -> None:
    log = write_log(tmp_path / "a.csv", 46, 1, begin_s=BEGIN_S)
    assert watch(unit, tmp_path, log).exit_code == 0
    other = watch(unit, tmp_path, log, "--false-alarms", "0.1")
    assert "--false-alarms 0.01" in str(other.exception)
    state = tmp_path / "s.json"
    state.write_text(state.read_text().replace('"steps": 1440', '"steps": 1441'))
    assert "its hash is not its own" in str(watch(unit, tmp_path, log).exception)


def test_a_second_monitor_of_one_state_is_told_to_wait(unit, tmp_path, monkeypatch) -> None:
    log = write_log(tmp_path / "a.csv", 47, 1, begin_s=BEGIN_S)
    monkeypatch.setenv(WAIT_VARIABLE, "0")
    find_state(tmp_path).mkdir(parents=True)
    release = try_lock(find_state(tmp_path) / LOCK)
    assert release is not None
    result = watch(unit, tmp_path, log)
    assert f"{tmp_path}: is being changed by " in str(result.exception)
    assert "Run this again when that is done" in str(result.exception)
    assert not (tmp_path / "s.json").exists()
    release()
    assert watch(unit, tmp_path, log).exit_code == 0


def test_a_log_that_the_system_refuses_is_no_log_without_a_true_value(
    unit, tmp_path, monkeypatch
) -> None:
    log = write_log(tmp_path / "a.csv", 12, 1)
    asked = []

    def refuse(config, log, columns, skip_invalid):
        asked.append(columns)
        if "true_N" in columns:
            raise mend_refusal(log)
        return read_log_steps(config, log, columns, skip_invalid)

    def mend_refusal(log):
        source = next(iter(open_sources(log, "a.csv", {})))
        with pytest.raises(InputError) as told:
            mend_source(source, OSError(24, "Too many open files"))
        return told.value

    monkeypatch.setattr(monitored_log, "read_log_steps", refuse)
    result = watch(unit, tmp_path, log)
    assert len(asked) == 1
    assert "a.csv: cannot be read to its end (Too many open files)" in str(result.exception)
    assert not (tmp_path / "s.json").exists()
