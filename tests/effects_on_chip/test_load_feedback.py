"""The load on the chip: the raw output less the drift of the step before, from the first step."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.effects_on_chip.bench import (
    draw_run,
    draw_runs,
    make_compensator,
    make_config,
    make_dataset,
    make_physics,
)

from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import (
    compose_integer_model,
    describe_compensator,
    encode_inputs,
    predict_integer,
)
from zerodrift.export.float_model import predict_fed_back
from zerodrift.export.integer_model import FLAG_DAMAGED, IntegerModel
from zerodrift.export.reference import Reference

EFFECTS = [EffectConfig("zero_tempco"), EffectConfig("creep", {"tau_s": 200.0})]


def step_by_step(run: Run, gain: float, offset: float, passes: int) -> np.ndarray:
    """Return the drift [n] of drift = gain load + offset, in plain words."""
    measured = run.measured[:, 0]
    before = 0.0
    for _ in range(passes):
        before = gain * (measured[0] - before) + offset
    drift = []
    for value in measured:
        before = gain * (value - before) + offset
        drift.append(before)
    return np.array(drift)


@pytest.mark.parametrize("gain", [0.05, -0.3, 0.7])
def test_rounds_end_in_the_loop_of_the_chip(gain: float) -> None:
    run = draw_run("run", 3, 500)

    def predict(run: Run) -> np.ndarray:
        return gain * run.reference[:, :1] + 3.0

    found = predict_fed_back(predict, replace(run, reference=run.reference + 7.0))
    wanted = step_by_step(run, gain, 3.0, passes=200)
    np.testing.assert_allclose(found[:, 0], wanted, atol=1e-6 * np.abs(wanted).max())


def test_loop_that_does_not_settle_is_refused() -> None:
    run = draw_run("run", 3, 2000)
    with pytest.raises(CheckError, match=r"run 'run': effects of the load feed on themselves"):
        predict_fed_back(lambda r: -1.1 * r.reference, run)


def make_model() -> tuple[IntegerModel, tuple[Run, ...]]:
    """Return a model with creep, and its runs, which begin under load and far from T0."""
    runs = tuple(
        replace(run, reference=run.reference + np.array([300.0, 2.0])) for run in draw_runs()
    )
    compensator, drifting = make_compensator(make_physics(EFFECTS, runs), runs)
    described = describe_compensator(compensator, make_config(), drifting)
    return compose_integer_model(described, make_config(), make_dataset(drifting)), drifting


def test_start_is_at_rest_with_the_load_that_remains() -> None:
    """A sensor that lay for hours under a load goes on as it was: nothing moves."""
    model, runs = make_model()
    codes = np.repeat(encode_inputs(model, runs[0])[:1], 400, axis=0)
    drift = Reference(model).run(codes[None]).drift[0]
    assert np.abs(drift - drift[-1]).max() <= 2
    full_scale = np.array([2000.0, 14.0])
    counts = np.array([output.lsb_per_unit for output in model.outputs])
    assert (np.abs(drift[-1] / counts) > 1e-4 * full_scale).all(), "and it is not nothing"


def test_first_drift_is_that_of_the_float_loop() -> None:
    runs = draw_runs()
    compensator, drifting = make_compensator(make_physics(EFFECTS, runs), runs)
    described = describe_compensator(compensator, make_config(), drifting)
    model = compose_integer_model(described, make_config(), make_dataset(drifting))
    counts = np.array([output.lsb_per_unit for output in model.outputs])
    error = predict_integer(model, drifting[0]) - described.predict_on_chip(drifting[0])
    assert (np.abs(error[0]) * counts <= 2.0).all()


def test_drift_that_was_overwritten_is_noticed(tmp_path: Path) -> None:
    """The remembered drift is state: outside of what the model can give, it was damaged."""
    model, runs = make_model()
    host = HostModel(model, generate(model), tmp_path, flags=("-O1",))
    codes = encode_inputs(model, runs[0])[:20]
    host.run(codes[:10])
    layout = np.frombuffer(host._state, dtype=np.int32)
    place = int(np.flatnonzero(layout == host.run(codes[10:11], restart=False).drift[0, 0])[0])
    layout = np.frombuffer(host._state, dtype=np.int32)
    layout[place] = model.drift.high[0] + 1
    flags = host.run(codes[11:12], restart=False).flags
    assert flags[0] == FLAG_DAMAGED


def test_code_at_the_rails_leaves_the_load_at_its_limits() -> None:
    model, _ = make_model()
    codes = np.zeros((1, 300, len(model.channels)), dtype=np.int32)
    codes[:, :, 0] = 3000
    codes[:, 100:, 1:] = np.where(np.arange(200)[:, None] % 2, 2**31 - 1, -(2**31))
    trace = Reference(model).run(codes)
    low, high = np.array(model.drift.low), np.array(model.drift.high)
    assert (trace.drift >= low).all() and (trace.drift <= high).all()
