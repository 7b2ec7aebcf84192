"""The conversion of raw codes stands in the error bound, and the check derives it by itself."""

import copy
import hashlib
import json
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from tests.certificate.test_check import list_texts
from tests.effects_on_chip.random_graphs import describe_graph, draw_codes
from tests.operations import test_conversion as one_code
from tests.operations import test_thermocouple as couples
from zerodrift.base.column_config import ConversionConfig, DividerConfig
from zerodrift.codegen.generate import generate
from zerodrift.dataset.chip_codes import RawRange, cover_range, find_range
from zerodrift.dataset.conversions import convert
from zerodrift.export.channels import design_conversion
from zerodrift.export.error_bound import ErrorBound, bound_errors
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize_graph
from zerodrift.export.reference import Reference
from zerodrift.operations.backend import GraphOperations
from zerodrift.verify.certificate import certify, describe_conversions
from zerodrift_proof.bound.conversion import ConversionCheck
from zerodrift_proof.certificate.check import compare
from zerodrift_proof.certificate.model import read_models
from zerodrift_proof.certificate.values import Block

Told = dict[str, Any]
GAIN = 0.31
COUNTS = 10**6
"""Of an output's unit, so that its own rounding is next to nothing."""
SINGLE = [f"code: {kind}" for kind in one_code.KINDS]
SUMS = [*(f"couple: {couple}" for couple in couples.SPANS), "couple with a thermistor: K"]


def make_channels(case: str) -> tuple[Channel, Channel]:
    """Return a converted thermometer, and a second input."""
    what, _, name = case.partition(": ")
    if what == "code":
        by = one_code.make_conversion(name)
        return Channel(
            "x0", "degC", one_code.LSB, no_reading=one_code.NONE, conversion=by
        ), Channel("x1", "V", 2.0**-8)
    model = couples.make_model(name, converted="thermistor" in what)
    return model.channels[0], model.channels[1]


def make_case(case: str) -> tuple[IntegerModel, ErrorBound]:
    """Return a model whose answer is the thermometer times a gain, and what is proven of it."""
    ops = GraphOperations(0.5)
    x = ops.input("x0")
    answer = ops.affine(x, GAIN, 0.0)
    floating, calibration = describe_graph([answer], draw_codes(3))
    first, second = make_channels(case)
    assert first.conversion is not None
    limits = (first.conversion.lowest, first.conversion.highest)
    ends = sorted(GAIN * end * first.lsb for end in limits)
    span = (limits[0] * first.lsb, limits[1] * first.lsb)
    output = replace(floating.outputs[0], lsb_per_unit=COUNTS)
    assert isinstance(output, OutputFormat)
    quantized = quantize_graph(
        replace(floating, channels=(first, second), outputs=(output,)),
        replace(
            calibration,
            code_limits=(limits, (-(2**15), 2**15 - 1)),
            drift_low=np.array([ends[0] - 1.0]),
            drift_high=np.array([ends[1] + 1.0]),
            temperature_range=limits,
            ranges={x: span, answer: (ends[0], ends[1])},
        ),
    )
    return quantized.model, bound_errors(quantized)


def certify_case(case: str) -> tuple[Told, dict[str, str]]:
    model, bound = make_case(case)
    assert bound.outputs, bound.why
    code = generate(model)
    return json.loads(certify(model, code, bound)), list_texts(code)


@pytest.mark.spread(1, "case", [*SINGLE, *SUMS])
def test_the_bound_with_its_conversion_is_confirmed_and_a_smaller_one_refused(case: str) -> None:
    told, texts = certify_case(case)
    outcome = compare(told, texts)
    assert outcome.understood and not outcome.failures, outcome.failures
    (claim,) = told["error_bound"]
    assert claim["causes"]["conversion"] > 0.9 * claim["bound"]
    claim["bound"] *= 0.96
    assert any("an error of at most" in text for text in compare(told, texts).failures)


@pytest.mark.spread(2, "case", [*SINGLE, *SUMS])
def test_no_code_is_further_off_than_the_bound(case: str) -> None:
    model, bound = make_case(case)
    by = model.channels[0].conversion
    assert by is not None
    rng = np.random.default_rng(8)
    codes = np.stack(
        [rng.integers(c.raw_least, c.raw_most, 40_000, endpoint=True) for c in model.channels],
        axis=1,
    )
    if by.junction is None:
        codes[:, 0] = rng.integers(by.low, by.high, 40_000, endpoint=True)
        exact = convert(codes[:, 0].astype(np.float64), by.formula)
    else:
        of = model.channels[1]
        cold = codes[:, 1].astype(np.float64)
        if of.conversion is not None:
            cold = convert(cold, of.conversion.formula) / of.lsb
        held = np.clip(cold, by.junction.low, by.junction.high)
        exact = convert(codes[:, 0].astype(np.float64), by.formula, held * of.lsb)
    own = model.convert(codes)
    read = (own[:, 0] != by.none) & np.isfinite(exact)
    lsb = model.channels[0].lsb  # beyond the table both models are limited
    read &= (exact > (by.lowest + 2) * lsb) & (exact < (by.highest - 2) * lsb)
    if by.junction is not None:
        read &= own[:, 1] != by.junction.lacks
    assert read.sum() > 1_000
    chip = Reference(model).run(codes[read][None]).drift[0, :, 0] / COUNTS
    off = np.abs(chip - GAIN * exact[read]).max()
    total = float(bound.outputs[0].total)
    assert off <= total
    assert off > 0.5 * total  # and the bound is no empty one


