"""Repeatability: how far readings of one load lie apart, put on again at the same temperature.

A reading is the mean of the drift from `FROM_S` to `TO_S` after a load was put on, while neither
load nor temperature moves. Readings are compared where load, temperature, and the way that the load
was reached (from below, from above, with the run's begin) are the same; what the zero's and the
span's own slopes make of the little that temperatures differ is taken off. The figure is the
largest difference within such a group, the pooled standard deviation is told beside it. Unless logs
are tared, no run's offset is taken off: what a sensor loses between two runs is part of how it
repeats.

Source: OIML R 60-1:2021, repeatability error: the difference between readings of consecutive tests
under the same loading and environmental conditions.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.report.findings import Trace

FROM_S, TO_S = 20.0, 60.0
"""After the load moved; at least `LEAST_SAMPLES` samples later for slow logs."""
LEAST_SAMPLES = 3
STEP = 0.005
"""Share of full scale by which a load that stays may wander, and equal loads may differ."""
LOADED = 0.01
"""Share of full scale from which a load is one."""
STILL_K = 1.0
"""By how much the temperature may move under a reading, and between readings compared."""


@dataclass(frozen=True)
class Repeatability:
    """What readings that repeat a load tell, in the output's unit."""

    largest: float
    """Largest difference of two readings in a group."""
    deviation: float
    """Pooled standard deviation within the groups."""
    readings: int
    groups: int


@dataclass(frozen=True)
class _Reading:
    way: int
    """1: load reached from below, -1: from above, 0: it stood at the run's begin."""
    load: float
    temperature_degC: float
    value: float


def measure_repeatability(
    traces: Sequence[Trace],
    k: int,
    full_scale: float,
    *,
    compensated: bool,
    slopes: tuple[float, float],
) -> Repeatability | None:
    """Return how an output repeats; None where no load is repeated at one temperature.

    Args:
        traces: the runs.
        k: the output.
        full_scale: of the output, in its unit.
        compensated: readings of the error after compensation, not of the drift.
        slopes: of the zero, in the output's unit per K, and of the span, per K.
    """
    readings = [
        reading
        for trace in traces
        for reading in _read_trace(trace, k, full_scale, compensated=compensated)
    ]
    zero, span = slopes
    largest, squares, freedom, count, groups = 0.0, 0.0, 0, 0, 0
    for group in _group(readings, full_scale):
        middle = float(np.mean([reading.temperature_degC for reading in group]))
        values = np.array(
            [r.value - (zero + span * r.load) * (r.temperature_degC - middle) for r in group]
        )
        largest = max(largest, float(np.ptp(values)))
        squares += float(np.sum((values - values.mean()) ** 2))
        freedom += len(group) - 1
        count += len(group)
        groups += 1
    if not groups:
        return None
    return Repeatability(largest, float(np.sqrt(squares / freedom)), count, groups)


def _read_trace(trace: Trace, k: int, full_scale: float, *, compensated: bool) -> list[_Reading]:
    """Return the readings of one run."""
    period = trace.sample_period_s
    first = max(int(np.ceil(FROM_S / period)), 1)
    last = max(int(np.ceil(TO_S / period)), first + LEAST_SAMPLES)
    load = trace.load[k]
    shown = (trace.error if compensated else trace.drift)[k]
    gaps = np.diff(trace.time_s) > 1.5 * period
    broken = np.concatenate([[0], np.cumsum(gaps)])
    readings = []
    for begin in _find_holds(load, STEP * full_scale, last):
        part = slice(begin + first, begin + last)
        temperature = trace.temperature_degC[begin : begin + last]
        own = float(np.mean(load[part]))
        if broken[begin] != broken[begin + last - 1]:
            continue
        if abs(own) < LOADED * full_scale or np.ptp(temperature) > STILL_K:
            continue
        way = 0
        if begin and broken[begin - 1] == broken[begin]:
            earlier = load[max(begin - last, 0) : begin]
            if np.max(np.abs(earlier - own)) < LOADED * full_scale:
                continue  # the load wandered here; it was not put on
            way = int(np.sign(own - earlier[-1]))
        mean = float(np.mean(trace.temperature_degC[part]))
        readings.append(_Reading(way, own, mean, float(np.mean(shown[part]))))
    return readings


def _find_holds(load: Array, tolerance: float, least: int) -> list[int]:
    """Return where holds begin: `least` samples in which the load stays within the tolerance."""
    holds, begin = [], 0
    while begin + least <= load.size:
        moved = np.abs(load[begin : begin + least] - load[begin]) > tolerance
        if moved.any():
            begin += int(np.argmax(moved))
            continue
        holds.append(begin)
        width = least
        while True:
            moved = np.abs(load[begin : begin + width] - load[begin]) > tolerance
            if moved.any():
                begin += int(np.argmax(moved))
                break
            if begin + width >= load.size:
                return holds
            width *= 2
    return holds


def _group(readings: Sequence[_Reading], full_scale: float) -> list[list[_Reading]]:
    """Return the readings that repeat a load, in groups of two at least."""
    groups: list[list[_Reading]] = []
    for way in (-1, 0, 1):
        own = sorted((r for r in readings if r.way == way), key=lambda r: r.load)
        for level in _split(own, [r.load for r in own], STEP * full_scale):
            level.sort(key=lambda r: r.temperature_degC)
            groups += _split(level, [r.temperature_degC for r in level], STILL_K)
    return [group for group in groups if len(group) > 1]


def _split(
    readings: Sequence[_Reading], values: Sequence[float], width: float
) -> list[list[_Reading]]:
    """Return sorted readings in groups whose values lie within a width."""
    groups: list[list[_Reading]] = []
    lowest = 0.0
    for reading, value in zip(readings, values, strict=True):
        if not groups or value - lowest > width:
            groups.append([])
            lowest = value
        groups[-1].append(reading)
    return groups
