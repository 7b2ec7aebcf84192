"""Kinds of wrong data beyond those of one column's unit: told with run, column and kind."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.physics.conftest import NOISE, SLOPE, follow, make_dataset

from zerodrift.diagnosis.agreement import Bench
from zerodrift.diagnosis.breaks import find_gain_change
from zerodrift.diagnosis.data_notes import INFORMS, KINDS
from zerodrift.diagnosis.explanations import find_reading
from zerodrift.diagnosis.leaks import find_leaks
from zerodrift.diagnosis.referee import review
from zerodrift.diagnosis.sentinels import find_spikes, list_sentinels
from zerodrift.diagnosis.standing import find_cut_off, find_wraps

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "wrong-data.md"


def drifting(bench):
    return (follow(bench.temperature, 90.0) - 25.0)[:, None] * SLOPE


@pytest.fixture(scope="module")
def clean():
    """Runs whose thermometer has a heat capacity."""
    dataset = make_dataset(drifting, runs=7, length=600)
    rng = np.random.default_rng(8)

    def soften(run):
        slow = follow(run.temperature_degC, 60.0) + 0.004 * rng.standard_normal(len(run))
        return replace(run, temperature_degC=slow)

    return replace(dataset, train=tuple(soften(run) for run in dataset.train))


def change_output(run, change):
    measured = run.measured.copy()
    measured[:, 0] = change(measured[:, 0])
    return replace(run, measured=measured)


def change_reference(run, change):
    reference = run.reference.copy()
    reference[:, 0] = change(reference[:, 0])
    return replace(run, reference=reference)


def warm(run, change):
    return replace(run, temperature_degC=change(run.temperature_degC))


def put(value, places):
    def apply(x):
        x = x.copy()
        x[places] = value
        return x

    return apply


def cut(run):
    rows = np.r_[0:200, 420:600]
    return replace(
        run,
        time_s=run.time_s[: rows.size],
        temperature_degC=run.temperature_degC[rows],
        measured=run.measured[rows],
        reference=run.reference[rows],
        inputs={name: values[rows] for name, values in run.inputs.items()},
    )


def exchange(run):
    changed = change_output(run, lambda x: run.temperature_degC)
    return replace(changed, temperature_degC=run.measured[:, 0])


SPIKED = np.arange(10, 590, 20)
KINDS_TRIED = {
    "sentinel": (lambda run: warm(run, put(-127.0, slice(100, 590, 37))), "temperature"),
    "sentinel ": (lambda run: change_output(run, put(9999.0, slice(250, 290))), "Fz"),
    "unit_change": (
        lambda run: warm(run, lambda t: np.where(np.arange(t.size) < 260, t, 1.8 * t + 32.0)),
        "temperature",
    ),
    "saturated": (
        lambda run: warm(run, lambda t: np.minimum(t, np.quantile(t, 0.6))),
        "temperature",
    ),
    "spikes": (
        lambda run: change_output(run, lambda x: x + 500.0 * np.isin(np.arange(x.size), SPIKED)),
        "Fz",
    ),
    "late_reference": (lambda run: change_reference(run, lambda r: np.roll(r, 25)), "reference"),
    "missing_reference": (lambda run: change_reference(run, np.zeros_like), "reference"),
    "swapped": (exchange, "temperature"),
}


@pytest.mark.spread(3, "kind", KINDS_TRIED)
def test_wrong_run_is_told_by_its_own_name(clean, kind):
    spoil, column = KINDS_TRIED[kind]
    train = list(clean.train)
    train[3] = spoil(train[3])
    found = review(replace(clean, train=tuple(train)))
    assert {note.run for note in found if note.stops} == {"run_3"}
    told = [note for note in found if note.kind == kind.strip()]
    assert told and column in told[0].column
    assert told[0].entry == f"run_3: {kind.strip()}"


def test_rows_that_were_cut_out_are_told(clean):
    train = list(clean.train)
    train[3] = cut(train[3])
    found = [note for note in review(replace(clean, train=tuple(train))) if note.run == "run_3"]
    assert [note.kind for note in found] == ["stitched"]
    assert found[0].rows[0] == 200


def test_lamp_that_is_switched_is_no_sentinel():
    rng = np.random.default_rng(3)
    lamp = np.where(np.arange(600) % 300 < 100, 1500.0, 0.1 * rng.standard_normal(600))
    assert not list_sentinels(lamp, visits=5)
    assert list_sentinels(lamp)


def test_steps_that_cancel_but_for_the_last_digits_are_no_quieter_unit():
    rng = np.random.default_rng(4)
    codes = np.cumsum(rng.integers(-1, 2, 900)) * 0.1 + 7.0
    assert find_gain_change(codes)[1] == 0
    factor, row = find_gain_change(
        np.where(np.arange(900) < 400, 1.0, 1000.0) * (5.0 + 0.01 * rng.standard_normal(900))
    )
    assert (factor, row) == (pytest.approx(1000.0, rel=0.02), 400)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_test_run_made_of_a_training_run_is_a_leak(clean, noise):
    rng = np.random.default_rng(5)
    source = clean.train[2]
    measured = 0.63 * source.measured[:-1] + 0.37 * source.measured[1:]
    reference = 0.63 * source.reference[:-1] + 0.37 * source.reference[1:]
    copy = replace(
        source.take(slice(0, -1)),
        name="copy",
        group="copy",
        measured=measured + noise * rng.standard_normal(measured.shape),
        reference=reference,
    )
    (note,) = find_leaks(clean.train, (copy,), clean.outputs)
    assert (note.run, note.kind) == ("copy", "leak")
    assert f"training run {source.group}" in note.text
    assert not find_leaks(clean.train[:-1], clean.train[-1:], clean.outputs)


def repeat(source, extra, rng, slope=0.0):
    """Return a run of the same thermometer, loads and inputs, with other noise on its outputs."""
    warmer = (source.temperature_degC - 25.0)[:, None] * slope * SLOPE
    noise = extra * NOISE * rng.standard_normal(source.measured.shape)
    measured = source.measured + warmer + noise
    return replace(source, name="again", group="again", measured=measured)


def test_copy_under_noise_far_above_its_own_is_a_leak(clean):
    source = clean.train[2]
    copy = repeat(source, 20.0, np.random.default_rng(5))
    (note,) = find_leaks(clean.train, (copy,), clean.outputs)
    assert (note.run, note.kind) == ("again", "leak")
    assert f"training run {source.group} (0 rows later)" in note.text


def test_another_sensor_recorded_at_once_is_no_leak(clean):
    """It shares the thermometer's noise and the loads to the last digit, not its drift."""
    rng = np.random.default_rng(6)
    source = clean.train[2]
    other = repeat(source, 1.0, rng, slope=0.3)
    own = replace(source, measured=source.measured + NOISE * rng.standard_normal((len(source), 2)))
    without = (*clean.train[:2], own, *clean.train[3:])
    assert not find_leaks(without, (repeat(other, 20.0, rng),), clean.outputs)


