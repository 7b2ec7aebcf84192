"""The specimen: sizes of the paper, calibration, noise, and what every physical part does."""

import ast
from pathlib import Path

import numpy as np
import pytest

import zerodrift_lab.twin.six_axis as six_axis
from zerodrift.base.errors import InputError
from zerodrift_lab.twin.recipe import EFFECTS
from zerodrift_lab.twin.sensor import FULL_SCALE
from zerodrift_lab.twin.six_axis import (
    EffectChoice,
    draw_sensor,
    load_protocol,
    parse_protocol,
    record,
)
from zerodrift_lab.twin.six_axis.effects import RAILS_PERCENT
from zerodrift_lab.twin.six_axis.electronics import read_thermometer
from zerodrift_lab.twin.six_axis.heat import NODE
from zerodrift_lab.twin.six_axis.specimen import list_test_weights

PAPER_SPAN = np.array([35.0, 25.0, 160.0, 1.4, 1.6, 0.8])


def test_typical_specimen_drifts_as_the_papers_tables_say():
    spans = np.array([np.abs(draw_sensor(seed).drift_span()) for seed in range(60)])
    np.testing.assert_allclose(np.median(spans, axis=0), PAPER_SPAN, rtol=0.15)
    np.testing.assert_allclose(np.abs(draw_sensor(None).drift_span()), PAPER_SPAN, rtol=0.06)
    spread = spans.std(axis=0) / spans.mean(axis=0)
    assert np.all(spread > 0.08)


def test_calibration_gives_back_the_test_weights():
    for seed in range(4):
        sensor = draw_sensor(seed)
        loads = list_test_weights()
        nodes = np.repeat(sensor.network.settle(10.0, 23.0)[None], len(loads), axis=0)
        found = sensor.to_load(sensor.sense(loads, nodes))
        # The couplers are not straight: within 0.25 % of full scale at a fifth of it.
        assert np.abs((found - loads) / FULL_SCALE).max() < 2.5e-3
        heavy = np.abs(loads) > 0
        assert np.abs(found[heavy] / loads[heavy] - 1.0).max() < 0.05


def test_vertical_couplers_feel_pressing_and_horizontal_ones_shear():
    sensor = draw_sensor(None)
    nodes = sensor.network.settle(10.0, 25.0)[None]
    zero = sensor.sense(np.zeros((1, 6)), nodes)[0]

    def answer(axis, share=0.05):
        load = np.zeros((1, 6))
        load[0, axis] = share * FULL_SCALE[axis]
        return sensor.sense(load, nodes)[0] - zero

    vertical, horizontal = slice(0, 6, 2), slice(1, 6, 2)
    assert np.all(answer(2)[vertical] > 100.0)
    assert np.abs(answer(2)[horizontal]).max() < 1.0
    for axis in (0, 1, 5):
        assert np.abs(answer(axis)[vertical]).max() < 1.0
        assert np.abs(answer(axis)[horizontal]).max() > 100.0


def test_gain_rises_with_temperature_as_the_modulus_falls():
    sensor = draw_sensor(None)
    load = np.zeros((1, 6))
    load[0, 2] = 100.0
    gains = []
    for air in (0.0, 40.0):
        nodes = sensor.network.settle(10.0, air)[None]
        ends = sensor.to_load(sensor.sense(np.concatenate([load, -load]), nodes.repeat(2, 0)))
        gains.append((ends[0, 2] - ends[1, 2]) / 200.0)
    per_kelvin = (gains[1] / gains[0] - 1.0) / 40.0
    assert 2e-4 < per_kelvin < 8e-4


def test_dark_current_doubles_and_matters_most_when_hot():
    sensor = draw_sensor(None)
    couplers = sensor.couplers

    def dark(air):
        nodes = np.full((1, 13), air)
        bright = couplers.convert(np.full((1, 6), 0.5), nodes)
        from dataclasses import replace

        without = replace(couplers, dark_current_na=np.zeros(6))
        return (bright - without.convert(np.full((1, 6), 0.5), nodes))[0]

    np.testing.assert_allclose(dark(45.0) / dark(35.0), 2.0, rtol=1e-9)


