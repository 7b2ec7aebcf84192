"""Leaving runs out: as good as refitting by hand, and honest about what was left out."""

import numpy as np
import pytest

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.held_out import BLOCKS_OF_ONE_RUN, LEAVE_ONE_RUN_OUT, TEST_LOGS, hold_out
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.fit import fit

OUTPUTS, UNITS, SCALE = ("Fz", "Mx"), ("N", "Nm"), (2000.0, 20.0)
EFFECTS = (EffectConfig("zero_tempco"), EffectConfig("thermal_lag"))


def drift(run):
    late = lowpass(run.temperature_degC, run.sample_period_s, 40.0)
    return np.stack([0.3 * late + 2.0, -0.02 * late], axis=1)


def fit_runs(runs, start=None, effects=EFFECTS):
    return fit(effects, runs, outputs=OUTPUTS, units=UNITS, full_scale=SCALE, start=start)


def as_dataset(train, test=()):
    return Dataset(tuple(train), tuple(test), (), OUTPUTS, UNITS, SCALE)


def refit_by_hand(runs, left_out, model):
    others = [run for run in runs if run.group != left_out.group]
    return fit_runs(others, start=model).predict(left_out)


def test_left_out_runs_are_predicted_as_by_a_fit_to_the_others(make_run):
    runs = [make_run(i, drift) for i in range(4)]
    model = fit_runs(runs)
    held_out = hold_out(model, as_dataset(runs))
    assert held_out.method == LEAVE_ONE_RUN_OUT
    assert not model.tared
    for run in runs:
        expected = refit_by_hand(runs, run, model)
        # The noise's RMS is 0.05: the two agree to a fiftieth of that.
        assert np.abs(held_out.predictions[run.name] - expected).max() < 1e-3


def test_two_runs_whose_fits_differ_much_are_still_left_out_right(make_run):
    def slow(run):
        late = lowpass(run.temperature_degC, run.sample_period_s, 90.0)
        return np.stack([0.3 * late, -0.02 * late], axis=1)

    runs = [make_run(0, drift), make_run(1, slow)]
    model = fit_runs(runs)
    held_out = hold_out(model, as_dataset(runs))
    taus = []
    for run in runs:
        other = next(r for r in runs if r is not run)
        alone = fit_runs([other])
        taus.append(alone.terms[1].term.values["tau_s"])
        difference = held_out.predictions[run.name] - alone.predict(run)
        difference -= difference.mean(axis=0)
        assert np.sqrt(np.mean(difference**2)) < 0.02
    assert max(taus) / min(taus) > 1.5


def test_tared_runs_are_left_out_with_the_mean_offset_of_the_others(make_run):
    offsets = np.array([-3.0, 1.0, 4.0, 10.0])

    def tared(number):
        return lambda run: drift(run) + offsets[number]

    runs = [make_run(i, tared(i)) for i in range(4)]
    model = fit_runs(runs)
    assert model.tared
    held_out = hold_out(model, as_dataset(runs))
    for i, run in enumerate(runs):
        error = run.drift - held_out.predictions[run.name]
        expected = offsets[i] - np.delete(offsets, i).mean()
        assert error[:, 0].mean() == pytest.approx(expected, abs=0.05)
        assert error[:, 0].std() == pytest.approx(0.05, rel=0.1)


def test_parts_of_a_run_are_left_out_together(make_run):
    whole = make_run(0, drift, length=600)
    rest = make_run(0, drift, length=600, part=1)
    runs = [whole, rest, *(make_run(i, drift) for i in range(1, 4))]
    model = fit_runs(runs)
    held_out = hold_out(model, as_dataset(runs))
    expected = refit_by_hand(runs, rest, model)
    assert held_out.predictions.keys() == {run.name for run in runs}
    assert np.abs(held_out.predictions[rest.name] - expected).max() < 1e-3


def test_single_run_is_left_out_in_blocks_and_says_so(make_run):
    run = make_run(0, drift, length=2400)
    held_out = hold_out(fit_runs([run]), as_dataset([run]))
    assert held_out.method == BLOCKS_OF_ONE_RUN
    assert "one run only" in held_out.explain()
    error = run.drift - held_out.predictions[run.name]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error[:, 0] ** 2)) < 0.1


def test_block_prediction_does_not_see_its_own_block(make_run):
    clean = make_run(0, drift, length=2400)
    spoilt = make_run(0, drift, length=2400)
    spoilt.measured[300:600, 0] += 50.0
    predictions = [
        hold_out(fit_runs([run], effects=EFFECTS[:1]), as_dataset([run])).predictions["run0"]
        for run in (clean, spoilt)
    ]
    # Rows 300 to 600 are the second of eight blocks: only the others' predictions may change.
    assert np.abs(predictions[0] - predictions[1])[300:600].max() < 1e-9
    assert np.abs(predictions[0] - predictions[1])[900:].max() > 0.1


def test_test_logs_are_the_held_out_ones_where_there_are_any(make_run):
    runs = [make_run(i, drift) for i in range(3)]
    model = fit_runs(runs[:2])
    held_out = hold_out(model, as_dataset(runs[:2], runs[2:]))
    assert held_out.method == TEST_LOGS
    assert list(held_out.predictions) == [runs[2].name]
    assert np.array_equal(held_out.predictions[runs[2].name], model.predict(runs[2]))


def test_model_without_effects_predicts_the_others_mean(make_run):
    runs = [make_run(i, lambda r: np.full((len(r), 2), 5.0)) for i in range(3)]
    held_out = hold_out(fit_runs(runs, effects=()), as_dataset(runs))
    others = np.concatenate([runs[1].drift, runs[2].drift]).mean(axis=0)
    assert np.allclose(held_out.predictions["run0"], others)
