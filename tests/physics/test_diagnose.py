import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.physics.conftest import NOISE, SLOPE, follow, linear, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.base.records import to_dict
from zerodrift.diagnosis import diagnose as diagnosing
from zerodrift.diagnosis import rules
from zerodrift.diagnosis.candidates import are_sound
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.course import diagnose_until_done
from zerodrift.diagnosis.diagnose import diagnose, look
from zerodrift.diagnosis.rules import lead
from zerodrift.diagnosis.span import LogSpan
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.terms import start_term


def lagging(bench):
    return (follow(bench.temperature, 90.0) - 25.0)[:, None] * SLOPE


def powered(bench):
    return linear(bench) + (bench.supply - 5.0)[:, None] * np.array([20.0, 0.2])


def test_complete_model_is_called_complete(tempco):
    diagnosis = diagnose(tempco, make_dataset(linear, length=600))
    assert diagnosis.verdict == "complete"
    assert diagnosis.effect is None
    assert diagnosis.floor_ratio_after == pytest.approx(1.0, abs=0.15)


@pytest.mark.long
def test_lag_is_named_and_brings_the_error_to_the_floor(tempco):
    diagnosis = diagnose(tempco, make_dataset(lagging, length=600))
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "thermal_lag")
    assert diagnosis.parameters["tau_s"] == pytest.approx(90.0, rel=0.05)
    assert diagnosis.floor_ratio_before > 2.0
    assert diagnosis.floor_ratio_after == pytest.approx(1.0, abs=0.15)
    best = diagnosis.candidates[0]
    assert best.effect == "thermal_lag"
    assert best.p_value == 2.0**-8
    assert best.heldout_rmse_ratio < 0.5


@pytest.mark.slow
def test_two_effects_are_found_one_after_the_other(tempco):
    def disturb(bench):
        return lagging(bench) + powered(bench) - linear(bench)

    course = diagnose_until_done(tempco, make_dataset(disturb, length=600))
    added = {step.effect for step in course.steps if step.effect}
    assert added == {"thermal_lag", "supply_sensitivity"}
    assert course.steps[-1].verdict == "complete"
    assert course.effects[0].kind == "zero_tempco"
    assert course.drop == ()


@pytest.mark.long
def test_effect_whose_channel_is_missing_is_unknown_and_the_channel_told(tempco):
    diagnosis = diagnose(tempco, make_dataset(powered, length=600, inputs=()))
    assert (diagnosis.verdict, diagnosis.effect) == ("unknown", None)
    assert "supply_sensitivity" in {u.effect for u in diagnosis.not_testable}
    assert "supply_sensitivity" in diagnosis.next_experiment


def test_disturbance_outside_the_catalogue_is_unknown(tempco):
    def disturb(bench):
        swing = np.sin(bench.time_s / 37.0 + bench.rng.uniform(0.0, 6.0))
        still = bench.temperature.std() < 1.0
        return linear(bench) + (0.0 if still else 2.0) * swing[:, None] * np.array([1.0, 0.01])

    diagnosis = diagnose(tempco, make_dataset(disturb, length=600))
    assert diagnosis.verdict == "unknown"
    assert diagnosis.nearest is not None
    assert any("period" in pattern.follows for pattern in diagnosis.remainder)


def test_sensor_that_wanders_at_rest_is_not_called_complete(tempco):
    def disturb(bench):
        walk = 0.1 * bench.rng.normal(size=(bench.time_s.size, 2)).cumsum(axis=0)
        return linear(bench) + walk * np.array([1.0, 0.01])

    diagnosis = diagnose(tempco, make_dataset(disturb, length=600))
    assert diagnosis.verdict == "unknown"
    assert any("wanders" in note for note in diagnosis.remarks)


