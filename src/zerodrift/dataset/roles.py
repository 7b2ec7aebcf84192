"""The role of each column of a log, by its name, unit and values, with the reason."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.survey import CLOCK_WORDS, TIME_WORDS, Survey, SurveyedColumn, words
from zerodrift.dataset.units import TEMPERATURE_UNITS, strip_unit

REFERENCE_WORDS = {"ref", "reference", "true", "truth", "nominal", "ideal"}
SETPOINT_WORDS = {
    *("set", "setpoint", "setp", "sp", "target", "command", "cmd", "demand", "soll", "sollwert"),
    *("consigne", "wanted", "desired", "programme", "program"),
}
DRIVE_WORDS = {"heater", "drive", "pwm", "duty", "fan", "pid", "controller", "effort", "relay"}
COMPUTED_WORDS = {
    *("savitzky", "golay", "filtered", "filter", "smooth", "smoothed", "avg", "average", "mean"),
    *("moving", "fit", "fitted", "residual", "std", "stdev", "min", "max", "delta", "rate"),
}
RATE_UNITS = {"deg/s", "rad/s"}
"""Of what a gyroscope measures: its rate is computed from nothing."""
RELATIVE_WORDS = {"ppm", "ppb", "deviation", "dev", "error", "drift", "relative"}
"""A column so named may be another one, written relative to its start."""
IGNORED_WORDS = {
    "index",
    "id",
    "row",
    "sample",
    "count",
    "number",
    "seq",
    "sequence",
    "record",
    "nr",
}
FLAG_WORDS = {"flag", "flags", "status", "state", "error", "battery", "mode", "hold", "range"}
RAW_THERMOMETER_WORDS = {"ntc", "thermistor", "pt100", "pt1000", "rtd", "thermocouple"}
VOLTS = ("V", "mV", "uV")
CHIP_WORDS = {"chip", "tmp117", "board", "sensor", "die", "internal", "int"}
FAR_WORDS = {"ambient", "room", "air", "ext", "external", "outside", "lab"}
#: Channel name that effects use -> pattern of columns that carry it.
INPUT_PATTERNS = {
    "supply": r"^(supply|vdd|vcc|vbat|v_?supply|batt(ery)?)(_voltage)?(_m?v)?$",
    "humidity": r"(^|_)(humidity|humid|rh|feuchte)(_|$)",
    "ambient_light": r"(^|_)(light|lux)(_|$)",
    "pressure": r"(^|_)(pressure|baro(meter)?|druck)(_|$)",
    **{f"acceleration_{axis}": rf"^(a{axis}|acc(eleration)?_?{axis})(_|$)" for axis in "xyz"},
}
#: Word in a name, or in a text beside it -> the unit that such a quantity is likely in.
LIKELY_UNITS = {
    **dict.fromkeys(("resistance", "ohms", "ohm", "widerstand"), "ohm"),
    **dict.fromkeys(("voltage", "volt", "volts", "spannung"), "V"),
    **dict.fromkeys(("current", "amps", "strom"), "A"),
    **dict.fromkeys(("force", "kraft"), "N"),
    **dict.fromkeys(("torque", "moment"), "Nm"),
    **dict.fromkeys(("weight", "mass", "gewicht"), "g"),
    **dict.fromkeys(("frequency", "freq"), "Hz"),
    **dict.fromkeys(("ppm",), "ppm"),
}
SAME = 1e-7
"""Two columns are one quantity if no more than this share of their changes is apart."""
STEADY = 0.05
"""A value that moves by less than this share of itself is that of something constant."""
SETPOINT_VALUES = 64
SETPOINT_CHANGES = 0.01
"""A temperature of so few values that changes so seldom looks like a setpoint."""

RAW_THERMOMETER = "a raw thermometer"
"""Why a column of ohms or counts is not used."""
TEMPERATURE, OUTPUT, REFERENCE, INPUT, UNUSED = (
    "temperature",
    "output",
    "reference",
    "input",
    "not used",
)


@dataclass(frozen=True)
class Role:
    """The role of one column of one file."""

    column: SurveyedColumn
    role: str
    """temperature | output | reference | input | not used."""
    why: str
    channel: str = ""
    """Of an input: the name that effects use."""
    rank: int = 0
    """Of a thermometer: 0 for the one most likely on the chip, then 1, 2, ..."""


def assign_roles(survey: Survey) -> list[Role]:
    """Return the role of each column of numbers; the likeliest thermometer is named as one.

    Setpoints and constants are neither thermometers nor outputs.
    """
    roles: dict[str, Role] = {}
    columns = list(survey.columns)
    has_names = survey.source.text is None or survey.source.text.header_line > 0
    for column in columns:
        if role := _set_aside(column, has_names):
            roles[column.name] = role
    left = [column for column in columns if column.name not in roles]
    for number, column in enumerate(left):
        for other in left[:number]:
            if other.name in roles and roles[other.name].role == UNUSED:
                continue
            is_thermal = _is_thermal(column) and _is_thermal(other) and column.unit != other.unit
            if not is_thermal and not words(column.name) & RELATIVE_WORDS:
                continue
            if same := _compare(survey.sample[column.name], survey.sample[other.name]):
                roles[column.name] = Role(column, UNUSED, f"is '{other.name}' {same}")
                break
    left = [column for column in columns if column.name not in roles]
    for rank, column in enumerate(_rank_thermometers(left)):
        why = _explain_thermometer(column)
        roles[column.name] = Role(column, TEMPERATURE, why, rank=rank)
    left = [column for column in left if column.name not in roles]
    for column in [column for column in left if words(column.name) & CLOCK_WORDS][:1]:
        roles[column.name] = Role(column, INPUT, "an absolute clock, by its name", "clock")
    for channel, pattern in INPUT_PATTERNS.items():
        named = [
            column
            for column in left
            if column.name not in roles and re.search(pattern, column.name, re.IGNORECASE)
        ]
        for number, column in enumerate(named):
            roles[column.name] = (
                Role(column, INPUT, "by its name", channel)
                if number == 0
                else Role(column, UNUSED, f"another {channel}")
            )
    left = [column for column in left if column.name not in roles]
    for column in left:
        is_reference = bool(words(column.name) & REFERENCE_WORDS)
        why = "the true value, by its name" if is_reference else "moves, and nothing else claims it"
        roles[column.name] = Role(column, REFERENCE if is_reference else OUTPUT, why)
    outputs = [role for role in roles.values() if role.role == OUTPUT]
    if any(role.column.unit for role in outputs):
        for role in outputs:
            if not role.column.unit:
                name = role.column.name
                roles[name] = Role(role.column, UNUSED, "has no unit, where others have one")
    return [roles[column.name] for column in columns]


def guess_unit(column: SurveyedColumn, survey: Survey) -> tuple[str, str]:
    """Return a column's unit and where it was taken from; ("LSB", "") where nothing states it."""
    if column.unit:
        return column.unit, "its name or the row of units"
    for word in words(column.name):
        if word in LIKELY_UNITS:
            return LIKELY_UNITS[word], f"the word '{word}'"
    for name, values in survey.texts.items():
        if len(values) == 1 and values[0].strip().lower() in LIKELY_UNITS:
            return LIKELY_UNITS[values[0].strip().lower()], f"'{name}', which says '{values[0]}'"
    return "LSB", ""


