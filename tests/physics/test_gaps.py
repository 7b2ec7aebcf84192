"""What has a memory keeps it over a gap in a log, as the sensor did."""

from dataclasses import replace

import numpy as np
import pytest
from tests.physics.conftest import (
    FULL_SCALE,
    NOISE,
    OUTPUTS,
    SLOPE,
    STEP_S,
    UNITS,
    follow,
    make_dataset,
)

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import join_stretches, predict_all, predict_along
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.held_out import hold_out
from zerodrift.physics.fit import fit
from zerodrift.physics.signals import lay_tracks, plan_signals

LAG = [EffectConfig("zero_tempco"), EffectConfig("thermal_lag")]


def take(run, start, stop, part=0, before=None):
    """Return samples start to stop of a run as one stretch."""
    return replace(
        run.take(slice(start, stop)),
        name=run.group if part == 0 else f"{run.group}#{part + 1}",
        part=part,
        start_s=float(run.time_s[0]),
        before=before,
    )


def interrupt(run, start, stop):
    """Return a run as two stretches, without samples start to stop."""
    first = take(run, 0, start)
    return first, take(run, stop, len(run), 1, first)


def interrupt_all(dataset, start, stop):
    stretches = [part for run in dataset.train for part in interrupt(run, start, stop)]
    return replace(dataset, train=tuple(stretches))


def lagging(bench):
    return (follow(bench.temperature, 300.0) - 25.0)[:, None] * SLOPE


def fit_lag(dataset):
    return fit(LAG, dataset.train, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE)


def make_straight_gap(length=600):
    """Return runs whose temperature and load are straight from sample 299 to 400."""
    dataset = make_dataset(lagging, length=length, noise=0.0)

    def straighten(x):
        x = x.copy()
        x[299:401] = np.linspace(x[299], x[400], 102)
        return x

    train = []
    for run in dataset.train:
        temperature = straighten(run.temperature_degC)
        drift = (follow(temperature, 300.0) - 25.0)[:, None] * SLOPE
        train.append(
            replace(
                run,
                temperature_degC=temperature,
                reference=straighten(run.reference),
                measured=straighten(run.reference) + drift,
                inputs={name: straighten(values) for name, values in run.inputs.items()},
            )
        )
    return replace(dataset, train=tuple(train), dwell=())


def test_prediction_after_a_straight_gap_is_that_of_the_unbroken_run():
    dataset = make_straight_gap()
    model = fit_lag(dataset)
    whole = dataset.train[0]
    first, second = interrupt(whole, 300, 400)
    expected = model.predict(whole)
    assert np.array_equal(model.predict(first), expected[:300])
    assert model.predict(second) == pytest.approx(expected[400:], abs=1e-9)
    assert np.abs(model.predict(second.at_rest()) - expected[400:]).max() > 1.0


@pytest.mark.parametrize("length", [600, 1600])
def test_fit_to_logs_with_gaps_finds_the_values_of_the_unbroken_logs(length):
    """The longer ones are fitted on averages over blocks."""
    dataset = make_straight_gap(length)
    whole, broken = fit_lag(dataset), fit_lag(interrupt_all(dataset, 300, 400))
    tau_s = [model.terms[1].term.values["tau_s"] for model in (whole, broken)]
    assert tau_s[1] == pytest.approx(tau_s[0], rel=1e-3)
    assert broken.coefficients[1] == pytest.approx(whole.coefficients[1], rel=1e-3)


def test_error_in_runs_left_out_does_not_know_of_gaps():
    dataset = interrupt_all(make_straight_gap(), 300, 400)
    predictions = hold_out(fit_lag(dataset), dataset).predictions
    for run in dataset.train:
        assert (np.abs(run.drift - predictions[run.name]).max(axis=0) < 0.5 * NOISE).all()


@pytest.mark.parametrize("block", [1, 7])
def test_stretches_begin_at_blocks_and_hold_what_was_logged(block):
    dataset = make_dataset(lagging, runs=2, length=100)
    runs = [*interrupt(dataset.train[0], 40, 60), dataset.train[1]]
    plan = plan_signals(runs, OUTPUTS, FULL_SCALE)
    broken, unbroken = lay_tracks(runs, plan, block)
    assert unbroken.places == ((2, 0),)
    ((one, start), (two, second)) = broken.places
    assert (one, start, two) == (0, 0, 1)
    assert second == (60 if block == 1 else 63)
    laid = broken.signals.temperature_degC
    assert np.array_equal(laid[:40], runs[0].temperature_degC)
    assert np.array_equal(laid[second:], runs[1].temperature_degC)
    bridge = np.diff(laid[39 : second + 1])
    assert bridge == pytest.approx(np.full(second - 39, bridge[0]))