def test_noisier_runs_are_named(tempco):
    dataset = make_dataset(linear, length=300)
    rng = np.random.default_rng(8)
    train = list(dataset.train)
    for i in (3, 5):
        noise = 3.0 * rng.normal(size=(300, 2)) * np.array([0.5, 0.004])
        train[i] = replace(train[i], measured=train[i].measured + noise)
    diagnosis = diagnose(tempco, replace(dataset, train=tuple(train)))
    assert diagnosis.verdict == "unknown"
    (note,) = [note for note in diagnosis.remarks if "noisier" in note]
    assert "run_3" in note and "run_5" in note


def test_quadratic_zero_shift_is_named_as_a_higher_order(tempco):
    def disturb(bench):
        return linear(bench) + 0.03 * ((bench.temperature - 25.0) ** 2)[:, None] * SLOPE

    diagnosis = diagnose(tempco, make_dataset(disturb, length=600))
    assert diagnosis.effect == "zero_tempco"
    assert diagnosis.parameters["order"] in (2, 3)


@pytest.mark.long
def test_clipped_samples_are_set_aside(tempco):
    dataset = make_dataset(linear, length=600, tared=False)
    train = [replace(run, measured=np.clip(run.measured, -300.0, 300.0)) for run in dataset.train]
    diagnosis = diagnose(tempco, replace(dataset, train=tuple(train)))
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "adc_saturation")
    assert diagnosis.floor_ratio_after == pytest.approx(1.0, abs=0.15)


@pytest.mark.long
def test_few_runs_are_called_thin_evidence(tempco):
    four = diagnose(tempco, make_dataset(lagging, runs=4, length=500))
    assert four.effect == "thermal_lag"
    assert four.evidence.startswith("thin: with 4 runs no p-value can be below 0.062")
    one = diagnose(tempco, make_dataset(lagging, runs=1, length=1500))
    assert one.evidence.startswith("thin: 1 run was cut into 8 pieces")


@pytest.mark.long
def test_floor_without_a_dwell_is_called_estimated(tempco):
    diagnosis = diagnose(tempco, make_dataset(lagging, length=500, dwell=False))
    assert diagnosis.effect == "thermal_lag"
    assert diagnosis.noise_floor_source == "estimated"
    assert any("no dwell" in note for note in diagnosis.remarks)


def test_effect_that_logs_do_not_excite_is_not_testable(tempco):
    diagnosis = diagnose(tempco, make_dataset(linear, length=300, inputs=("humidity",)))
    why = {u.effect: u.why for u in diagnosis.not_testable}
    assert why["ambient_light"] == "no input 'ambient_light'"
    assert "do not excite" in why["humidity"]


def test_idle_effect_is_proposed_for_removal():
    model = [EffectConfig("zero_tempco"), EffectConfig("supply_sensitivity")]
    course = diagnose_until_done(model, make_dataset(linear, length=400))
    assert course.drop == ("supply_sensitivity",)


@pytest.mark.long
def test_verdict_is_the_same_twice_and_fits_json(tempco):
    dataset = make_dataset(lagging, runs=4, length=300)
    one, two = (json.dumps(to_dict(diagnose(tempco, dataset))) for _ in range(2))
    assert one == two
    told = json.loads(one)
    for key in ("verdict", "effect", "lookalikes", "candidates", "not_testable"):
        assert key in told
    assert set(told["candidates"][0]) >= {
        *("effect", "rmse_left_out_ratio", "p_value", "excitation", "parameters", "testable"),
        "heldout_rmse_ratio",
    }


def test_next_experiment_tells_lookalikes_apart(tempco):
    # With slow ramps alone a short lag and a gradient are the same.
    def disturb(bench):
        slow = np.interp(bench.time_s, bench.time_s[[0, -1]], bench.temperature[[0, -1]])
        bench.temperature[:] = slow
        return (follow(slow, 20.0) - 25.0)[:, None] * SLOPE * 8.0

    diagnosis = diagnose(tempco, make_dataset(disturb, length=500))
    if diagnosis.lookalikes:
        assert "times the noise" in diagnosis.next_experiment
    else:
        assert diagnosis.next_experiment


