"""Comparison of any model with measurements: figures as by hand, JSON as promised."""

import json

import numpy as np
import pytest

from zerodrift.base.records import to_dict
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.compare import Labels, compare
from zerodrift.diagnosis.held_out import LEAVE_ONE_RUN_OUT, NONE, HeldOut

NAMES = (("Fz", "Mx"), ("N", "Nm"), (2000.0, 20.0))


def linear(run):
    return np.stack([0.1 * (run.temperature_degC - 20.0), np.zeros(len(run))], axis=1)


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def test_errors_are_those_of_measured_minus_reference_minus_model(make_run):
    train = tuple(make_run(i, linear) for i in range(3))
    test = (make_run(7, lambda r: 1.5 * linear(r)),)
    result = compare(Dataset(train, test, (), *NAMES), linear)
    fz = to_dict(result.summarise())["outputs"]["Fz"]
    error = test[0].drift[:, 0] - linear(test[0])[:, 0]
    assert fz["rmse_heldout"] == pytest.approx(rms(error))
    assert fz["max_abs"] == pytest.approx(float(np.abs(error).max()))
    assert fz["rmse_pct_fs"] == pytest.approx(100.0 * rms(error) / 2000.0)
    assert fz["rmse_uncompensated"] == pytest.approx(rms(test[0].drift[:, 0]))
    inside = np.concatenate([run.drift[:, 0] - linear(run)[:, 0] for run in train])
    assert fz["rmse"] == pytest.approx(rms(inside))
    constant = np.mean(np.concatenate([run.drift[:, 0] for run in train]))
    alone = rms(test[0].drift[:, 0] - constant)
    assert fz["explained"] == pytest.approx(1.0 - (rms(error) / alone) ** 2)


def test_an_offset_is_not_explained_by_a_model_that_knows_no_more_than_it(make_run):
    """As an oscillator whose drift is all offset: 100.00 % of the mean square, and nothing."""
    runs = tuple(make_run(i, lambda r: 0.001 * linear(r) + 50.0) for i in range(4))
    level = float(np.mean(np.concatenate([run.drift[:, 0] for run in runs[:3]])))
    found = compare(
        Dataset(runs[:3], runs[3:], (), *NAMES), lambda run: np.full((len(run), 2), level)
    )
    told = found.summarise().outputs["Fz"]
    assert told.rmse_test < 1e-2 * told.rmse_uncompensated
    assert told.explained == pytest.approx(0.0, abs=1e-6)


def test_offsets_of_tared_runs_are_taken_off_and_told(make_run):
    train = tuple(make_run(i, lambda r, i=i: linear(r) + 5.0 * i) for i in range(3))
    result = compare(Dataset(train, (), (), *NAMES), linear, tared=True)
    result = to_dict(result.summarise())
    assert result["tared"] is True
    assert result["outputs"]["Fz"]["rmse"] == pytest.approx(0.05, rel=0.1)
    assert result["outputs"]["Fz"]["run_offset"] == pytest.approx(rms([0.0, 5.0, 10.0]), rel=0.01)
    plain = compare(Dataset(train, (), (), *NAMES), linear).summarise()
    plain = to_dict(plain)
    assert plain["outputs"]["Fz"]["rmse"] > 5.0
    assert plain["outputs"]["Fz"]["run_offset"] == 0.0


def test_json_has_every_promised_key_and_no_infinity(make_run):
    train = tuple(make_run(i, lambda r: 3.0 * linear(r)) for i in range(4))
    told = to_dict(
        compare(
            Dataset(train, train[:1], (), *NAMES), linear, labels=Labels(("zero_tempco",))
        ).summarise()
    )
    json.dumps(told, allow_nan=False)
    assert told["effects"] == ["zero_tempco"]
    assert set(told["outputs"]) == {"Fz", "Mx"}
    assert {"unit", "rmse_uncompensated", "rmse", "rmse_heldout"} <= set(told["outputs"]["Fz"])
    assert {"max_abs", "rmse_pct_fs", "noise_floor"} <= set(told["outputs"]["Fz"])
    assert {"run", "output", "from_s", "to_s", "rmse", "pattern"} <= set(told["worst"][0])
    assert set(told["runs"]) == {run.group for run in train}
    assert "rmse" in told["runs"]["run1"]["Mx"]


def test_model_that_saw_every_run_has_no_held_out_error(make_run):
    train = tuple(make_run(i, linear) for i in range(3))
    result = compare(Dataset(train, (), (), *NAMES), linear)
    assert result.method.method == NONE
    assert to_dict(result.summarise())["outputs"]["Fz"]["rmse_heldout"] is None
    assert "nothing is held out" in result.method.explain()


def test_runs_left_out_tell_their_held_out_error(make_run):
    train = tuple(make_run(i, linear) for i in range(3))
    worse = {run.name: 0.5 * linear(run) for run in train}
    result = compare(
        Dataset(train, (), (), *NAMES), linear, held_out=HeldOut(LEAVE_ONE_RUN_OUT, worse)
    )
    fz = to_dict(result.summarise())["runs"]["run0"]["Fz"]
    assert fz["held_out"] is True
    assert fz["rmse"] == pytest.approx(rms(train[0].drift[:, 0] - worse["run0"][:, 0]))
    assert fz["rmse_in_sample"] == pytest.approx(rms(train[0].drift[:, 0] - linear(train[0])[:, 0]))


def test_parts_of_a_run_are_told_as_one_run(make_run):
    parts = (make_run(0, linear, length=600), make_run(0, linear, length=900, part=1))
    result = compare(Dataset((*parts, make_run(1, linear)), (), (), *NAMES), linear)
    assert [run.name for run in result.runs] == ["run0", "run1"]
    both = np.concatenate([run.drift - linear(run) for run in parts])
    assert result.runs[0].told[1].rmse == pytest.approx(rms(both[:, 1]))


def test_output_that_is_zero_throughout_is_compared_without_division_by_zero(make_run):
    runs = tuple(make_run(i, noise=0.0) for i in range(3))
    result = compare(Dataset(runs, (), (), *NAMES), lambda run: np.zeros((len(run), 2)))
    told = to_dict(result.summarise())
    json.dumps(told, allow_nan=False)
    assert told["outputs"]["Mx"]["rmse"] == 0.0
    assert told["outputs"]["Mx"]["explained"] == 0.0
    assert told["worst"] == []
