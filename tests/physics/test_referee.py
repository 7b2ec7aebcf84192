"""Wrong data in one run: told with run, column and kind; clean logs get no note."""

from dataclasses import replace

import numpy as np
import pytest
from tests.physics.conftest import SLOPE, follow, make_dataset

from zerodrift.diagnosis.agreement import HARM, Bench
from zerodrift.diagnosis.noise_gains import find_noise_gains
from zerodrift.diagnosis.referee import review
from zerodrift.diagnosis.standing import find_cut_off
from zerodrift.physics.rails import find_rails


def drifting(bench):
    return (follow(bench.temperature, 90.0) - 25.0)[:, None] * SLOPE


@pytest.fixture(scope="module")
def clean():
    return make_dataset(drifting, runs=7, length=600)


def spoil(dataset, **changes):
    """Return the set with its third run changed."""
    train = list(dataset.train)
    train[2] = replace(train[2], **changes)
    return replace(dataset, train=tuple(train))


def measure(change):
    def apply(run):
        measured = run.measured.copy()
        measured[:, 0] = change(measured[:, 0])
        return {"measured": measured}

    return apply


def warm(change):
    return lambda run: {"temperature_degC": change(run.temperature_degC)}


def jump(x):
    return x + 40.0 * (np.arange(x.size) >= 333)


def stick(x):
    return np.where(np.arange(x.size) < 420, x, x[420])


def freeze(x):
    rows = np.arange(x.size)
    return np.where((rows > 150) & (rows < 450), x[200], x)


def wrap(x):
    return np.where(x > np.quantile(x, 0.8), x - 3.0 * np.ptp(x), x)


KINDS = {
    "gain": (measure(lambda x: 1000.0 * x), "Fz"),
    "sign": (measure(lambda x: -x), "Fz"),
    "fahrenheit": (warm(lambda t: 1.8 * t + 32.0), "temperature"),
    "kelvin": (warm(lambda t: t + 273.15), "temperature"),
    "frozen": (warm(freeze), "temperature"),
    "constant": (warm(lambda t: np.full(t.size, 22.0)), "temperature"),
    "offset_jump": (measure(jump), "Fz"),
    "stuck": (measure(stick), "Fz"),
    "wrapped": (measure(wrap), "Fz"),
    "swapped": (lambda run: {"measured": run.measured[:, ::-1]}, "Fz"),
}


def test_clean_logs_get_no_note(clean):
    assert review(clean) == ()
    assert review(replace(clean, train=clean.train[:1])) == ()
    assert review(make_dataset(lambda b: 0.0 * b.load, runs=4, length=300)) == ()


@pytest.mark.spread(4, "kind", KINDS)
def test_wrong_run_is_told_with_its_column(clean, kind):
    change, column = KINDS[kind]
    found = review(spoil(clean, **change(clean.train[2])))
    assert {note.run for note in found} == {"run_2"}
    mine = [note for note in found if note.column == column]
    assert mine and mine[0].kind == kind
    assert mine[0].rows[0] < mine[0].rows[1] < 600
    assert f"run run_2, column {column}" in mine[0].write()


def test_jump_is_told_where_it_is(clean):
    (note,) = review(spoil(clean, **measure(jump)(clean.train[2])))
    assert note.rows[0] == pytest.approx(333, abs=1)


def test_time_in_another_unit_is_told(clean):
    run = clean.train[2]
    short = run.take(slice(0, None, 60))
    wrong = spoil(
        clean,
        **{name: getattr(short, name) for name in ("temperature_degC", "measured", "reference")},
        time_s=run.time_s[: len(short)],
        inputs=short.inputs,
    )
    found = review(wrong)
    assert [(note.run, note.column, note.kind) for note in found] == [
        ("run_2", "time", "time_unit")
    ]


def test_what_all_runs_show_is_no_wrong_data(clean):
    def everywhere(run):
        return replace(run, **measure(lambda x: x + jump(0.0 * x))(run))

    jumping = replace(clean, train=tuple(everywhere(run) for run in clean.train))
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
    measured = run.measured.copy()
    measured[rows, 0] = highest[place]
    train = list(clean.train)
    train[place] = replace(run, measured=measured)
    assert find_rails(measured[:, 0], run.reference[:, 0]).sum() >= rows.size
    assert find_cut_off(train, clean.outputs) == []
    cut = run.measured.copy()
    cut[:, 0] = np.minimum(cut[:, 0], np.quantile(cut[:, 0], 0.5))
    train[place] = replace(run, measured=cut)
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


def test_run_of_a_kind_of_its_own_does_no_harm():
    """A soak at a temperature where no other run has been, and a slow one, add to what is known."""
    apart = make_dataset(drifting, runs=5, length=600)
    run = apart.train[1]
    soak = 80.0 + 0.002 * np.random.default_rng(7).normal(size=len(run))
    slow = follow(soak, 90.0) - 25.0
    drift = slow[:, None] * SLOPE + 0.5 * np.random.default_rng(8).normal(size=(len(run), 2)) * [
        1.0,
        0.01,
    ]
    train = list(apart.train)
    train[1] = replace(run, temperature_degC=soak, measured=run.reference + drift)
    assert review(replace(apart, train=tuple(train))) == ()


def test_parts_of_a_run_are_held_together(clean):
    """A gap makes two stretches of a run; what is wrong with it is told once."""
    run = clean.train[2]
    reversed_run = replace(run, measured=-run.measured)
    first, last = reversed_run.take(slice(0, 280)), reversed_run.take(slice(320, 600))
    parts = (first, replace(last, name="run_2#2", part=1))
    train = (*clean.train[:2], *parts, *clean.train[3:])
    found = review(replace(clean, train=train))
    assert {(note.run, note.kind) for note in found} == {("run_2", "sign")}


def test_output_that_repeats_another_column_is_foreign(clean):
    run = clean.train[2]
    measured = run.measured.copy()
    measured[:, 0] = 1.8 * run.temperature_degC + 32.0
    (note,) = review(spoil(clean, measured=measured))
    assert (note.run, note.column, note.kind) == ("run_2", "Fz", "foreign_column")
    assert "repeats temperature" in note.text


def test_dwell_is_looked_at_too(clean):
    (rest,) = clean.dwell
    measured = rest.measured.copy()
    measured[50:400:9, 0] = 9999.0
    found = review(replace(clean, dwell=(replace(rest, measured=measured),)))
    assert [(note.run, note.column, note.kind) for note in found] == [
        (rest.group, "Fz", "sentinel")
    ]