@pytest.mark.long
def test_crosstalk_beside_a_span_shift_of_each_output_is_testable():
    """What one output's own columns imitate is no imitation in another output."""

    def disturb(bench):
        share = bench.load / np.array([2000.0, 14.0])
        span = 0.02 * (bench.temperature - 25.0)[:, None] * share * np.array([20.0, 0.2])
        return linear(bench) + span + share[:, ::-1] * np.array([8.0, 0.06])

    model = [EffectConfig("zero_tempco"), EffectConfig("span_tempco")]
    diagnosis = diagnose(model, make_dataset(disturb, length=600))
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "crosstalk")
    assert diagnosis.floor_ratio_after < 1.15


@pytest.mark.spread(1, "runs", [2, 4])
def test_complete_model_with_few_runs_is_given_no_name(tempco, runs):
    for seed in range(2):
        dataset = make_dataset(linear, runs=runs, length=400, seed=seed)
        assert diagnose(tempco, dataset).effect is None


def test_degenerate_values_are_no_finding(tempco):
    case = open_case(make_dataset(lagging, runs=4, length=300), load_catalogue(), tempco)
    first = look(case, case.terms)
    lag = next(judged for judged in first.judged if judged.kind == "thermal_lag")
    assert lag.sound and lead(first) is lag
    unsound = replace(first, judged=tuple(replace(j, sound=False) for j in first.judged))
    assert lead(unsound) is None


@pytest.mark.parametrize(
    ("values", "is_sound"),
    [
        ({"time_constants": 1, "tau_s": 60.0}, True),
        ({"time_constants": 1, "tau_s": 100000.0}, False),
        ({"time_constants": 1, "tau_s": 1.5}, False),
        ({"time_constants": 1, "tau_s": 3000.0}, False),
        ({"time_constants": 2, "tau_s": 54.36, "slow_tau_s": 54.36, "slow_share": 0.3}, False),
        ({"time_constants": 2, "tau_s": 30.0, "slow_tau_s": 300.0, "slow_share": -1e-5}, False),
        ({"time_constants": 2, "tau_s": 30.0, "slow_tau_s": 300.0, "slow_share": 0.3}, True),
        ({"time_constants": 2, "tau_s": 30.0, "slow_tau_s": 300.0, "slow_share": -0.3}, True),
    ],
)
def test_values_that_logs_of_1200_s_cannot_show_are_unsound(values, is_sound):
    catalogue = load_catalogue()
    free = start_term(catalogue, EffectConfig("thermal_lag"))
    term = replace(free, values={**free.values, **values})
    assert are_sound(term, LogSpan(shortest_s=2.0, longest_s=1200.0)) is is_sound


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("clock_delay", {"delay_s": -3.0}),
        ("clock_delay", {"delay_s": 3.0}),
        ("span_tempco", {"calibrated_degC": -40.0}),
    ],
)
def test_a_negative_value_is_as_sound_as_a_positive_one(kind, values):
    term = start_term(load_catalogue(), EffectConfig(kind))
    told = replace(term, values={**term.values, **values})
    assert are_sound(told, LogSpan(2.0, 1200.0, {"load": 0.3, "temperature": 0.05}))


@pytest.mark.parametrize(
    ("kind", "values", "is_sound"),
    [
        ("load_hysteresis", {"half_width_pct": 0.2}, False),
        ("load_hysteresis", {"half_width_pct": 0.4}, True),
        ("thermal_hysteresis", {"half_width_K": 0.04}, False),
        ("thermal_hysteresis", {"half_width_K": 0.06}, True),
    ],
)
def test_a_play_as_wide_as_its_signals_noise_is_unsound(kind, values, is_sound):
    term = start_term(load_catalogue(), EffectConfig(kind))
    played = replace(term, values={**term.values, **values})
    span = LogSpan(2.0, 1200.0, {"load": 0.3, "temperature": 0.05})
    assert are_sound(played, span) is is_sound


