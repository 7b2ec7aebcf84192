"""Wrong data in one run: told with run, column and kind; clean logs get no note."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.physics.conftest import NOISE, SLOPE, follow, make_dataset

from zerodrift.diagnosis.agreement import HARM, Bench
from zerodrift.diagnosis.data_notes import INFORMS, KINDS
from zerodrift.diagnosis.explanations import find_reading
from zerodrift.diagnosis.leaks import find_leaks
from zerodrift.diagnosis.misfits import find_noise_gains
from zerodrift.diagnosis.referee import review
from zerodrift.diagnosis.sentinels import find_spikes, list_sentinels
from zerodrift.diagnosis.standing import find_cut_off, find_gain_change, find_standing, find_wraps
from zerodrift.physics.rails import find_rails

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


def cut(run, rows):
    """Leave some rows of a run, whose time goes on."""
    left = run.take(rows)
    return replace(left, time_s=run.time_s[: len(left)])


def exchange(run):
    changed = change_output(run, lambda x: run.temperature_degC)
    return replace(changed, temperature_degC=run.measured[:, 0])


def spoil(dataset, **changes):
    """Return the set with its third run changed."""
    train = list(dataset.train)
    train[2] = replace(train[2], **changes)
    return replace(dataset, train=tuple(train))


def jump(x):
    return x + 40.0 * (np.arange(x.size) >= 333)


def freeze(x):
    rows = np.arange(x.size)
    return np.where((rows > 150) & (rows < 450), x[200], x)


SPIKED = np.arange(10, 590, 20)
KINDS_TRIED = {
    "gain": (lambda run: change_output(run, lambda x: 1000.0 * x), "Fz"),
    "sign": (lambda run: change_output(run, lambda x: -x), "Fz"),
    "fahrenheit": (lambda run: warm(run, lambda t: 1.8 * t + 32.0), "temperature"),
    "kelvin": (lambda run: warm(run, lambda t: t + 273.15), "temperature"),
    "frozen": (lambda run: warm(run, freeze), "temperature"),
    "constant": (lambda run: warm(run, lambda t: np.full(t.size, 22.0)), "temperature"),
    "offset_jump": (lambda run: change_output(run, jump), "Fz"),
    "stuck": (
        lambda run: change_output(run, lambda x: np.where(np.arange(x.size) < 420, x, x[420])),
        "Fz",
    ),
    "wrapped": (
        lambda run: change_output(
            run, lambda x: np.where(x > np.quantile(x, 0.8), x - 3.0 * np.ptp(x), x)
        ),
        "Fz",
    ),
    "swapped ": (lambda run: replace(run, measured=run.measured[:, ::-1]), "Fz"),
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
    "foreign_column": (
        lambda run: change_output(run, lambda x: 1.8 * run.temperature_degC + 32.0),
        "Fz",
    ),
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
    assert told[0].rows[0] < told[0].rows[1] < 600
    assert f"run run_3, column {told[0].column}" in told[0].write()


def test_what_begins_at_a_row_is_told_there(clean):
    run = clean.train[2]
    for changed, kind, row in (
        (cut(run, np.r_[0:200, 420:600]), "stitched", 200),
        (change_output(run, jump), "offset_jump", 333),
        (cut(run, slice(0, None, 60)), "time_unit", 0),
    ):
        train = (*clean.train[:2], changed, *clean.train[3:])
        found = [note for note in review(replace(clean, train=train)) if note.run == "run_2"]
        assert [note.kind for note in found] == [kind]
        assert found[0].rows[0] == pytest.approx(row, abs=1)


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


def test_thermometer_that_stopped_until_a_jump_had_no_other_unit(clean):
    """The jump meets a conversion by chance, to a few hundredths of itself."""
    train = list(clean.train)
    moved = train[3].temperature_degC.copy()
    moved[200:420] = moved[200]
    moved[420:] += 1.02 * (1.8 * moved[419] + 32.0) - moved[420]
    train[3] = replace(train[3], temperature_degC=moved)
    found = {(n.run, n.column): n.kind for n in review(replace(clean, train=tuple(train)))}
    assert found["run_3", "temperature"] == "frozen"


def test_value_that_ends_the_log_within_reach_of_other_runs_is_no_sentinel():
    rng = np.random.default_rng(9)
    x = np.where(np.arange(600) < 400, 15.0 + 0.1 * rng.standard_normal(600), 26.0)
    assert list_sentinels(x)
    assert not list_sentinels(x, elsewhere=[np.linspace(0.0, 30.0, 600)])
    assert list_sentinels(np.where(x == 26.0, 9999.0, x), elsewhere=[np.linspace(0.0, 30.0, 600)])


def test_value_that_is_interpolated_at_its_ends_is_a_sentinel():
    """A log that is resampled has a row between the value and what was read beside it."""
    rng = np.random.default_rng(9)
    x = 15.0 + 0.1 * rng.standard_normal(600)
    for first in (100, 300, 480):
        x[first : first + 40] = -127.0
        x[[first - 1, first + 40]] = -127.0 + 140.0 * rng.random(2)
    ((value, rows),) = list_sentinels(x)
    assert value == -127.0
    assert rows.sum() == 120


@pytest.mark.parametrize("hidden", [False, True])
def test_thermometer_rests_where_no_output_goes_on_and_is_cut_off_where_one_does(clean, hidden):
    train = list(clean.train)
    rows = np.arange(600)
    felt = 30.0 - 25.0 * np.exp(-rows / 40.0)
    true = felt + 20.0 * np.sin((rows - 330) / 90.0) * (rows > 330) * hidden
    noise = 0.02 * NOISE * np.random.default_rng(3).normal(size=(600, 2))
    measured = train[3].reference + (true - 25.0)[:, None] * SLOPE + noise
    train[3] = replace(train[3], temperature_degC=np.round(felt, 1), measured=measured)
    found = {(n.run, n.kind) for n in find_standing(train, clean.outputs)}
    assert found == ({("run_3", "saturated")} if hidden else set())


def test_dwell_that_spikes_as_often_as_the_runs_is_none_of_the_recorder(clean):
    """Single rows of every log stand out: a disturbance of the sensor's own."""

    def disturb(run, count):
        rows = np.random.default_rng(len(run.name)).integers(5, len(run) - 5, count)
        return change_output(run, lambda x: x + 400.0 * np.isin(np.arange(x.size), rows))

    (rest,) = clean.dwell
    spiking = disturb(rest, 3)
    (note,) = review(replace(clean, dwell=(spiking,)))
    assert (note.run, note.column, note.kind) == (rest.group, "Fz", "spikes")
    every = tuple(disturb(run, 2) for run in clean.train)
    assert not find_spikes((*every, spiking), clean.outputs)


