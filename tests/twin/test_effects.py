"""Every effect: that it shows, that it has the size that was asked for, and nothing else moves."""

import dataclasses
import time

import numpy as np
import pytest

from zerodrift.base.errors import InputError
from zerodrift_lab.twin import EffectChoice, Recipe, simulate
from zerodrift_lab.twin.recipe import EFFECTS, LISTED_EFFECTS
from zerodrift_lab.twin.sensor import OUTPUT_LSB, TEMPERATURE_LSB

SHORT = Recipe(seed=11, train=("chamber",) * 3, dwell=False, duration_s=1800.0)


def hide(name, size=None, **parameters):
    """Return the short recipe with one effect hidden, and told both base effects but that one."""
    told = tuple(choice for choice in SHORT.told if choice.name != name)
    return dataclasses.replace(SHORT, told=told, hidden=(EffectChoice(name, size, parameters),))


def measure_size(simulation):
    """Return the hidden drift's size from the logs' temperature alone, by plain least squares."""
    parameters = simulation.physics.parameters
    told = {choice.name for choice in simulation.recipe.told}
    rows, temperature = [], []
    for run in simulation.select("train"):
        rows.append(run.hidden_drift)
        temperature.append(run.temperature_degC)
    lengths = [part.size for part in temperature]
    away = np.concatenate(temperature) - 25.0
    columns = list(np.repeat(np.eye(len(lengths)), lengths, axis=0).T)
    if "zero_tempco" in told:
        columns.append(away)
    if "dark_current" in told:
        doubling = parameters["dark_current"]["doubling_K"]
        columns += [2.0 ** (away / doubling), away * 2.0 ** (away / doubling)]
    design = np.stack(columns, axis=1)
    effect = np.concatenate(rows) / simulation.noise_rms
    left = effect - design @ np.linalg.lstsq(design, effect, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


@pytest.fixture(scope="module")
def plain():
    """The short campaign with nothing hidden, for each set of told effects."""
    made = {}

    def make(told):
        key = tuple(choice.name for choice in told)
        if key not in made:
            made[key] = simulate(dataclasses.replace(SHORT, told=told))
        return made[key]

    return make


@pytest.mark.parametrize("size", [0.5, 2.0])
@pytest.mark.parametrize("name", EFFECTS)
def test_effect_has_the_size_asked_for_and_shows_in_the_logs(name, size, plain):
    simulation = simulate(hide(name, size))
    assert simulation.physics.sizes[name] == pytest.approx(size, rel=0.005)
    assert measure_size(simulation) == pytest.approx(size, rel=0.05)
    before = plain(simulation.recipe.told)
    changed = [
        not np.array_equal(a.measured, b.measured)
        for a, b in zip(before.runs, simulation.runs, strict=True)
    ]
    # A converter that clips shows where a load is near its rail, not in every short run.
    assert any(changed) if name == "adc_saturation" else all(changed)


@pytest.mark.parametrize("name", EFFECTS)
def test_effect_leaves_surroundings_loads_and_noise_alone(name, plain):
    simulation = simulate(hide(name))
    before = plain(simulation.recipe.told)
    for a, b in zip(before.runs, simulation.runs, strict=True):
        np.testing.assert_array_equal(a.temperature_degC, b.temperature_degC)
        np.testing.assert_array_equal(a.reference, b.reference)
        np.testing.assert_array_equal(a.noise, b.noise)
        for channel, values in a.channels.items():
            np.testing.assert_array_equal(values, b.channels[channel])


def test_log_is_reference_plus_drift_plus_noise_within_a_count():
    simulation = simulate(hide("creep"))
    for run in simulation.runs:
        error = run.measured - run.reference - run.drift - run.noise
        rounding = np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4])
        assert np.all(np.abs(error) <= OUTPUT_LSB / 2 + rounding)


def test_complete_model_has_no_hidden_drift():
    for run in simulate(SHORT).runs:
        assert np.all(run.hidden_drift == 0.0)


def test_untold_size_of_an_element_effect_is_what_comes_out():
    simulation = simulate(hide("thermal_lag", tau_s=60.0))
    assert simulation.physics.parameters["thermal_lag"] == {"tau_s": 60.0}
    size = simulation.physics.sizes["thermal_lag"]
    assert size > 3.0
    assert measure_size(simulation) == pytest.approx(size, rel=0.05)


def test_lag_of_given_size_keeps_its_tau_and_scales_the_drift():
    large, small = (simulate(hide("thermal_lag", size, tau_s=60.0)) for size in (4.0, 1.0))
    assert small.physics.parameters["thermal_lag"] == {"tau_s": 60.0}
    ratio = large.physics.coefficients["zero_tempco"] / small.physics.coefficients["zero_tempco"]
    np.testing.assert_allclose(ratio, 4.0, rtol=1e-6)


