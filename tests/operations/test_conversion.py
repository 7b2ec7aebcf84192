"""Raw codes become the quantity's: within the error, and the same bits wherever it is computed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.effects_on_chip.random_graphs import describe_graph, draw_codes
from tests.operations.everywhere import PERIOD_S, derive_again
from tests.oracle.machine import Oracle

from zerodrift.base.column_config import ConversionConfig, DividerConfig
from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.chip_codes import RawCover, RawRange, cover_range, find_code, find_range
from zerodrift.dataset.conversions import convert
from zerodrift.export.channels import design_conversion
from zerodrift.export.encoding import encode_channel, round_channel
from zerodrift.export.integer_model import (
    FLAG_NO_READING,
    FLAG_TEMPERATURE_RANGE,
    Channel,
    Guards,
    IntegerModel,
)
from zerodrift.export.model_files import load_model
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.conversion import IntegerConversion
from zerodrift.verify.chip_check import check_chip
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.host_check import check_host
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_golden, draw_sequences

LSB, NONE = 2.0**-7, -(2**15)
NTC = ConversionConfig(
    kind="ntc", r25_ohm=1e4, beta_K=3950.0, divider=DividerConfig(1e4, True, 65536.0, 64.0)
)
STEINHART = ConversionConfig(
    kind="ntc",
    steinhart=(1.129241e-3, 2.341077e-4, 8.775468e-8),
    divider=DividerConfig(1e4, False, 4096.0, 4.0),
)
KINDS = {
    "ntc": (NTC, "uint16", (-40.0, 150.0), None),
    "ntc of 24 bits": (
        replace(NTC, divider=DividerConfig(1e4, False, 2.0**24, 2.0**14)),
        "int32",
        (-40.0, 150.0),
        None,
    ),
    "steinhart of 12 bits": (STEINHART, "uint16", (-20.0, 90.0), 0),
    "pt100": (ConversionConfig(kind="pt100", scale=400 / 2**15), "uint16", (-200.0, 200.0), None),
    "pt1000": (ConversionConfig(kind="pt1000", scale=0.001), "int32", (-50.0, 150.0), -(2**31)),
    "table": (
        ConversionConfig(kind="table", points=((100, 0), (1000, 20), (2000, 30), (4000, 100))),
        "uint16",
        (5.0, 90.0),
        None,
    ),
    "polynomial": (
        ConversionConfig(kind="polynomial", coefficients=(1.0, 0.003, 1e-8)),
        "int16",
        (2.0, 90.0),
        -(2**15),
    ),
    "falling line": (ConversionConfig(scale=-0.01, offset=100.0), "uint16", (-20.0, 90.0), None),
}


def make_cover(kind: str, beyond: float = 3.0) -> tuple[RawCover, ConversionConfig, RawRange]:
    by, raw, span, lacks = KINDS[kind]
    found = find_range(by, raw, span)
    assert isinstance(found, RawRange), found
    return cover_range(by, found, raw, (span[0] - beyond, span[1] + beyond), lacks), by, found


def make_conversion(kind: str) -> IntegerConversion:
    cover, by, _ = make_cover(kind)
    return design_conversion(0, cover, by, LSB, 0.0, NONE)


def make_model(kind: str) -> IntegerModel:
    """Return a model of two inputs, the first of which is converted."""
    ops = GraphOperations(PERIOD_S)
    x = ops.input("x0")
    nodes = [ops.lowpass(x, 9.0), ops.product(x, ops.input("x1"))]
    floating, calibration = describe_graph(nodes, draw_codes(3))
    by = make_conversion(kind)
    first = Channel("x0", "degC", LSB, no_reading=NONE, conversion=by)
    low, high = sorted((by.lowest + 300, by.highest - 300))
    model = quantize(
        replace(floating, channels=(first, *floating.channels[1:])),
        replace(
            calibration,
            code_limits=((low, high), calibration.code_limits[1]),
            temperature_range=(low, high),
        ),
    )
    return replace(model, guards=replace(model.guards, rate_max=900))


@pytest.mark.parametrize("kind", KINDS)
def test_every_code_is_within_the_error_that_is_told(kind: str) -> None:
    by = make_conversion(kind)
    codes = np.unique(np.linspace(by.low, by.high, 200_003).round()).astype(np.int64)
    codes = codes[~by.find_missing(codes)]
    wanted = convert(codes.astype(np.float64), by.formula)
    off = np.abs(by.convert(codes) * LSB - wanted).max()
    assert off <= by.error * (1 + 1e-6) <= LSB * (1 + 1e-6)
    by.check_form()


def test_thermistor_meets_its_mark() -> None:
    by = make_conversion("ntc")
    codes = np.arange(65536)
    degc = convert(codes.astype(np.float64), NTC)
    inside = (degc >= -40.0) & (degc <= 150.0)
    assert inside.sum() > 60_000
    off = np.abs(by.convert(codes)[inside] * LSB - degc[inside]).max()
    assert off <= 0.01 and by.table_bytes <= 1024


@pytest.mark.parametrize("kind", KINDS)
def test_codes_beyond_are_limited_or_no_reading(kind: str) -> None:
    by = make_conversion(kind)
    every = np.unique(np.linspace(by.least, by.most, 70_001).round()).astype(np.int64)
    found, missing = by.convert(every), by.find_missing(every)
    assert (found[missing] == NONE).all()
    assert ((found[~missing] >= by.lowest) & (found[~missing] <= by.highest)).all()
    assert by.lowest > NONE


def test_a_converter_at_its_rails_has_no_reading() -> None:
    by = make_conversion("ntc")
    for code in (0, 63, 65472, 65535):
        assert by.convert(np.array([code]))[0] == NONE, code
    for code in (64, 65471):
        assert by.convert(np.array([code]))[0] != NONE, code


@pytest.mark.spread(1, "kind", KINDS)
def test_reference_c_onnx_and_certificate_agree(kind: str, tmp_path: Path) -> None:
    model = make_model(kind)
    model.save(tmp_path / "model.json")
    assert load_model(tmp_path / "model.json").to_text() == model.to_text()
    code = generate(model)
    host, onnx = HostModel(model, code, tmp_path / "host", flags=("-O1",)), OnnxModel(model)
    sequences = draw_sequences(model, 2000)
    log = np.stack([np.linspace(host.model.channels[0].raw_least, 30_000, 500)] * 2, axis=1)
    sequences["golden"] = draw_golden(model, np.clip(log, -(2**15), 2**15 - 1).astype(np.int64))
    flags = np.zeros(0, dtype=np.uint32)
    for settled, (name, codes) in enumerate(sequences.items()):
        for check in (
            check_host(host, codes, settled=settled % 2 == 0),
            check_onnx(onnx, host, codes, settled=settled % 2 == 0),
        ):
            assert check.mismatch is None, f"{name}: {check.mismatch}"
        flags = np.append(flags, host.run(codes).flags)
    by = model.channels[0].conversion
    assert by is not None
    assert (flags & FLAG_NO_READING).any() == bool(by.list_missing())
    assert (flags & FLAG_TEMPERATURE_RANGE).any()
    outcome = derive_again(model, code)
    assert outcome.understood and not outcome.failures, outcome.failures


@pytest.mark.spread(0, "core", ["cortex-m0plus", "cortex-m4"])
def test_emulated_cores_agree(core: str, tmp_path: Path) -> None:
    for number, kind in enumerate(("ntc", "ntc of 24 bits", "pt1000")):
        model = make_model(kind)
        code = generate(model)
        host = HostModel(model, code, tmp_path / f"host{number}", flags=("-O1",))
        codes = draw_sequences(model, 400)["noise"]
        check_chip(core, code, host, {"noise": codes}, tmp_path / f"chip{number}")


def test_a_changed_table_is_no_longer_what_the_certificate_is_about() -> None:
    model = make_model("ntc")
    code = generate(model)
    by = model.channels[0].conversion
    assert by is not None
    wrong = code.source.replace(f", 0, {by.lines - 1});", f", 0, {by.lines});")
    assert wrong != code.source
    outcome = derive_again(model, replace(code, source=wrong))
    assert outcome.failures or not outcome.understood


@pytest.mark.parametrize("kind", KINDS)
def test_codes_of_values_are_the_nearest(kind: str) -> None:
    cover, by, found = make_cover(kind)
    codes = np.unique(np.linspace(cover.low, cover.high, 999).round())
    values = convert(codes, by)
    np.testing.assert_array_equal(find_code(by, found, values), codes)
    channel = make_model(kind).channels[0]
    given, outside = encode_channel(channel, values)
    np.testing.assert_array_equal(given, codes)
    assert not outside[1:-1].any()
    assert np.abs(round_channel(channel, values) - values).max() <= LSB * (1 + 1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_written_a_second_time_from_the_specification_it_is_the_same(
    kind: str, tmp_path: Path
) -> None:
    model = make_model(kind)
    model.save(tmp_path / "model.json")
    oracle, codes = Oracle(tmp_path / "model.json"), draw_sequences(model, 1000)["noise"]
    trace = Reference(model).run(codes[None], settled=False)
    for row, drift, flags in zip(codes, trace.drift[0], trace.flags[0], strict=True):
        answer = oracle.step([int(code) for code in row])
        assert (answer.drift, answer.flags) == (drift.tolist(), int(flags))


def test_a_reading_held_while_there_is_none_is_the_last_one() -> None:
    model = make_model("ntc")
    codes = np.tile(np.array([30_000, 100]), (1, 6, 1))
    codes[0, 2:4, 0] = 65_535
    trace = Reference(model).run(codes)
    assert (trace.flags[0] & FLAG_NO_READING).tolist() == [0, 0, 64, 64, 0, 0]
    still = Reference(model).run(np.tile(codes[:, :1], (1, 6, 1)))
    np.testing.assert_array_equal(trace.drift, still.drift)


def test_a_thermometer_that_turns_is_refused_in_words() -> None:
    by = ConversionConfig(kind="polynomial", coefficients=(0.0, 0.01, -1e-7))
    found = find_range(by, "uint16", (10.0, 260.0))
    assert isinstance(found, RawRange)  # beyond the turn nothing is needed
    assert found.end == 50_000
    rises_falls_rises = (0.0, 300 / 65536, -900 / 65536**2, 700 / 65536**3)
    by = ConversionConfig(kind="polynomial", coefficients=rises_falls_rises)
    told = find_range(by, "uint16", (5.0, 80.0))
    assert isinstance(told, str) and "turns at code" in told


def test_a_table_with_too_many_bends_is_refused() -> None:
    rng = np.random.default_rng(0)
    y = np.cumsum(rng.uniform(0.1, 10.0, 2000))
    points = tuple((float(20 * k), float(v)) for k, v in enumerate(y))
    by = ConversionConfig(kind="table", points=points)
    found = find_range(by, "uint16", (y[0], y[-1]))
    assert isinstance(found, RawRange)
    cover = cover_range(by, found, "uint16", (y[0], y[-1]), None)
    with pytest.raises(CheckError, match="needs a table of more than 4096 bytes"):
        design_conversion(0, cover, by, LSB, 0.0, -(2**31))


@pytest.mark.parametrize(
    "change",
    [
        {"raw": "uint8"},
        {"end": 70_000},
        {"first": (0, 1)},
        {"block_bits": 40},
        {"nodes": (1, 2)},
        {"lowest": NONE},
        {"channel": 1},
    ],
)
def test_a_table_that_no_quantizer_made_is_refused(change: dict[str, object]) -> None:
    from zerodrift.export.model_files import check_model

    model = make_model("ntc")
    by = replace(make_conversion("ntc"), **change)  # type: ignore[arg-type]
    channels = (replace(model.channels[0], conversion=by), *model.channels[1:])
    with pytest.raises((InputError, CheckError)):
        check_model("model.json", replace(model, channels=channels, guards=Guards(0, 0, -9, 9, 9)))


def test_an_unsigned_code_without_a_table_is_taken_as_it_is(tmp_path: Path) -> None:
    linear = ConversionConfig(scale=0.01, offset=-40.0)
    cover = RawCover("uint16", 0, 65535, None, 0, 65535, is_plain=True)
    by = design_conversion(0, cover, linear, 0.01, -40.0, 65535)
    model = make_model("ntc")
    first = Channel("x0", "degC", 0.01, -40.0, bits=32, no_reading=65535, conversion=by)
    nodes = (replace(model.nodes[0], low=2000, high=16000), *model.nodes[1:])
    guards = replace(model.guards, temperature_low=1800, temperature_high=16200)
    model = replace(model, channels=(first, model.channels[1]), nodes=nodes, guards=guards)
    check_again(model, tmp_path, ("uint16_t x0; /* x0: -40 + 0.01 degC per count; 65535 = no",))


def test_a_guarded_state_goes_with_a_conversion(tmp_path: Path) -> None:
    check_again(replace(make_model("pt100"), guarded=True), tmp_path, ("uint32_t check;",))


def check_again(model: IntegerModel, folder: Path, in_header: tuple[str, ...]) -> None:
    """Hold C, ONNX and the certificate's checker against the reference."""
    model.save(folder / "model.json")
    assert load_model(folder / "model.json").hash == model.hash
    code = generate(model)
    for text in in_header:
        assert text in code.header
    host, onnx = HostModel(model, code, folder / "host", flags=("-O1",)), OnnxModel(model)
    for codes in draw_sequences(model, 1000).values():
        for check in (check_host(host, codes), check_onnx(onnx, host, codes)):
            assert check.mismatch is None, check.mismatch
    outcome = derive_again(model, code)
    assert outcome.understood and not outcome.failures, outcome.failures
