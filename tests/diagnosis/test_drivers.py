"""What a drift may follow is computed stretch by stretch, and suspected by what an effect says."""

import numpy as np
import pytest

from zerodrift.diagnosis.drivers import DriftDriver, derive, find_stretches, read_driver, suspect
from zerodrift.physics.catalogue import load_catalogue

CHANNELS = ("temperature", "load Fx", "load Fz", "supply", "acceleration_y", "time")


def test_lag_of_a_ramp_is_its_slope_times_the_time_constant():
    time_s = np.arange(2000.0)
    lag = derive(DriftDriver("temperature", "lag", 50.0), 0.01 * time_s, time_s, 1.0)
    assert lag[0] == 0.0
    assert lag[-1] == pytest.approx(0.01 * 50.0, rel=1e-9)


def test_rate_is_per_minute_and_stops_at_a_gap():
    time_s = np.concatenate([np.arange(300.0), 1000.0 + np.arange(300.0)])
    values = np.where(time_s < 900.0, 0.02 * time_s, 500.0 - 0.05 * time_s)
    rate = derive(DriftDriver("temperature", "rate"), values, time_s, 1.0)
    assert rate[:300] == pytest.approx(np.full(300, 1.2))
    assert rate[300:] == pytest.approx(np.full(300, -3.0))


def test_stretches_are_cut_at_every_gap():
    time_s = np.array([0.0, 1.0, 2.0, 10.0, 11.0, 5.0, 6.0])
    assert find_stretches(time_s, 1.0) == [slice(0, 3), slice(3, 5), slice(5, 7)]


@pytest.mark.parametrize(
    "driver", [DriftDriver("temperature"), DriftDriver("load Fz", "lag", 61.5)]
)
def test_key_is_read_back(driver):
    assert read_driver(driver.key) == driver


@pytest.mark.parametrize("key", ["", "drift", "lag:x:supply", "lag:-1:supply", "jerk:1:supply"])
def test_what_is_no_key_is_no_driver(key):
    assert read_driver(key) is None


@pytest.mark.parametrize(
    ("kind", "parameters", "expected"),
    [
        ("thermal_lag", {"tau_s": 61.0}, DriftDriver("temperature", "lag", 61.0)),
        ("thermal_gradient", {"smoothing_s": 20.0}, DriftDriver("temperature", "rate")),
        ("thermal_hysteresis", {"half_width_K": 2.0}, DriftDriver("temperature")),
        ("creep", {"tau_s": 300.0}, DriftDriver("load Fz", "lag", 300.0)),
        ("load_hysteresis", {}, DriftDriver("load Fz")),
        ("span_tempco", {}, DriftDriver("load Fz")),
        ("supply_sensitivity", {}, DriftDriver("supply")),
        ("inertial_load", {}, DriftDriver("acceleration_y")),
        ("warm_up", {"tau_s": 300.0}, DriftDriver("time")),
    ],
)
def test_effect_suspects_the_channel_that_it_declares(kind, parameters, expected):
    needs = load_catalogue()[kind].needs
    assert suspect(needs, parameters, CHANNELS, "Fz")[0] == expected


def test_every_effect_of_the_catalogue_suspects_something():
    channels = ("temperature", "load Fz", "supply", "humidity", "ambient_light", "acceleration_x")
    channels = (*channels, "pressure")
    for effect in load_catalogue().listed():
        assert suspect(effect.needs, {}, (*channels, "time"), "Fz"), effect.kind


def test_load_that_no_log_moves_is_not_suspected():
    assert suspect(("load",), {"tau_s": 3.0}, ("temperature", "time"), "Fz") == ()
