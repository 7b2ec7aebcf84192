"""The lag bank's search by sums of products gives what the columns themselves give."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.lag_bank.data import DEGREE, BankData, raise_all
from zerodrift.train.lag_bank.search import LeftOutJudge, Rows, choose_bank, solve_ridge

Array = NDArray[np.float64]


def make_rows(tared: bool, lag_s: float = 30.0) -> Rows:
    """Return rows of five stretches of four runs, one of them in two parts that do not touch."""
    rng = np.random.default_rng(3)
    runs, targets = [], []
    for number, group in enumerate(("a", "b", "a", "c", "d")):
        length = 230 + 17 * number
        temperature = 25.0 + np.cumsum(rng.normal(size=length))
        drift = (lowpass(temperature, 1.0, lag_s) - 25.0)[:, None] * np.array([0.1, -0.02])
        targets.append(drift + 0.001 * rng.normal(size=drift.shape) + ord(group))
        runs.append(
            Run(
                name=f"run{number}",
                group=group,
                part=number,
                source=Path("run.csv"),
                sample_period_s=1.0,
                time_s=np.arange(length, dtype=float),
                temperature_degC=temperature,
                measured=drift,
                reference=np.zeros_like(drift),
            )
        )
    others = [rng.normal(size=(len(run), 2)) for run in runs]
    loaded = [np.zeros(len(run), dtype=bool) for run in runs]
    data = BankData(runs, ("temperature_degC",), others, targets, loaded)
    return Rows(data, data.counts * rng.uniform(0.5, 1.0, len(data.counts)), tared, np.ones(2))


def prepare_slowly(rows: Rows, columns: Array, some: NDArray[np.bool_]) -> Array:
    x, weight, run = columns[some].copy(), rows.weight[some], rows.data.run_group[some]
    if rows.tared:
        for r in np.unique(run):
            own = run == r
            x[own] -= weight[own] @ x[own] / weight[own].sum()
    return np.asarray(x * np.sqrt(weight)[:, None])


@pytest.mark.parametrize("tared", [False, True])
def test_rows_are_centred_and_weighted_run_by_run(tared: bool) -> None:
    rows = make_rows(tared)
    columns = rows.columns([(0, 12.0)])
    for some in (rows.everything, rows.data.group != 1, np.zeros(len(columns), dtype=bool)):
        found = rows.prepare(columns, some)
        np.testing.assert_allclose(found, prepare_slowly(rows, columns, some), atol=1e-11)


@pytest.mark.parametrize("tared", [False, True])
def test_sums_of_many_sets_are_those_of_each(tared: bool) -> None:
    rows = make_rows(tared)
    judge, base = LeftOutJudge(rows), rows.columns([(0, 12.0)])
    more = [rows.data.lag((0, tau_s)) for tau_s in (5.0, 40.0, 50.0)]
    together = judge.sum_each(base, more)
    errors = judge.measure(together, np.array(1e-6))
    for t, own in enumerate(more):
        alone = judge.sum_products(np.concatenate([base, own], axis=1))
        np.testing.assert_allclose(together.learnt[t], alone.learnt, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(together.judged[t], alone.judged, rtol=1e-9, atol=1e-9)
        assert errors[t] == pytest.approx(judge.measure(alone, np.array(1e-6)), rel=1e-6)


def test_error_left_out_is_that_of_fits_to_the_others() -> None:
    rows = make_rows(True)
    columns = rows.columns([(0, 12.0)])
    judge = LeftOutJudge(rows)
    squares = weight = 0.0
    for g in range(rows.data.groups):
        learnt, judged = rows.data.group != g, (rows.data.group == g) & rows.data.covered
        f, y = rows.prepare(columns, learnt), rows.prepare(rows.targets, learnt)
        ridge = np.sqrt(1e-6 * np.sum(f**2, axis=0))
        c = np.linalg.lstsq(
            np.concatenate([f, np.diag(ridge)]),
            np.concatenate([y, np.zeros((len(ridge), 2))]),
            rcond=None,
        )[0]
        squares += float(np.sum(rows.prepare(rows.targets - columns @ c, judged) ** 2))
        weight += float(rows.weight[judged].sum())
    found = judge.measure(judge.sum_products(columns), np.array(1e-6))
    assert found == pytest.approx(np.sqrt(squares / weight / 2), rel=1e-4)


def test_search_ends_where_no_lag_helps() -> None:
    banks = choose_bank(make_rows(True))
    assert len(banks) < 4
    assert [len(bank.lags) for bank in banks] == list(range(len(banks)))
    assert banks[1].lags[0][1] == pytest.approx(30.0, rel=0.05)


def test_lag_and_slope_agree_with_small_differences() -> None:
    data = make_rows(False).data
    columns, slopes = data.lag_and_slope((0, 20.0))
    np.testing.assert_array_equal(columns, data.lag((0, 20.0)))
    step = 1e-3
    ahead, behind = (data.lag((0, 20.0 * np.exp(sign * step))) for sign in (1.0, -1.0))
    np.testing.assert_allclose((ahead - behind) / (2.0 * step), slopes, atol=2e-3)


def test_powers_and_stacked_solutions() -> None:
    x = np.random.default_rng(0).normal(size=50)
    np.testing.assert_allclose(raise_all(x), np.stack([x ** (p + 1) for p in range(DEGREE)], 1))
    a = np.random.default_rng(1).normal(size=(3, 4, 40, 5))
    normal, right = a.swapaxes(-1, -2) @ a, np.random.default_rng(2).normal(size=(3, 4, 5, 2))
    ridge = np.full((3, 4, 5), 0.1)
    found = solve_ridge(normal, right, ridge)
    for i, k in np.ndindex(3, 4):
        expected = np.linalg.solve(normal[i, k] + 0.1 * np.eye(5), right[i, k])
        np.testing.assert_allclose(found[i, k], expected, rtol=1e-8)
