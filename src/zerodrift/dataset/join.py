"""Joins the files of one run on time: loggers with rates, jitter and clocks of their own.

The rows are those of the fastest file; the others are interpolated linearly between their rows.
Nothing is extrapolated: where one of them is interrupted, or has not begun, there are no rows.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, locate_key
from zerodrift.base.errors import InputError
from zerodrift.dataset.checks import check_period
from zerodrift.dataset.clock_difference import ClockDifference, measure_difference
from zerodrift.dataset.logs import COMMON
from zerodrift.dataset.resample import find_gaps
from zerodrift.dataset.sampling import COARSEST
from zerodrift.dataset.tables import LogTable
from zerodrift.dataset.time_units import is_unix, write_local

QUARTER_S = 900.0
"""Zones differ by whole quarters of an hour."""
ONE_CLOCK = (
    "files that are joined are taken by one clock where nothing says otherwise: an offset between "
    "their clocks cannot be told from a lag of the same size; [logs] offset_s states one"
)


def join_tables(
    config: Config, tables: Sequence[LogTable], label: str, notes: list[str]
) -> LogTable:
    """Return the files of one run as one table, on the rows of the fastest.

    Args:
        config: the project.
        tables: one per file, values and times checked.
        label: how messages name the run.
        notes: gets what the user should know.

    Raises:
        InputError: their times are of different kinds, do not overlap, or one is too coarse.
    """
    if len(tables) == 1:
        return tables[0]
    time = config.time_column
    _refuse_mixed_clocks(config, tables, label)
    median_s = [_median_step(table.columns[time]) for table in tables]
    setting = locate_key(config.path, "sensor", "sample_period_s")
    for table, median in zip(tables, median_s, strict=True):
        check_period(table.source.label, median, config.sample_period_s, COARSEST, setting)
    order = np.argsort(median_s, kind="stable")
    base, others = tables[int(order[0])], [tables[int(i)] for i in order[1:]]
    _compare_clocks(config, base, others, notes)
    kept = _find_common_rows(config, base, others, label)
    if not kept.any():
        raise InputError(_explain_apart(config, tables, label))
    rows = ", ".join(
        f"{table.source.name} (a row every {median:.4g} s)"
        for table, median in zip(tables, median_s, strict=True)
    )
    left = int(kept.size - kept.sum())
    alone = "one row" if left == 1 else f"{left} rows"
    more = f"; {alone} of {base.source.name} without the others left out" if left else ""
    notes.append(f"{label}: {rows} joined on time{more}")
    at_s = base.columns[time][kept]
    base.take(kept)
    joined, logged = dict(base.columns), dict(base.logged)
    joined.pop(COMMON, None)
    for other in others:
        other_s = other.columns[time]
        for name, values in other.columns.items():
            if name not in (time, COMMON):
                joined[name] = np.interp(at_s, other_s, values)
        logged |= {name: np.interp(at_s, other_s, own) for name, own in other.logged.items()}
    return replace(base, columns=joined, logged=logged)


def _median_step(time_s: Array) -> float:
    return float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0


def _find_common_rows(
    config: Config, base: LogTable, others: Sequence[LogTable], label: str
) -> "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]":
    """Return which rows [n] of the base lie where every other file has rows around them."""
    time_s = base.columns[config.time_column]
    kept = np.ones(time_s.size, dtype=np.bool_)
    for other in others:
        other_s = other.columns[config.time_column]
        kept &= (time_s >= other_s[0]) & (time_s <= other_s[-1])
        for row in find_gaps(other_s, _median_step(other_s), config.sample_period_s):
            kept &= (time_s <= other_s[row]) | (time_s >= other_s[row + 1])
    return kept


def _refuse_mixed_clocks(config: Config, tables: Sequence[LogTable], label: str) -> None:
    """Refuse a local clock beside one that counts from 1970, as their zone is not known."""
    kinds = [_tell_scale(config, table) for table in tables]
    if "local" not in kinds or len(set(kinds)) == 1:
        return
    local = tables[kinds.index("local")]
    other = next(t for t, kind in zip(tables, kinds, strict=True) if kind != "local")
    zone = propose_zone(local.columns[config.time_column], other.columns[config.time_column])
    hint = f'; zone = "{zone}" would make them overlap best' if zone else ""
    begin = local.columns[config.time_column][0]
    raise InputError(
        f"{label}: {local.source.name} is by a local clock (it begins at "
        f"{write_local(begin)}), {other.source.name} counts from 1970 in UTC; expected times "
        f"of one kind. State where the clock stood: [sensor] time = {{ column = "
        f'"{config.time.columns[0]}", zone = "Europe/Berlin" }}{hint}.'
    )


def _tell_scale(config: Config, table: LogTable) -> str:
    """Return what a file's times count from: utc | local | own (day, row, power-on)."""
    clock = table.clock
    if clock is None or clock.kind in ("day", "rows"):
        return "own"
    if clock.kind == "number":
        first = float(table.columns[config.time_column][0])
        return "utc" if is_unix(first) else "own"
    return "utc" if clock.is_absolute else "local"


