"""What loads add to the drift: told by steps, at the order that runs left out ask for."""

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from tests.train.test_lag_bank import FULL_SCALE, NOISE, OUTPUTS, UNITS, draw_temperature, make_run

from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.fit import fit
from zerodrift.train.lag_bank.fit import (
    LoadPart,
    difference,
    fit_lag_bank,
    fit_loads,
    list_pairs,
    prepare,
    see_loads,
)
from zerodrift.train.lag_bank.model import POWERS, list_load_terms

Array = NDArray[np.float64]

LENGTH = 1600
GAIN = np.array([[3e-4, 2e-7], [1e-3, -2e-4]])
"""[load, output] per kelvin."""
CURVE = np.array([[2e-6, 1e-9], [0.0, 3e-4], [4e-5, 0.0]])
"""[product, output] of Fz Fz, Fz Mx, Mx Mx."""


def hang_weights(seed: int, length: int = LENGTH) -> Array:
    """Return loads [n, 2] that are put on and taken off, of drawn sizes."""
    rng = np.random.default_rng(seed)
    load = np.zeros((length, 2))
    for start in range(100, length - 100, 200):
        load[start : start + 100] = rng.uniform([100.0, -2.0], [400.0, 2.0])
    return load


def add_load(run: Run, seed: int, *, curve: float = 1.0) -> tuple[Run, Array]:
    """Return the run with weights hung on, and what they add to its drift [n, 2]."""
    load = hang_weights(seed, len(run))
    products = np.stack([load[:, 0] ** 2, load[:, 0] * load[:, 1], load[:, 1] ** 2], axis=1)
    added = (run.temperature_degC - 25.0)[:, None] * (load @ GAIN) + curve * (products @ CURVE)
    return replace(run, reference=load, measured=run.measured + load + added), added


def take_part(runs: list[Run], lags_s: tuple[float, ...]) -> tuple[LoadPart, Array]:
    """Return the load part fitted beside these lags, and what it predicts for the last run."""
    physics = fit((), runs, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE)
    rows = prepare(physics, runs, ("temperature_degC",)).raw
    part = fit_loads(physics, runs, rows, [(0, tau_s) for tau_s in lags_s])
    predicted = see_loads(runs[-1], physics, rows.data.scales[0], part.terms) @ part.coefficients
    return part, predicted


def test_curvature_is_taken_where_it_is_there_and_left_where_not() -> None:
    for curve, order in ((1.0, 2), (0.0, 1)):
        runs = [make_run(i, slow=0.0, length=LENGTH) for i in range(4)]
        loaded = [add_load(run, i, curve=curve) for i, run in enumerate(runs[:3])]
        part, predicted = take_part([runs[3], *(run for run, _ in loaded)], (20.0,))
        pairs = (("Fz", "Fz"), ("Fz", "Mx"), ("Mx", "Mx"))
        assert part.terms == list_load_terms(OUTPUTS, order, pairs)
        assert np.all(np.abs(predicted - loaded[-1][1]).max(axis=0) < 1.0 * NOISE)


def test_steps_tell_the_load_where_the_temperature_is_not_understood() -> None:
    """A drift that no lag here explains moves slowly, and does not pass for the load's."""
    runs, added = [], np.zeros((0, 2))
    for i in range(3):
        slow = lowpass(draw_temperature(50 + i, LENGTH), 1.0, 60.0) - 25.0
        run = make_run(i, slow=0.0, length=LENGTH)
        hidden = 0.02 * slow[:, None] * np.array([5.0, 0.1])
        run, added = add_load(replace(run, measured=run.measured + hidden), i)
        runs.append(run)
    physics = fit((), runs, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE)
    rows = prepare(physics, runs, ("temperature_degC",)).raw
    missed = []
    for alike in (None, 0.0):
        part = fit_loads(physics, runs, rows, [(0, 20.0)], choice=(2,), alike=alike)
        seen = see_loads(runs[-1], physics, rows.data.scales[0], part.terms)
        missed.append(np.std(seen @ part.coefficients - added, axis=0))
    assert np.all(missed[0] < 0.5 * missed[1])


def test_single_loaded_run_is_judged_by_blocks_of_it() -> None:
    runs = [make_run(i, slow=0.0, length=LENGTH) for i in range(3)]
    loaded, added = add_load(make_run(3, slow=0.0, length=2 * LENGTH), 3)
    part, predicted = take_part([*runs, loaded], (20.0,))
    assert (("Fz", "Fz"), 0) in part.terms
    assert np.all(np.std(predicted - added, axis=0) < 0.5 * NOISE)


def test_product_that_never_came_up_is_not_a_term() -> None:
    runs = [make_run(i, slow=0.0, length=400) for i in range(2)]
    first, second = np.zeros((400, 2)), np.zeros((400, 2))
    first[100:200, 0], second[100:200, 1] = 300.0, 2.0
    runs = [replace(run, reference=x) for run, x in zip(runs, (first, second), strict=True)]
    physics = fit((), runs, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE)
    assert list_pairs(OUTPUTS, physics, runs) == (("Fz", "Fz"), ("Mx", "Mx"))


def test_orders_are_nested() -> None:
    pairs = (("Fz", "Fz"), ("Fz", "Mx"))
    orders = [set(list_load_terms(OUTPUTS, order, pairs)) for order in range(len(POWERS))]
    assert orders[0] == set()
    assert all(a < b for a, b in itertools.pairwise(orders))


def test_differences_make_correlated_rows_white() -> None:
    """Noise of that correlation has the same variance in every row afterwards, the first too."""
    rng = np.random.default_rng(0)
    alike, rows, copies = 0.9, 40, 4000
    noise = np.zeros((rows, copies))
    noise[0] = rng.standard_normal(copies) / np.sqrt(1.0 - alike**2)
    for n in range(1, rows):
        noise[n] = alike * noise[n - 1] + rng.standard_normal(copies)
    begins = np.arange(rows) == 0
    white = difference(noise, alike, begins)
    covariance = white @ white.T / copies
    assert np.abs(covariance - np.eye(rows)).max() < 0.1


def test_bank_with_loads_reaches_the_noise() -> None:
    runs = [add_load(make_run(i, slow=0.0, length=LENGTH), i)[0] for i in range(4)]
    physics = fit((), runs, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE)
    bank = fit_lag_bank(physics, runs, lags_s=[20.0], units=0)
    judge, _ = add_load(make_run(9, slow=0.0, length=LENGTH), 9)
    error = judge.drift - physics.predict(judge) - bank.correct(judge, physics)
    assert np.all(np.std(error, axis=0) < 1.1 * NOISE)