def _set_aside(column: SurveyedColumn, has_names: bool) -> Role | None:
    """Return the role of a column that clearly has no use; None: it may have one."""
    named = words(column.name)
    if column.is_constant and not named & REFERENCE_WORDS:
        return Role(column, UNUSED, f"is {column.low:g} in every row")
    if named & TIME_WORDS and column.rises:
        return Role(column, UNUSED, "another time")
    if named & SETPOINT_WORDS and not named & REFERENCE_WORDS:
        return Role(column, UNUSED, "a setpoint, by its name")
    if named & DRIVE_WORDS and not _is_thermal(column):
        return Role(column, UNUSED, "a controller's drive, by its name")
    computed = COMPUTED_WORDS - {"rate"} if column.unit in RATE_UNITS else COMPUTED_WORDS
    if named & computed:
        return Role(column, UNUSED, "computed from others, by its name")
    if column.name.lower() in IGNORED_WORDS or (named & IGNORED_WORDS and column.rises):
        return Role(column, UNUSED, "counts rows")
    if named & FLAG_WORDS and column.distinct <= 3:
        return Role(column, UNUSED, "a flag, by its name")
    is_couple = "tc" in named and column.unit in VOLTS
    if (is_couple or named & RAW_THERMOMETER_WORDS) and not _is_thermal(column):
        return Role(
            column, UNUSED, f"{RAW_THERMOMETER}: its conversion to degC is not known from the log"
        )
    if not has_names and _looks_like_setpoint(column):
        return Role(column, UNUSED, "looks like a setpoint: few values, seldom changed")
    return None


