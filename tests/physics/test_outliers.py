"""Fit and diagnosis of logs with wild rows, beside the same logs without."""

from dataclasses import replace

import numpy as np
import pytest
from tests.physics.conftest import NOISE, follow, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.base.records import to_json
from zerodrift.diagnosis.compare import compare
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.held_out import hold_out
from zerodrift.physics.fit import fit

SLOPE = np.array([1.2, 0.01])


def lagging(bench):
    return (follow(bench.temperature, 90.0) - 25.0)[:, None] * SLOPE


def spoil(dataset, share):
    rng = np.random.default_rng(11)

    def hit(run):
        rows = rng.uniform(size=len(run)) < share
        far = rng.choice([-1, 1], (rows.sum(), 2)) * rng.uniform(15.0, 60.0, (rows.sum(), 2))
        measured = run.measured.copy()
        measured[rows] += far * NOISE
        return replace(run, measured=measured)

    return replace(
        dataset,
        train=tuple(hit(run) for run in dataset.train),
        dwell=tuple(hit(run) for run in dataset.dwell),
    )


@pytest.fixture(scope="module")
def clean():
    return make_dataset(lagging, length=600)


def fit_lag(dataset):
    effects = [EffectConfig("zero_tempco"), EffectConfig("thermal_lag")]
    shape = {"outputs": dataset.outputs, "units": dataset.units, "full_scale": dataset.full_scale}
    return fit(effects, dataset.train, **shape)


@pytest.mark.parametrize("share", [0.002, 0.02])
def test_values_stay_within_one_standard_error_of_the_clean_fit(clean, share):
    expected, found = fit_lag(clean), fit_lag(spoil(clean, share))
    error = expected.terms[1].std_errors["tau_s"]
    assert found.terms[1].term.values["tau_s"] == pytest.approx(
        expected.terms[1].term.values["tau_s"], abs=error
    )


@pytest.mark.long
def test_effect_is_named_and_outliers_are_counted(clean, tempco):
    diagnosis = diagnose(tempco, spoil(clean, 0.02))
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "thermal_lag")
    assert diagnosis.floor_ratio_after == pytest.approx(1.0, abs=0.15)
    assert diagnosis.outliers.rows == pytest.approx(0.02 * 600 * 9, rel=0.4)
    assert to_json(diagnosis)["outliers"]["rows"] == diagnosis.outliers.rows
    assert any("outliers" in note for note in diagnosis.remarks)


def test_errors_are_told_over_all_rows_and_beside_it_without_outliers(clean):
    def told(dataset):
        model = fit_lag(dataset)
        compared = compare(
            dataset, model.predict, held_out=hold_out(model, dataset), tared=model.tared
        )
        return compared.summarise()

    expected, found = told(clean), told(spoil(clean, 0.02))
    assert expected.outliers.rows == 0
    assert expected.outputs["Fz"].rmse_without_outliers is None
    fz = found.outputs["Fz"]
    assert fz.rmse_left_out > 4.0 * expected.outputs["Fz"].rmse_heldout
    assert fz.rmse_without_outliers == pytest.approx(expected.outputs["Fz"].rmse_heldout, rel=0.03)
    assert fz.noise_floor == pytest.approx(expected.outputs["Fz"].noise_floor, rel=0.03)


@pytest.mark.long
def test_samples_before_a_load_that_drifts_are_sound_once_the_model_explains_them():
    """Loads put on two samples after the log begins: at the first two, all of their drift lacks."""

    def warmed(bench):
        bench.load[:] = bench.rng.choice([-1, 1], 2) * np.array([150.0, 1.5])
        bench.load[:2] = 0.0
        warm = (bench.temperature - 25.0)[:, None]
        return warm * SLOPE + 0.01 * warm * bench.load

    dataset = make_dataset(warmed, length=600)
    held = [run.outliers for run in dataset.train if run.outliers is not None]
    assert sum(bool(outliers.rows[:2].any()) for outliers in held) >= 4
    effects = [EffectConfig("zero_tempco"), EffectConfig("span_tempco")]
    diagnosis = diagnose(effects, dataset)
    assert diagnosis.verdict == "complete" and diagnosis.effect is None
    assert diagnosis.floor_ratio_before == pytest.approx(1.0, abs=0.15)