def test_noise_is_what_the_truth_says_and_about_one_count_of_14_bits():
    sensor = draw_sensor(4)
    run = record(sensor, load_protocol("dwell"), period_s=0.1)
    white = np.diff(run.measured, axis=0).std(axis=0) / np.sqrt(2.0)
    assert np.all(white < sensor.noise_rms)
    rms = np.sqrt(np.mean(run.noise**2, axis=0))
    np.testing.assert_allclose(rms, sensor.noise_rms, rtol=0.35)
    count = 2.0 * FULL_SCALE / 2**14
    assert np.all((0.3 * count < rms) & (rms < 4.0 * count))
    # The floor is the noise, since nothing was loaded and the reference is exact.
    np.testing.assert_allclose(run.floor, rms, rtol=1e-9)


def test_floor_is_the_error_of_a_perfect_model_against_the_reference():
    run = record(draw_sensor(1), load_protocol("walking"))
    error = run.measured - run.reference - run.drift
    np.testing.assert_allclose(run.floor, np.sqrt(np.mean(error**2, axis=0)))
    exact = run.measured - run.load - run.drift
    assert np.all(run.floor > np.sqrt(np.mean(exact**2, axis=0)))
    assert np.abs(run.reference - run.load).max() > 0.3


def test_a_regression_that_sees_every_node_reaches_the_floor_and_one_thermometer_does_not():
    """The floor is no more and no less than noise: all of the drift follows from the nodes."""
    sensor = draw_sensor(2)
    names = ("chamber", "chamber", "chamber", "standing", "standing", "heating", "cooling")
    train = [record(sensor, load_protocol(name), f"{name}_{k}") for k, name in enumerate(names)]

    def see_all(run):
        away = (run.nodes - 25.0) / 40.0
        couplers = [run.nodes[:, NODE[name]] for name in ("couplers_a", "couplers_b")]
        columns = [np.ones(len(away)), *away.T, away[:, NODE["beams"]] ** 2]
        columns += [((own - 25.0) / 40.0) ** 2 for own in couplers]
        columns += [np.exp2((own - 60.0) / td) for own in couplers for td in (8.5, 10.0, 11.5)]
        return np.stack(columns, axis=1)

    def see_thermometer(run):
        away = (run.temperature_degC - 25.0) / 40.0
        return np.stack([away**power for power in range(8)], axis=1)

    for see, reached in ((see_all, True), (see_thermometer, False)):
        design = np.concatenate([see(run) for run in train])
        drift = np.concatenate([run.measured - run.reference for run in train])
        weights, *_ = np.linalg.lstsq(design, drift, rcond=1e-12)
        for name in ("chamber", "standing", "heating"):
            run = record(sensor, load_protocol(name), f"held_out_{name}")
            error = run.measured - run.reference - see(run) @ weights
            ratio = np.sqrt(np.mean(error**2, axis=0)) / run.floor
            if reached:
                assert np.all((ratio > 0.85) & (ratio < 1.25))
            else:
                assert ratio[2] > 3.0


def test_thermometer_has_its_step_lag_offset_and_pace():
    rng = np.random.default_rng(0)
    step_s = 0.1
    ramp = 20.0 + 0.05 * np.arange(6001) * step_s
    shown = read_thermometer(ramp, step_s, 1, rng, 0.03)
    codes = shown / 0.0078125
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-9)
    # One conversion a second: ten equal readings, then a step.
    changes = np.flatnonzero(np.diff(shown)) + 1
    assert set(np.diff(changes[5:] % 10).tolist()) == {0}
    # Lag of the package, and half a second of holding on average.
    late_s = np.mean((ramp - (shown - 0.03))[1000:]) / 0.05
    assert late_s == pytest.approx(1.5 + 0.5, abs=0.1)