def _looks_like_setpoint(column: SurveyedColumn) -> bool:
    return column.distinct <= SETPOINT_VALUES and column.changes < SETPOINT_CHANGES


def _is_thermal(column: SurveyedColumn) -> bool:
    """Tell whether a column is a temperature by its unit or its name."""
    if words(column.name) & {"celsius", "fahrenheit", "kelvin"}:
        return True
    has_name = re.search(r"temp(?!co)|(^|_)t(_|$)", column.name, re.IGNORECASE) is not None
    return column.unit in TEMPERATURE_UNITS or (has_name and not column.unit)


def _rank_thermometers(columns: Sequence[SurveyedColumn]) -> list[SurveyedColumn]:
    """Return the columns that are temperatures, the one most likely on the chip first."""
    found = [column for column in columns if _is_thermal(column)]
    plain = [c for c in found if c.unit or re.search("temp|celsius", c.name, re.IGNORECASE)]
    found = plain or found

    def rank(column: SurveyedColumn) -> tuple[bool, int]:
        named = words(column.name)
        place = 2
        if words(strip_unit(column.name)) & CHIP_WORDS:
            place = 0
        elif strip_unit(column.name).lower() in ("temperature", "temp", "t"):
            place = 1
        elif named & FAR_WORDS:
            place = 3
        return _looks_like_setpoint(column), place

    return sorted(found, key=rank)


def _explain_thermometer(column: SurveyedColumn) -> str:
    by = f"its unit, {column.unit}" if column.unit else "its name"
    doubt = (
        "; looks like a setpoint, few values seldom changed" if _looks_like_setpoint(column) else ""
    )
    return f"a thermometer by {by}{doubt}"


def _compare(values: Array, other: Array) -> str:
    """Return how one column follows from another, if it does by a scale and an offset."""
    known = np.isfinite(values) & np.isfinite(other)
    one, two = values[known], other[known]
    if one.size < 8 or np.ptp(one) == 0 or np.ptp(two) == 0:
        return ""
    centred = two - two.mean()
    slope = float(centred @ (one - one.mean()) / (centred @ centred))
    left = one - one.mean() - slope * (two - two.mean())
    digits = np.ptp(one) / max(np.unique(one).size - 1, 1)
    if float(np.mean(left**2)) > max(SAME * float(np.var(one)), (0.51 * digits) ** 2 / 3):
        return ""
    if float(np.mean(left**2)) > 1e-4 * float(np.var(one)):
        return ""
    shift = float(one.mean() - slope * two.mean())
    if abs(slope - 1.8) < 0.01 and abs(shift - 32) < 0.5:
        return "in degF"
    if abs(slope - 1) < 1e-3 and abs(shift - 273.15) < 0.1:
        return "in K"
    return f"times {slope:.6g} and {shift:+.6g}"
