"""Nothing that a model computes ever leaves what its certificate proves, rails included."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fixed_point.accumulators import drop_missing, prove_values, recompute, record_sequences
from tests.fixed_point.strategies import shapes
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.base.errors import CheckError
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.intervals import Interval
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.product import IntegerProduct
from zerodrift.operations.recurrent import H_LIMIT_Q30


@pytest.mark.long
@settings(
    max_examples=30,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(shape=shapes(most_hidden=12, most_outputs=4), seed=st.integers(0, 2**31))
def test_nothing_leaves_its_proven_interval(shape: Shape, seed: int) -> None:
    model = draw_model(shape, seed)
    bounds = {bound.where: bound.interval for bound in model.prove()}
    intervals = prove_values(model)
    seen = drop_missing(record_sequences(model, steps=300))
    for node in model.nodes:
        columns = seen.values[node.name].reshape(len(seen.values[node.name]), -1)
        for column, interval in zip(columns.T, intervals[node.name], strict=True):
            assert interval.low <= column.min() and column.max() <= interval.high, node.name
    watched = set()
    for where, accumulator in recompute(model, seen):
        bound = bounds[where]
        assert bound.low <= accumulator.min() and accumulator.max() <= bound.high, where
        watched.add(where)
    assert {where for where in bounds if not where.endswith((".steps", ".window"))} <= watched


def test_feature_bounds_are_reached() -> None:
    """A bound that is never near would be no proof of anything but caution."""
    model = draw_model(Shape(inputs=4, hidden=3), 3)
    features = next(n for n in model.nodes if isinstance(n, IntegerFeatures))
    bounds = {bound.where: bound.interval for bound in model.prove()}
    for i in range(features.width):
        toward_high = features.matrix[i].astype(np.int64) > 0
        codes = np.where(toward_high, 32767, -32768)[None] << 12
        reached = int((codes @ features.matrix[i].astype(np.int64))[0] + features.bias[i])
        assert reached <= bounds[f"features[{i}]"].high
        assert reached > 0.9 * bounds[f"features[{i}]"].high


@pytest.mark.parametrize("reset", ["after", "before"])
def test_state_reaches_its_limit_and_stays_there(reset: str) -> None:
    model = draw_model(Shape(reset=reset, hidden=6, gain=60.0), 4)
    layer = model.recurrent
    assert layer is not None
    largest = 0
    h_q30 = np.zeros((64, 6), dtype=np.int64)
    draw = Draw(9)
    for _ in range(400):
        x = np.where(draw.uniform(0.0, 1.0, 64, 4) < 0.5, -32768, 32767)
        h_q30 = layer.gru.step(x, h_q30)
        largest = max(largest, int(np.abs(h_q30).max()))
    assert H_LIMIT_Q30 - 2 <= largest <= H_LIMIT_Q30


def test_every_state_within_the_invariant_stays_within() -> None:
    """The induction step itself, from states that no run would visit."""
    rng = np.random.default_rng(5)
    for weights in ("int16", "int8"):
        layer = draw_model(Shape(weights=weights, hidden=8, gain=60.0), 6).recurrent
        assert layer is not None
        h_q30 = rng.choice([-H_LIMIT_Q30, -H_LIMIT_Q30 + 1, -1, 0, 1, H_LIMIT_Q30], size=(5000, 8))
        x = rng.choice([-32768, 0, 32767], size=(5000, 4))
        assert np.abs(layer.gru.step(x, h_q30)).max() <= H_LIMIT_Q30


def test_damaged_lowpass_within_its_invariant_stays_within() -> None:
    """Any v that the soundness check admits keeps v and y where the certificate says."""
    model = draw_model(Shape(inputs=1, hidden=0, outputs=1, front_end=("lowpass",)), 2)
    node = next(n for n in model.nodes if isinstance(n, IntegerLowpass))
    bounds = {bound.where: bound.interval for bound in model.prove()}
    allowed, out = bounds[f"{node.name}.v"], bounds[node.name]
    for v in (allowed.low, allowed.high, 0):
        for x in (-32768 << 12, 32767 << 12):
            state, y = node.step({"v": np.array([v])}, {node.inputs[0]: np.array([x])})
            assert out.low <= y[0] <= out.high
            assert allowed.low <= state["v"][0] <= allowed.high


@pytest.mark.parametrize(
    "fields", [{"c_q24": -1}, {"c_q24": 2**24 + 1}, {"m_q31": 0}, {"m_q31": -5}, {"shift": 8}]
)
def test_lowpass_that_is_none_is_refused(fields: dict[str, int]) -> None:
    node = IntegerLowpass("f", ("x",), c_q24=1000, m_q31=2**30 + 2**29, shift=9)
    node.prove([[Interval(-1000, 1000)]])
    with pytest.raises(CheckError, match=r"f: c = .*refused"):
        replace(node, **fields).prove([[Interval(-1000, 1000)]])


@pytest.mark.parametrize("shift", [-1, 32])
def test_shift_that_c_leaves_undefined_is_refused(shift: int) -> None:
    layer = draw_model(Shape(hidden=2), 9).recurrent
    assert layer is not None
    bad = replace(layer.gru, shift=(layer.gru.shift[0], shift, layer.gru.shift[2]))
    with pytest.raises(CheckError, match=rf"gru\.u: a shift by {shift} bits"):
        bad.prove("gru", [Interval(-1, 1)] * 4)
    with pytest.raises(CheckError, match="p: a shift by 63 bits"):
        IntegerProduct("p", ("a", "b"), shift=63).prove([[Interval(0, 1)], [Interval(0, 1)]])


def test_delay_longer_than_its_ring_is_refused() -> None:
    IntegerDelay("d", ("x",), steps=32767).prove([[Interval(0, 1)]])
    with pytest.raises(CheckError, match=r"d\.steps"):
        IntegerDelay("d", ("x",), steps=70_000).prove([[Interval(0, 1)]])


@pytest.mark.parametrize("weights", ["int16", "int8"])
@pytest.mark.parametrize("reset", ["after", "before"])
def test_weights_scaled_beyond_the_proof_are_refused(weights: str, reset: str) -> None:
    """The certificate looks at the integers: doubling a row that fits must be noticed."""
    layer = draw_model(Shape(weights=weights, reset=reset, hidden=64, inputs=8), 8).recurrent
    assert layer is not None
    loud = replace(layer.gru, w_x=np.full_like(layer.gru.w_x, 32767))
    with pytest.raises(CheckError, match=r"does not fit 32 bits"):
        loud.prove("gru", [Interval(-32768, 32767)] * 8)
