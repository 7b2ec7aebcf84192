"""A programme: what chamber, loads and inputs are set to over time, in logs with rests between."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.discovery.limits import Limits
from zerodrift.operations.recursion import filter_recursively

NO_WAY_K = 1e-9
"""What adding up leaves of a way that has been gone."""


@dataclass(frozen=True)
class Setting:
    """From this moment on: where to go, how fast, and what is put on."""

    from_s: float
    """Since the log's first row."""
    temperature_degC: float
    rate_K_per_min: float
    """Of the chamber's set point, a positive number; 0: it stays."""
    loads: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Log:
    """One log: it begins and ends at the start temperature, unloaded."""

    settings: tuple[Setting, ...]
    lasts_s: float
    power_on: bool = False
    """Whether it begins with the power-on."""


@dataclass(frozen=True)
class SetProgramme:
    """Logs one after the other, with rests between in which nothing is recorded."""

    logs: tuple[Log, ...]
    rest_s: float
    start_degC: float

    @property
    def hours(self) -> float:
        """What it takes, every rest included."""
        return sum(log.lasts_s + self.rest_s for log in self.logs) / 3600.0


@dataclass(frozen=True)
class PlannedCourse:
    """The signals of one log on a grid [n]."""

    time_s: Array
    temperature_degC: Array
    """Of the sensor's thermometer, which follows the chamber."""
    loads: Mapping[str, Array]
    inputs: Mapping[str, Array]


def list_set_points(log: Log, start_degC: float) -> tuple[Array, Array]:
    """Return knots (s, degC) of the chamber's set point."""
    times, levels = [0.0], [start_degC]
    ends = [setting.from_s for setting in log.settings[1:]] + [log.lasts_s]
    for setting, end_s in zip(log.settings, ends, strict=True):
        now = levels[-1]
        way = abs(setting.temperature_degC - now)
        rate = setting.rate_K_per_min / 60.0
        over_s = way / rate if rate > 0.0 else 0.0
        if way > NO_WAY_K and rate > 0.0:
            done_s = min(setting.from_s + over_s, end_s)
            share = (done_s - setting.from_s) / over_s
            times += [setting.from_s, done_s]
            levels += [now, now + share * (setting.temperature_degC - now)]
    return np.array(times), np.array(levels)


def follow(log: Log, limits: Limits, step_s: float, start_degC: float) -> PlannedCourse:
    """Return the signals of a log: set points ramped, the thermometer behind the chamber.

    Args:
        log: what is set.
        limits: how fast loads and inputs change, and how slowly the sensor follows.
        step_s: seconds between samples.
        start_degC: where the log begins, at rest.
    """
    count = max(2, int(np.floor(log.lasts_s / step_s + 1e-9)))
    time_s: Array = (np.arange(count, dtype=np.float64) + 0.5) * step_s
    times, levels = list_set_points(log, start_degC)
    chamber: Array = np.asarray(np.interp(time_s, times, levels), dtype=np.float64)
    decay = float(np.exp(-step_s / limits.follows_s))
    away = filter_recursively([1.0 - decay], [1.0, -decay], chamber - start_degC)
    begins = np.array([setting.from_s for setting in log.settings])

    def ramp(values: list[float], change_s: float) -> Array:
        """Return levels joined by straight moves of `change_s`."""
        moved = np.array(values)
        at, to = [0.0], [moved[0]]
        for begin, before, after in zip(begins[1:], moved[:-1], moved[1:], strict=True):
            if after != before:
                at += [max(begin, at[-1] + 1e-6), max(begin, at[-1] + 1e-6) + change_s]
                to += [before, after]
        return np.asarray(np.interp(time_s, at, to))

    return PlannedCourse(
        time_s,
        np.asarray(start_degC + away, dtype=np.float64),
        {
            name: ramp([s.loads.get(name, 0.0) for s in log.settings], reach.change_s)
            for name, reach in limits.loads.items()
        },
        {
            name: ramp(
                [s.inputs.get(name, limits.nominal[name]) for s in log.settings], reach.change_s
            )
            for name, reach in limits.inputs.items()
        },
    )


def check_followed(programme: SetProgramme, limits: Limits) -> list[str]:
    """Return where a programme breaks the limits, a sentence each; empty: nowhere."""
    broken = []
    for number, log in enumerate(programme.logs, start=1):
        times, levels = list_set_points(log, programme.start_degC)
        for begin, end, now, to in zip(times, times[1:], levels, levels[1:], strict=False):
            fastest = limits.heating_K_per_s if to > now else limits.cooling_K_per_s
            if end > begin and abs(to - now) / (end - begin) > fastest * (1.0 + 1e-9):
                rate = 60.0 * abs(to - now) / (end - begin)
                broken.append(f"log {number}, {begin:g} s: {rate:.3g} K/min is too fast")
        for setting in log.settings:
            where = f"log {number}, {setting.from_s:g} s"
            to = setting.temperature_degC
            if not limits.low_degC - 1e-9 <= to <= limits.high_degC + 1e-9:
                broken.append(f"{where}: {to:g} degC is outside the chamber's range")
            for name, load in setting.loads.items():
                reach = limits.loads[name]
                if not min(0.0, reach.low) - 1e-9 <= load <= max(0.0, reach.high) + 1e-9:
                    broken.append(f"{where}: {name} = {load:g} cannot be put on")
            for name, value in setting.inputs.items():
                if not limits.inputs[name].low - 1e-9 <= value <= limits.inputs[name].high + 1e-9:
                    broken.append(f"{where}: {name} = {value:g} cannot be set")
    return broken
