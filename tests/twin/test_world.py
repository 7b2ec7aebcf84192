"""The generator's integrator, programmes and hysteresis, against independent solutions."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from zerodrift_lab.twin import EffectChoice, Recipe, simulate
from zerodrift_lab.twin.heat import draw_heat_network
from zerodrift_lab.twin.hysteresis import ELEMENT_SPREAD, play
from zerodrift_lab.twin.integrate import relax, solve_network
from zerodrift_lab.twin.programmes import Following, Gait, Ramps, Steps


def test_relax_solves_the_first_order_equation_for_a_ramp():
    time_s = np.arange(200) * 0.5
    tau_s, slope = 13.7, 0.31
    exact = slope * (time_s - tau_s + tau_s * np.exp(-time_s / tau_s))
    np.testing.assert_allclose(relax(slope * time_s, tau_s, 0.5), exact, atol=1e-12)


def test_relax_begins_at_rest_unless_told_otherwise():
    step = np.full(50, 4.0)
    assert np.all(relax(step, 9.0, 1.0) == pytest.approx(4.0))
    np.testing.assert_allclose(
        relax(step, 9.0, 1.0, 0.0), 4.0 * -np.expm1(-np.arange(50) / 9.0), atol=1e-12
    )


def test_heat_network_agrees_with_a_general_solver():
    network = draw_heat_network(3)
    air = Ramps(np.array([0.0, 100.0, 700.0, 900.0]), np.array([20.0, 20.0, 60.0, 60.0]))
    lamp = Steps(0.0, np.array([300.0]), np.array([1.5]), 20.0)

    def drive(time_s):
        here = air.evaluate(time_s)
        return network.build_drive(here, here, lamp.evaluate(time_s), np.full(time_s.size, 0.05))

    system = network.build_system()
    start = np.full(3, 20.0)
    time_s = np.arange(9001) * 0.1
    temperature, rate = solve_network(system, drive(time_s), 0.1, start)
    solved = solve_ivp(
        lambda t, x: system @ x + drive(np.array([t]))[0],
        (0.0, 900.0),
        start,
        t_eval=time_s[::1000],
        rtol=1e-9,
        atol=1e-9,
        max_step=5.0,
    )
    np.testing.assert_allclose(temperature[::1000], solved.y.T, atol=2e-5)
    np.testing.assert_allclose(np.gradient(temperature, 0.1, axis=0)[2:-2], rate[2:-2], atol=1e-4)


def test_heat_network_settles_where_heat_in_is_heat_out():
    network = draw_heat_network(0)
    count = 40_000
    constant = np.full(count, 31.0)
    nothing = np.zeros(count)
    drive = network.build_drive(constant, constant, nothing, nothing)
    temperature, _ = solve_network(network.build_system(), drive, 1.0, np.zeros(3))
    np.testing.assert_allclose(temperature[-1], 31.0, atol=1e-6)


@pytest.mark.parametrize(
    "programme",
    [
        Steps(1.0, np.array([10.0, 30.0]), np.array([5.0, -2.0]), 4.0),
        Gait(10.0, 55.0, 7.0, 0.6, 40.0, 0.4),
        Gait(10.0, 55.0, 7.0, 1.0, 40.0, 1.0),
        Following(Ramps(np.array([0.0, 20.0, 40.0]), np.array([3.0, 3.0, 9.0])), 15.0, 0.4),
    ],
)
def test_programme_derivative_is_that_of_its_value(programme):
    time_s = np.linspace(0.003, 59.9, 2011)
    half_s = 1e-5
    difference = programme.evaluate(time_s + half_s) - programme.evaluate(time_s - half_s)
    np.testing.assert_allclose(
        programme.differentiate(time_s), difference / (2 * half_s), atol=1e-4
    )


def test_following_solves_the_first_order_equation():
    air = Ramps(np.array([0.0, 20.0, 40.0]), np.array([3.0, 3.0, 9.0]))
    time_s = np.arange(6001) * 0.01
    expected = relax(air.evaluate(time_s), 15.0, 0.01)
    np.testing.assert_allclose(Following(air, 15.0, 1.0).evaluate(time_s), expected, atol=1e-9)


def test_play_agrees_with_stepping_every_element():
    time_s = np.linspace(0.0, 60.0, 60_001)
    signal = 3.0 * np.sin(0.7 * time_s) + np.sin(1.9 * time_s + 0.4)
    half_width = 0.8
    widths = half_width * ELEMENT_SPREAD / ELEMENT_SPREAD.mean()
    position = np.full(widths.size, signal[0])
    expected = []
    for value in signal:
        position = np.minimum(np.maximum(position, value - widths), value + widths)
        expected.append(position.mean())
    coarse = signal[::10]
    np.testing.assert_allclose(play(coarse, half_width), expected[::10], atol=1e-6)
    np.testing.assert_allclose(play(coarse, half_width, every=7), expected[::70], atol=1e-6)


def test_play_of_a_gait_does_not_depend_on_the_step():
    gait = Gait(2.0, 58.0, 0.613, 0.57, 180.0, 0.3)
    coarse = play(gait.evaluate(np.arange(6001) * 0.01), 40.0, every=100)
    fine = play(gait.evaluate(np.arange(12_001) * 0.005), 40.0, every=200)
    assert np.ptp(coarse) > 50.0
    # At the largest hysteresis of interest, 1 % of the load, 0.025 N is a thousandth of the noise.
    np.testing.assert_allclose(coarse, fine, atol=0.025)


def test_play_forgets_nothing_at_rest_and_rounding_turns_nothing():
    ramp = np.concatenate([np.linspace(0.0, 5.0, 101), np.full(500, 5.0)])
    ramp[101:] += 1e-15 * (-1.0) ** np.arange(500)
    played = play(ramp, 1.0)
    np.testing.assert_allclose(played[101:], 4.0, atol=1e-12)


MEMORY = (
    "thermal_lag",
    "thermal_hysteresis",
    "thermal_gradient",
    "heat_path",
    "clock_delay",
    "creep",
    "load_hysteresis",
    "humidity",
    "load_rate",
)


@pytest.mark.spread(
    2, "kinds", [("chamber",), ("heating", "cooling", "cold_start", "load_steps"), ("walking",)]
)
def test_halving_the_step_changes_less_than_a_thousandth_of_the_noise(kinds):
    recipe = Recipe(
        train=kinds,
        dwell=False,
        duration_s=1200.0,
        # Thousands of strides through the play take long; the play has a test of its own.
        hidden=tuple(
            EffectChoice(name)
            for name in MEMORY
            if kinds != ("walking",) or name != "load_hysteresis"
        ),
    )
    coarse, fine = simulate(recipe), simulate(dataclasses.replace(recipe, finer=2))
    for a, b in zip(coarse.runs, fine.runs, strict=True):
        change = np.abs((a.drift + a.tare) - (b.drift + b.tare)).max(axis=0)
        assert np.all(change < 1e-3 * coarse.noise_rms)
        np.testing.assert_array_equal(a.temperature_degC, b.temperature_degC)


def test_integration_step_is_at_least_five_times_finer_than_the_log():
    from zerodrift_lab.twin.simulate import run_campaign

    for period_s in (0.05, 0.1, 1.0, 5.0):
        recipe = Recipe(
            train=("chamber", "walking"), dwell=False, duration_s=300.0, sample_period_s=period_s
        )
        for run in run_campaign(recipe):
            assert run.fine_step_s <= period_s / 5
            assert run.fine_step_s <= run.stimulus.finest_s + 1e-12


@pytest.mark.parametrize("seed", range(4))
def test_heating_and_cooling_are_those_of_the_paper(seed):
    recipe = Recipe(seed=seed, train=("heating", "cooling"), dwell=False)
    heating, cooling = simulate(recipe).runs
    rise = heating.temperature_degC.max() - heating.temperature_degC[60:90].mean()
    fall = cooling.temperature_degC.min() - cooling.temperature_degC[60:90].mean()
    assert 8.0 < rise < 13.0
    assert -6.5 < fall < -4.0


def test_chamber_covers_the_range_and_rates_differ():
    runs = simulate(Recipe(seed=5, dwell=False)).runs
    coldest = min(run.temperature_degC.min() for run in runs)
    hottest = max(run.temperature_degC.max() for run in runs)
    assert -25.0 < coldest < -10.0
    assert 50.0 < hottest < 65.0
    fastest = [np.abs(np.diff(run.temperature_degC[::30])).max() * 2.0 for run in runs]
    assert max(fastest) > 1.2 * min(fastest)


def test_walk_goes_cold_hot_cold():
    run = simulate(Recipe(train=("walking",), dwell=False)).runs[0]
    thirds = np.array_split(run.temperature_degC[60:], 3)
    assert thirds[0][-1] < thirds[1][-1] - 10.0
    assert thirds[2][-1] < thirds[1][-1] - 10.0
    assert np.abs(run.reference[:, 2]).max() > 100.0
