"""Times as loggers write them: formats, zones, daylight saving, midnight, what cannot be told."""

from datetime import UTC, datetime, timedelta, timezone
from zoneinfo import ZoneInfo

import numpy as np
import polars as pl
import pytest

COUNT = 60
UTC_START = datetime(2024, 10, 21, 15, 52, 16, tzinfo=UTC)


def write_log(project, times, header="time_s", separator=","):
    rows = [
        separator.join([time, repr(20 + 0.25 * k), repr(3.5 * k), "0"])
        for k, time in enumerate(times)
    ]
    names = separator.join([header, "temperature_degC", "Fz_N", "ref_Fz_N"])
    (project.directory / "log.csv").write_text("\n".join([names, *rows]) + "\n")


def state(project, time: str) -> None:
    toml = project.directory / "zerodrift.toml"
    toml.write_text(toml.read_text().replace('time = "time_s"', f"time = {time}"))


def step(seconds: float = 1.0, start: datetime = UTC_START, count: int = COUNT):
    return [start + timedelta(seconds=seconds * k) for k in range(count)]


@pytest.mark.parametrize(
    "write",
    [
        lambda t: t.strftime("%Y-%m-%dT%H:%M:%SZ"),
        lambda t: t.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
        lambda t: t.strftime("%Y-%m-%dT%H:%M:%S+00:00"),
        lambda t: (t + timedelta(hours=2)).strftime("%Y-%m-%d %H:%M:%S+0200"),
        lambda t: t.strftime("%Y-%m-%d %H:%M:%S UTC"),
        lambda t: t.strftime("%Y%m%dT%H%M%SZ"),
        lambda t: t.strftime("%Y-%m-%dT%H:%M:%S"),
        lambda t: t.strftime("%Y-%m-%d %H:%M:%S.%f"),
        lambda t: t.strftime("%Y/%m/%d %H:%M:%S"),
        lambda t: t.strftime("%d.%m.%Y %H:%M:%S"),
        lambda t: t.strftime("%d/%m/%Y-%H:%M:%S"),
        lambda t: t.strftime("%m/%d/%Y %I:%M:%S %p"),
        lambda t: t.strftime("%d-%b-%Y %H:%M:%S"),
        lambda t: t.strftime("%d.%m.%y %H:%M:%S"),
        lambda t: f"{t.timestamp():.3f}",
    ],
)
def test_dates_are_read_as_seconds_from_1970(project, write):
    write_log(project, [write(t) for t in step()])
    (run,) = project.load().train
    np.testing.assert_allclose(run.time_s, UTC_START.timestamp() + np.arange(COUNT), atol=1e-6)


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_unix_times_keep_their_microseconds(project, unit):
    scale = {"ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    start = int(UTC_START.timestamp())
    write_log(project, [str((start + k) * scale) for k in range(COUNT)])
    state(project, f'{{ column = "time_s", unit = "{unit}" }}')
    (run,) = project.load().train
    np.testing.assert_allclose(run.time_s - start, np.arange(COUNT), atol=1e-6)


def test_counter_in_ms_is_read(project):
    write_log(project, [str(1000 * k + 77) for k in range(COUNT)], header="millis")
    state(project, '"millis"')
    (run,) = project.load().train
    np.testing.assert_allclose(run.time_s, np.arange(COUNT) + 0.077, atol=1e-9)


def test_day_and_month_that_cannot_be_told_are_asked_for(project):
    start = datetime(2024, 3, 4, 10, 0, 0, tzinfo=UTC)
    write_log(project, [t.strftime("%d/%m/%Y %H:%M:%S") for t in step(start=start)])
    message = project.refusal()
    assert "log.csv: column 'time_s' holds '04/03/2024 10:00:00'" in message
    assert '"%d/%m/%Y %H:%M:%S.%f" (day first) or "%m/%d/%Y %H:%M:%S.%f" (month first)' in message
    assert 'format = "%d/%m/%Y %H:%M:%S.%f"' in message
    for code, month in (("%d/%m", 3), ("%m/%d", 4)):
        project.write_toml((project.directory / "zerodrift.toml").read_text())
        state(project, f'{{ column = "time_s", format = "{code}/%Y %H:%M:%S" }}')
        at = datetime.fromtimestamp(project.load().train[0].time_s[0], UTC)
        assert (at.month, at.day) == (month, 7 - month)
        toml = project.directory / "zerodrift.toml"
        lines = toml.read_text().splitlines()
        toml.write_text(
            "\n".join('time = "time_s"' if x.startswith("time =") else x for x in lines) + "\n"
        )


def test_later_rows_tell_day_from_month(project):
    start = datetime(2024, 3, 4, 10, 0, 0, tzinfo=UTC)
    times = step(3600, start, 300)
    write_log(project, [t.strftime("%d/%m/%Y %H:%M") for t in times])
    (run,) = project.load(sample_period_s=3600.0).train
    assert run.time_s[0] == start.timestamp()
    np.testing.assert_allclose(np.diff(run.time_s), 3600)


def test_time_of_day_goes_on_over_midnight(project):
    start = datetime(2024, 3, 4, 23, 59, 30, tzinfo=UTC)
    write_log(project, [t.strftime("%H:%M:%S") for t in step(start=start)])
    (run,) = project.load().train
    np.testing.assert_allclose(run.time_s, 86370 + np.arange(COUNT), atol=1e-9)


def test_elapsed_hours_may_exceed_a_day(project):
    times = [86390 + k for k in range(COUNT)]
    write_log(
        project, [f"{s // 3600}:{s // 60 % 60:02d}:{s % 60:02d},5" for s in times], separator=";"
    )
    (run,) = project.load().train
    np.testing.assert_allclose(run.time_s, np.array(times) + 0.5, atol=1e-9)


def test_date_and_time_of_day_in_two_columns(project):
    start = datetime(2024, 3, 4, 23, 59, 30, tzinfo=UTC)
    times = [t.strftime("%d.%m.%Y;%H:%M:%S") for t in step(start=start)]
    write_log(project, times, header="Datum;Uhrzeit", separator=";")
    state(project, '{ column = ["Datum", "Uhrzeit"] }')
    (run,) = project.load().train
    np.testing.assert_allclose(run.time_s - start.timestamp(), np.arange(COUNT), atol=1e-6)


def write_berlin(start: datetime, minutes: int, count: int) -> list[str]:
    zone = ZoneInfo("Europe/Berlin")
    times = (start + timedelta(minutes=minutes * k) for k in range(count))
    return [t.astimezone(zone).strftime("%Y-%m-%d %H:%M:%S") for t in times]


BERLIN = '{ column = "time_s", zone = "Europe/Berlin" }'


@pytest.mark.parametrize("minutes", [1, 5])
@pytest.mark.parametrize(
    "start", [datetime(2024, 10, 26, 23, 10, tzinfo=UTC), datetime(2024, 3, 31, 0, 10, tzinfo=UTC)]
)
def test_zone_makes_times_even_over_daylight_saving(project, start, minutes):
    write_log(project, write_berlin(start, minutes, 150))
    state(project, BERLIN)
    (run,) = project.load(sample_period_s=60.0 * minutes).train
    np.testing.assert_allclose(run.time_s, start.timestamp() + 60 * minutes * np.arange(150))


@pytest.mark.parametrize(("hour", "minute"), [(0, 5), (1, 5)])
def test_log_that_begins_or_ends_in_the_repeated_hour_is_told_by_its_neighbours(
    project, hour, minute
):
    # 02:05 to 03:25 in the second pass, or 00:45 to 02:25 in the first one.
    first = hour == 0
    start = (
        datetime(2024, 10, 26, 22, 45, tzinfo=UTC)
        if first
        else datetime(2024, 10, 27, 1, minute, tzinfo=UTC)
    )
    write_log(project, write_berlin(start, 1, 100 if first else 80))
    state(project, BERLIN)
    (run,) = project.load(sample_period_s=60.0).train
    assert run.time_s[0] == start.timestamp()
    assert np.ptp(run.time_s) == 60 * (99 if first else 79)


def test_clock_that_was_not_put_back_is_refused(project):
    start = datetime(2024, 10, 27, 1, 30, tzinfo=UTC)
    write_log(project, [t.strftime("%Y-%m-%d %H:%M:%S") for t in step(60, start, 120)])
    state(project, BERLIN)
    message = project.refusal(sample_period_s=60.0)
    assert "the hour from 2024-10-27 02:00:00 on is there twice in Europe/Berlin" in message
    assert "state a fixed zone such as +01:00" in message
    state_text = (project.directory / "zerodrift.toml").read_text()
    (project.directory / "zerodrift.toml").write_text(state_text.replace("Europe/Berlin", "+01:00"))
    assert project.load(sample_period_s=60.0).train[0].time_s[0] == start.timestamp() - 3600


def test_time_that_its_zone_does_not_have_is_refused(project):
    start = datetime(2024, 3, 31, 1, 30, tzinfo=UTC)
    write_log(project, [t.strftime("%Y-%m-%d %H:%M:%S") for t in step(60, start, 120)])
    state(project, BERLIN)
    message = project.refusal(sample_period_s=60.0)
    assert "row 31: time_s is 2024-03-31 02:00:00, which Europe/Berlin does not have" in message


def test_zone_that_does_not_exist_is_refused(project):
    write_log(project, [t.strftime("%Y-%m-%d %H:%M:%S") for t in step()])
    state(project, '{ column = "time_s", zone = "Europe/Berin" }')
    message = project.refusal()
    assert "there is no time zone 'Europe/Berin'; expected a name such as Europe/Berlin" in message


def test_time_without_a_zone_stays_a_local_clock(project):
    local = UTC_START.replace(tzinfo=timezone(timedelta(hours=5)))
    write_log(project, [t.strftime("%Y-%m-%d %H:%M:%S") for t in step(start=local)])
    assert project.load().train[0].time_s[0] == UTC_START.timestamp()


def test_text_that_is_no_time_is_refused_with_its_line(project):
    times = [t.strftime("%Y-%m-%d %H:%M:%S") for t in step()]
    times[30] = "lid opened"
    write_log(project, times)
    assert "log.csv:32: time_s holds 'lid opened', which is no time" in project.refusal()
    assert len(project.load(skip_invalid=True).train[0]) == COUNT


def test_unknown_text_says_how_to_state_a_format(project):
    write_log(project, [f"day {k} of the trial" for k in range(COUNT)])
    message = project.refusal()
    assert "holds 'day 0 of the trial', which is no number and no time that is known" in message


def test_unit_and_format_contradict_each_other(project):
    state(project, '{ column = "time_s", unit = "ms", format = "%H:%M" }')
    assert "contradict each other; expected a unit for numbers, or a format for text" in (
        project.refusal()
    )


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Tokyo"])
@pytest.mark.parametrize("kind", ["parquet", "feather"])
def test_datetimes_of_parquet_and_feather(project, unit, zone, kind):
    write_log(project, [repr(float(k)) for k in range(COUNT)])
    frame = pl.read_csv(project.directory / "log.csv").with_columns(
        pl.Series("time_s", [t.replace(tzinfo=None) for t in step()]).cast(pl.Datetime(unit))
    )
    if zone:
        at = pl.col("time_s").dt.replace_time_zone("UTC").dt.convert_time_zone(zone)
        frame = frame.with_columns(at)
    path = project.directory / f"log.{kind}"
    frame.write_parquet(path) if kind == "parquet" else frame.write_ipc(path)
    (run,) = project.load(train_logs=(path.name,)).train
    np.testing.assert_allclose(run.time_s - UTC_START.timestamp(), np.arange(COUNT), atol=1e-6)


def test_rows_that_are_written_less_evenly_later_are_read_too(project):
    start = datetime(2024, 10, 21, 23, 58, 30, tzinfo=UTC)
    times = [
        t.strftime("%Y-%m-%d %H:%M:%S").replace(" 00:", " 0:") for t in step(start=start, count=200)
    ]
    write_log(project, times)
    (run,) = project.load().train
    np.testing.assert_allclose(run.time_s, start.timestamp() + np.arange(200), atol=1e-6)


def test_second_that_no_minute_has_is_refused(project):
    times = [t.strftime("%Y-%m-%d %H:%M:%S") for t in step()]
    times[30] = times[30][:-2] + "75"
    write_log(project, times)
    assert "log.csv:32: time_s holds '2024-10-21 15:52:75', which is no time" in project.refusal()
