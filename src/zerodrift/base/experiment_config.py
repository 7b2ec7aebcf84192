"""The `[experiment]` table of zerodrift.toml: what chamber, loads and sources can do."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from zerodrift.base.errors import InputError, nearest
from zerodrift.base.toml_table import TomlTable

EXPERIMENT_KEYS = (
    *("temperature_degC", "start_degC", "heating_K_per_min", "cooling_K_per_min", "follows_s"),
    *("hours", "log_min", "rest_min", "power", "units", "noise_pct", "loads", "inputs"),
)
RANGE_KEYS = ("range", "change_s", "hold_s")
COLDEST_DEGC, HOTTEST_DEGC = -273.15, 500.0


@dataclass(frozen=True)
class Reach:
    """How far a load or an input can be set, and how fast."""

    low: float
    high: float
    change_s: float = 5.0
    """Duration of a change, s."""
    hold_s: float = 60.0
    """Shortest time between two changes, s."""


@dataclass(frozen=True)
class ExperimentConfig:
    """`[experiment]`; what is None or empty is taken from the logs, or is the planner's default."""

    temperature_degC: tuple[float, float] | None = None
    start_degC: float | None = None
    """Where each log begins and ends."""
    heating_K_per_min: float | None = None
    """Fastest programmed ramp upwards."""
    cooling_K_per_min: float | None = None
    """Fastest programmed ramp downwards, a positive number."""
    follows_s: float | None = None
    """Time constant with which the sensor's thermometer follows the chamber, s."""
    hours: float | None = None
    log_min: float | None = None
    """Shortest log, minutes."""
    rest_min: float | None = None
    """Minutes between two logs, in which nothing is recorded."""
    power: bool = False
    """Whether a log may begin with the power-on."""
    units: int = 1
    """Sensors that the chamber holds at once."""
    noise_pct: float | None = None
    """RMS of the noise in % of full scale, where no logs show it."""
    loads: Mapping[str, Reach] = field(default_factory=dict)
    """Output -> the loads that can be put on it, in its unit."""
    inputs: Mapping[str, Reach] = field(default_factory=dict)
    """Input -> the values it can be set to."""
    lines: Mapping[str, str] = field(default_factory=dict)
    """Key -> its place in the file, for messages."""

    def locate(self, key: str) -> str:
        """Return the place of a key in the file and how a user writes it."""
        return f"{self.lines[key]}: [experiment] {key}" if key in self.lines else f"{key}"


def read_experiment(
    table: TomlTable, outputs: tuple[str, ...], inputs: tuple[str, ...]
) -> ExperimentConfig:
    """Return the checked `[experiment]` table; empty where the file has none.

    Args:
        table: the table, possibly empty.
        outputs: the names that loads may have.
        inputs: the names that inputs may have.

    Raises:
        InputError: an unknown key or name, a value of the wrong type or range, or limits that
            contradict each other.
    """
    table.refuse_unknown(EXPERIMENT_KEYS)

    def positive(key: str) -> float | None:
        return table.positive(key) if key in table.values else None

    temperature = None
    if "temperature_degC" in table.values:
        temperature = _read_range(table, "temperature_degC")
        if temperature[0] <= COLDEST_DEGC or temperature[1] > HOTTEST_DEGC:
            raise table.expect(
                "temperature_degC",
                f"temperatures above {COLDEST_DEGC} and up to {HOTTEST_DEGC:g} degC",
            )
    start = None
    if "start_degC" in table.values:
        start = table.number("start_degC", "a temperature in degC")
        if temperature is not None and not temperature[0] <= start <= temperature[1]:
            raise table.expect(
                "start_degC",
                f"a temperature within [experiment] temperature_degC, {temperature[0]:g} to "
                f"{temperature[1]:g}, since every log begins and ends there; change one of the two",
            )
    rest = None
    if "rest_min" in table.values:
        rest = table.number("rest_min", "minutes, 0 or more")
        if rest < 0.0:
            raise table.expect("rest_min", "minutes, 0 or more")
    config = ExperimentConfig(
        temperature_degC=temperature,
        start_degC=start,
        heating_K_per_min=positive("heating_K_per_min"),
        cooling_K_per_min=positive("cooling_K_per_min"),
        follows_s=positive("follows_s"),
        hours=positive("hours"),
        log_min=positive("log_min"),
        rest_min=rest,
        power=table.flag("power"),
        units=table.integer("units", 1, 100_000) if "units" in table.values else 1,
        noise_pct=positive("noise_pct"),
        loads=_read_reaches(table, "loads", outputs, "output"),
        inputs=_read_reaches(table, "inputs", inputs, "input"),
        lines={key: f"{table.file}:{table.line(key)}" for key in table.values},
    )
    check_time(config)
    return config


def check_time(config: ExperimentConfig) -> None:
    """Refuse a log and its rest that do not fit into the hours.

    Raises:
        InputError: naming both keys.
    """
    if config.hours is None or config.log_min is None:
        return
    needed = config.log_min + (config.rest_min or 0.0)
    if needed > 60.0 * config.hours:
        raise InputError(
            f"{config.locate('hours')} is {config.hours:g} h, but one log of {config.log_min:g} min"
            f" with its rest takes {needed:g} min; expected room for at least one. Allow more "
            "hours, or a shorter log_min."
        )


def _read_range(table: TomlTable, key: str) -> tuple[float, float]:
    """Read `[low, high]`."""
    expected = "[LOW, HIGH], two numbers, the lower one first"
    found = table.values.get(key)
    if not isinstance(found, list) or len(found) != 2:
        raise table.expect(key, expected)
    pair = []
    for value in found:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
            raise table.expect(key, expected)
        pair.append(float(value))
    if pair[0] >= pair[1]:
        raise table.expect(key, f"{expected}; a range without width leaves nothing to move")
    return pair[0], pair[1]


def _read_reaches(
    table: TomlTable, key: str, known: tuple[str, ...], what: str
) -> dict[str, Reach]:
    """Read `[experiment.loads]` or `[experiment.inputs]`: NAME = [low, high], or a table."""
    reaches = {}
    inner = table.table(key, None, optional=True)
    for name, value in inner.values.items():
        if name not in known:
            raise inner.error(
                name,
                f"{inner.label(name)} is no {what}{nearest(name, known) or '.'} Expected one of "
                f"{', '.join(known) or f'none: the file names no {what}s'}.",
            )
        if isinstance(value, list):
            reaches[name] = Reach(*_read_range(inner, name))
            continue
        one = inner.table(name, RANGE_KEYS)
        low, high = _read_range(one, "range")
        reaches[name] = Reach(
            low,
            high,
            one.positive("change_s") if "change_s" in one.values else Reach.change_s,
            one.positive("hold_s") if "hold_s" in one.values else Reach.hold_s,
        )
    return reaches