@pytest.mark.parametrize("codes", [4.0, 0.0])
def test_steps_of_a_coarse_converter_beside_a_finer_reference_are_no_fault(clean, codes):
    """It moves from code to code, or rests at one for as long as noise does not reach the next."""
    rng = np.random.default_rng(2)
    (rest,) = clean.dwell
    reference = rest.reference + 0.01 * rng.standard_normal(rest.reference.shape)
    slow = np.linspace(0.0, codes, len(rest))[:, None]
    measured = 5.0 * np.round(slow + 0.22 * rng.standard_normal((len(rest), 2)))
    coarse = replace(rest, reference=reference, measured=measured)
    assert not find_spikes((*clean.train, coarse), clean.outputs)
    assert not [n for n in find_standing((coarse,), clean.outputs) if n.column != "temperature"]


def test_thermometer_that_rests_in_a_part_of_a_run_alone_is_connected(clean):
    run = clean.train[0]
    first, later = run.take(slice(0, 60)), run.take(slice(60, len(run)))
    still = warm(first, lambda t: np.full_like(t, t[0]))
    assert not find_standing((still, *clean.train[1:], later), clean.outputs)
    (note,) = find_standing((still, *clean.train[1:]), clean.outputs)
    assert (note.run, note.kind) == (run.group, "constant")


