"""Joins the files of one run on time: loggers with rates, jitter and clocks of their own.

The rows are those of the fastest file; the others are interpolated linearly between their rows.
Nothing is extrapolated: where one of them is interrupted, or has not begun, there are no rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, locate_key
from zerodrift.base.errors import InputError
from zerodrift.dataset.checks import check_period
from zerodrift.dataset.logs import COMMON
from zerodrift.dataset.sampling import COARSEST, find_gaps
from zerodrift.dataset.tables import LogTable
from zerodrift.dataset.units import is_unix, write_local

# How far apart two loggers' clocks are, by a quantity that both record.
#
# The second log y2(t) is matched to the first by y2(t) = a + b * y1(t + offset + rate * (t - t0)),
# both smoothed alike, by Gauss-Newton steps from the best of a coarse search. Gain b and zero a are
# those of two thermometers of one quantity. A lag between the two looks the same as an offset: no
# data of one quantity tell them apart.

SMOOTHED_PERIODS = 8
"""Half width, in periods of the slower log, of the triangle that both are smoothed with."""
MOST_STEPS = 200_000
"""Points of the grid on which the two are compared."""
BLOCKS = 24
"""Blocks whose sums tell the uncertainty, the noise within each being of any kind."""
FARTHEST = 0.25
"""Share of the common time that the clocks may be apart."""
SIGNIFICANT = 3.0
"""A rate within this many standard deviations of none is taken as none."""
MOST_ITERATIONS = 8
CREDIBLE = 0.98
"""Share of the second log's variance that the first has to explain."""


@dataclass(frozen=True)
class ClockDifference:
    """What to add to the second log's times, `offset_s + rate * (t - since_s)`."""

    offset_s: float
    offset_std_s: float
    rate: float
    rate_std: float
    since_s: float
    """Where the offset holds, in s: the first time that both logs have."""
    explained: float
    """Share of the second log's variance that the first explains then."""

    @property
    def is_credible(self) -> bool:
        """Tell whether both logs are of one quantity, as far as they show."""
        return self.explained > CREDIBLE

    def apply(self, time_s: Array) -> Array:
        """Return times [n] of the second log by the first one's clock."""
        moved: Array = time_s + self.offset_s + self.rate * (time_s - self.since_s)
        return moved

    def describe(self) -> str:
        """Return the difference in words, with twice its standard deviations."""
        offset = f"{self.offset_s:+.{_digits(self.offset_std_s)}f} s"
        rate = (
            f"{1e6 * self.rate:+.{_digits(1e6 * self.rate_std)}f} ppm" if self.rate else "no rate"
        )
        return (
            f"{offset} (+-{2 * self.offset_std_s:.2g} s) and {rate} (+-{2e6 * self.rate_std:.2g} "
            "ppm)"
        )


def _digits(std: float) -> int:
    """Return how many decimals a value of this standard deviation is worth."""
    return max(0, 1 - int(np.floor(np.log10(max(std, 1e-9)))))


def measure_difference(
    first_s: Array, first: Array, second_s: Array, second: Array
) -> ClockDifference | None:
    """Measure how the second log's clock differs from the first one's.

    Args:
        first_s: [n] rising times of the first log.
        first: [n] the common quantity as it recorded it.
        second_s: [m] rising times of the second.
        second: [m] the same by the second.

    Returns:
        The difference; None where the logs have too little in common to determine it.
    """
    begin = max(first_s[0], second_s[0])
    end = min(first_s[-1], second_s[-1])
    period_s = max(float(np.median(np.diff(first_s))), float(np.median(np.diff(second_s))))
    steps = int((end - begin) / period_s)
    if steps < 20 * SMOOTHED_PERIODS or np.ptp(first) == 0 or np.ptp(second) == 0:
        return None
    step_s = period_s * max(1.0, steps / MOST_STEPS)
    logs = first_s, first, second_s, second
    start = ClockDifference(
        _search(*logs, step_s, end - begin), np.inf, 0.0, np.inf, float(begin), 0.0
    )
    found = _iterate(logs, start, step_s, has_rate=True)
    if found is not None and abs(found.rate) < SIGNIFICANT * found.rate_std:
        # A rate that is not there would cost the offset its certainty.
        steady = _iterate(logs, replace(found, rate=0.0), step_s, has_rate=False)
        return None if steady is None else replace(steady, rate_std=found.rate_std)
    return found


def _iterate(
    logs: tuple[Array, Array, Array, Array],
    start: ClockDifference,
    step_s: float,
    has_rate: bool,
) -> ClockDifference | None:
    """Return the difference after Gauss-Newton steps, once they no longer change it."""
    first_s, first, second_s, second = logs
    begin = start.since_s
    offset_s, rate = start.offset_s, start.rate
    found = None
    for _ in range(MOST_ITERATIONS):
        moved_s = second_s + offset_s + rate * (second_s - begin)
        found = _refine(first_s, first, moved_s, second, step_s, has_rate)
        if found is None:
            return None
        # On the second clock's own times, up to the square of the rate.
        offset_s += found.offset_s - found.rate * (found.since_s - begin)
        rate += found.rate
        left_s = abs(found.offset_s) + abs(found.rate) * (second_s[-1] - second_s[0])
        if left_s < 1e-3 * step_s:
            break
    return None if found is None else replace(found, offset_s=offset_s, rate=rate, since_s=begin)


