"""What a variable step computes: the exact answer to straight lines, whatever the times."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.golden.model_factory import Shape, draw_float_model
from tests.variable_step.models import make_lowpass, make_model
from zerodrift.base.errors import CheckError
from zerodrift.export.integer_model import FLAG_RATE_RANGE, IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.lowpass import lowpass
from zerodrift.verify.vectors import draw_sequences

LSB_K = 2.0**-7


def run(model: IntegerModel, codes: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the outputs [T, K] in their unit."""
    scale = np.array([output.lsb_per_unit for output in model.outputs])
    return Reference(model).run(codes[None]).drift[0] / scale


def follow(
    x: NDArray[np.float64], times_s: NDArray[np.float64], tau_s: float
) -> NDArray[np.float64]:
    """Return tau dy/dt + y = x for straight lines between the samples, in double precision."""
    y = np.empty_like(x)
    y[0] = x[0]
    for n in range(1, len(x)):
        r = times_s[n] / tau_s
        a = -np.expm1(-r)
        c = 1 - a / r if r > 1e-4 else r / 2 - r * r / 6
        y[n] = y[n - 1] + a * (x[n - 1] - y[n - 1]) + c * (x[n] - x[n - 1])
    return y


def read_nodes(model: IntegerModel, codes: NDArray[np.int64]) -> dict[str, NDArray[np.int64]]:
    """Return every node's values [T] of a run from rest."""
    rows: list[dict[str, NDArray[np.int64]]] = []
    Reference(model).run(codes[None], observe=lambda _, values: rows.append(dict(values)))
    return {n.name: np.array([row[n.name][0] for row in rows]) for n in model.nodes[:-1]}


@pytest.mark.parametrize("tau_s", [0.5, 60.0, 36_000.0])
def test_low_pass_is_exact_for_straight_lines_at_any_times(tau_s: float) -> None:
    rng = np.random.default_rng(5)
    model = make_lowpass((tau_s,))
    codes = rng.integers(-8000, 8000, 400).astype(np.int64)
    times_us = np.round(10 ** rng.uniform(-5.5, 3, 400) * tau_s * 1e6).astype(np.int64)
    times_us = np.maximum(times_us, 1)
    times_us[0] = 0
    found = read_nodes(model, np.stack([codes, times_us], axis=1))["lowpass_1"] / 2.0**12
    expected = follow(codes.astype(np.float64), times_us / 1e6, tau_s)
    assert np.abs(found - expected).max() < 0.01  # of a code of 2^-7 K, over steps of up to 16000


def test_equal_steps_are_those_of_a_fixed_period() -> None:
    rng = np.random.default_rng(6)
    x = np.cumsum(rng.normal(0, 30, 3000)).round()
    times = np.full(3000, 1_000_000)
    codes = np.stack([x.astype(np.int64), times], axis=1)
    found = read_nodes(make_lowpass((95.0,)), codes)["lowpass_1"] / 2.0**12
    assert np.abs(found - lowpass(x, 1.0, 95.0)).max() < 0.01


@pytest.mark.spread(2, "ratio", [1e-6, 1e-4, 1e-2, 1.0, 30.0, 1e3])
def test_step_response_is_within_a_thousandth_of_the_step(ratio: float) -> None:
    """A step of 15,000 codes on the way from one sample to the next, then the approach."""
    tau_s = 1000.0
    model = make_lowpass((tau_s,))
    count = min(max(int(3 / ratio), 5), 4000)
    codes = np.full((count, 2), 7500, dtype=np.int64)
    codes[0, 0] = -7500
    codes[:, 1] = round(ratio * tau_s * 1e6)
    found = read_nodes(model, codes)["lowpass_1"] / 2.0**12
    expected = follow(codes[:, 0].astype(float), codes[:, 1] / 1e6, tau_s)
    assert np.abs(found - expected).max() < 1e-3 * 15_000


def test_steps_too_short_are_collected() -> None:
    """4,000 steps of a ten millionth of the time constant each: as a few of 2^-20."""
    tau_s = 1000.0
    model = make_lowpass((tau_s,))
    short = np.full((4_000, 2), 7000, dtype=np.int64)
    short[:, 1] = 97  # 10^-7 of tau
    short[0] = (0, 0)
    found = read_nodes(model, short)["lowpass_1"] / 2.0**12
    expected = follow(short[:, 0].astype(float), short[:, 1] / 1e6, tau_s)
    assert found[1] == found[0]  # nothing yet
    assert np.abs(found - expected).max() < 7000 * 2.0**-20 + 0.26
    assert found[-1] > 2.4  # 3.9e-4 of 7000


def test_time_slept_is_added_to_the_next_step() -> None:
    model = make_model()
    codes = draw_sequences(model, 500)["walk"]
    reference = Reference(model)
    before = reference.run(codes[None, :40]).state
    longer = codes[40:60].copy()
    longer[0, -1] = 5_000_000
    at_once = reference.run(longer[None], state=before)
    longer[0, -1] = 1_000_000
    slept = reference.run(longer[None], state=reference.sleep(before, 4_000_000))
    assert (slept.drift == at_once.drift).all()
    assert (slept.flags == at_once.flags).all()
    assert (slept.state.pack() == at_once.state.pack()).all()


def test_first_step_counts_no_time() -> None:
    model = make_model()
    codes = draw_sequences(model, 500)["walk"][:20]
    traces = []
    for first in (0, 10**12):
        given = codes.copy()
        given[0, -1] = first
        traces.append(Reference(model).run(given[None], settled=False))
    assert (traces[0].drift == traces[1].drift).all()


def test_rate_flag_is_by_time() -> None:
    model = make_lowpass((10.0,))
    most = model.guards.rate_max
    codes = np.array([[0, 0], [most + 1, 10**6], [0, 2 * 10**6], [0, 10**6]], dtype=np.int64)
    flags = Reference(model).run(codes[None]).flags[0] & FLAG_RATE_RANGE
    assert (flags > 0).tolist() == [False, True, False, False]


def test_elapsed_time_stops_at_its_limit() -> None:
    model = make_model()
    node = next(n for n in model.nodes if n.kind == "elapsed")
    codes = draw_sequences(model, 500)["constant"][:6].copy()
    codes[:, -1] = 2**60
    found = read_nodes(model, codes)["elapsed"]
    assert found.max() == node.limit  # type: ignore[attr-defined]


def test_delay_is_refused_with_the_reason() -> None:
    ops = GraphOperations(1.0)
    shape = Shape(inputs=1, hidden=0, outputs=1, front_end=(), warm_up_steps=0)
    floating, calibration = draw_float_model(shape, 1)
    late = replace(
        floating,
        sample_period_s=1.0,
        features=(ops.delay(ops.input("source0"), 3.0),),
        coefficients=np.ones((1, 1)),
        variable_step=True,
    )
    with pytest.raises(CheckError, match="a line of samples at equal times"):
        quantize(late, calibration)


@pytest.mark.parametrize("window", [0, 4])
def test_recurrent_layer_is_refused_with_the_reason(window: int) -> None:
    shape = Shape(inputs=2, outputs=1, warm_up_steps=0, window=window)
    floating, calibration = draw_float_model(shape, 1)
    with pytest.raises(CheckError, match="steps of one length"):
        quantize(replace(floating, variable_step=True), calibration)