@pytest.mark.parametrize(("height", "told"), [(2000.0, True), (3.0, False)])
def test_few_spikes_are_told_by_what_they_weigh(clean, height, told):
    rows = [70, 190, 333, 480]
    train = list(clean.train)
    train[3] = change_output(train[3], lambda x: x + height * np.isin(np.arange(x.size), rows))
    found = find_spikes(train, clean.outputs)
    assert [(n.run, n.column) for n in found] == ([("run_3", "Fz")] if told else [])


def test_counter_that_wraps_shows_on_an_uneven_clock_too(clean):
    def wrap(x):
        span, low = 0.7 * float(np.ptp(x)), float(x.min())
        return mix(low + np.mod(x - low, span))

    def mix(x):
        return np.interp(np.arange(x.size) + 0.4, np.arange(x.size), x)

    run = change_reference(change_output(clean.train[3], wrap), mix)
    runs = [*clean.train[:3], run, *clean.train[4:]]
    (note,) = find_wraps(runs, clean.outputs)
    assert (note.run, note.column, note.kind) == ("run_3", "Fz", "wrapped")


def test_values_for_none_that_come_back_at_once_are_no_counter(clean):
    x = clean.train[3].measured[:, 0]
    scattered = change_output(clean.train[3], put(x.min() + 40.0 * np.ptp(x), SPIKED))
    assert find_wraps([scattered], clean.outputs) == []
    apart = change_output(
        clean.train[3], put(x.min() + 40.0 * np.ptp(x), np.r_[100:120, 300:340, 400])
    )
    assert [n.kind for n in find_wraps([apart], clean.outputs)] == ["wrapped"]


def test_thermometer_that_stopped_and_one_that_is_cut_short_are_told_apart_by_the_outputs(clean):
    """Rows are missing where an output jumps too; before the jump the thermometer rests in both."""
    rows, rng = np.arange(600), np.random.default_rng(3)
    true = np.interp(rows, [0, 150, 350, 600], [20.0, 45.0, 45.0, 20.0])
    going_on = np.interp(rows, [0, 150, 350, 600], [20.0, 45.0, 5.0, 20.0])
    kinds = {}
    for name, behind in (("stopped", going_on), ("cut", np.where(rows < 350, true, going_on))):
        felt = np.where(rows < 350, true, behind)
        noise = 0.02 * NOISE * rng.normal(size=(600, 2))
        measured = clean.train[3].reference + (behind - 25.0)[:, None] * SLOPE + noise
        felt = np.round(felt / 0.0625) * 0.0625
        run = replace(clean.train[3], temperature_degC=felt, measured=measured)
        runs = [*clean.train[:3], run, *clean.train[4:]]
        found = review(replace(clean, train=tuple(runs)))
        kinds[name] = {n.kind for n in found if (n.run, n.column) == ("run_3", "temperature")}
    assert kinds == {"stopped": {"frozen"}, "cut": {"stitched"}}


def test_what_dies_away_since_the_log_began_is_no_thermometer_that_stands_at_its_limit(clean):
    """A rest at the highest temperature, at which the log begins and the sensor warms up."""
    rows = np.arange(600)
    felt = np.round(np.interp(rows, [0, 300, 600], [40.0, 40.0, 15.0]), 1)
    drift = (felt - 25.0)[:, None] * SLOPE + 8.0 * np.exp(-rows / 60.0)[:, None] * SLOPE
    noise = 0.02 * NOISE * np.random.default_rng(3).normal(size=(600, 2))
    measured = clean.train[3].reference + drift + noise
    train = list(clean.train)
    train[3] = replace(train[3], temperature_degC=felt, measured=measured)
    assert find_standing(train, clean.outputs) == []