def test_run_of_the_same_programme_is_no_leak(clean):
    """Thermometer (a coarse one) and loads are the same; each has noise of its own, as large."""
    rng = np.random.default_rng(7)
    source = warm(clean.train[2], lambda x: np.round(x / 0.5) * 0.5)
    slow = follow(clean.train[2].temperature_degC, 90.0) - 25.0
    quiet = replace(source, measured=source.reference + slow[:, None] * SLOPE)
    runs = [repeat(quiet, 1.0, rng) for _ in range(2)]
    train = (replace(runs[0], name="first", group="first"), *clean.train[3:])
    assert not find_leaks(train, (runs[1],), clean.outputs)
    copy = repeat(runs[0], 20.0, rng)
    assert [note.kind for note in find_leaks(train, (copy,), clean.outputs)] == ["leak"]


def test_output_that_stops_at_its_highest_value_is_stuck_not_cut_off(clean):
    """Its load goes back, and it stays: a limit would let it go."""
    train = list(clean.train)
    run = train[3]
    top = int(np.argmax(run.measured[:300, 0]))
    after = slice(top, top + 250)
    x = run.measured[:, 0].copy()
    x[after] = x[top]
    x[top + 250 :] = np.minimum(x[top + 250 :], x[top] - 1.0)
    train[3] = replace(run, measured=np.column_stack([x, run.measured[:, 1]]))
    (note,) = [n for n in review(replace(clean, train=tuple(train))) if n.column == "Fz"]
    assert (note.run, note.kind) == ("run_3", "stuck")