def _search(
    first_s: Array, first: Array, second_s: Array, second: Array, step_s: float, common_s: float
) -> float:
    """Return the offset at which the two are most alike, to about one step of a coarse grid."""
    begin, end = max(first_s[0], second_s[0]), min(first_s[-1], second_s[-1])
    grid_s = np.arange(begin, end, step_s)
    one = _smooth(np.interp(grid_s, first_s, first))
    two = _smooth(np.interp(grid_s, second_s, second))
    # Of changes rather than values, so that a slow trend does not decide.
    lag = SMOOTHED_PERIODS
    one, two = one[lag:] - one[:-lag], two[lag:] - two[:-lag]
    one, two = one - one.mean(), two - two.mean()
    size = 1 << int(np.ceil(np.log2(2 * one.size)))
    spectrum = np.fft.rfft(one, size) * np.conj(np.fft.rfft(two, size))
    alike = np.fft.irfft(spectrum, size)
    reach = int(FARTHEST * common_s / step_s)
    shifts = np.arange(-reach, reach + 1)
    overlap = np.maximum(one.size - np.abs(shifts), 1)
    best = int(np.argmax(alike[shifts] / np.sqrt(overlap)))
    return float(shifts[best] * step_s)


def _refine(
    first_s: Array,
    first: Array,
    second_s: Array,
    second: Array,
    step_s: float,
    has_rate: bool,
) -> ClockDifference | None:
    """Return the difference after one linear step, with its standard deviations."""
    begin, end = max(first_s[0], second_s[0]), min(first_s[-1], second_s[-1])
    grid_s = np.arange(begin, end, step_s)
    if grid_s.size < 10 * SMOOTHED_PERIODS:
        return None
    one = _smooth(_average(grid_s, first_s, first))
    two = _smooth(_average(grid_s, second_s, second))
    inner = slice(2 * SMOOTHED_PERIODS, -2 * SMOOTHED_PERIODS)
    slope = np.gradient(one, step_s)[inner]
    elapsed_s = (grid_s - begin)[inner]
    one, two = one[inner], two[inner]
    scale_s = float(end - begin)
    drift = slope * elapsed_s / scale_s if has_rate else np.zeros(slope.size)
    design = np.stack([slope, drift, np.ones(one.size), one - one.mean()], axis=1)
    solution, *_ = np.linalg.lstsq(design, two, rcond=None)
    left = two - design @ solution
    gain = float(solution[3])
    if gain == 0 or not np.isfinite(solution).all():
        return None
    # Sandwich: the noise of neighbours is alike, that of blocks is not.
    scores = design * left[:, None]
    sums = np.array([part.sum(axis=0) for part in np.array_split(scores, BLOCKS)])
    bread = np.linalg.pinv(design.T @ design)
    spread = bread @ (sums.T @ sums) @ bread * BLOCKS / (BLOCKS - 4)
    offset_std, rate_std = np.sqrt(np.maximum(np.diag(spread)[:2], 0.0)) / abs(gain)
    return ClockDifference(
        offset_s=float(solution[0]) / gain,
        offset_std_s=float(offset_std),
        rate=float(solution[1]) / gain / scale_s if has_rate else 0.0,
        rate_std=float(rate_std) / scale_s,
        since_s=float(begin),
        explained=1 - float(np.var(left) / np.var(two)),
    )


def _average(grid_s: Array, time_s: Array, values: Array) -> Array:
    """Return the values at [k] points of a grid, as means over a step where rows are finer."""
    step_s = float(grid_s[1] - grid_s[0])
    area = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * (values[1:] + values[:-1]) / 2)])
    finer_s = np.concatenate([grid_s - step_s / 2, [grid_s[-1] + step_s / 2]])
    # The integral of straight lines between rows, at the edges of the steps.
    row = np.clip(np.searchsorted(time_s, finer_s, side="right") - 1, 0, time_s.size - 2)
    width_s = finer_s - time_s[row]
    slope = (values[row + 1] - values[row]) / (time_s[row + 1] - time_s[row])
    at_edge = area[row] + width_s * (values[row] + slope * width_s / 2)
    mean: Array = np.diff(at_edge) / step_s
    return mean


def _smooth(values: Array) -> Array:
    """Return values [k] smoothed by a triangle, ends held."""
    width = SMOOTHED_PERIODS
    box = np.ones(width) / width
    padded = np.pad(values, width, mode="edge")
    twice = np.convolve(np.convolve(padded, box, "same"), box, "same")
    smoothed: Array = twice[width:-width]
    return smoothed


# Joins the files of one run on time: loggers with rates, jitter and clocks of their own.

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
