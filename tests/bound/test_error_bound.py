"""No input takes the chip further from the float model than what is proven of it."""

import json
from fractions import Fraction

import mpmath
import numpy as np
import pytest

from tests.bound.cases import draw_case
from tests.golden.model_factory import Shape, draw_float_model
from zerodrift.codegen.generate import generate
from zerodrift.export.error_bound import bound_errors, round_up
from zerodrift.export.quantize import quantize_graph
from zerodrift.operations.exp2 import OCTAVE_Q29
from zerodrift.operations.intervals import (
    enclose_exp,
    enclose_exp2,
    enclose_log,
    enclose_power,
    shorten,
)
from zerodrift.operations.polynomial import (
    bound_exp2_octave,
    bound_power_octave,
    evaluate_polynomial,
    fit_octave,
)
from zerodrift.operations.tables import T_MAX, T_MIN, bound_tanh, tanh_q30
from zerodrift.verify.certificate import certify

SEED = 11


def _hold(numbers: range) -> int:
    held = 0
    for number in numbers:
        case = draw_case(SEED, number)
        bound = case.bound()
        if not bound.outputs:
            assert "load" in bound.why or "exponent" in bound.why, bound.why
            continue
        largest = [round_up(error.total) for error in bound.outputs]
        assert (case.measure().max(axis=(0, 1)) <= largest).all(), number
        held += len(largest)
    return held


@pytest.mark.long
def test_no_drawn_input_exceeds_the_bound() -> None:
    assert _hold(range(10)) > 15


@pytest.mark.slow
def test_no_drawn_input_of_many_models_exceeds_the_bound() -> None:
    assert _hold(range(12, 212)) > 300


def test_the_table_of_tanh_is_as_far_from_tanh_as_is_claimed_and_no_further() -> None:
    t = np.arange(T_MIN, T_MAX + 1)
    exact = np.tanh(t.astype(np.longdouble) * np.longdouble(2.0**-16)) * np.longdouble(2.0**30)
    worst = float(np.abs(tanh_q30(t) - exact).max())
    assert worst <= float(bound_tanh()) <= worst + 1e-3


@pytest.mark.long
def test_octaves_are_within_what_is_claimed() -> None:
    f = np.arange(0, 1 << 31, 4099, dtype=np.int64)
    x = f.astype(np.longdouble) * np.longdouble(2.0**-31)
    exact = np.exp2(x) * 2.0**29
    worst = float(np.abs(evaluate_polynomial(f, OCTAVE_Q29) - exact).max())
    assert 2.0 < worst <= bound_exp2_octave(OCTAVE_Q29, 29) < worst + 2.0
    for exponent in (0.3, 1.7, 2.5):
        octave = fit_octave(lambda v, p=exponent: float(v**p), 8, 26)  # type: ignore[misc]
        exact = (1.0 + x) ** np.longdouble(exponent) * 2.0**26
        worst = float(np.abs(evaluate_polynomial(f, octave) - exact).max())
        claimed = bound_power_octave(octave, Fraction(exponent), 26)
        assert 0.5 < worst <= claimed < worst + 4.0


@pytest.mark.parametrize("x", ["1/3", "-7/5", "-40", "55/2", "1/1000000", "3", "-1/7"])
def test_enclosures_hold_the_real_value(x: str) -> None:
    value = Fraction(x)
    with mpmath.workprec(400):
        real = mpmath.mpf(value.numerator) / value.denominator
        cases = [(enclose_exp(value), mpmath.exp(real)), (enclose_exp2(value), 2**real)]
        if value > 0:
            cases.append((enclose_log(value), mpmath.log(real)))
            cases.append((enclose_power(value, Fraction(37, 100)), real ** (mpmath.mpf(37) / 100)))
        for found, exact in cases:
            low, high = (mpmath.mpf(end.numerator) / end.denominator for end in found)
            assert low <= exact <= high
            assert high - low <= 1e-30 * max(1, abs(exact))


def test_shortened_numbers_are_never_smaller() -> None:
    rng = np.random.default_rng(3)
    for exponent in range(-200, 200, 7):
        x = Fraction(int(rng.integers(1, 2**62)), 3**90) * Fraction(2) ** exponent
        assert x <= shorten(x) <= x * (1 + Fraction(1, 2**60))


def test_of_a_recurrent_layer_that_may_not_forget_only_the_range_is_claimed() -> None:
    described, calibration = draw_float_model(Shape(), 1)
    quantized = quantize_graph(described, calibration)
    bound = bound_errors(quantized)
    assert all(error.range > 0.99 * error.total for error in bound.outputs)
    assert "recurrent" in bound.why
    told = json.loads(certify(quantized.model, generate(quantized.model), bound))
    assert "between -1 and 1" in told["holds"]
    assert [claim["causes"]["range"] > 0.0 for claim in told["error_bound"]] == [True] * 3


def test_the_certificate_names_the_float_model_and_every_cause() -> None:
    for number in range(SEED):
        case = draw_case(SEED, number)
        bound = case.bound()
        if bound.outputs and case.described.network is not None:
            break
    told = json.loads(certify(case.quantized.model, generate(case.quantized.model), bound))
    for claim, error in zip(told["error_bound"], bound.outputs, strict=True):
        assert Fraction(claim["bound"]) >= error.total
        assert told["float_model"][claim["signal"]]["node"] == "drift"
    assert all(max(line["of"], default=-1) < i for i, line in enumerate(told["float_model"]))
