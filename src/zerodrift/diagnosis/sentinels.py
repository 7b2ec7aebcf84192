"""Values that stand for none: one value far off that recurs exactly, and rows that spike.

A recorder that has no reading writes one fixed value: -127 (DS18B20, no answer), 85 (DS18B20 after
power-on), -200, 9999. Noise never meets one value again far from its neighbours, so no list of such
values is needed.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.resolution import measure_code
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.data_notes import DataNote

RECURS = 3
"""Rows with the value, at least: two single rows may be the two ends of one disturbance."""
VISITS = 5
"""Times that an input or a load must be there and back, as both are switched."""
FAR = 4.0
"""How many times further from its neighbours, and from all other values, than other neighbours are
from each other, ..."""
ORDINARY, MOST_EDGES = 0.995, 0.9
"""... but for the few steps of a load, and of the few places where the column was near the value
anyway."""
APART = 0.5
"""Share of all others' range that a value met in one stand alone lies away from them."""
ALONE = 0.5
"""Share of a jump that a load beside it does not make too."""
OFTENER = 5.0
"""Times that a value among others is met more often than any of these."""
MOST_VALUES = 4
"""Different values for none in one column."""
LEAST_OTHERS = 0.3
"""Share of the rows that must hold other values."""
DISTINCT = 8
"""Fewer different values among the others are the codes of a coarse converter."""
CHANCE = 0.01
"""An output's rows that spike hold more of the squares of its drift than all else does: fewer and
smaller ones are what drift covers (`benchmarks.evidence`, the condition outliers_2). Of the rows
that spike in all logs, chance brings so many into this run with this probability at most, and no
other run has as large a share of them. ..."""
HIGH = 20.0
"""... They are single rows that stand out of both neighbours by so many usual steps."""
HEIGHT_K, STEPS = 5.0, 30.0
"""A thermometer, which has a heat capacity, does not go there and back within a row by so many
kelvin and usual steps."""
FEWEST_SPIKES = 3


