"""Thermocouples on the chip: raw code and cold junction become a temperature, the same bits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.effects_on_chip.random_graphs import describe_graph, draw_codes
from tests.operations.everywhere import PERIOD_S, derive_again
from tests.oracle.machine import Oracle

from zerodrift.base.column_config import ConversionConfig, DividerConfig, sum_formula
from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.chip_codes import (
    SUM_LIMITS,
    RawRange,
    choose_fraction_bits,
    cover_range,
    find_range,
)
from zerodrift.dataset.conversions import convert, emf
from zerodrift.export.channels import JunctionCodes, design_conversion
from zerodrift.export.encoding import encode_channel
from zerodrift.export.integer_model import FLAG_NO_READING, Channel, IntegerModel
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

LSB, BOARD_LSB = 2.0**-5, 2.0**-8
NONE = -(2**15)
SPANS = {
    "B": (300.0, 1000.0),
    "E": (-100.0, 900.0),
    "J": (-100.0, 700.0),
    "K": (-100.0, 1000.0),
    "N": (-100.0, 1000.0),
    "R": (0.0, 1000.0),
    "S": (0.0, 1000.0),
    "T": (-200.0, 350.0),
}
"""Type -> degC that the tables are made for."""
COLD = (0.0, 60.0)


def make_formula(couple: str) -> ConversionConfig:
    """Return 16 bits of 2.5 uV, from -82 to 82 mV."""
    return ConversionConfig(kind="thermocouple", couple=couple, scale=2.5e-6, junction="board")


def make_conversion(
    couple: str, lsb: float = LSB, board: Channel | None = None
) -> IntegerConversion:
    by, span = make_formula(couple), SPANS[couple]
    bits = choose_fraction_bits(by, span, lsb)
    of_sum = sum_formula(by, bits)
    found = find_range(of_sum, "int16", span, SUM_LIMITS)
    assert isinstance(found, RawRange), found
    cover = cover_range(of_sum, found, "int16", (span[0] - 3, span[1] + 3), NONE, bits)
    low, high = (round(end / BOARD_LSB) for end in COLD)
    own = 0.0 if board is None or board.conversion is None else board.conversion.error
    junction = JunctionCodes(1, 16, BOARD_LSB, 0.0, NONE, low, high, own)
    return design_conversion(0, cover, by, lsb, 0.0, NONE, junction)


def make_board(converted: bool) -> Channel:
    """Return the cold junction's thermometer, a thermistor of its own if it is converted."""
    by = None
    if converted:
        divider = DividerConfig(1e4, True, 65536.0, 64.0)
        ntc = ConversionConfig(kind="ntc", r25_ohm=1e4, beta_K=3950.0, divider=divider)
        found = find_range(ntc, "uint16", (-20.0, 90.0))
        assert isinstance(found, RawRange)
        cover = cover_range(ntc, found, "uint16", (-20.0, 90.0), None)
        by = replace(design_conversion(0, cover, ntc, BOARD_LSB, 0.0, NONE), channel=1)
        by = replace(by, name="conversion_1")
    return Channel("x1", "degC", BOARD_LSB, no_reading=NONE, conversion=by)


def make_model(couple: str, converted: bool = False) -> IntegerModel:
    """Return a model of a thermocouple and its cold junction, in that order."""
    ops = GraphOperations(PERIOD_S)
    x = ops.input("x0")
    nodes = [ops.lowpass(x, 9.0), ops.product(x, ops.input("x1"))]
    floating, calibration = describe_graph(nodes, draw_codes(3))
    board = make_board(converted)
    by = make_conversion(couple, board=board)
    first = Channel("x0", "degC", LSB, no_reading=NONE, conversion=by)
    low, high = by.lowest + 300, by.highest - 300
    model = quantize(
        replace(floating, channels=(first, board)),
        replace(calibration, code_limits=((low, high), (0, 15_000)), temperature_range=(low, high)),
    )
    return replace(model, guards=replace(model.guards, rate_max=900))


