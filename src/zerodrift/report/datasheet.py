"""TK0, TKC, creep, hysteresis, repeatability: before and after compensation, as datasheets have it.

Each output's drift, and then its residual after compensation, is described by the same few columns:
an offset of each run, T - T0, the load, (T - T0) load, and the creeping load. For span and creep
the drift's bend with temperature and its lag are described too (powers of T - T0 up to the third, T
against T late by `LAGS_S`), since they are much larger than creep and would pass for it. Runs are
the unit of evidence, so standard uncertainties come from how runs differ.

The drift before compensation is the sensor's own and is taken from all runs; the residual after it
is taken from held-out runs where there are any.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.summary import ComparisonSummary
from zerodrift.operations.lowpass import lowpass
from zerodrift.report.findings import Trace, find_threshold
from zerodrift.verify.summary import StatedUncertainty

# Repeatability: how far readings of one load lie apart, put on again at the same temperature.
#
# A reading is the mean of the drift from `FROM_S` to `TO_S` after a load was put on, while neither
# load nor temperature moves. Readings are compared where load, temperature, and the way that the
# load was reached (from below, from above, with the run's begin) are the same; what the zero's and
# the span's own slopes make of the little that temperatures differ is taken off. The figure is the
# largest difference within such a group, the pooled standard deviation is told beside it. Unless
# logs are tared, no run's offset is taken off: what a sensor loses between two runs is part of how
# it repeats.
#
# Source: OIML R 60-1:2021, repeatability error: the difference between readings of consecutive
# tests under the same loading and environmental conditions.

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


# TK0, TKC, creep, hysteresis, repeatability: before and after compensation, as datasheets have it.

MOST_ROWS = 60_000
"""More samples than that are averaged in blocks."""
CREEP_TAUS_S = tuple(float(t) for t in np.geomspace(30.0, 3600.0, 15).round())
CREEP_AT_S = 1800.0
PER_K = 10.0
LEAST_LOAD = 0.01
"""Share of full scale by which a load must move."""
LEAST_SPAN_K = 5.0
"""By how much the temperature must move."""
BINS = 12
TK0, TKC, CREEP = 0, 2, 3
"""Columns among those behind the runs' offsets: T, load, T load, creep, then the bends."""
LAGS_S = (30.0, 120.0, 480.0)


UNCERTAINTY = "expanded uncertainty (k = 2)"
NOT_REPEATED = (
    "not shown by these logs: no load is put on again, the same way and within "
    f"{STILL_K:g} K of the same temperature, and held for {TO_S:g} s"
)
BEFORE, AFTER = "before", "after"
"""Compensation."""


@dataclass(frozen=True)
class DatasheetRow:
    """One figure of the datasheet."""

    quantity: str
    output: str
    unit: str
    note: str
    """How the figure came about, or why there is none."""
    before: tuple[float, float | None] | None = None
    """Value and standard uncertainty, which is None where runs do not tell it; None where these
    logs do not tell the value."""
    after: tuple[float, float | None] | None = None


@dataclass(frozen=True)
class _Block:
    """One run, averaged in blocks."""

    period_s: float
    rise_K: Array
    rate: Array
    moving: float
    """Rate in K/min above which the run heats, and below minus which it cools."""
    load: Array
    """[K, n]."""
    before: Array
    """[K, n]."""
    after: Array
    """[K, n]."""