def find_sentinels(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on columns in which one value far off recurs exactly."""
    notes = []
    tables = [_list_columns(run, outputs) for run in runs]
    for run, columns in zip(runs, tables, strict=True):
        for name, (x, beside) in columns.items():
            is_switched = name in run.inputs or name.startswith("reference of ")
            visits = VISITS if is_switched else 1
            elsewhere = [
                table[name][0]
                for other, table in zip(runs, tables, strict=True)
                if other.group != run.group and name in table
            ]
            note = _tell(run, name, list_sentinels(x, beside, visits, elsewhere))
            notes += [note] if note is not None else []
    return notes


def _list_columns(run: Run, outputs: Sequence[str]) -> dict[str, tuple[Array, Array | None]]:
    """Return each column [n] of a run by its name, and what it follows."""
    columns: dict[str, tuple[Array, Array | None]] = {
        "temperature": (run.temperature_degC, None),
        **{name: (run.inputs[name], None) for name in sorted(run.inputs) if name != "clock"},
    }
    for k, name in enumerate(outputs):
        columns[name] = (run.measured[:, k], run.reference[:, k])
        columns[f"reference of {name}"] = (run.reference[:, k], run.measured[:, k])
    return columns


def list_sentinels(
    x: Array,
    beside: Array | None = None,
    visits: int = 1,
    elsewhere: Sequence[Array] = (),
) -> list[tuple[float, Mask]]:
    """Return (value, rows [n]) of each value that stands for none in a column [n].

    Args:
        x: the column.
        beside: what it follows, a load and what is measured of it; None: nothing.
        visits: how many times it must be there at least.
        elsewhere: the same column of other runs.
    """
    found: list[tuple[float, Mask]] = []
    kept = np.ones(x.size, dtype=np.bool_)
    for _ in range(MOST_VALUES):
        for end in _list_candidates(x[kept]):
            rows = kept & (x == end)
            starts = int(rows[0]) + int(np.count_nonzero(rows[1:] & ~rows[:-1]))
            if starts >= visits and _is_sentinel(x, beside, rows, kept & ~rows, elsewhere):
                found.append((float(end), rows))
                kept &= ~rows
                break
        else:
            break
    return found


def _list_candidates(x: Array) -> list[float]:
    """Return the values that may stand for none: both ends, and one that is met most often."""
    values, counts = np.unique(x, return_counts=True)
    candidates = [float(values[-1]), float(values[0])]
    order = np.argsort(-counts, kind="stable")[:2]
    if order.size == 2 and counts[order[0]] >= OFTENER * counts[order[1]]:
        candidates.append(float(values[order[0]]))
    return candidates


def _is_sentinel(
    x: Array, beside: Array | None, rows: Mask, others: Mask, elsewhere: Sequence[Array]
) -> bool:
    """Return whether some rows [n], all of one value, jump away from all others and back.

    The row next to one may be interpolated between it and its neighbour, where a log is resampled:
    it is passed over.
    """
    count = int(rows.sum())
    others = others & (np.convolve(rows, [1, 0, 1], "same") == 0)
    if count < RECURS or int(others.sum()) < max(LEAST_OTHERS * x.size, 2 * DISTINCT):
        return False
    kept = np.flatnonzero(others)
    level = x if beside is None else x - beside
    usual = np.abs(np.diff(level[kept]))
    if np.unique(x[kept]).size < DISTINCT:
        return False
    both = (rows[:-2] & others[2:]) | (others[:-2] & rows[2:])
    if not both.any():
        return False
    across, apart_from = np.abs(x[2:] - x[:-2])[both], np.abs(level[2:] - level[:-2])[both]
    if float(np.median(apart_from / np.maximum(across, 1e-300))) < ALONE:
        return False
    jumps = np.minimum(across, apart_from)  # of two rows, one of which is ordinary
    # A column that rests most of the time still moves by its usual step.
    ordinary = max(float(np.quantile(usual, ORDINARY)), float(np.median(usual[usual > 0.0])))
    value = float(x[rows][0])
    apart = float(np.abs(x[kept] - value).min())
    low, high = float(x[kept].min()), float(x[kept].max())
    if np.count_nonzero(np.diff(np.flatnonzero(rows)) > 1) == 0:
        # One stand near all other values: the column stopped there, or rests. One that begins or
        # ends the log shows one edge only, so that other runs' values count too.
        near = [x[kept], *(elsewhere if rows[0] or rows[-1] else ())]
        reach = [min(map(np.min, near)), max(map(np.max, near))]
        if max(reach[0] - value, value - reach[1]) < APART * (reach[1] - reach[0]):
            return False
    among = low < value < high
    return bool(
        np.quantile(jumps, 1.0 - MOST_EDGES, method="lower") > (FAR + 1.0) * ordinary
        and (among or apart > FAR * ordinary)
    )


def _tell(run: Run, name: str, found: Sequence[tuple[float, Mask]]) -> DataNote | None:
    if not found:
        return None
    every = np.flatnonzero(np.logical_or.reduce([rows for _, rows in found]))
    values = ", ".join(f"{value:.6g} in {int(rows.sum())}" for value, rows in found)
    stated = ", ".join(f"{value:.6g}" for value, _ in found)
    text = (
        f"holds {values} of {len(run)} rows, far off from all others and exactly the same: the "
        f"recorder had no reading there. State it: [logs] missing = [{stated}]"
    )
    return DataNote(run.group, name, (int(every[0]), int(every[-1])), "sentinel", text)


def find_spikes(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on runs with more rows that spike than chance brings there from all runs."""
    notes = []
    for run in runs:
        usual = float(np.median(np.abs(np.diff(run.temperature_degC))))
        rows = _list_peaks(run.temperature_degC, max(HEIGHT_K, STEPS * usual))
        if rows.size >= FEWEST_SPIKES:
            notes.append(_tell_spikes(run, "temperature", rows, run.temperature_degC))
    for k, name in enumerate(outputs):
        found = [_list_drift_peaks(run, k) for run in runs]
        shares = _share_peaks(runs, k, found)
        counts = {group: np.zeros(2) for group in shares}
        for run, rows in zip(runs, found, strict=True):
            counts[run.group] += (rows.size, len(run))
        total, every = np.sum(list(counts.values()), axis=0) if counts else (0.0, 1.0)
        for group, (count, length) in counts.items():
            rates = [spikes / rows for other, (spikes, rows) in counts.items() if other != group]
            by_chance = float(binom.sf(count - 1, total, length / every))
            # With no other log nothing says what is usual.
            stands_out = not rates or (count / length > max(rates) and by_chance <= CHANCE)
            if count >= FEWEST_SPIKES and shares[group] > 1.0 and stands_out:
                mine = [i for i, run in enumerate(runs) if run.group == group]
                i = max(mine, key=lambda i: found[i].size)
                notes.append(_tell_spikes(runs[i], name, found[i], runs[i].measured[:, k]))
    return notes


def _list_drift_peaks(run: Run, k: int) -> NDArray[np.intp]:
    drift = run.drift[:, k]
    steps = np.abs(np.diff(drift))
    usual = float(np.median(steps[steps > 0.0])) if steps.any() else 0.0
    usual = max(usual, float(run.resolution[k]))
    if (peaks := _list_peaks(drift, HIGH * usual)).size == 0:
        return peaks
    # A coarse converter at rest still moves by its step, beside a reference that is finer.
    return _list_peaks(drift, HIGH * max(usual, measure_code(run.measured[:, k])))


def _share_peaks(
    runs: Sequence[Run], k: int, found: Sequence[NDArray[np.intp]]
) -> dict[str, float]:
    """Return per run the squares by which its spikes stand out, over those of its other rows."""
    spikes: dict[str, float] = {}
    others: dict[str, float] = {}
    for run, rows in zip(runs, found, strict=True):
        drift = run.drift[:, k]
        away = drift[rows] - 0.5 * (drift[rows - 1] + drift[rows + 1])
        rest = np.delete(drift, rows) - np.median(drift)
        # Where rows are averages, one beside a spike holds a part of it.
        rest = np.clip(rest, *np.quantile(rest, [0.05, 0.95]))
        spikes[run.group] = spikes.get(run.group, 0.0) + float(away @ away)
        others[run.group] = others.get(run.group, 0.0) + float(rest @ rest)
    return {group: spikes[group] / max(others[group], 1e-300) for group in spikes}


def _list_peaks(x: Array, least: float) -> NDArray[np.intp]:
    """Return the rows that stand out of both neighbours by more than `least`, which is not 0."""
    steps = np.diff(x)
    up, down = steps[:-1], -steps[1:]
    height = np.minimum(np.abs(up), np.abs(down))
    return np.flatnonzero((up * down > 0.0) & (height > max(least, 1e-300))) + 1


def _tell_spikes(run: Run, name: str, rows: NDArray[np.intp], values: Array) -> DataNote:
    kind, text = tell_wild(values[rows], len(run))
    return DataNote(run.group, name, (int(rows[0]), int(rows[-1])), kind, text)


def tell_wild(values: Array, rows: int) -> tuple[str, str]:
    """Return kind and text for the values of single rows far off: of one value they are none.

    Args:
        values: [m] what the column reads there.
        rows: of the whole run.
    """
    kinds, counts = np.unique(values, return_counts=True)
    most, value = int(counts.max()), float(kinds[counts.argmax()])
    if most >= max(RECURS, 0.5 * values.size):
        return "sentinel", (
            f"holds {value:.6g} in {most} of {rows} rows, far off from the rows before and behind: "
            f"the recorder had no reading there. State it: [logs] missing = [{value:.6g}]"
        )
    return "spikes", (
        f"{values.size} of {rows} rows are far off from the rows before and behind, with no "
        "cause in the logs: spikes of the recorder. Leave them out ([logs] missing, or the rows), "
        "or record the run again"
    )