def test_two_element_effects_both_reach_their_size():
    hidden = (EffectChoice("thermal_lag", 2.0), EffectChoice("thermal_hysteresis", 3.0))
    sizes = simulate(dataclasses.replace(SHORT, hidden=hidden)).physics.sizes
    assert sizes["thermal_lag"] == pytest.approx(2.0)
    assert sizes["thermal_hysteresis"] == pytest.approx(3.0, rel=2e-3)


def test_parameter_and_size_of_a_second_element_effect_contradict():
    hidden = (
        EffectChoice("thermal_lag", 2.0),
        EffectChoice("thermal_hysteresis", 3.0, {"half_width_K": 1.0}),
    )
    with pytest.raises(InputError, match="leave out half_width_K or the size"):
        simulate(dataclasses.replace(SHORT, hidden=hidden))


@pytest.mark.parametrize("name", LISTED_EFFECTS)
def test_every_catalogue_effect_can_be_told(name):
    told = (*(choice for choice in SHORT.told if choice.name != name), EffectChoice(name))
    simulation = simulate(dataclasses.replace(SHORT, train=("chamber",), told=told))
    assert name in simulation.physics.parameters
    assert simulation.physics.sizes == {}
    assert all(np.all(run.hidden_drift == 0.0) for run in simulation.runs)


def test_default_drift_spans_what_the_paper_reports():
    spans = []
    for seed in range(8):
        recipe = dataclasses.replace(SHORT, seed=seed, train=("chamber",), duration_s=3600.0)
        run = simulate(recipe).runs[0]
        spans.append(np.ptp(run.drift, axis=0) / np.ptp(run.temperature_degC) * 80.0)
    typical = np.median(spans, axis=0)
    paper = np.array([35.0, 25.0, 160.0, 1.4, 1.6, 0.8])
    assert np.all(np.abs(np.log(typical / paper)) < np.log(1.35))


def test_noise_has_the_stated_rms_and_colour():
    simulation = simulate(Recipe(seed=3, train=("chamber",) * 4, dwell=False))
    noise = np.concatenate([run.noise for run in simulation.runs])
    stated = np.sqrt(simulation.noise_rms**2 - OUTPUT_LSB**2 / 12.0)
    np.testing.assert_allclose(noise.std(axis=0), stated, rtol=0.1)
    whitened = (noise - noise.mean(axis=0)) / noise.std(axis=0)
    neighbours = np.mean(whitened[1:] * whitened[:-1], axis=0)
    assert np.all((neighbours > 0.15) & (neighbours < 0.7))


def test_converters_quantise():
    simulation = simulate(dataclasses.replace(SHORT, tare="none"))
    run = simulation.runs[0]
    codes = run.temperature_degC / TEMPERATURE_LSB
    assert np.abs(codes - np.round(codes)).max() < 0.01
    counts = run.measured / OUTPUT_LSB
    assert np.abs(counts - np.round(counts)).max() < 0.06


def test_tare_zeroes_the_start_of_every_log():
    for run in simulate(SHORT).runs:
        assert np.all(np.abs(run.measured[:10].mean(axis=0)) < 1e-3)
    untared = simulate(dataclasses.replace(SHORT, tare="none"))
    assert all(np.all(run.tare == 0.0) for run in untared.runs)


def test_rails_cut_the_logs():
    simulation = simulate(hide("adc_saturation", rail_pct=10.0))
    rails = np.array([60.0, 60.0, 200.0, 1.4, 1.4, 2.0])
    for run in simulation.runs:
        assert np.all(np.abs(run.measured + run.tare) <= rails + OUTPUT_LSB)
    assert simulation.physics.sizes["adc_saturation"] > 10.0


def test_seed_decides_everything_and_seeds_differ():
    recipe = dataclasses.replace(hide("creep"), train=("chamber",))
    first, again = simulate(recipe), simulate(recipe)
    other = simulate(dataclasses.replace(recipe, seed=12))
    assert first.physics.parameters == again.physics.parameters
    assert first.physics.parameters != other.physics.parameters
    np.testing.assert_array_equal(first.runs[0].measured, again.runs[0].measured)
    assert not np.array_equal(first.runs[0].measured, other.runs[0].measured)


def test_an_hour_at_ten_hertz_takes_under_a_second():
    recipe = Recipe(train=("chamber",), dwell=False, sample_period_s=0.1)
    seconds = []
    for _ in range(3):
        begin = time.process_time()
        simulate(recipe)
        seconds.append(time.process_time() - begin)
    assert min(seconds) < 1.0
