"""The lag bank finds the lags that are there, and says what its logs cannot show."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.fit import fit
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.front_end import TEMPERATURE
from zerodrift.train.lag_bank.fit import (
    NO_JUMP,
    FittedBank,
    _measure_jumps,
    choose_sources,
    fit_lag_bank,
)
from zerodrift.train.lag_bank.search import Columns, ProjectionProblem, _evaluate

Array = NDArray[np.float64]

OUTPUTS, UNITS, FULL_SCALE = ("Fz", "Mx"), ("N", "Nm"), (2000.0, 14.0)
NOISE = np.array([0.05, 0.001])
FAST_S, SLOW_S = 20.0, 250.0


def draw_temperature(seed: int, length: int) -> Array:
    rng = np.random.default_rng(seed)
    knots = rng.uniform(5.0, 50.0, length // 150 + 2)
    ramps = np.interp(np.arange(length), np.arange(knots.size) * 150.0, knots)
    return np.round(lowpass(ramps, 1.0, 10.0) * 128.0) / 128.0


def make_run(
    seed: int, *, slow: float, length: int = 2000, tare: float = 0.0, load: float = 0.0
) -> Run:
    """Return a run whose drift follows two lags of the temperature, the slow one by a share."""
    rng = np.random.default_rng(1000 + seed)
    temperature = draw_temperature(seed, length)
    body = (1.0 - slow) * lowpass(temperature, 1.0, FAST_S) + slow * lowpass(
        temperature, 1.0, SLOW_S
    )
    x = (body - 25.0) / 20.0
    drift = np.stack([20.0 * x + 6.0 * x**2, 0.3 * x - 0.1 * x**3], axis=1)
    steps = np.floor(np.arange(length) / 400.0) % 2.0
    reference = load * np.stack([steps * 500.0, np.zeros(length)], axis=1)
    drift += 2e-4 * (temperature - 25.0)[:, None] * reference
    noise = rng.normal(size=drift.shape) * NOISE
    return Run(
        name=f"run{seed}",
        group=f"run{seed}",
        part=0,
        source=Path(f"run{seed}.csv"),
        sample_period_s=1.0,
        time_s=np.arange(length, dtype=float),
        temperature_degC=temperature,
        measured=reference + drift + noise + tare * rng.normal(size=2) * np.array([5.0, 0.1]),
        reference=reference,
    )


def fit_bank(runs: list[Run], **options: object) -> tuple[PhysicalModel, FittedBank]:
    physics = fit((), runs, outputs=OUTPUTS, units=UNITS, full_scale=FULL_SCALE)
    return physics, fit_lag_bank(physics, runs, **options)  # type: ignore[arg-type]


def measure(physics: PhysicalModel, bank: FittedBank, run: Run) -> Array:
    """Return the RMSE [K] in multiples of the noise, the mean error taken off."""
    error = run.drift - physics.predict(run) - bank.correct(run, physics)
    return np.asarray((error - error.mean(axis=0)).std(axis=0) / NOISE)


def test_one_lag_is_found_and_the_rest_is_called_unverified() -> None:
    physics, bank = fit_bank([make_run(i, slow=0.0) for i in range(4)])
    assert len(bank.bank.lags) == 1
    assert bank.bank.lags[0][1] == pytest.approx(FAST_S, rel=0.05)
    assert measure(physics, bank, make_run(9, slow=0.0)).max() < 1.05
    assert "unverified" in bank.notes[0]


def interrupt(run: Run, logged: int, missing: int) -> list[Run]:
    """Return the run's stretches of so many samples, so many lost after each."""
    stretches: list[Run] = []
    for start in range(0, len(run) - logged, logged + missing):
        before = stretches[-1] if stretches else None
        own = run.take(slice(start, start + logged))
        stretches.append(replace(own, part=len(stretches), before=before))
    return stretches


@pytest.mark.long
def test_bank_lives_on_over_gaps_as_the_sensor_did() -> None:
    """Taken to be at rest at the start of each stretch, it would not see its lag whole."""
    whole = [make_run(i, slow=0.0, length=1500) for i in range(4)]
    stretches = [part for run in whole for part in interrupt(run, 30, 6)]
    _, bank = fit_bank(whole, units=0)
    physics, over_gaps = fit_bank(stretches, units=0)
    assert over_gaps.bank.lags[0][1] == pytest.approx(bank.bank.lags[0][1], rel=0.02)
    assert measure(physics, over_gaps, make_run(9, slow=0.0)).max() < 1.1
    alone = [replace(run, group=f"{run.group}#{run.part}", before=None) for run in stretches]
    physics, at_rest = fit_bank(alone, units=0)
    assert measure(physics, at_rest, make_run(9, slow=0.0)).max() > 2.0