@pytest.mark.long
def test_a_noisy_reference_is_no_hysteresis():
    """What remembers the load lacks the reference's noise, so that it lowers the error by it."""

    def blur(dataset, rms):
        runs = [
            replace(
                run,
                reference=run.reference
                + np.random.default_rng(i).normal(size=run.reference.shape) * rms * NOISE,
            )
            for i, run in enumerate((*dataset.train, *dataset.dwell))
        ]
        count = len(dataset.train)
        return replace(dataset, train=tuple(runs[:count]), dwell=tuple(runs[count:]))

    effects = [EffectConfig("zero_tempco")]
    for seed in (0, 1):
        found = diagnose(effects, blur(make_dataset(linear, seed=seed), 1.0))
        assert found.verdict == "complete"
        [play] = [c for c in found.candidates if c.effect == "load_hysteresis"]
        assert not play.sound or play.rmse_left_out_ratio > 0.985


def test_what_remembers_the_load_must_gain_more_than_the_references_noise():
    catalogue = load_catalogue()
    span = LogSpan(2.0, 1200.0, reference_noise=np.array([0.1, 0.0]))
    play = start_term(catalogue, EffectConfig("load_hysteresis"))
    span_shift = start_term(catalogue, EffectConfig("span_tempco"))
    little, much = np.array([0.012, 0.0]), np.array([0.02, 0.0])
    assert not span.is_more_than_smoothing(play, little)
    assert span.is_more_than_smoothing(play, much)
    assert span.is_more_than_smoothing(span_shift, little)


@pytest.mark.long
def test_what_is_surely_there_is_named_though_much_is_left(monkeypatch):
    def disturbed(bench):
        rng = np.random.default_rng(int(1e6 * bench.supply[0] + 1e3 * bench.temperature[0]) % 2**31)
        phase, period = rng.uniform(0.0, 6.0), rng.uniform(300.0, 500.0)
        unlogged = np.sin(2.0 * np.pi * bench.time_s / period + phase)
        moves = np.ptp(bench.temperature) > 1.0  # the dwell knows nothing of it
        drift = linear(bench) + (bench.supply - 5.0)[:, None] * np.array([60.0, 0.6])
        return drift + moves * unlogged[:, None] * np.array([1.5, 0.0125])

    dataset = make_dataset(disturbed, length=600)
    plain = diagnose([EffectConfig("zero_tempco")], dataset)
    assert (plain.verdict, plain.effect) == ("missing", "supply_sensitivity")
    assert plain.something_else > 0.9
    # it gains in all runs; without that rule its probability must be large
    monkeypatch.setattr(diagnosing, "is_there", lambda finding: False)
    unsure = diagnose([EffectConfig("zero_tempco")], dataset)
    assert (unsure.verdict, unsure.nearest) == ("unknown", "supply_sensitivity")
    chance = unsure.probability_of("supply_sensitivity")
    assert 0.5 < chance < diagnosing.SURELY_THERE
    monkeypatch.setattr(diagnosing, "SURELY_THERE", chance)
    sure = diagnose([EffectConfig("zero_tempco")], dataset)
    assert (sure.verdict, sure.effect) == ("missing", "supply_sensitivity")
    assert sure.something_else >= unsure.something_else > 0.9
    assert sure.floor_ratio_after > 1.5 and sure.remainder


def test_what_gains_more_in_disguise_is_a_look_alike(monkeypatch):
    def judge(kind, gain, plausible):
        gains = np.full(8, gain)
        facts = {"kind": kind, "plausible": plausible, "sound": True}
        return SimpleNamespace(gains=gains, gain=gains.sum(), **facts)

    monkeypatch.setattr(rules, "helps", lambda judged, examination: True)
    leading = judge("zero_tempco", 100.0, True)
    better = judge("dark_current", 100.5, False)
    worse = judge("thermal_hysteresis", 99.5, False)
    examination = SimpleNamespace(judged=[better, leading, worse])
    assert rules.list_lookalikes(rules.Finding(examination, leading)) == [better]
