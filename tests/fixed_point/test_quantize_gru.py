"""The formats chosen for a GRU: provably safe or refused, and close to the float cell."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.golden.model_factory import Draw

from zerodrift.base.errors import CheckError
from zerodrift.export.quantize_layers import quantize_gru, quantize_head
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.intervals import Interval

FEATURE_EXPONENTS = np.array([13, 14])
SIZES = st.sampled_from((0.0, 1e-30, 1e-6, 0.01, 1.0, 10.0, 200.0, 5000.0, 1e6, 1e12, 1e300))


def make_gru(w_x: float, w_h: float, bias: float, reset: str, seed: int) -> FloatGru:
    """Return a GRU(3) of two features whose weights are uniform up to the given sizes."""
    draw = Draw(seed)
    return FloatGru(
        w_x=draw.uniform(-1.0, 1.0, 3, 3, 2) * w_x,
        w_h=draw.uniform(-1.0, 1.0, 3, 3, 3) * w_h,
        bias=draw.uniform(-1.0, 1.0, 4, 3) * bias,
        reset=reset,
    )


@settings(max_examples=200, deadline=None)
@given(
    w_x=SIZES,
    w_h=SIZES,
    bias=SIZES,
    reset=st.sampled_from(("after", "before")),
    weights=st.sampled_from(("int16", "int8")),
    seed=st.integers(0, 1000),
)
def test_any_weights_are_proven_or_refused(
    w_x: float, w_h: float, bias: float, reset: str, weights: str, seed: int
) -> None:
    gru = make_gru(w_x, w_h, bias, reset, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            integer = quantize_gru(gru, FEATURE_EXPONENTS, weights)
        except CheckError as error:
            assert "refused" in str(error)
            return
    integer.prove("gru", [Interval(-32768, 32767)] * 2)
    assert max(integer.shift) <= 31 and min(integer.shift) >= 0
    assert max(integer.multiplier_shift) <= 31 and min(integer.multiplier_shift) >= 0


@pytest.mark.parametrize(("weights", "limit"), [("int16", 3e-4), ("int8", 2e-2)])
@pytest.mark.parametrize("reset", ["after", "before"])
def test_one_step_is_close_to_the_float_cell(weights: str, reset: str, limit: float) -> None:
    draw = Draw(7)
    for seed in range(20):
        gru = make_gru(2.0, 2.0, 1.0, reset, seed)
        integer = quantize_gru(gru, FEATURE_EXPONENTS, weights)
        x = draw.codes(-16000, 16000, 50, 2).astype(np.int64)
        h_q30 = np.round(draw.uniform(-0.99, 0.99, 50, 3) * 2**30).astype(np.int64)
        expected = gru.step(x * 2.0**-FEATURE_EXPONENTS, h_q30 / 2.0**30)
        assert np.abs(integer.step(x, h_q30) / 2.0**30 - expected).max() < limit


@pytest.mark.parametrize("weights", ["int16", "int8"])
def test_settled_state_is_a_point_of_rest(weights: str) -> None:
    integer = quantize_gru(make_gru(1.0, 0.5, 0.5, "after", 3), FEATURE_EXPONENTS, weights)
    x = Draw(8).codes(-8000, 8000, 20, 2).astype(np.int64)
    settled = integer.settle(x)
    later = settled
    for _ in range(200):
        later = integer.step(x, later)
    assert np.abs(later - settled).max() < 2**30 * 1e-4


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weight_that_is_no_number_is_refused(value: float) -> None:
    gru = make_gru(1.0, 1.0, 1.0, "after", 1)
    gru.w_h[2, 1, 0] = value
    with pytest.raises(CheckError, match=r"w_h\[2, 1, 0\] is not finite"):
        quantize_gru(gru, FEATURE_EXPONENTS, "int16")


@given(seed=st.integers(0, 1000), size=st.floats(1e-6, 1e6), count=st.integers(1, 64))
def test_head_sum_fits_32_bits(seed: int, size: float, count: int) -> None:
    weights = Draw(seed).uniform(-size, size, 2, count)
    rows, exponents = quantize_head(weights)
    for row, exponent, wanted in zip(rows.astype(np.int64), exponents, weights, strict=True):
        assert np.abs(row).sum() * 32768 <= 2**31 - 1
        assert np.abs(row * 2.0 ** (15.0 - exponent) - wanted).max() <= 0.5 * 2.0 ** (15 - exponent)
