"""The chip's conversion of raw codes against the equations of the sensors, code by code."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.column_config import ConversionConfig, DividerConfig, sum_formula
from zerodrift.base.errors import InputError
from zerodrift.codegen.generate import generate
from zerodrift.dataset.chip_codes import (
    SUM_LIMITS,
    RawRange,
    choose_fraction_bits,
    cover_range,
    find_range,
)
from zerodrift.dataset.conversions import emf
from zerodrift.export.channels import JunctionCodes, design_conversion
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.conversion import IntegerConversion

LSB_K, NONE, KELVIN = 2.0**-7, -(2**15), 273.15
MARK_K, MARK_BYTES, MARK_INSTRUCTIONS = 0.01, 1024, 80
BEYOND_K = 3.0
"""How far from its range a table goes: 2 K to the flag, and one more."""
AT_ONCE = 1 << 20
"""Codes that are looked at together; all of them are."""
COUNTED = 200
COUPLES = {"K": (-50.0, 400.0), "J": (-50.0, 400.0), "T": (-100.0, 200.0), "S": (0.0, 1000.0)}
"""Type -> degC that its tables are made for."""
COUPLE_SCALE_V = 2.5e-6
"""A converter of 16 bits and 82 mV."""
BOARD_DEGC, BOARD_LSB_K = (0.0, 60.0), 2.0**-7
"""The cold junction, and one code of its thermometer, such as a TMP117's."""
CORES = ("cortex-m4", "cortex-m0plus")


@dataclass(frozen=True)
class Case:
    """A thermometer: what zerodrift is told of it, and its own equation."""

    name: str
    formula: ConversionConfig
    raw: str
    range_degC: tuple[float, float]
    to_code: Callable[[Array], Array]
    """Temperature -> the code, not rounded, written here from the sensor's equation."""
    is_marked: bool = False


def divide(ohm: Array, counts: float, series_ohm: float = 1e4) -> Array:
    """Return the counts of a divider with the sensor on the low side."""
    return counts * ohm / (ohm + series_ohm)


def resist_ntc(degc: Array) -> Array:
    """Return a thermistor of 10 kohm and beta 3950 K in ohm."""
    return np.asarray(1e4 * np.exp(3950.0 / (degc + KELVIN) - 3950.0 / 298.15))


def resist_platinum(degc: Array) -> Array:
    """Return a Pt100 in ohm (IEC 60751:2022, equations 1 and 2)."""
    cold = np.where(degc < 0.0, -4.183e-12 * (degc - 100.0) * degc**3, 0.0)
    return np.asarray(100.0 * (1.0 + 3.9083e-3 * degc - 5.775e-7 * degc**2 + cold))