def propose_zone(local_s: Array, utc_s: Array) -> str:
    """Return the difference to UTC at which a local log overlaps another most; empty: none does.

    Of equal overlaps, the one at which the two begin closest together.
    """
    best, most = "", 0.0
    apart = np.inf
    for quarters in range(-48, 57):
        shift_s = QUARTER_S * quarters
        begin = max(local_s[0] - shift_s, utc_s[0])
        shared_s = float(min(local_s[-1] - shift_s, utc_s[-1]) - begin)
        away_s = abs(float(local_s[0] - shift_s - utc_s[0]))
        if shared_s > most + 1e-6 or (shared_s > 0 and shared_s >= most - 1e-6 and away_s < apart):
            hours, minutes = divmod(abs(quarters) * 15, 60)
            best = f"{'-' if quarters < 0 else '+'}{hours:02d}:{minutes:02d}"
            most, apart = max(most, shared_s), away_s
    return best


def _compare_clocks(
    config: Config, base: LogTable, others: Sequence[LogTable], notes: list[str]
) -> None:
    """Bring the others to the base's clock where both record one quantity; add a note either
    way."""
    time = config.time_column
    is_told = False
    for other in others:
        stated = config.clocks.offset_s(other.source.path)
        if COMMON not in base.columns or COMMON not in other.columns:
            is_told |= stated is not None
            continue
        is_told = True
        difference = measure_difference(
            base.columns[time], base.columns[COMMON], other.columns[time], other.columns[COMMON]
        )
        name, first = other.source.label, base.source.name
        if difference is None or not difference.is_credible:
            why = "" if difference is None else _tell_unlike(difference)
            notes.append(
                f"{name}: the clock's difference to {first} is not known from [logs] common{why}; "
                "taken as none"
            )
            continue
        other.columns[time] = difference.apply(other.columns[time])
        notes.append(
            f"{name}: its clock is brought to that of {first} by {difference.describe()}, found by "
            "[logs] common; a lag between the two sensors cannot be told from an offset of the "
            "same size"
        )
    if not is_told and any(other.source.path != base.source.path for other in others):
        notes.append(ONE_CLOCK)


def _tell_unlike(difference: ClockDifference) -> str:
    share = max(difference.explained, 0.0)
    return f", as one explains only {100 * share:.3g} % of the other's changes"


def _explain_apart(config: Config, tables: Sequence[LogTable], label: str) -> str:
    spans = "; ".join(
        f"{table.source.name} from {_write(table.columns[config.time_column][0])} to "
        f"{_write(table.columns[config.time_column][-1])}"
        for table in tables
    )
    return (
        f"{label}: its files do not overlap in time: {spans}; expected rows of the same time. "
        f'Correct [sensor] time (unit, zone), or state [logs] offset_s = {{ "'
        f'{tables[-1].source.name}" = SECONDS }}, or take one file out.'
    )


def _write(time_s: float) -> str:
    return write_local(time_s) if is_unix(time_s) else f"{time_s:.10g} s"