def test_second_thermometer_sits_on_the_elastic_body():
    run = record(draw_sensor(1), load_protocol("walking"))
    beams, board = run.nodes[:, NODE["beams"]], run.nodes[:, NODE["board"]]
    assert np.sqrt(np.mean((run.body_temperature_degC - beams) ** 2)) < 0.5
    assert np.sqrt(np.mean((board - beams) ** 2)) > 1.0


def test_converter_saturates_at_its_rails():
    sensor = draw_sensor(0)
    protocol = parse_protocol("load Fx 599 N\nload Mz 19.9 Nm\nload Fy -599 N\nwait 60 s", "p", "p")
    codes = record(sensor, protocol).adc
    assert codes.min() >= 0
    assert codes.max() <= 65535
    low, high = RAILS_PERCENT
    clipped = draw_sensor(0, [EffectChoice("adc_saturation")])
    codes = record(clipped, protocol).adc
    reach = np.abs(codes - 32768).max() / 32768 * 100.0
    assert low <= reach <= high
    assert np.mean(codes == codes.max()) > 0.1


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_can_be_switched_on_and_changes_the_run(name):
    bare = draw_sensor(2)
    sensor = draw_sensor(2, [EffectChoice(name)])
    protocol = load_protocol("exercise")
    changed = record(sensor, protocol).drift - record(bare, protocol).drift
    about = (changed - changed.mean(axis=0)) / bare.noise_rms
    size = float(np.sqrt(np.mean(about**2)))
    # Those with a size have it in the scaling run; another run of the protocol is near.
    additive = sensor.effects[0].size is not None
    assert (1.2 < size < 3.5) if additive else size > 0.2


def test_a_size_is_met_in_the_scaling_run():
    small, large = (draw_sensor(2, [EffectChoice("creep", size)]) for size in (1.0, 3.0))
    np.testing.assert_allclose(
        3.0 * small.effects[0].coefficients, large.effects[0].coefficients, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([EffectChoice("creap")], "did you mean 'creep'"),
        ([EffectChoice("creep"), EffectChoice("creep")], "asked for twice"),
        ([EffectChoice("creep", 2.0, {"tau_s": -1.0})], "tau_s is -1"),
        ([EffectChoice("thermal_lag", 2.0)], "takes no size"),
    ],
)
def test_impossible_effects_are_refused(effects, message):
    with pytest.raises(InputError, match=message):
        draw_sensor(0, effects)


def test_same_seed_same_run_and_other_names_other_draws():
    sensor, protocol = draw_sensor(7), load_protocol("chamber")
    one, two = (record(sensor, protocol, "chamber_1", 3) for _ in range(2))
    np.testing.assert_array_equal(one.adc, two.adc)
    assert record(sensor, protocol, "chamber_2", 3).seconds != one.seconds
    assert not np.array_equal(draw_sensor(8).calibration, sensor.calibration)


def test_tare_zeroes_the_first_ten_seconds():
    run = record(draw_sensor(1), load_protocol("chamber"), tare="start")
    assert np.abs(run.measured[:10].mean(axis=0)).max() < 1e-3
    np.testing.assert_allclose(run.measured, run.load + run.drift + run.noise, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"period_s": 0.0}, "sample period"), ({"tare": "end"}, "tare is 'end'")],
)
def test_impossible_recordings_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        record(draw_sensor(0), load_protocol("dwell"), **options)


def test_generator_and_fit_share_no_code():
    allowed = {"zerodrift.base.errors", "zerodrift.base.config", "zerodrift.dataset.runs"}
    modules = sorted(Path(six_axis.__file__).parent.glob("*.py"))
    assert len(modules) > 10
    for module in modules:
        for node in ast.walk(ast.parse(module.read_text())):
            name = node.module or "" if isinstance(node, ast.ImportFrom) else ""
            if name.split(".")[0] == "zerodrift":
                assert name.startswith("zerodrift_lab.twin.") or name in allowed, name