def change(texts: dict[str, str], told: Told, old: str, new: str) -> tuple[Told, dict[str, str]]:
    name = next(name for name in texts if name.endswith(".c") and not name.startswith("zd_"))
    assert texts[name].count(old) >= 1, old
    changed = texts[name].replace(old, new, 1)
    claims = copy.deepcopy(told)
    claims["files"][name] = hashlib.sha256(changed.encode()).hexdigest()
    return claims, {**texts, name: changed}


@pytest.mark.spread(0, "case", ["code: ntc", "code: ntc of 24 bits", "couple: K"])
def test_a_table_that_is_a_little_off_is_found(case: str) -> None:
    """A node by a count and a half, which the checksum of the tables would tell too."""
    model, _ = make_case(case)
    code = generate(model)
    (machine, *_) = read_models(list_texts(code), code.prefix)
    machine.run()
    told = describe_conversions(model)
    first, by = model.channels[0], model.channels[0].conversion
    assert by is not None

    def derive() -> float:
        words = machine.program.tokens.words
        check = ConversionCheck(told, words, machine.prefix, machine.constants)
        return float(check.bound("x0", Fraction(first.lsb), Fraction(first.offset)))

    assert derive() <= by.error
    nodes = machine.constants["conversion_0_nodes"]
    assert isinstance(nodes, Block)
    for k in (3, len(by.nodes) // 3, len(by.nodes) // 2):
        was = nodes.cells[k]
        assert isinstance(was, int)
        nodes.cells[k] = was + (3 << (by.shift - by.block_bits - 1))
        assert derive() > by.error
        nodes.cells[k] = was


@pytest.mark.spread(
    1,
    ("old", "new"),
    [
        ("(conversion_0_at >> 11)", "(conversion_0_at >> 10)"),
        ("(conversion_0_place & 2047u)", "(conversion_0_place & 1023u)"),
        ("zd_clamp32(in->x0,", "zd_clamp32(in->x0 + 1,"),
        ("conversion_0_line + 1]", "conversion_0_line]"),
        (" : conversion_0)", " : conversion_0 + 1)"),
    ],
)
def test_another_way_to_look_up_is_not_believed(old: str, new: str) -> None:
    told, texts = certify_case("code: ntc")
    if "2047" in old or "11" in old:
        model, _ = make_case("code: ntc")
        by = model.channels[0].conversion
        assert by is not None
        bits, mask = by.block_bits, by.mask
        old = old.replace("11)", f"{bits})").replace("2047", f"{mask}")
        new = new.replace("10)", f"{bits - 1})").replace("1023", f"{mask >> 1}")
    claims, changed = change(texts, told, old, new)
    outcome = compare(claims, changed)
    assert outcome.failures or not outcome.understood


@pytest.mark.spread(
    1,
    ("case", "edit"),
    [
        ("code: ntc", {"beta_K": 3951.0}),
        ("code: ntc", {"r25_ohm": 10_010.0}),
        ("code: ntc", {"divider": {"series_ohm": 10_010.0, "counts": 65536.0, "side": "low"}}),
        ("code: pt100", {"scale": 0.01221}),
        ("code: polynomial", {"coefficients": [1.01, 0.003, 1e-8]}),
        ("code: table", {"points": [[100, 0], [1000, 20.02], [2000, 30], [4000, 100]]}),
        ("couple: K", {"junction": {"input": "x1", "scale": 2.0**-8, "offset": 0.1}}),
        ("couple: K", {"raw_scale": 2.6e-6}),
        ("couple: K", {"junction": None}),
    ],
)
def test_another_formula_is_not_what_the_table_stands_for(case: str, edit: Told) -> None:
    told, texts = certify_case(case)
    told["conversions"][0] |= edit
    outcome = compare(told, texts)
    assert outcome.failures or not outcome.understood
    del told["conversions"]
    outcome = compare(told, texts)
    assert outcome.failures or not outcome.understood


def test_a_coarse_converter_is_proven_code_by_code() -> None:
    divider = DividerConfig(1e4, True, 256.0, 1.0)
    by = ConversionConfig(kind="ntc", r25_ohm=1e4, beta_K=3950.0, divider=divider)
    found = find_range(by, "uint16", (0.0, 60.0))
    assert isinstance(found, RawRange)
    cover = cover_range(by, found, "uint16", (0.0, 60.0), None)
    made = design_conversion(0, cover, by, 2.0**-7, 0.0, -(2**15))
    codes = np.arange(made.low, made.high + 1)
    off = np.abs(made.convert(codes) * 2.0**-7 - convert(codes.astype(np.float64), by)).max()
    assert off <= made.error <= 2.0**-7
