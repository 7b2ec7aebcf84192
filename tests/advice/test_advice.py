from dataclasses import replace

import numpy as np
import pytest
from tests.advice.conftest import CHAMBER, HEAT_PATH, MIXED, lag, straighten

from zerodrift.base.config import NetworkConfig
from zerodrift.base.records import to_dict
from zerodrift.diagnosis.advice import SPACING_S, advise


def named(advice):
    return [protocol.name for protocol in advice.protocols]


@pytest.mark.parametrize("seed", [10, 11, 12])
@pytest.mark.spread(2, "tau_s", [60.0, 150.0])
def test_a_hidden_lag_is_found_and_its_time_constant_bounded(ask, seed, tau_s):
    advice = ask(hidden=lag(tau_s), seed=seed)
    slowest = max(advice.time_constants, key=lambda t: t.tau_s)
    assert tau_s / 2.0 < slowest.tau_s < tau_s * 2.0
    assert slowest.low_s <= slowest.tau_s <= slowest.high_s
    assert advice.without_memory > 3.0


@pytest.mark.parametrize("seed", [10, 11, 12])
def test_a_sensor_without_lag_calls_for_no_memory(ask, seed):
    advice = ask(seed=seed)
    assert advice.time_constants == ()
    assert advice.without_memory == pytest.approx(1.0)
    assert advice.spans is None
    assert "call for no memory" in advice.explain()[0]


def test_a_window_shorter_than_the_lag_does_not_span_it_and_a_long_one_does(ask):
    hidden = lag(150.0)
    short = ask(NetworkConfig("gru", memory=10, lags_s=(3.0,)), hidden=hidden, seed=10)
    long = ask(NetworkConfig("gru", memory=600, lags_s=(3.0,)), hidden=hidden, seed=10)
    assert short.memory.span_s == 9.0
    assert short.spans is False
    assert short.memory.error_ratio > 1.3
    assert 'memory = "stream"' in short.explain()[1]
    assert long.memory.span_s == 599.0
    assert long.spans is True


def test_the_spacing_of_a_windowed_kind_decides_its_span(ask):
    def span(spacing_s):
        network = NetworkConfig(
            "mlp_seq", memory=10, lags_s=(3.0,), options={"spacing_s": spacing_s}
        )
        return ask(network, hidden=lag(150.0), seed=10)

    assert span(1.0).spans is False
    assert span(50.0).spans is True
    assert "samples" in span(1.0).memory.remedy


def test_lags_found_by_training_make_up_for_a_short_window(ask):
    advice = ask(NetworkConfig("gru", memory=10), hidden=lag(150.0), seed=10)
    assert advice.spans is True
    assert advice.memory.window_ratio > 1.3
    assert "alone does not span" in advice.explain()[1]


def test_a_bank_of_fast_lags_does_not_span_a_slow_one(ask):
    hidden = lag(200.0)
    fast = ask(NetworkConfig("lag_bank", lags_s=(3.0, 6.0)), hidden=hidden, seed=11)
    slow = ask(NetworkConfig("lag_bank", lags_s=(20.0, 200.0)), hidden=hidden, seed=11)
    assert fast.spans is False
    assert slow.spans is True
    assert ask(NetworkConfig("lag_bank"), hidden=hidden, seed=11).spans is True


def test_a_model_without_lag_is_told_of_it(project):
    config, dataset = project(hidden=lag(150.0), seed=10)
    assert advise(config, dataset).spans is False
    effect = replace(config.effects[0], kind="thermal_lag")
    assert advise(config, dataset, [*config.effects, effect]).spans is True


def test_spacing_of_windows_is_that_of_training():
    from zerodrift.train.stages import SPACING_S as TRAINED

    assert SPACING_S == TRAINED


@pytest.mark.spread(1, "seed", [20, 21, 22])
def test_chamber_logs_of_a_plain_lag_show_one_heat_path(ask, seed):
    assert ask(seed=seed).heat == "one"
    assert ask(hidden=lag(20.0), seed=seed).heat == "one"
    advice = ask(hidden=lag(150.0), seed=seed)
    assert advice.heat != "several"
    assert named(advice)[0] == "heat from one side"


@pytest.mark.parametrize("seed", [20, 21, 22])
def test_heat_from_one_side_is_another_path_where_the_elements_feel_it(ask, seed):
    advice = ask(train=MIXED, hidden=HEAT_PATH, seed=seed)
    assert advice.heat == "several"
    assert advice.paths[0].run.startswith("heating")
    assert named(advice)[0] == "a second thermometer"


@pytest.mark.parametrize("seed", [20, 21, 22])
def test_a_second_thermometer_tells_the_paths_apart(ask, seed):
    advice = ask(train=MIXED, hidden=HEAT_PATH, body=True, seed=seed)
    assert advice.heat == "several"
    assert not any(path.differs for path in advice.paths)
    assert advice.untold_K["body_temperature"] > 0.5
    assert "a second thermometer" not in named(advice)


def test_one_run_alone_tells_nothing_of_heat_paths(ask):
    advice = ask(train=("chamber",), hidden=lag(100.0), seed=20)
    assert advice.heat == "unknown"
    assert advice.paths == ()
    assert "more runs" in named(advice)


def test_what_the_programme_lacks_is_asked_for(project):
    config, dataset = project(train=CHAMBER, seed=20)
    assert "known loads at several temperatures" in named(advise(config, dataset))
    assert "the whole range" not in named(advise(config, dataset))
    narrow = replace(
        dataset,
        train=tuple(
            replace(run, temperature_degC=20.0 + 0.1 * run.temperature_degC)
            for run in dataset.train
        ),
    )
    assert "the whole range" in named(advise(config, narrow))
    late = replace(
        dataset, train=tuple(replace(run, time_s=run.time_s + 100.0) for run in dataset.train)
    )
    assert "cold power-on" in named(advise(config, late))
    assert "cold power-on" not in named(advise(config, dataset))


def test_ramps_of_one_rate_are_noticed(project):
    config, dataset = project(train=CHAMBER, seed=20)
    assert "two ramp rates" in named(advise(config, straighten(dataset, 0.04)))
    assert "two ramp rates" not in named(advise(config, dataset))


def test_logs_with_loads_do_not_call_for_weights(ask):
    advice = ask(hidden=lag(100.0), seed=20, exercise=("load",))
    assert "known loads at several temperatures" not in named(advice)
    slowest = max(t.tau_s for t in advice.time_constants)
    assert 40.0 < slowest < 250.0


def test_outputs_that_never_move_give_no_advice(project):
    config, dataset = project(train=("chamber",), seed=20)
    still = replace(
        dataset,
        train=tuple(
            replace(run, measured=np.ones_like(run.measured), reference=np.ones_like(run.measured))
            for run in dataset.train
        ),
    )
    assert advise(config, still) is None


def test_json_holds_what_the_sentences_say(ask):
    advice = ask(hidden=lag(100.0), seed=20)
    told = to_dict(advice.summarise())
    assert told["sentences"] == advice.explain()
    assert told["heat_paths"] == advice.heat
    assert told["next_protocols"][0]["name"] == "heat from one side"
    assert set(told["runs"]) == {f"chamber_{i}" for i in range(1, 7)}