def make_ntc(counts: float) -> ConversionConfig:
    """Return the conversion of the thermistor in its divider."""
    divider = DividerConfig(1e4, True, counts, max(counts // 1024, 1.0))
    return ConversionConfig(kind="ntc", r25_ohm=1e4, beta_K=3950.0, divider=divider)


CASES = (
    *(
        Case(
            f"NTC 10k/3950, divider of 10k, {bits} bits",
            make_ntc(2.0**bits),
            "uint16" if bits <= 16 else "int32",
            (-40.0, 150.0),
            lambda degc, counts=2.0**bits: divide(resist_ntc(degc), counts),
            is_marked=bits == 16,
        )
        for bits in (16, 12, 24)
    ),
    Case(
        "Pt100, 15 bits of 400 ohm",
        ConversionConfig(kind="pt100", scale=400.0 / 2**15),
        "uint16",
        (-195.0, 600.0),
        lambda degc: resist_platinum(degc) * 2**15 / 400.0,
    ),
    Case(
        "Pt1000, 1 mohm a code",
        ConversionConfig(kind="pt1000", scale=1e-3),
        "int32",
        (-50.0, 200.0),
        lambda degc: resist_platinum(degc) * 1e4,
    ),
    Case(
        "polynomial, LM135-like with a bend",
        ConversionConfig(kind="polynomial", coefficients=(-60.0, 4e-3, -1e-8)),
        "uint16",
        (-40.0, 120.0),
        lambda degc: (4e-3 - np.sqrt(16e-6 - 4e-8 * (degc + 60.0))) / 2e-8,
    ),
)


def main(quick: bool) -> None:
    """Print error, table, instructions and the worth of a code of each thermometer."""
    for case in CASES[: 2 if quick else None]:
        measure(case)
    for couple in ("K",) if quick else COUPLES:
        measure_couple(couple)


def measure(case: Case) -> None:
    """Print what becomes of one thermometer."""
    low, high = case.range_degC
    found = find_range(case.formula, case.raw, case.range_degC)
    assert isinstance(found, RawRange), found
    cover = cover_range(case.formula, found, case.raw, (low - BEYOND_K, high + BEYOND_K), None)
    by = design_conversion(0, cover, case.formula, LSB_K, 0.0, NONE)
    degc = np.linspace(low, high, 4_000_001)
    codes, degc = sort(case.to_code(degc), degc)
    every = np.arange(np.ceil(codes[0]), np.floor(codes[-1]) + 1.0)
    largest, squares, worths = 0.0, 0.0, list[float]()
    for begin in range(0, every.size, AT_ONCE):
        some = every[begin : begin + AT_ONCE + 1]
        exact = np.interp(some, codes, degc)
        off = np.abs(by.convert(some.astype(np.int64)) * LSB_K - exact)
        largest, squares = max(largest, off.max()), squares + float((off[:AT_ONCE] ** 2).sum())
        steps = np.abs(np.diff(exact))
        worths += [float(steps.min()), float(steps.max())] if steps.size else []
    model = make_model(by)
    counted = every[np.linspace(0, every.size - 1, COUNTED).astype(int)].astype(np.int64)
    spent = [count(model, by, core, counted) for core in CORES]
    print(f"{case.name}, {low:g} to {high:g} degC, {every.size} codes:")
    print(
        f"  off by {largest:.5f} K at most (it says {by.error:.5f}),"
        f" {np.sqrt(squares / every.size):.5f} K RMS, the rounding to {LSB_K:g} K included; table"
        f" {by.table_bytes} B ({by.lines} lines in {len(by.first) - 1} blocks); {tell(spent)}"
    )
    print(f"  one code is worth {min(worths):.5f} to {max(worths):.5f} K")
    if case.is_marked:
        held = largest <= MARK_K and by.table_bytes <= MARK_BYTES
        held = held and spent[0] is not None and spent[0] <= MARK_INSTRUCTIONS
        print(
            f"  mark: {MARK_K:g} K, {MARK_BYTES} B, {MARK_INSTRUCTIONS} instructions on"
            f" {CORES[0]}: {'held' if held else 'NOT held'}"
        )


def measure_couple(couple: str) -> None:
    """Print what becomes of a thermocouple whose cold junction is measured."""
    low, high = COUPLES[couple]
    formula = ConversionConfig(
        kind="thermocouple", couple=couple, scale=COUPLE_SCALE_V, junction="board"
    )
    bits = choose_fraction_bits(formula, (low, high), LSB_K)
    of_sum = sum_formula(formula, bits)
    found = find_range(of_sum, "int16", (low, high), SUM_LIMITS)
    assert isinstance(found, RawRange), found
    cover = cover_range(of_sum, found, "int16", (low - BEYOND_K, high + BEYOND_K), NONE, bits)
    ends = [round(end / BOARD_LSB_K) for end in BOARD_DEGC]
    junction = JunctionCodes(1, 16, BOARD_LSB_K, 0.0, NONE, ends[0], ends[1])
    by = design_conversion(0, cover, formula, LSB_K, 0.0, NONE, junction)
    raw = np.arange(-(2**15) + 1, 2**15)
    degc = np.linspace(low - 1.0, high + 1.0, 4_000_001)
    volts = emf(couple, degc)
    largest, squares, number = 0.0, 0.0, 0
    boards = range(ends[0], ends[1] + 1, 97)
    for board in boards:
        cold_v = float(emf(couple, np.array([board * BOARD_LSB_K]))[0])
        exact = np.interp(raw * COUPLE_SCALE_V + cold_v, volts, degc, left=np.nan, right=np.nan)
        inside = (exact >= low) & (exact <= high)
        got = by.convert(raw[inside], np.full(int(inside.sum()), board)) * LSB_K
        off = np.abs(got - exact[inside])
        largest, squares = max(largest, float(off.max())), squares + float((off**2).sum())
        number += off.size
    codes = np.stack(
        [raw[:: raw.size // COUNTED], np.full_like(raw, ends[1] // 2)[:: raw.size // COUNTED]]
    )
    model = make_model(by, Channel("board", "degC", BOARD_LSB_K, no_reading=NONE))
    spent = [count(model, by, core, codes.T) for core in CORES]
    print(
        f"thermocouple of type {couple}, int16 codes of {1e6 * COUPLE_SCALE_V:g} uV, {low:g} to"
        f" {high:g} degC, cold junction {BOARD_DEGC[0]:g} to {BOARD_DEGC[1]:g} degC, {number} pairs"
        f" of codes:"
    )
    rms = np.sqrt(squares / number)
    print(
        f"  off by {largest:.5f} K at most (it says {by.error:.5f}), {rms:.5f} K RMS,"
        f" the rounding to {LSB_K:g} K included; tables {by.table_bytes} B; {tell(spent)}"
    )
    print(f"  one code is worth {by.worth[0]:.5f} to {by.worth[1]:.5f} K")


def tell(spent: list[int | None]) -> str:
    """Return the instructions on each core."""
    return ", ".join(
        f"{n} instructions on {core}" if n is not None else f"no compiler or emulator for {core}"
        for n, core in zip(spent, CORES, strict=True)
    )


def sort(codes: Array, degc: Array) -> tuple[Array, Array]:
    """Return both with rising codes."""
    return (codes, degc) if codes[-1] > codes[0] else (codes[::-1], degc[::-1])


def make_model(by: IntegerConversion, *others: Channel) -> IntegerModel:
    """Return a small model whose thermometer is converted, beside other inputs."""
    ops = GraphOperations(1.0)
    feature = ops.lowpass(ops.input("temperature_degC"), 60.0)
    channel = Channel("temperature", "degC", LSB_K, no_reading=NONE, conversion=by)
    floating = FloatModel(
        name="bench",
        sample_period_s=1.0,
        channels=(channel, *others),
        sources={"temperature_degC": 0} | {one.name: i + 1 for i, one in enumerate(others)},
        outputs=(OutputFormat("Fz", "N", 1000, 1000.0),),
        features=(feature, *(ops.input(one.name) for one in others)),
        coefficients=np.array([[0.5], *([0.1] for _ in others)]),
        offset=np.zeros(1),
    )
    limits = (by.lowest + 100, by.highest - 100)
    drift = (np.array([-200.0]), np.array([200.0]))
    all_limits = (limits, *((0, 15_000) for _ in others))
    return quantize(floating, Calibration(all_limits, np.zeros(0), *drift, 2000, 0))


def count(
    model: IntegerModel, by: IntegerConversion, core: str, codes: NDArray[np.int64]
) -> int | None:
    """Return the most instructions that the conversion adds to a step; None: cannot be counted."""
    first, *others = model.channels
    plain = replace(model, channels=(replace(first, conversion=None), *others))
    codes = codes.reshape(-1, len(model.channels))
    of_result = codes.copy()
    of_result[:, 0] = by.convert(*codes.T)
    with tempfile.TemporaryDirectory() as scratch:
        try:
            from zerodrift.c_runtime.emulator import EmulatedModel

            given = ((model, codes), (plain, of_result))
            counts = []
            for number, (one, raw) in enumerate(given):
                folder = Path(scratch) / str(number)
                folder.mkdir()
                chip = EmulatedModel(one, generate(one), core, folder, ("-O2",))
                rows = raw.astype(one.code_type)
                counts.append(np.array(chip.count_instructions(rows)))
        except (ImportError, InputError):
            return None
    return int((counts[0] - counts[1]).max())