def draw_pairs(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    rng = np.random.default_rng(4)
    raw = rng.integers(-(2**15) + 1, 2**15, count)
    return raw, rng.integers(round(COLD[0] / BOARD_LSB), round(COLD[1] / BOARD_LSB) + 1, count)


@pytest.mark.parametrize("couple", SPANS)
@pytest.mark.spread(0, "lsb", [LSB, 2.0**-7])
def test_temperature_is_within_the_error_that_is_told(couple: str, lsb: float) -> None:
    by = make_conversion(couple, lsb)
    raw, cold = draw_pairs(200_000)
    wanted = convert(raw.astype(np.float64), by.formula, cold * BOARD_LSB)
    inside = (wanted >= SPANS[couple][0]) & (wanted <= SPANS[couple][1])
    assert inside.sum() > 5_000
    off = np.abs(by.convert(raw, cold) * lsb - wanted)[inside].max()
    assert 0.3 * lsb < off <= by.error <= 1.3 * lsb
    assert by.table_bytes <= 1536
    by.check_form()


@pytest.mark.spread(2, ("couple", "converted"), [*((c, False) for c in SPANS), ("K", True)])
def test_reference_c_onnx_and_certificate_agree(
    couple: str, converted: bool, tmp_path: Path
) -> None:
    model = make_model(couple, converted)
    model.save(tmp_path / "model.json")
    assert load_model(tmp_path / "model.json").to_text() == model.to_text()
    code = generate(model)
    host, onnx = HostModel(model, code, tmp_path / "host", flags=("-O1",)), OnnxModel(model)
    sequences = draw_sequences(model, 1000)
    log = np.stack([np.linspace(-20_000, 20_000, 500), np.linspace(9_000, 22_000, 500)], axis=1)
    sequences["golden"] = draw_golden(model, log.astype(np.int64))
    flags = np.zeros(0, dtype=np.uint32)
    for settled, (name, codes) in enumerate(sequences.items()):
        for check in (
            check_host(host, codes, settled=settled % 2 == 0),
            check_onnx(onnx, host, codes, settled=settled % 2 == 0),
        ):
            assert check.mismatch is None, f"{name}: {check.mismatch}"
        flags = np.append(flags, host.run(codes).flags)
    assert (flags & FLAG_NO_READING).any() and not (flags & FLAG_NO_READING).all()
    outcome = derive_again(model, code)
    assert outcome.understood and not outcome.failures, outcome.failures
    header = " ".join(code.header.replace("\n     * ", " ").split())
    assert f"V of a thermocouple of type {couple}" in header


@pytest.mark.parametrize("converted", [False, True])
def test_written_a_second_time_from_the_specification_it_is_the_same(
    converted: bool, tmp_path: Path
) -> None:
    model = make_model("K", converted)
    model.save(tmp_path / "model.json")
    oracle, codes = Oracle(tmp_path / "model.json"), draw_sequences(model, 1000)["noise"]
    trace = Reference(model).run(codes[None], settled=False)
    for row, drift, flags in zip(codes, trace.drift[0], trace.flags[0], strict=True):
        answer = oracle.step([int(code) for code in row])
        assert (answer.drift, answer.flags) == (drift.tolist(), int(flags))


@pytest.mark.parametrize("core", ["cortex-m0plus", "cortex-m4"])
def test_emulated_cores_agree(core: str, tmp_path: Path) -> None:
    model = make_model("K", converted=True)
    code = generate(model)
    host = HostModel(model, code, tmp_path / "host", flags=("-O1",))
    codes = draw_sequences(model, 400)["noise"]
    check_chip(core, code, host, {"noise": codes}, tmp_path / "chip")


def test_without_a_reading_of_the_cold_junction_there_is_none_of_the_thermocouple() -> None:
    model = make_model("K")
    codes = np.tile(np.array([4_000, 6_400]), (1, 6, 1))
    codes[0, 2:4, 1] = NONE
    converted = model.convert(codes)
    assert (converted[0, :, 0] == NONE).tolist() == [False, False, True, True, False, False]
    trace = Reference(model).run(codes)
    assert (trace.flags[0] & FLAG_NO_READING).tolist() == [0, 0, 64, 64, 0, 0]
    codes = np.array([[[32_767, 15_000]]])  # 82 mV: no K gives that
    assert model.convert(codes)[0, 0, 0] == NONE


def test_codes_of_temperatures_are_the_nearest_for_the_junction_they_were_taken_at() -> None:
    channel = make_model("K").channels[0]
    raw, cold = draw_pairs(5_000)
    values = convert(raw.astype(np.float64), make_formula("K"), cold * BOARD_LSB)
    inside = (values > -90.0) & (values < 990.0)
    found, outside = encode_channel(channel, values[inside], cold[inside])
    assert not outside.any()
    assert np.abs(found - raw[inside]).max() <= 1
    assert np.mean(found == raw[inside]) > 0.9


def test_a_junction_that_no_quantizer_made_is_refused() -> None:
    from zerodrift.export.model_files import check_model

    model = make_model("K")
    by = model.channels[0].conversion
    assert by is not None and by.junction is not None
    for change in (
        {"junction": None},
        {"fraction_bits": 40},
        {"junction": replace(by.junction, channel=7)},
        {"junction": replace(by.junction, lacks=3)},
        {"junction": replace(by.junction, first=(0, 1))},
        {"junction": by},
    ):
        wrong = replace(by, **change)  # type: ignore[arg-type]
        channels = (replace(model.channels[0], conversion=wrong), model.channels[1])
        with pytest.raises((InputError, CheckError)):
            check_model("model.json", replace(model, channels=channels))


def test_the_voltage_of_the_junction_is_that_of_the_function() -> None:
    by = make_conversion("T")
    assert by.junction is not None and by.fraction_bits is not None
    codes = np.arange(by.junction.low, by.junction.high + 1)
    volts = by.junction.convert(codes) * 2.5e-6 / 2.0**by.fraction_bits
    assert np.abs(volts - emf("T", codes * BOARD_LSB)).max() < 2.5e-6 / 2.0**by.fraction_bits
