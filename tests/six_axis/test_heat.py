"""Thirteen thermal nodes: against a general solver, at rest, and by halving the step."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from zerodrift_lab.twin.six_axis import (
    draw_sensor,
    list_protocols,
    load_protocol,
    parse_protocol,
    record,
)
from zerodrift_lab.twin.six_axis.heat import (
    CAPACITY,
    CONDUCTANCE,
    NODE,
    NODES,
    OWN_POWER,
    Surroundings,
    draw_network,
    warm,
)


def surround(count, **changes):
    plain = {
        "step_s": 0.5,
        "air": np.full(count, 20.0),
        "plate": np.full(count, 20.0),
        "on_plate": np.zeros(count, dtype=bool),
        "lamp": np.zeros(count),
        "airflow": np.full(count, 10.0),
        "powered_before": True,
    }
    return Surroundings(**{**plain, **changes})


def test_network_agrees_with_a_general_solver_across_switches():
    network = draw_network(5)
    count = 2401
    time_s = np.arange(count) * 0.5
    air = np.interp(time_s, [0, 100, 500], [20.0, 20.0, 50.0])
    plate = np.full(count, -20.0)
    on_plate = (time_s >= 300) & (time_s < 800)
    airflow = np.where(time_s >= 600, 25.0, 10.0)
    lamp = np.interp(time_s, [0, 50, 60, 900, 910], [0.0, 0.0, 3.0, 3.0, 0.0])
    solved = warm(
        network,
        surround(count, air=air, plate=plate, on_plate=on_plate, airflow=airflow, lamp=lamp),
    )

    def slope(begin, t, x):
        """The network's equations, written out heat flow by heat flow."""
        here = [np.interp(t, time_s, signal) for signal in (air, lamp)]
        k = int(begin * 2)
        flow = np.zeros(13)
        for a in range(13):
            for b in range(13):
                flow[a] += network.inner[a, b] * (x[b] - x[a])
        for a in range(13):
            on = bool(on_plate[k]) and a == NODE["sole"]
            flow[a] += 0.0 if on else network.outer_area[a] * airflow[k] * (here[0] - x[a])
            flow[a] += network.plate_conductance * (-20.0 - x[a]) if on else 0.0
        for name, share in (("cover", 0.5), ("base_a", 0.35), ("top", 0.15)):
            flow[NODE[name]] += share * here[1]
        for name, watts in OWN_POWER.items():
            flow[NODE[name]] += watts
        return flow / network.capacity

    state = network.settle(10.0, 20.0)
    np.testing.assert_allclose(solved[0], state, atol=1e-9)
    for begin, end in ((0, 300), (300, 600), (600, 800), (800, 1200)):
        exact = solve_ivp(
            lambda t, x, begin=begin: slope(begin, t, x),
            (begin, end),
            state,
            method="LSODA",
            rtol=1e-9,
            atol=1e-9,
            max_step=10.0,
        )
        state = exact.y[:, -1]
        # Airflow and plate hold over the step before the switch is seen on the grid.
        np.testing.assert_allclose(solved[end * 2], state, atol=2e-4)


def test_own_heat_leaves_as_much_as_comes_in():
    network = draw_network(None)
    rest = network.settle(10.0, 20.0)
    lost = 10.0 * np.sum(network.outer_area * (rest - 20.0))
    assert lost == pytest.approx(sum(OWN_POWER.values()), rel=1e-9)


def test_there_are_thirteen_nodes_each_with_capacity_and_a_way_out():
    assert len(NODES) == 13
    assert set(CAPACITY) == set(NODES)
    assert {name for pair in CONDUCTANCE for name in pair} == set(NODES)


def test_power_on_begins_at_the_airs_temperature():
    network = draw_network(1)
    temperatures = warm(network, surround(4001, powered_before=False))
    np.testing.assert_allclose(temperatures[0], 20.0, atol=1e-9)
    np.testing.assert_allclose(temperatures[-1], network.settle(10.0, 20.0), atol=0.3)


def test_one_sided_heat_is_another_distribution_than_the_chamber():
    """What body and board differ by at one rate of the board's temperature tells the ways apart."""
    sensor = draw_sensor(2)
    air = "airflow 25 W/m2K\nwait 60 s\nair 60 degC at 3 K/min then wait 60 s\n"
    plate = "airflow 25 W/m2K\nwait 60 s\nplate 60 degC\nwait 400 s\n"
    ratios = []
    for text in (air, plate):
        run = record(sensor, parse_protocol(text, "p", "p"), period_s=1.0)
        board, body = run.nodes[:, NODE["board"]], run.nodes[:, NODE["beams"]]
        rate = np.gradient(board)
        k = int(np.argmax(rate))
        ratios.append((body - board - (body - board)[0])[k] / rate[k])
    assert abs(ratios[1] / ratios[0] - 1.0) > 0.2


@pytest.mark.parametrize("name", list_protocols())
def test_halving_the_step_changes_less_than_a_thousandth_of_the_noise(name):
    sensor = draw_sensor(3)
    coarse = record(sensor, load_protocol(name), period_s=1.0)
    fine = record(sensor, load_protocol(name), period_s=1.0, finer=2)
    assert np.all(np.abs(coarse.drift - fine.drift).max(axis=0) < 1e-3 * sensor.noise_rms)
    assert np.abs(coarse.nodes - fine.nodes).max() < 1e-6
    # A conversion falls between grid points; at worst one count flips.
    differs = np.abs(coarse.temperature_degC - fine.temperature_degC)
    assert differs.max() <= 0.0079
    assert np.mean(differs > 0) < 0.01


def test_halving_the_step_holds_with_effects_that_remember():
    from zerodrift_lab.twin.six_axis import EffectChoice

    names = ("creep", "humidity", "thermal_lag", "thermal_hysteresis", "clock_delay", "load_rate")
    sensor = draw_sensor(3, [EffectChoice(name) for name in names])
    protocol = parse_protocol(
        "wait 60 s\nair 45 degC at 6 K/min\nload Fz 200 N\nhumidity 80 %\nwait 100 s\n"
        "gait 0.7 s Fz 100 N\nwait 60 s\ngait off\nload none\nair 20 degC over 100 s\nwait 150 s\n",
        "p",
        "p",
    )
    coarse, fine = record(sensor, protocol), record(sensor, protocol, finer=2)
    assert np.all(np.abs(coarse.drift - fine.drift).max(axis=0) < 1e-3 * sensor.noise_rms)
