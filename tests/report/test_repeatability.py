"""Repeatability of logs made by hand, whose answer is known."""

import numpy as np
import pytest
from tests.report.conftest import make_comparison, make_trace

from zerodrift.report.datasheet import measure_datasheet, measure_repeatability
from zerodrift.report.tables import tabulate_datasheet

FULL_SCALE = 100.0
HOLD = 100


def make_run(loads, extra, *, temperature=25.0, temperatures=None, left=0.1, **about):
    """Return a run of holds of 100 s, the load of each, and what is added to the drift there."""
    load = np.repeat(np.asarray(loads, dtype=float), HOLD)
    drift = np.repeat(np.asarray(extra, dtype=float), HOLD)
    warm = np.repeat(temperatures if temperatures is not None else [temperature], HOLD)
    warm = np.resize(warm, load.size) if temperatures is None else np.asarray(warm, float)
    return make_trace(drift, left * drift, temperature=warm, load=load, **about)


def measure(*traces, compensated=False, slopes=(0.0, 0.0)):
    return measure_repeatability(traces, 0, FULL_SCALE, compensated=compensated, slopes=slopes)


def test_a_load_put_on_three_times_tells_largest_difference_and_deviation():
    run = make_run([0, 50, 0, 50, 0, 50, 0], [9.0, 1.0, 9.0, 1.3, 9.0, 1.1, 9.0])
    told = measure(run)
    assert told.largest == pytest.approx(0.3, abs=1e-12)
    assert told.deviation == pytest.approx(np.std([1.0, 1.3, 1.1], ddof=1), abs=1e-12)
    assert (told.readings, told.groups) == (3, 1)
    assert measure(run, compensated=True).largest == pytest.approx(0.03, abs=1e-12)


def test_runs_that_repeat_a_load_count_and_so_does_what_lies_between_them():
    runs = [make_run([0, 50], [0.0, value]) for value in (1.0, 1.5)]
    assert measure(*runs).largest == pytest.approx(0.5)


def test_runs_that_begin_under_load_are_compared_with_each_other_alone():
    begun = [make_run([50], [value]) for value in (1.0, 1.2)]
    assert measure(*begun).largest == pytest.approx(0.2)
    assert measure(begun[0], make_run([0, 50], [0.0, 4.0])) is None


@pytest.mark.parametrize(
    "run",
    [
        make_run([0, 50, 0], [0.0, 1.0, 0.0]),
        make_run([0, 50, 80, 50, 0], [0.0, 1.0, 0.0, 2.0, 0.0]),
        make_run([0, 50, 0, 52], [0.0, 1.0, 0.0, 2.0]),
        make_run([0, 0, 0, 0], [0.0, 1.0, 0.0, 2.0]),
        make_run([0, 50, 0, 50], [0.0, 1.0, 0.0, 2.0], temperatures=[20.0, 20.0, 25.0, 25.0]),
    ],
    ids=["once", "from below and from above", "another load", "no load", "another temperature"],
)
def test_what_is_no_repeat_is_not_told(run):
    assert measure(run) is None


def test_readings_while_the_temperature_moves_do_not_count():
    run = make_run([0, 50, 0, 50, 0], [0.0, 1.0, 0.0, 2.0, 0.0])
    time_s = run.time_s
    moving = make_trace(
        run.drift[0], run.error[0], temperature=20.0 + time_s / 30.0, load=run.load[0]
    )
    assert measure(run) is not None
    assert measure(moving) is None


def test_holds_too_short_and_loads_that_wander_do_not_count():
    pulses = np.tile(np.concatenate([np.zeros(100), np.full(40, 50.0)]), 4)
    short = make_trace(pulses, pulses, temperature=np.full(560, 25.0), load=pulses)
    assert measure(short) is None
    # 0.004 %FS a second up and down: any window holds its load, none was put on.
    slow = 50.0 + np.abs(np.arange(2000.0) % 1000 - 500) * 0.004
    drift = np.arange(2000.0)
    assert measure(make_trace(drift, drift, temperature=np.full(2000, 25.0), load=slow)) is None


def test_the_slopes_are_taken_off_where_temperatures_differ_a_little():
    warm = [25.0, 25.0, 25.8, 25.8]
    rise = (0.02 + 0.0004 * 50.0) * 0.8
    run = make_run([0, 50, 0, 50], [0.0, 1.0, 0.0, 1.1 + rise], temperatures=warm)
    assert measure(run).largest == pytest.approx(0.1 + rise)
    assert measure(run, slopes=(0.02, 0.0004)).largest == pytest.approx(0.1)


def test_several_loads_are_pooled_and_the_worst_is_told():
    run = make_run([0, 50, 0, 80, 0, 50, 0, 80], [0.0, 1.0, 0.0, 2.0, 0.0, 1.2, 0.0, 2.6])
    told = measure(run)
    assert told.largest == pytest.approx(0.6)
    assert told.deviation == pytest.approx(np.sqrt((0.2**2 / 2 + 0.6**2 / 2) / 2))
    assert (told.readings, told.groups) == (4, 2)


def test_datasheet_has_the_row_in_percent_of_full_scale():
    warm = [20.0, 20.0, 20.0, 20.0, 40.0, 40.0]
    runs = [
        make_run(
            [0, 50, 0, 50, 0, 0], [0, 1.0, 0, 1.5, 0, 0], temperatures=warm, held_out=bool(number)
        )
        for number in range(2)
    ]
    rows = measure_datasheet(runs, make_comparison(full_scale=200.0))
    (row,) = (row for row in rows if row.quantity == "repeatability")
    assert row.unit == "%FS"
    assert row.before == (pytest.approx(0.25), None)
    assert row.after == (pytest.approx(0.025), None)
    assert "4 readings that repeat 1 load " in row.note
    assert any("repeatability" in line for line in tabulate_datasheet(rows).rows)


def test_datasheet_says_where_the_held_out_runs_repeat_nothing():
    warm = [20.0, 20.0, 20.0, 20.0, 40.0, 40.0]
    repeats = make_run(
        [0, 50, 0, 50, 0, 0], [0, 1.0, 0, 1.5, 0, 0], temperatures=warm, held_out=False
    )
    once = make_run([0, 50, 0, 0, 0, 0], [0, 1.0, 0, 0, 0, 0], temperatures=warm)
    rows = measure_datasheet([repeats, once], make_comparison(full_scale=200.0))
    (row,) = (row for row in rows if row.quantity == "repeatability")
    assert row.before == (pytest.approx(0.25), None)
    assert row.after is None
    assert "not shown by the held-out runs" in row.note
    rows = measure_datasheet([once], make_comparison(full_scale=200.0))
    (row,) = (row for row in rows if row.quantity == "repeatability")
    assert row.before is row.after is None
    assert row.note.startswith("not shown by these logs")