def measure_datasheet(
    traces: Sequence[Trace],
    compared: ComparisonSummary,
    stated: Mapping[str, StatedUncertainty] | None = None,
) -> list[DatasheetRow]:
    """Return the datasheet's figures of each output.

    Args:
        traces: the runs.
        compared: what `compare` found, for units and full scale.
        stated: output -> the uncertainty of its compensated value, by the last firmware.

    Returns:
        Six rows of each output.
    """
    block = -(-sum(t.time_s.size for t in traces) // MOST_ROWS)
    middle = float(np.mean([t.temperature_degC.mean() for t in traces]))
    moving = find_threshold(traces)
    blocks = [_average(t, block, round(middle), moving) for t in traces]
    held_out = [b for b, t in zip(blocks, traces, strict=True) if t.held_out] or blocks
    rows: list[DatasheetRow] = []
    for k, (name, told) in enumerate(compared.outputs.items()):
        full_scale = float(told.full_scale)
        figures, slopes = _measure_output({BEFORE: blocks, AFTER: held_out}, k, name, full_scale)
        rows += figures
        rows.append(_tell_repeatability(traces, k, name, full_scale, slopes))
        rows.append(_state_uncertainty(name, told.unit, (stated or {}).get(name)))
    return rows


def _state_uncertainty(name: str, unit: str, stated: StatedUncertainty | None) -> DatasheetRow:
    """Return the expanded uncertainty of an output, its causes in the note."""
    if stated is None:
        why_not = (
            "not told: `zerodrift firmware` states it, of a current firmware, from runs left out"
        )
        return DatasheetRow(UNCERTAINTY, name, unit, why_not)
    causes = ("noise", "parameters", "left_out", "rounding")
    parts = ", ".join(f"{cause.replace('_', ' ')} {getattr(stated, cause):.2g}" for cause in causes)
    return DatasheetRow(
        UNCERTAINTY, name, unit, f"standard uncertainties: {parts}", None, (stated.expanded, None)
    )


def _average(trace: Trace, block: int, reference_degC: float, moving: float) -> _Block:
    def mean(x: Array) -> Array:
        count = x.shape[-1] // block
        return np.asarray(
            x[..., : count * block].reshape(*x.shape[:-1], count, block).mean(axis=-1)
        )

    return _Block(
        trace.sample_period_s * block,
        mean(trace.temperature_degC) - reference_degC,
        mean(trace.rate_K_per_min),
        moving,
        mean(trace.load),
        mean(trace.drift),
        mean(trace.error),
    )


def _measure_output(
    sides: Mapping[str, Sequence[_Block]], k: int, name: str, full_scale: float
) -> tuple[list[DatasheetRow], Mapping[str, "_SlopeFit"]]:
    blocks = sides[BEFORE]
    loaded = max(float(np.ptp(b.load[k])) for b in blocks) >= LEAST_LOAD * full_scale
    moved = max(float(np.ptp(b.rise_K)) for b in blocks) >= LEAST_SPAN_K
    tau_s = _choose_tau(blocks, k) if loaded else 0.0
    slopes = {w: _fit(b, k, w, loaded=loaded, tau_s=tau_s) for w, b in sides.items()}
    bent = {w: _fit(b, k, w, loaded=loaded, tau_s=tau_s, bends=True) for w, b in sides.items()}
    percent = 100.0 / full_scale
    how = f"mean slope; {len(blocks)} runs before, {len(sides[AFTER])} after"
    still = f"the temperature moves by less than {LEAST_SPAN_K:g} K in a run"
    unloaded = "no load that moves in these logs"
    grown = 100.0 * (1.0 - float(np.exp(-CREEP_AT_S / tau_s))) if loaded else 0.0

    def tell(
        quantity: str,
        unit: str,
        column: int | None,
        factor: float,
        note: str,
        why_not: str,
        fits: Mapping[str, _SlopeFit],
    ) -> DatasheetRow:
        if why_not or column is None:
            return DatasheetRow(quantity, name, unit, f"not told: {why_not}" if why_not else note)
        before, after = (
            _pair(fit.value[column] * factor, fit.error[column] * abs(factor))
            for fit in (fits[BEFORE], fits[AFTER])
        )
        return DatasheetRow(quantity, name, unit, note, before, after)

    no_span = still if not moved else "" if loaded else unloaded
    rows = [
        tell("TK0", "%FS/10 K", TK0, PER_K * percent, how, "" if moved else still, slopes),
        tell("TKC", "% of reading/10 K", TKC, 100.0 * PER_K, how, no_span, bent),
        tell(
            "creep, 30 min",
            "% of load",
            CREEP,
            grown,
            f"retardation time {tau_s:g} s",
            "" if loaded else unloaded,
            bent,
        ),
    ]
    row = tell(
        "temperature hysteresis",
        "%FS",
        None,
        percent,
        "heating − cooling, lag included",
        "" if moved else still,
        slopes,
    )
    if moved:
        loops = {which: _measure_loop(sides[which], fit) for which, fit in slopes.items()}
        before, after = (
            None if loop is None else _pair(loop[0] * percent, loop[1] * percent)
            for loop in (loops[BEFORE], loops[AFTER])
        )
        row = replace(row, before=before, after=after)
        if before is None:
            why_not = "not told: no run passes one temperature both heating and cooling"
            row = replace(row, note=why_not)
    return [*rows, row], slopes


def _tell_repeatability(
    traces: Sequence[Trace],
    k: int,
    name: str,
    full_scale: float,
    slopes: Mapping[str, "_SlopeFit"],
) -> DatasheetRow:
    """Return the largest difference of readings that repeat a load; after it of held-out runs."""
    held_out = [t for t in traces if t.held_out] or traces
    percent = 100.0 / full_scale
    before, after = (
        measure_repeatability(
            runs,
            k,
            full_scale,
            compensated=which == AFTER,
            slopes=(float(slopes[which].value[TK0]), float(slopes[which].value[TKC])),
        )
        for which, runs in ((BEFORE, traces), (AFTER, held_out))
    )
    row = DatasheetRow("repeatability", name, "%FS", NOT_REPEATED)
    if before is None:
        return row
    note = (
        f"largest difference; {before.readings} readings that repeat "
        f"{before.groups} load{'s' if before.groups > 1 else ''} at one temperature, "
        f"standard deviation {before.deviation * percent:.2g} %FS"
    )
    if after is None:
        note += "; after: not shown by the held-out runs"
        return replace(row, note=note, before=(before.largest * percent, None))
    note += f" before, {after.deviation * percent:.2g} %FS after ({after.readings} readings)"
    first, second = (one.largest * percent for one in (before, after))
    return replace(row, note=note, before=(first, None), after=(second, None))


def _pair(value: float, error: float) -> tuple[float, float | None]:
    """Return a value and its uncertainty; null for one that runs do not tell."""
    return float(value), float(error) if np.isfinite(error) else None


@dataclass(frozen=True)
class _SlopeFit:
    value: Array
    """[4] of T, load, T load, creep; zeros for columns that are not there."""
    error: Array
    """[4] standard uncertainties."""
    square: float
    """Sum of squares of what is left."""
    rests: tuple[Array, ...]
    """What the load's columns and offsets leave of each run: drift with temperature, and noise."""


def _columns(block: _Block, k: int, *, loaded: bool, tau_s: float, bends: bool) -> Array:
    """Return the columns [n, 1 to 9] of one run."""
    rise, load = block.rise_K, block.load[k]
    columns = [rise]
    if loaded:
        columns += [load, rise * load, lowpass(load, block.period_s, tau_s)]
    if bends:
        columns += [rise**2, rise**3]
        columns += [rise - lowpass(rise, block.period_s, tau) for tau in LAGS_S]
    return np.stack(columns, axis=1)


def _fit(
    blocks: Sequence[_Block],
    k: int,
    which: str,
    *,
    loaded: bool,
    tau_s: float,
    bends: bool = False,
) -> _SlopeFit:
    """Return the least-squares fit with an offset for each run."""
    designs, targets = [], []
    for block in blocks:
        x, y = _columns(block, k, loaded=loaded, tau_s=tau_s, bends=bends), getattr(block, which)[k]
        designs.append(x - x.mean(axis=0))
        targets.append(y - y.mean())
    design, target = np.concatenate(designs), np.concatenate(targets)
    scale = np.maximum(np.abs(design).max(axis=0), 1e-300)
    inverse = np.linalg.pinv((design / scale).T @ (design / scale), rcond=1e-10)
    solution = inverse @ ((design / scale).T @ target)
    left = [y - (x / scale) @ solution for x, y in zip(designs, targets, strict=True)]
    pushes = np.stack([(x / scale).T @ e for x, e in zip(designs, left, strict=True)])
    runs = len(blocks)
    spread = np.full(solution.size, np.inf)
    if runs > 1:
        meat = pushes.T @ pushes * runs / (runs - 1)
        spread = np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), 0.0))
    value, error = np.zeros(4), np.full(4, np.inf)
    told = 4 if loaded else 1
    value[:told], error[:told] = (solution / scale)[:told], (spread / scale)[:told]
    rests = tuple(y - x[:, 1:told] @ value[1:told] for x, y in zip(designs, targets, strict=True))
    return _SlopeFit(value, error, float(sum(e @ e for e in left)), rests)