@pytest.mark.long
def test_two_lags_are_found() -> None:
    """Their mixture's square has a product of both in it, which units have to learn."""
    runs = [make_run(i, slow=0.3, length=1200) for i in range(4)]
    physics, bank = fit_bank(runs)
    found = [tau_s for _, tau_s in bank.bank.lags]
    assert min(abs(np.log(tau_s / FAST_S)) for tau_s in found) < 0.2
    assert min(abs(np.log(tau_s / SLOW_S)) for tau_s in found) < 0.3
    _, alone = fit_bank(runs, lags_s=[FAST_S])
    judge = make_run(9, slow=0.3)
    assert measure(physics, bank, judge).max() < 0.3 * measure(physics, alone, judge).max()
    assert "unverified" not in bank.notes[0]


def test_another_thermometer_is_used_from_three_runs_on() -> None:
    runs = [
        replace(make_run(seed, slow=0.0), inputs={"room_temperature": np.linspace(20, 21, 2000)})
        for seed in range(3)
    ]
    assert choose_sources(("room_temperature",), runs) == (TEMPERATURE, "room_temperature")
    assert choose_sources(("room_temperature",), runs[:2]) == (TEMPERATURE,)


def test_tares_are_told_from_drift() -> None:
    physics, bank = fit_bank([make_run(i, slow=0.0, tare=1.0) for i in range(4)], lags_s=[20.0])
    assert bank.tared
    assert measure(physics, bank, make_run(9, slow=0.0)).max() < 1.05
    assert not fit_bank([make_run(i, slow=0.0) for i in range(4)], lags_s=[20.0])[1].tared


def test_readings_that_mostly_repeat_are_not_infinitely_sure() -> None:
    """The median of their jumps is nothing; a class of such rows would outweigh all others."""
    steps = np.random.default_rng(3).normal(0.0, 0.2, (4000, 1))
    coarse = np.diff(np.round(steps), axis=0) ** 2
    assert np.median(coarse) == 0.0
    assert _measure_jumps(coarse) == pytest.approx(coarse.mean(), rel=0.1)
    assert _measure_jumps(np.zeros((30, 1))) == NO_JUMP
    fine = np.diff(steps, axis=0) ** 2
    assert np.array_equal(_measure_jumps(fine), np.median(fine, axis=0))


def test_load_is_seen_where_it_changes_the_drift() -> None:
    physics, bank = fit_bank([make_run(i, slow=0.0, load=1.0) for i in range(4)], lags_s=[20.0])
    assert (("Fz",), 1) in bank.bank.loads
    assert measure(physics, bank, make_run(9, slow=0.0, load=1.0)).max() < 1.05


def test_load_that_changes_nothing_is_left_out() -> None:
    runs = [make_run(i, slow=0.0, load=1.0) for i in range(4)]
    span = 2e-4 * np.stack([r.temperature_degC - 25.0 for r in runs])[..., None]
    plain = [
        replace(r, measured=r.measured - s * r.reference) for r, s in zip(runs, span, strict=True)
    ]
    assert fit_bank(plain, lags_s=[20.0])[1].bank.loads == ()


def test_noisy_reference_does_not_spoil_the_others() -> None:
    """A run under a noisy, jumping load beside quiet ones costs the quiet ones next to nothing."""
    quiet = [make_run(i, slow=0.0) for i in range(3)]
    rng = np.random.default_rng(5)
    last = make_run(3, slow=0.0)
    gait = np.stack([150.0 * rng.random(len(last)), np.zeros(len(last))], axis=1)
    noise = rng.normal(size=last.measured.shape) * NOISE * 30.0
    walking = replace(last, reference=gait + noise, measured=last.measured + gait)
    physics, bank = fit_bank([*quiet, walking], lags_s=[20.0])
    assert bank.bank.loads == ()
    assert measure(physics, bank, make_run(9, slow=0.0)).max() < 1.1


def test_the_same_seed_gives_the_same_bank_to_the_bit() -> None:
    runs = [make_run(i, slow=0.0) for i in range(3)]
    first, second = (fit_bank(runs, seed=3, lags_s=[20.0])[1] for _ in range(2))
    assert np.array_equal(first.bank.coefficients, second.bank.coefficients)
    assert np.array_equal(first.head, second.head)


def test_slopes_of_the_projection_are_those_of_the_cost() -> None:
    """With one output Kaufman's gradient is exact."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 2))
    y = np.tanh(x @ np.array([[1.0], [-0.5]])) + 0.1 * rng.normal(size=(200, 1))

    def build(theta: Array) -> Columns:
        hidden = np.tanh(x @ theta.reshape(2, 2).T)
        slopes = ((1.0 - hidden**2)[:, :, None] * x[:, None, :]).reshape(200, 4)
        return Columns(hidden, slopes, np.arange(4), np.arange(4) // 2)

    problem = ProjectionProblem(build, y, np.full(2, 0.1), np.full(4, 0.01), np.zeros(4))
    theta = rng.normal(size=4)
    gradient = _evaluate(problem, theta).gradient
    for p in range(4):
        step = np.zeros(4)
        step[p] = 1e-5
        ahead, behind = _evaluate(problem, theta + step), _evaluate(problem, theta - step)
        slope = (ahead.cost - behind.cost) / 2e-5
        assert -2.0 * gradient[p] == pytest.approx(slope, rel=1e-4, abs=1e-6)
