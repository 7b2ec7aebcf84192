"""TK0, TKC, creep and hysteresis that were planted are found again."""

import numpy as np
import pytest
from tests.report.conftest import make_comparison, make_trace

from zerodrift.operations.lowpass import lowpass
from zerodrift.report.datasheet import measure_datasheet

TELL = make_comparison(full_scale=500.0)
TAU_S = 400.0


def make_runs(*, tk0=0.2, tkc=0.0004, creep=0.004, loop=0.0, loaded=True, runs=6):
    """Return runs with so much of everything, of which the compensation leaves a tenth."""
    traces = []
    for number in range(runs):
        rng = np.random.default_rng(number)
        knots = np.concatenate([[20.0], rng.uniform(-10.0, 60.0, 6), [20.0]])
        time_s = np.arange(4000.0)
        temperature = np.interp(time_s, np.linspace(0.0, 4000.0, 8), knots)
        load = np.repeat(100.0 * rng.integers(0, 4, 8), 500).astype(float)
        load = load if loaded else np.zeros(4000)
        drift = tk0 * temperature + tkc * (temperature - 20.0) * load
        drift = drift + creep * lowpass(load, 1.0, TAU_S)
        drift = drift - loop / 2.0 * np.sign(np.gradient(temperature))
        noise = 0.02 * rng.standard_normal((2, 4000))
        traces.append(
            make_trace(
                drift + noise[0],
                0.1 * drift + noise[1],
                temperature=temperature,
                load=load,
                held_out=number >= 2,
            )
        )
    return traces


def read(rows, quantity):
    return next(row for row in rows if row.quantity.startswith(quantity))


@pytest.mark.parametrize(
    ("quantity", "truth"),
    [
        ("TK0", 0.2 * 10.0 / 500.0 * 100.0),
        ("TKC", 0.0004 * 10.0 * 100.0),
        ("creep", 0.4 * (1.0 - np.exp(-1800.0 / TAU_S))),
    ],
)
def test_datasheet_finds_what_was_planted_before_and_after(quantity, truth):
    row = read(measure_datasheet(make_runs(), TELL), quantity)
    for which, share in (("before", 1.0), ("after", 0.1)):
        value, error = getattr(row, which)
        assert error > 0.0
        assert value == pytest.approx(share * truth, abs=max(4.0 * error, 0.03 * abs(truth)))


def test_datasheet_finds_a_planted_loop():
    row = read(measure_datasheet(make_runs(loop=2.0, tkc=0.0, creep=0.0), TELL), "temperature")
    assert row.before[0] == pytest.approx(100.0 * 2.0 / 500.0, rel=0.15)
    assert row.after[0] == pytest.approx(100.0 * 0.2 / 500.0, rel=0.3)


def test_datasheet_says_what_these_logs_cannot_tell():
    rows = measure_datasheet(make_runs(loaded=False), TELL)
    for quantity in ("TKC", "creep"):
        row = read(rows, quantity)
        assert row.before is row.after is None
        assert "no load" in row.note
    assert read(rows, "TK0").before is not None


def test_datasheet_of_one_run_has_no_uncertainty():
    value, error = read(measure_datasheet(make_runs(runs=1), TELL), "TK0").before
    assert value == pytest.approx(0.4, rel=0.05)
    assert error is None