def _choose_tau(blocks: Sequence[_Block], k: int) -> float:
    """Return the retardation time that describes the uncompensated drift best."""
    slowest = max(b.period_s for b in blocks)
    known = [tau for tau in CREEP_TAUS_S if tau > slowest] or [2.0 * slowest]
    squares = [_fit(blocks, k, BEFORE, loaded=True, tau_s=tau, bends=True).square for tau in known]
    return known[int(np.argmin(squares))]


def _measure_loop(blocks: Sequence[_Block], fit: _SlopeFit) -> tuple[float, float] | None:
    """Return the largest mean difference of the two branches, and its standard uncertainty."""
    low = min(float(b.rise_K.min()) for b in blocks)
    high = max(float(b.rise_K.max()) for b in blocks)
    edges = np.linspace(low, high, BINS + 1)[1:-1]
    differences = np.full((len(blocks), BINS), np.nan)
    for row, (block, rest) in enumerate(zip(blocks, fit.rests, strict=True)):
        # Within a bin the branches may sit at different temperatures: take the slope off first.
        flat = rest - fit.value[TK0] * (block.rise_K - block.rise_K.mean())
        bins = np.searchsorted(edges, block.rise_K)
        for number in range(BINS):
            heating = flat[(bins == number) & (block.rate > block.moving)]
            cooling = flat[(bins == number) & (block.rate < -block.moving)]
            if heating.size and cooling.size:
                differences[row, number] = heating.mean() - cooling.mean()
    counts = np.sum(~np.isnan(differences), axis=0)
    if not counts.any():
        return None
    wanted = max(2, int(counts.max()) // 2) if counts.max() > 1 else 1
    kept = differences[:, counts >= wanted]
    means = np.nanmean(kept, axis=0)
    place = int(np.argmax(np.abs(means)))
    own = kept[:, place][~np.isnan(kept[:, place])]
    error = float(own.std(ddof=1) / np.sqrt(own.size)) if own.size > 1 else float("inf")
    return abs(float(means[place])), error
