"""How many tanh units stand beside the lag bank, and which lags they see, is told by the logs."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.train.test_lag_bank import NOISE, fit_bank, make_run, measure

from zerodrift.base.records import from_json, to_dict
from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.front_end import TEMPERATURE
from zerodrift.train.lag_bank.data import DEGREE, BankData
from zerodrift.train.lag_bank.model import LagBank, LagBankRecord
from zerodrift.train.lag_bank.search import Bank, LeftOutJudge, Rows
from zerodrift.train.lag_bank.units import (
    FEW_UNITS,
    SPREAD_LAGS,
    choose_units,
    list_trials,
    measure_left_out,
    spread_lags,
)

Array = NDArray[np.float64]

ONE, TWO = ((0, 20.0),), ((0, 20.0), (0, 250.0))


def make_rows(runs: list[Run], sources: tuple[str, ...] = (TEMPERATURE,)) -> Rows:
    none = [np.zeros((len(run), 0)) for run in runs]
    unloaded = [np.zeros(len(run), dtype=bool) for run in runs]
    drifts = [run.drift for run in runs]
    data = BankData(runs, sources, none, drifts, unloaded)
    return Rows(data, data.counts, False, np.concatenate(drifts).std(axis=0))


def bend(run: Run) -> Run:
    """Return the run with a drift that bends where parts of the sensor differ in temperature."""
    parts = [lowpass(run.temperature_degC, 1.0, tau_s) for tau_s in (8.0, 40.0, 120.0)]
    fast, middle, slow = ((part - 25.0) / 20.0 for part in parts)
    bent = np.tanh(3.0 * (fast - middle)) + np.tanh(2.0 * (middle - slow) + fast)
    noise = np.random.default_rng(len(run) + run.part).normal(size=run.drift.shape) * NOISE
    return replace(run, measured=bent[:, None] * np.array([10.0, 0.2]) + noise)


def list_shapes(rows: Rows, runs: list[Run], bank: Bank, **options: bool) -> list[tuple[int, int]]:
    trials = list_trials(rows, runs, bank, 16, hold=options.get("hold", False))
    return [(len(trial.lags), trial.count) for trial in trials]


def test_one_lag_of_one_thermometer_is_asked_for_few_units_only() -> None:
    runs = [make_run(i, slow=0.0, length=600) for i in range(3)]
    rows = make_rows(runs)
    assert list_shapes(rows, runs, Bank(ONE, 1e-6, 1.0)) == [(1, FEW_UNITS)]
    two = Bank(TWO, 1e-6, 1.0)
    assert list_shapes(rows, runs, two) == [(2, FEW_UNITS), (2, 16), (SPREAD_LAGS, 16)]
    assert list_shapes(rows, runs, two, hold=True) == [(2, FEW_UNITS), (2, 16)]


def test_two_thermometers_keep_the_lags_that_were_found() -> None:
    runs = [make_run(i, slow=0.0, length=600) for i in range(3)]
    runs = [replace(run, inputs={"body_temperature": run.temperature_degC}) for run in runs]
    rows = make_rows(runs, (TEMPERATURE, "body_temperature"))
    assert list_shapes(rows, runs, Bank(ONE, 1e-6, 1.0)) == [(1, FEW_UNITS), (1, 16)]


def test_lags_are_spread_over_what_the_logs_can_tell() -> None:
    rows = make_rows([make_run(i, slow=0.0, length=2000) for i in range(2)])
    taus_s = [tau_s for _, tau_s in spread_lags(rows)]
    assert taus_s == [4.0, 20.0, 100.0, 500.0]


@pytest.mark.long
def test_many_units_are_taken_where_the_drift_bends_and_pay() -> None:
    runs = [bend(make_run(i, slow=0.0, length=1500)) for i in range(5)]
    judge = bend(make_run(9, slow=0.0, length=1500))
    physics, alone = fit_bank(runs, units=0)
    _, few = fit_bank(runs, units=FEW_UNITS)
    _, many = fit_bank(runs)
    assert (alone.front_end, alone.bank.degree) == (None, DEGREE)
    assert (len(many.weights), many.bank.degree) == (16, 1)
    errors = [measure(physics, bank, judge).mean() for bank in (alone, few, many)]
    assert errors[2] < 0.7 * errors[1] < 0.7 * errors[0]


def test_units_that_help_no_run_left_out_are_not_there() -> None:
    runs = [make_run(i, slow=0.0, length=1200) for i in range(4)]
    rows = make_rows(runs)
    bank = LeftOutJudge(rows).choose_ridge(ONE)
    choice = choose_units(rows, runs, bank, 16, seed=0)
    assert choice.ratio is not None
    assert choice.ratio > 0.95
    assert (choice.front_end, choice.lags, choice.degree) == (None, ONE, DEGREE)


def test_a_lag_of_one_power_is_what_many_powers_with_zeros_are() -> None:
    run, rng = make_run(1, slow=0.0, length=300), np.random.default_rng(1)
    data = BankData([run], (TEMPERATURE,), [np.zeros((300, 0))], [run.drift], [np.zeros(300, bool)])
    levels, lags = rng.normal(size=(DEGREE, 2)), rng.normal(size=(1, 2))
    powers = np.concatenate([lags, np.zeros((DEGREE - 1, 2))])
    one, four = (
        LagBank((TEMPERATURE,), data.scales, ONE, (), np.zeros((1, 2)), np.vstack([levels, x]), d)
        for x, d in ((lags, 1), (powers, DEGREE))
    )
    first, second = (bank.compute(run, ("Fz", "Mx")) @ bank.coefficients for bank in (one, four))
    np.testing.assert_allclose(first, second, rtol=1e-12, atol=1e-12)
    assert one.parameters == four.parameters == 11
    assert len(one.names) == DEGREE + 1
    assert one.macs < four.macs
    again = one.to_record().restore(2)
    assert np.array_equal(again.compute(run, ("Fz", "Mx")), one.compute(run, ("Fz", "Mx")))
    old = {key: value for key, value in to_dict(four.to_record()).items() if key != "degree"}
    assert from_json(LagBankRecord, old).restore(2).degree == DEGREE


def test_every_run_counts_once_however_long_it_is() -> None:
    runs = [make_run(i, slow=0.0, length=length) for i, length in enumerate((1200, 300, 300))]
    rows = replace(make_rows(runs), unit=np.ones(2))
    covered = rows.data.covered
    off = np.where(rows.data.run_group == 0, 1.0, 3.0)[:, None] * np.ones(2)
    assert all(covered[rows.data.run_group == g].any() for g in range(3))
    found = measure_left_out(rows, lambda some: lambda: rows.targets + off)
    assert found == pytest.approx(np.sqrt((1.0 + 9.0 + 9.0) / 3.0))
    covered[:] = False
    assert measure_left_out(rows, lambda some: lambda: rows.targets) == np.inf


@pytest.mark.parametrize("count", [1, 3])
def test_fewer_units_than_few_are_all_that_is_tried(count: int) -> None:
    runs = [make_run(i, slow=0.0, length=600) for i in range(3)]
    trials = list_trials(make_rows(runs), runs, Bank(TWO, 1e-6, 1.0), count, hold=False)
    assert [trial.count for trial in trials] == [count]
