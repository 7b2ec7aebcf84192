"""Elapsed time and the clock: counted from power-on, held where calibration has nothing to say."""

from dataclasses import replace

import numpy as np
import pytest
from tests.effects_on_chip.bench import (
    CLOCK_START_S,
    draw_runs,
    make_compensator,
    make_config,
    make_dataset,
    make_physics,
)

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import (
    compose_integer_model,
    describe_compensator,
    encode_inputs,
    predict_integer,
)
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.counter import IntegerCounter
from zerodrift.operations.node import CODES


def make_model(
    effects: list[EffectConfig], runs: tuple[Run, ...]
) -> tuple[IntegerModel, tuple[Run, ...]]:
    """Return the integer model of effects, and the runs with their drift."""
    compensator, drifting = make_compensator(make_physics(effects, runs), runs)
    described = describe_compensator(compensator, make_config(), drifting)
    return compose_integer_model(described, make_config(), make_dataset(drifting)), drifting


def test_counter_saturates_and_never_wraps() -> None:
    node = IntegerCounter("counter", (), limit=5)
    state = node.rest({CODES: np.zeros((2, 1), dtype=np.int64)})
    seen = []
    for _ in range(9):
        state, out = node.step(state, {})
        seen.append(out.tolist())
    assert seen == [[n, n] for n in (0, 1, 2, 3, 4, 5, 5, 5, 5)]


@pytest.mark.parametrize("settled", [True, False])
def test_warm_up_begins_at_power_on(settled: bool) -> None:
    """Both `init` and `settle` mean power-on: the drift of self-heating is still to come."""
    model, runs = make_model([EffectConfig("warm_up", {"tau_s": 100.0})], draw_runs())
    codes = np.repeat(encode_inputs(model, runs[0])[:1], 2000, axis=0)
    drift = Reference(model).run(codes[None], settled=settled).drift[0, :, 0]
    wanted = (1.0 - np.exp(-np.arange(2000) / 100.0)) * (drift[-1] - drift[0]) + drift[0]
    assert abs(int(drift[-1]) - int(drift[0])) > 1000
    assert np.abs(drift - wanted).max() <= 2.0


def test_log_that_begins_after_power_on_is_compared_from_there() -> None:
    runs = draw_runs()
    late = tuple(replace(run, time_s=run.time_s + 250.0) for run in runs)
    compensator, drifting = make_compensator(
        make_physics([EffectConfig("warm_up", {"tau_s": 300.0})], late), late
    )
    described = describe_compensator(compensator, make_config(), drifting)
    model = compose_integer_model(described, make_config(), make_dataset(drifting))
    error = predict_integer(model, drifting[0]) - described.predict_on_chip(drifting[0])
    counts = np.array([output.lsb_per_unit for output in model.outputs])
    assert (np.abs(error) * counts).max() <= 2.0


def test_age_without_a_clock_is_held_beyond_calibration() -> None:
    """Hours of logs say nothing about years."""
    runs = tuple(
        replace(run, inputs={k: v for k, v in run.inputs.items() if k != "clock"})
        for run in draw_runs(length=500)
    )
    model, drifting = make_model([EffectConfig("zero_tempco"), EffectConfig("ageing")], runs)
    codes = np.repeat(encode_inputs(model, drifting[0])[:1], 8000, axis=0)
    drift = Reference(model).run(codes[None]).drift[0, :, 0]
    moves = np.flatnonzero(np.diff(drift.astype(np.int64)))
    assert moves.max() <= 5 * 499 + 1
    assert moves.size > 100


def test_clock_of_the_hardware_counts_from_its_own_origin() -> None:
    model, runs = make_model([EffectConfig("ageing")], draw_runs())
    channel = next(c for c in model.channels if c.name == "clock")
    assert channel.bits == 32 and channel.lsb == 1.0
    codes = encode_inputs(model, runs[1])
    assert codes.dtype == np.int32
    place = model.channels.index(channel)
    assert codes[0, place] == CLOCK_START_S + 3.0 * 86400.0