def freeze_before_a_jump(run):
    t = run.temperature_degC.copy()
    t[200:420] = t[200]
    return replace(run, temperature_degC=t)


def test_thermometer_that_stopped_until_a_jump_had_no_other_unit(clean):
    """The jump meets a conversion by chance, to a few hundredths of itself."""
    train = list(clean.train)
    run = freeze_before_a_jump(train[3])
    before, after = run.temperature_degC[419], run.temperature_degC[420]
    fahrenheit = 1.8 * before + 32.0
    moved = run.temperature_degC.copy()
    moved[420:] += 1.02 * fahrenheit - after
    train[3] = replace(run, temperature_degC=moved)
    kinds = {
        n.kind
        for n in review(replace(clean, train=tuple(train)))
        if (n.run, n.column) == ("run_3", "temperature")
    }
    assert kinds == {"frozen"}


def test_value_that_ends_the_log_within_reach_of_other_runs_is_no_sentinel():
    rng = np.random.default_rng(9)
    x = np.where(np.arange(600) < 400, 15.0 + 0.1 * rng.standard_normal(600), 26.0)
    assert list_sentinels(x)
    assert not list_sentinels(x, elsewhere=[np.linspace(0.0, 30.0, 600)])
    assert list_sentinels(np.where(x == 26.0, 9999.0, x), elsewhere=[np.linspace(0.0, 30.0, 600)])


@pytest.mark.parametrize(("height", "told"), [(2000.0, True), (3.0, False)])
def test_few_spikes_are_told_by_what_they_weigh(clean, height, told):
    rows = [70, 190, 333, 480]
    train = list(clean.train)
    train[3] = change_output(train[3], lambda x: x + height * np.isin(np.arange(x.size), rows))
    found = find_spikes(train, clean.outputs)
    assert [(n.run, n.column) for n in found] == ([("run_3", "Fz")] if told else [])


def test_values_for_none_that_come_back_at_once_are_no_counter(clean):
    x = clean.train[3].measured[:, 0]
    scattered = change_output(clean.train[3], put(x.min() + 40.0 * np.ptp(x), SPIKED))
    assert find_wraps([scattered], clean.outputs) == []
    apart = change_output(
        clean.train[3], put(x.min() + 40.0 * np.ptp(x), np.r_[100:120, 300:340, 400])
    )
    assert [n.kind for n in find_wraps([apart], clean.outputs)] == ["wrapped"]


def test_parts_of_one_log_are_not_told_apart_by_a_level_that_one_passes(clean):
    run = clean.train[0]
    x = run.measured[:, 0]
    cut_off = change_output(run, lambda x: np.minimum(x, np.quantile(x, 0.6)))
    wide = change_output(clean.train[1], lambda y: y + 0.5 * np.ptp(x))
    runs = [cut_off, wide, replace(wide, name="run_2", group="run_2")]
    one = Path("log.csv")
    assert find_cut_off([replace(r, source=Path(f"{r.name}.csv")) for r in runs], clean.outputs)
    assert not find_cut_off([replace(r, source=one) for r in runs], clean.outputs)


def test_reading_that_explains_the_worst_run_is_found_and_none_in_clean_runs(clean):
    def look(train):
        bench = Bench(train, clean.outputs, np.array(clean.full_scale))
        return find_reading(bench, frozenset(range(len(train))))

    assert look(clean.train) is None
    train = list(clean.train)
    train[3] = warm(train[3], lambda t: 1.8 * t + 32.0)
    found = look(train)
    assert found is not None
    assert found[0] == 3
    assert (found[1][0].run, found[1][0].kind) == ("run_3", "fahrenheit")


def test_page_lists_every_kind_and_whether_it_stops():
    rows = [line.split("|") for line in PAGE.read_text(encoding="utf-8").splitlines()]
    told = {row[1].strip().strip("`"): row[3].strip() for row in rows if len(row) == 6}
    told.pop("kind")
    told.pop("---")
    assert told == {kind: "no" if kind in INFORMS else "yes" for kind in KINDS}