def test_bridge_over_a_long_gap_is_no_longer_than_what_was_logged_before():
    dataset = make_dataset(lagging, runs=1, length=100)
    first, second = interrupt(dataset.train[0], 40, 60)
    late = replace(second, time_s=second.time_s + 1e6 * STEP_S)
    plan = plan_signals([first, late], OUTPUTS, FULL_SCALE)
    (track,) = lay_tracks([first, late], plan)
    assert track.places == ((0, 0), (1, 80))


def test_a_later_stretch_alone_keeps_what_was_before_it():
    dataset = make_dataset(lagging, runs=1, length=100)
    first, second = interrupt(dataset.train[0], 40, 60)
    plan = plan_signals([first, second], OUTPUTS, FULL_SCALE)
    (track,) = lay_tracks([second], plan)
    assert track.places == ((0, 60),)
    (rested,) = lay_tracks([second.at_rest()], plan)
    assert rested.places == ((0, 0),)


def test_hysteresis_is_named_in_logs_with_gaps(tempco):
    def stick(x):
        kept, y = x[0], []
        for value in x.tolist():
            kept = min(max(kept, value - 5.0), value + 5.0)
            y.append(kept)
        return np.array(y)

    def disturb(bench):
        return (stick(bench.temperature) - 25.0)[:, None] * SLOPE

    dataset = interrupt_all(make_dataset(disturb, runs=6, length=600), 250, 300)
    diagnosis = diagnose(tempco, dataset)
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "thermal_hysteresis")
    assert diagnosis.parameters["half_width_K"] == pytest.approx(5.0, rel=0.05)
    assert diagnosis.floor_ratio_after < 1.2


def test_replay_along_the_run_is_that_of_the_run_without_a_gap():
    whole = make_straight_gap().train[0]
    first, second = interrupt(whole, 300, 400)
    seen = []

    def total(run):
        seen.append(run)
        return np.cumsum(run.temperature_degC[:, None] + run.reference, axis=0)

    expected = total(whole)
    assert np.array_equal(predict_along(total, first), expected[:300])
    assert predict_along(total, second) == pytest.approx(expected[400:])
    assert seen[-1].before is None
    assert seen[-1].time_s == pytest.approx(whole.time_s)
    assert seen[-1].inputs["supply"] == pytest.approx(whole.inputs["supply"])


def cut_in_three(run):
    first = take(run, 0, 150)
    second = take(run, 200, 300, 1, first)
    return first, second, take(run, 400, len(run), 2, second)


def test_every_stretch_is_predicted_from_one_replay_of_its_run():
    runs = make_straight_gap().train
    stretches = [part for run in runs[:2] for part in cut_in_three(run)]
    seen = []

    def total(run):
        seen.append(run)
        return np.cumsum(run.temperature_degC[:, None] + run.reference, axis=0)

    order = [5, 0, 3, 2, 1, 4]
    found = predict_all(total, [stretches[i] for i in order])
    assert len(seen) == 2
    for i, answer in zip(order, found, strict=True):
        assert np.array_equal(answer, predict_along(total, stretches[i]))


def test_model_predicts_all_stretches_as_one_by_one():
    dataset = interrupt_all(make_dataset(lagging, runs=3, length=400), 150, 200)
    model = fit(LAG, dataset.train, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE)
    for run, answer in zip(dataset.train, model.predict_all(dataset.train), strict=True):
        assert np.array_equal(answer, model.predict(run))


def test_joined_runs_mark_what_was_logged_and_given():
    whole = make_straight_gap().train[0]
    first, second, third = cut_in_three(whole)
    (run,), (logged,) = join_stretches([first, second, third])
    assert (run.before, len(run)) == (None, len(whole))
    gaps = np.r_[150:200, 300:400]
    assert np.array_equal(np.flatnonzero(~logged), gaps)
    assert np.array_equal(run.measured[logged], np.delete(whole.measured, gaps, axis=0))
    (run,), (logged,) = join_stretches([third])
    assert np.array_equal(np.flatnonzero(logged), np.arange(400, len(whole)))
    (run,), (logged,) = join_stretches([whole])
    assert run is whole
    assert logged.all()
