"""Layer normalisation: hand-worked vectors, its error, what is proven of it, what is refused."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from benchmarks.bench_layer_norm import EPSILONS, MARK_PCT, VECTORS, WIDTHS, measure_width
from tests.certificate.test_check import list_texts
from tests.fixed_point.accumulators import recompute, record_sequences
from tests.golden.model_factory import Shape, draw_model
from tests.prove.models import prove

from zerodrift.base.errors import CheckError, NoRuleError
from zerodrift.codegen.generate import generate
from zerodrift.export.quantize_layers import quantize_layer_norm
from zerodrift.operations.errors import Known
from zerodrift.operations.intervals import Interval
from zerodrift.operations.layer_norm import (
    LARGEST_ROOT_Q29,
    MOST_WIDTH,
    PART_BITS,
    ROOT_SPARE,
    FloatLayerNorm,
    IntegerLayerNorm,
    invert_root,
    list_constants,
)
from zerodrift.operations.signals import Real
from zerodrift_proof.equality.build import OPEN

SHAPE = Shape(inputs=3, layered=(("gru", 5, (0,)), ("norm", 5, (1,))), code_limit=12000)
CODES = Interval(-32768 << 15, 32767 << 15)


def make(width: int, epsilon: float = 1e-5, gain: float = 1.0) -> IntegerLayerNorm:
    layer = FloatLayerNorm(np.full(width, gain), np.zeros(width), epsilon)
    return quantize_layer_norm(layer, "norm", "h", np.full(width, 15))[0]


def run(node: IntegerLayerNorm, copies: list[list[int]]) -> np.ndarray:
    return node.step({}, {"h": np.array(copies, dtype=np.int64) << 15})[1]


def test_a_vector_worked_out_by_hand() -> None:
    """x = 3000, 1000, -1000, -3000 of 2^-15: their mean is 0, that of their squares 5 10^6."""
    node = make(4, epsilon=2.0**-60)
    assert list_constants(4) == (2**27, 29, 2**27)
    assert node.align == (0, 0, 0, 0) and node.epsilon == 1
    found = run(node, [[3000, 1000, -1000, -3000]])[0]
    wanted = [x / math.sqrt(5_000_000) for x in (3000, 1000, -1000, -3000)]
    scale = 2.0 ** (26 + round(math.log2(node.gain[0])) - node.shift[0])
    np.testing.assert_allclose(found / scale, wanted, rtol=2.0**-26)


def test_equal_numbers_give_the_bias() -> None:
    layer = FloatLayerNorm(np.ones(5), np.array([-0.5, -0.25, 0.0, 0.25, 0.5]), 1e-5)
    node, own = quantize_layer_norm(layer, "norm", "h", np.full(5, 15))
    for code in (-32768, -1, 0, 1, 32767):
        found = run(node, [[code] * 5])[0] * 2.0 ** -(own + 15)
        np.testing.assert_allclose(found, layer.bias, atol=1e-4)  # the mean is rounded to 2^-27


def test_the_inverse_root_is_as_near_as_is_specified() -> None:
    rng = np.random.default_rng(1)
    steps = np.arange(2**28, 2**30, 9973, dtype=np.int64)
    a = np.concatenate([steps, rng.integers(2**28, 2**30, 200_000), [2**28, 2**30 - 1]])
    r = invert_root(a)
    assert r.max() <= LARGEST_ROOT_Q29
    relative = r / 2.0**29 * np.sqrt(a / 2.0**30) - 1.0
    assert np.abs(relative).max() <= 2.0**-28
    for one in (2**28, 2**28 + 1, 2**29, 2**30 - 1):  # in exact arithmetic
        square = Fraction(int(invert_root(np.array([one]))[0]), 2**29) ** 2 * Fraction(one, 2**30)
        assert (1 - Fraction(1, 2**28)) ** 2 <= square <= (1 + Fraction(1, 2**28)) ** 2


@pytest.mark.parametrize("width", WIDTHS)
def test_integers_are_within_the_mark_of_float(width: int) -> None:
    for of_all, _ in measure_width(width, 3000):
        assert of_all <= MARK_PCT / 50


@pytest.mark.slow
@pytest.mark.parametrize("width", WIDTHS)
def test_integers_are_within_the_mark_of_float_over_many_vectors(width: int) -> None:
    found = measure_width(width, VECTORS)
    assert len(found) == len(EPSILONS)
    assert max(of_all for of_all, _ in found) <= MARK_PCT
    assert max(worst for _, worst in found) <= MARK_PCT


@pytest.mark.parametrize("width", [1, 2, 3, 7, 64, 127, 128])
@pytest.mark.parametrize("epsilon", [1e-12, 1e-5, 1.0])
def test_no_number_exceeds_what_is_proven(width: int, epsilon: float) -> None:
    """One number apart from all others is the furthest that a normalised one can be."""
    node, rng = make(width, epsilon), np.random.default_rng(width)
    (out, bounds) = node.prove([[CODES] * width])
    alone = np.full((2, width), -32768)
    alone[0, 0], alone[1, 0] = 32767, -32767
    rails = rng.choice([-32768, 32767], (200, width))
    near = rng.integers(-3, 4, (200, width)) + rng.integers(-32000, 32000, (200, 1))
    found = run(node, [*alone.tolist(), *rails.tolist(), *near.tolist()])
    for column, interval in zip(found.T, out, strict=True):
        assert interval.low <= column.min() and column.max() <= interval.high
    part = list_constants(width)[2] + ROOT_SPARE
    assert found.max() <= (part * int(node.gain[0]) >> node.shift[0]) + 1
    assert math.sqrt(width) * 2.0**PART_BITS <= part
    assert {"norm.sum", "norm.squares", "norm.part", "norm[0].copy"} <= {b.where for b in bounds}


def test_every_accumulator_stays_within_its_bound() -> None:
    model = draw_model(replace(SHAPE, gain=6.0), 8)
    bounds = {b.where: b.interval for b in model.prove() if b.where.startswith("layer_norm")}
    watched = set()
    for where, accumulator in recompute(model, record_sequences(model, steps=300)):
        if where.startswith("layer_norm"):
            bound = bounds[where]
            assert bound.low <= accumulator.min() and accumulator.max() <= bound.high, where
            watched.add(where)
    assert watched == set(bounds)


def test_a_layer_of_other_scales_and_one_that_is_far_from_0() -> None:
    layer = FloatLayerNorm(np.array([0.0, 1e-6, 3.0, 900.0]), np.array([0.0, 5.0, -2.0, 0.1]), 1e-3)
    exponents = np.array([15, 3, 9, 12])
    node, own = quantize_layer_norm(layer, "norm", "h", exponents)
    assert node.align == (12, 0, 6, 9)
    node.prove([[CODES] * 4])
    x = np.random.default_rng(2).integers(-20000, 20000, (300, 4))
    found = node.step({}, {"h": x << 15})[1] * 2.0 ** -(own + 15)
    wanted = layer.step(x * 2.0**-exponents)
    np.testing.assert_allclose(found, wanted, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize(
    ("width", "epsilon", "gain", "told"),
    [
        (4, 0.0, 1.0, "expected one above 0"),
        (4, math.inf, 1.0, "expected one above 0"),
        (4, math.nan, 1.0, "expected one above 0"),
        (MOST_WIDTH + 1, 1e-5, 1.0, "normalises 129 values; up to 128"),
        (4, 1e-5, math.nan, "not finite"),
        (4, 1e40, 1.0, "far above their squares"),
    ],
)
def test_what_has_no_format_is_refused(width: int, epsilon: float, gain: float, told: str) -> None:
    with pytest.raises(CheckError, match=told):
        make(width, epsilon, gain)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"align": ()}, "has 0 numbers"),
        ({"shift": (1, 2)}, "different lengths"),
        ({"gain": np.ones((4, 1), dtype=np.int32)}, "rows of 4 numbers"),
        ({"epsilon": 0}, "epsilon is 0"),
        ({"epsilon": 2**60 + 1}, "epsilon is"),
    ],
)
def test_fields_of_a_model_file_that_do_not_fit_are_refused(fields: dict, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        replace(make(4), **fields).check_form()


def test_what_could_overflow_is_refused() -> None:
    with pytest.raises(CheckError, match="normalises 4 values, and gets 3"):
        make(4).prove([[CODES] * 3])
    with pytest.raises(CheckError, match="a shift by 63"):
        replace(make(4), align=(63, 0, 0, 0)).prove([[CODES] * 4])
    with pytest.raises(CheckError, match=r"norm\[0\]\.copy"):
        replace(make(4), bias=np.full(4, 2**30, dtype=np.int32)).prove([[CODES] * 4])


def test_it_says_why_it_has_no_bound_on_its_error() -> None:
    known = Known(0, 1, Fraction(1), Fraction(0))
    with pytest.raises(NoRuleError, match="1 / sqrt"):
        make(4).bound_error(Real("norm", (), (), ("norm", 0)), known, [])


CHANGES = {
    "a gain": ("layer_norm_gain[5] = {\n    ", "layer_norm_gain[5] = {\n    1"),
    "epsilon": ("layer_norm_bias, INT64_C(", "layer_norm_bias, INT64_C(1"),
    "what it reads": ("&layer_norm_p, gru_q15, result", "&layer_norm_p, features, result"),
}


@pytest.mark.spread(1, "what", CHANGES)
def test_the_proof_finds_other_numbers_than_the_model_s(what: str) -> None:
    model = draw_model(SHAPE, 3)
    texts = list_texts(generate(model))
    before, after = CHANGES[what]
    assert texts["golden.c"].count(before) == 1
    changed = {**texts, "golden.c": texts["golden.c"].replace(before, after)}
    assert any(one.verdict == OPEN for one in prove(model, changed))


def test_the_runtime_s_header_is_read_by_models_that_normalise_alone() -> None:
    for shape, wanted in ((SHAPE, True), (replace(SHAPE, layered=SHAPE.layered[:1]), False)):
        assert ("zd_layer_norm.h" in generate(draw_model(shape, 3)).source) == wanted