def test_counter_that_wraps_several_times_at_once_is_one(clean):
    """A load steps by more than the counter's whole range."""

    def wrap(x):
        return np.mod(x + 3.0 * np.ptp(x) * (np.arange(x.size) // 100 % 2), 0.7 * np.ptp(x))

    def load(x):
        return x + 3.0 * np.ptp(clean.train[3].measured[:, 0]) * (np.arange(x.size) // 100 % 2)

    run = change_reference(change_output(clean.train[3], wrap), load)
    (note,) = find_wraps([*clean.train[:3], run], clean.outputs)
    assert (note.run, note.column, note.kind) == ("run_3", "Fz", "wrapped")


def test_spikes_to_either_side_are_no_counter(clean):
    x = clean.train[3].measured[:, 0]
    spiked = change_output(clean.train[3], put(x.max() + np.ptp(x), [50, 250, 450]))
    spiked = change_output(spiked, put(x.min() - np.ptp(x), [150, 350]))
    assert find_wraps([spiked], clean.outputs) == []


def test_level_that_another_part_of_the_run_passes_is_no_limit(clean):
    part = change_output(clean.train[0], lambda x: np.minimum(x, np.quantile(x, 0.6)))
    higher = replace(change_output(clean.train[0], lambda x: x + np.ptp(x)), part=1, name="run_0#2")
    others = [change_output(run, lambda x: 3.0 * x) for run in clean.train[1:4]]
    assert find_cut_off([part, *others], clean.outputs)
    assert not find_cut_off([part, higher, *others], clean.outputs)


def test_late_reference_shows_under_a_load_that_moves_smoothly(clean):
    """Its changes are much the same a little later: what counts is how much more is explained."""
    rows = np.arange(600)
    smooth = 40.0 * np.sin(rows / 25.0)

    def loaded(run, late):
        run = change_output(run, lambda x: x - run.reference[:, 0] + smooth)
        return change_reference(run, lambda x: np.roll(smooth, late))

    train = [loaded(run, 5 if i == 3 else 0) for i, run in enumerate(clean.train)]
    found = {(n.run, n.column): n.kind for n in review(replace(clean, train=tuple(train)))}
    assert found == {("run_3", "reference of Fz"): "late_reference"}


def test_reference_that_stands_while_a_load_begins_late_is_missing(clean):
    """The output's noise seems to change its gain where the load begins."""
    begins = (np.arange(600) > 200) * np.repeat(np.random.default_rng(2).normal(size=60), 10)
    run = change_output(
        clean.train[3], lambda x: x - clean.train[3].reference[:, 0] + 99.0 * begins
    )
    run = change_reference(run, lambda x: 0.0 * x)
    found = review(replace(clean, train=(*clean.train[:3], run, *clean.train[4:])))
    assert {n.kind for n in found if n.run == "run_3"} == {"missing_reference"}


def test_parts_of_one_log_are_not_told_apart_by_a_level_that_one_passes(clean):
    run = clean.train[0]
    x = run.measured[:, 0]
    cut_off = change_output(run, lambda x: np.minimum(x, np.quantile(x, 0.6)))
    wide = change_output(clean.train[1], lambda y: y + 0.5 * np.ptp(x))
    runs = [cut_off, wide, replace(wide, name="run_2", group="run_2")]
    one = Path("log.csv")
    assert find_cut_off([replace(r, source=Path(f"{r.name}.csv")) for r in runs], clean.outputs)
    assert not find_cut_off([replace(r, source=one) for r in runs], clean.outputs)


def test_output_that_stands_at_a_level_of_its_own_in_each_of_two_runs_is_not_cut_off(clean):
    def cut_off(run, share):
        return change_output(run, lambda x: np.minimum(x, np.quantile(x, share)))

    wide = [change_output(run, lambda y: y + 2000.0 * (y > np.median(y))) for run in clean.train]
    one = [cut_off(clean.train[0], 0.6), *wide[2:]]
    assert {n.run for n in find_cut_off(one, clean.outputs)} == {"run_0"}
    two = [*one, cut_off(clean.train[1], 0.5)]
    assert find_cut_off(two, clean.outputs) == []


def test_reading_that_explains_the_worst_run_is_found_and_none_in_clean_runs(clean):
    assert find_reading(*hold(clean)) is None
    in_degF = 1.8 * clean.train[2].temperature_degC + 32.0
    found = find_reading(*hold(spoil(clean, temperature_degC=in_degF)))
    assert found is not None
    assert (found[0], found[1][0].run, found[1][0].kind) == (2, "run_2", "fahrenheit")


def test_page_lists_every_kind_and_whether_it_stops():
    rows = [line.split("|") for line in PAGE.read_text(encoding="utf-8").splitlines()]
    told = {row[1].strip().strip("`"): row[3].strip() for row in rows if len(row) == 6}
    told.pop("kind")
    told.pop("---")
    assert told == {kind: "no" if kind in INFORMS else "yes" for kind in KINDS}


def test_clean_logs_get_no_note(clean):
    assert review(clean) == ()
    assert review(replace(clean, train=clean.train[:1])) == ()
    assert review(make_dataset(lambda b: 0.0 * b.load, runs=4, length=300)) == ()


def test_what_all_runs_show_is_no_wrong_data(clean):
    jumping = replace(clean, train=tuple(change_output(run, jump) for run in clean.train))
    assert review(jumping) == ()
    flipped = replace(
        clean, train=tuple(replace(run, measured=-run.measured) for run in clean.train)
    )
    assert all(note.kind != "sign" for note in review(flipped))


def test_test_logs_that_reach_further_or_are_too_short_are_told(clean):
    *train, last = clean.train
    hot = replace(last, temperature_degC=last.temperature_degC + 60.0)
    found = review(replace(clean, train=tuple(train), test=(hot,)))
    assert ("run_6", "temperature", "beyond_training") in {
        (note.run, note.column, note.kind) for note in found
    }
    short = review(replace(clean, train=tuple(train), test=(last.take(slice(0, 12)),)))
    assert [note.kind for note in short] == ["too_short"]


def test_coarse_converter_at_rest_does_not_wrap(clean):
    rest = np.random.default_rng(1).integers(0, 3, 600)[:, None] * np.array([1.0, 0.01])
    still = spoil(clean, measured=clean.train[2].reference + 0.0 * rest + rest)
    assert all(note.kind != "wrapped" for note in review(still))


def test_another_unit_shows_by_its_noise_in_a_run_of_a_kind_of_its_own(clean):
    rng = np.random.default_rng(5)

    def shake(run):
        return run.measured + 3.0 * rng.standard_normal(run.measured.shape) * [0.05, 0.0005]

    shaken = spoil(clean, measured=shake(clean.train[2]))
    assert not find_noise_gains(shaken.train, clean.outputs)
    thousandfold = clean.train[2].measured * [1000.0, 1.0]
    (note,) = find_noise_gains(spoil(clean, measured=thousandfold).train, clean.outputs)
    assert (note.run, note.column, note.kind) == ("run_2", clean.outputs[0], "gain")
    assert "1000 times" in note.text


def test_more_noise_alone_is_no_other_unit(clean):
    rng = np.random.default_rng(6)
    run = clean.train[2]
    louder = run.measured + np.outer(2.0 * rng.standard_normal(len(run)), [1.0, 0.0])
    assert not find_noise_gains(spoil(clean, measured=louder).train, clean.outputs)


def hold(dataset):
    bench = Bench(dataset.train, dataset.outputs, np.array(dataset.full_scale))
    return bench, frozenset(range(len(bench.groups)))


@pytest.mark.parametrize(("every", "as_measured"), [(97, False), (11, True)])
def test_what_is_wild_all_over_is_taken_as_it_was_measured(every, as_measured, clean):
    measured = clean.train[2].measured.copy()
    measured[5::every, 0] += 400.0
    spoilt = spoil(clean, measured=measured)
    course = hold(spoilt)[0].courses[2][0]
    assert np.array_equal(course.drift, spoilt.train[2].drift) == as_measured


def test_a_drift_that_goes_with_the_load_is_no_other_gain(clean):
    # In one run alone the load and the temperature move together.
    bench, every = hold(clean)
    assert bench.agrees("run_2", clean.outputs[0], every)
    bench, every = hold(spoil(clean, measured=2.0 * clean.train[2].measured))
    assert not bench.agrees("run_2", clean.outputs[0], every)


def test_alike_samples_on_one_plateau_of_the_load_are_not_cut_off(clean):
    """Chance repeats an extreme for a few samples; an amplifier at its end does for any load."""
    highest = [float(run.measured[:, 0].max()) for run in clean.train]
    place = int(np.argsort(highest)[len(highest) // 2])
    run = clean.train[place]
    top = int(np.argmax(run.measured[:, 0]))
    rows = np.flatnonzero(run.reference[:, 0] == run.reference[top, 0])[:8]
    train = list(clean.train)
    train[place] = change_output(run, put(highest[place], rows))
    assert find_rails(train[place].measured[:, 0], run.reference[:, 0]).sum() >= rows.size
    assert find_cut_off(train, clean.outputs) == []
    train[place] = change_output(run, lambda x: np.minimum(x, np.quantile(x, 0.5)))
    (note,) = find_cut_off(train, clean.outputs)
    assert (note.run, note.column, note.kind) == (run.group, clean.outputs[0], "saturated")


def test_run_that_doubles_what_is_left_of_the_others_is_stopped_whatever_it_is(clean):
    """No unit, sign or column explains it: it is another sensor's, or something unknown."""
    run = clean.train[2]
    assert hold(clean)[0].find_worst(hold(clean)[1]) is None
    odd = 25.0 * np.sin(np.arange(len(run)) / 40.0)[:, None] * [1.0, 0.01]
    spoilt = spoil(clean, measured=run.measured + odd)
    bench, every = hold(spoilt)
    assert bench.find_worst(every) == 2
    assert bench.assess(2, every).harm.max() > HARM
    (note,) = review(spoilt)
    assert (note.run, note.kind) == ("run_2", "another_sensor")
    assert "does not agree with the others" in note.text


def test_run_that_goes_further_than_all_others_is_held_to_them_where_they_have_been():
    """How its drift goes on beyond them, no fit of the others knows."""
    apart = make_dataset(drifting, runs=5, length=600)
    train = list(apart.train)
    run = train[1]
    warm = 5.0 + 95.0 * np.sin(np.pi * np.arange(len(run)) / len(run))
    bent = np.where(warm > 55.0, 4.0 * (warm - 55.0), 0.0)[:, None] * SLOPE
    drift = (follow(warm, 90.0) - 25.0)[:, None] * SLOPE + bent

    def look(drift, rows=slice(None)):
        whole = replace(run, temperature_degC=warm, measured=run.reference + drift)
        train[1] = whole.take(rows)
        bench, every = hold(replace(apart, train=tuple(train)))
        return bench.assess(1, every).doubt.max(), bench.find_worst(every)

    beyond = np.flatnonzero(warm > 55.0)
    for rows in (slice(None), slice(int(beyond[0]), int(beyond[-1]))):
        doubt, worst = look(drift, rows)
        assert doubt > 1.0
        assert worst is None
    assert look(-drift)[1] == 1


def test_parts_of_a_run_are_held_together(clean):
    """A gap makes two stretches of a run; what is wrong with it is told once."""
    run = clean.train[2]
    reversed_run = replace(run, measured=-run.measured)
    first, last = reversed_run.take(slice(0, 280)), reversed_run.take(slice(320, 600))
    parts = (first, replace(last, name="run_2#2", part=1))
    train = (*clean.train[:2], *parts, *clean.train[3:])
    found = review(replace(clean, train=train))
    assert {(note.run, note.kind) for note in found} == {("run_2", "sign")}
