"""Wrong data within one run: what stands still, is cut off, jumps, wraps, or goes on elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.outliers import NORMAL_OF_MAD, find_jumps
from zerodrift.dataset.resolution import measure_code
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.agreement import LAGS_S, lag
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.physics.rails import FEWEST_VISITS, find_rails

SIDE = 12
"""Rows on either side of a break through which straight lines are laid."""
# Places within a run where a column goes on elsewhere: another unit, or rows that are missing.

BREAK = 12.0
"""The lines miss each other by this many times what they miss elsewhere (the median of all rows
without a break), ..."""
ONCE = 0.6
"""... of which one step is this share at least, ..."""
LARGEST = 5.0
"""... and this step is so many times larger than the largest elsewhere in that column."""
CHANCE = 0.1
"""Chance with which a break would look by itself like a change of unit; from here on missing rows
are told."""
LOUDER = 3.0
"""The noise of an output behind a change of its unit differs by this factor at least, ..."""
PLAIN = 20.0
"""... or by so much, and the range by nearly as much: no noise and no drift changes so at once."""
FOLLOWS = 0.5
"""Share of the squares that a load leaves of an output's steps where these are the load's."""
ALIKE = 0.3
"""... and by the same factor as its values, to this share."""
LAST_DIGITS = 1e-9
SURE = 8.0
"""Standard errors by which the logarithm of the noise differs: of some thousand places in some
hundred columns, chance reaches 6."""


@dataclass(frozen=True)
class ColumnBreak:
    """A row from which on a column is somewhere else."""

    row: int
    before: float
    after: float
    usual: float
    """What the column does from row to row before it."""


def find_breaks(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on changes of unit, and on rows that are missing, within a run."""
    notes = []
    largest = [_find_largest(run.temperature_degC) for run in runs]
    for i, run in enumerate(runs):
        elsewhere = max((s for j, s in enumerate(largest) if j != i), default=0.0)
        found = find_break(run.temperature_degC, elsewhere)
        if found is not None:
            notes.append(_tell_break(run, found))
        for k, name in enumerate(outputs):
            factor, row = find_gain_change(run.measured[:, k])
            if row and not _follows_load(run, k, row):
                text = (
                    f"from row {row} on values and noise are {factor:.4g} times those before: "
                    "another unit or gain. Convert one part, or cut the run there "
                    "(file@from:to)"
                )
                notes.append(DataNote(run.group, name, (row, len(run) - 1), "unit_change", text))
    return notes


def find_unit_changes(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on thermometers alone whose unit changes within a run."""
    found = find_breaks(runs, outputs)
    return [n for n in found if n.column == "temperature" and n.kind == "unit_change"]


def _follows_load(run: Run, k: int, row: int) -> bool:
    """Return whether what an output does behind a row is what its load does there."""
    moved, load = (np.diff(x[row:, k]) for x in (run.measured, run.reference))
    return bool(np.sum((moved - load) ** 2) < FOLLOWS * np.sum(moved**2))


def _find_largest(x: Array) -> float:
    """Return the largest step of a column but for one."""
    steps = np.sort(np.abs(np.diff(x)))
    return float(steps[-2]) if steps.size > 1 else 0.0


def find_break(x: Array, elsewhere: float = 0.0) -> ColumnBreak | None:
    """Return the one row from which on a column [n] is somewhere else; None without.

    Args:
        x: the column.
        elsewhere: the largest step of it in other runs.
    """
    if x.size < 4 * SIDE:
        return None
    steps = np.abs(np.diff(x))
    row = int(steps.argmax()) + 1
    if not SIDE <= row <= x.size - SIDE:
        return None
    rest = np.delete(steps, row - 1)
    step = float(steps[row - 1])
    if step <= LARGEST * max(float(rest.max()), elsewhere):
        return None
    # Without the row on either side, which an uneven clock mixes.
    before, after = _reach(x[row - SIDE : row - 1], SIDE), _reach(x[row + 1 : row + SIDE], -2)
    usual = float(np.median(steps)) + float(np.std(np.diff(x[row - SIDE : row])))
    # A coarse thermometer tells neither side to less than its step.
    usual = max(usual, measure_code(x[row:]))
    gap = abs(after - before)
    if gap < BREAK * usual or step < ONCE * gap:
        return None
    return ColumnBreak(row, before, after, usual)


def _find_stand(run: Run, row: int) -> "_Stand":
    """Return the rows before another one that hold one temperature.

    An uneven clock may lay a row between both sides.
    """
    x = run.temperature_degC
    starts = {}
    for last in (row - 1, row - 2):
        others = np.flatnonzero(x[:last] != x[last])
        starts[last] = int(others[-1]) + 1 if others.size else 0
    last = max(starts, key=lambda last: last - starts[last])
    return _Stand(run, starts[last], last, float(x[last]))


def _convert_before(stand: "_Stand", factor: float, offset: float) -> "_Stand":
    """Return a stand with the temperature of its run in another unit up to its last row."""
    x = stand.run.temperature_degC
    converted = np.where(np.arange(x.size) <= stand.last, factor * x + offset, x)
    run = replace(stand.run, temperature_degC=converted)
    return replace(stand, run=run, value=float(converted[stand.last]))


def _reach(x: Array, at: int) -> float:
    """Return what a line through values says at a row beside them."""
    return float(np.polyval(np.polyfit(np.arange(x.size), x, 1), at))


def _tell_break(run: Run, found: ColumnBreak) -> DataNote:
    rows = (found.row, len(run) - 1)
    conversions = {
        "degC before it and degF behind": (1.8, 32.0),
        "degF before it and degC behind": (1.0 / 1.8, -32.0 / 1.8),
        "degC before it and kelvin behind": (1.0, 273.15),
        "kelvin before it and degC behind": (1.0, -273.15),
    }
    differ = {
        words: abs(found.after - a * found.before - b) for words, (a, b) in conversions.items()
    }
    words = min(differ, key=lambda words: differ[words])
    missed = max(differ[words] - 2.0 * found.usual, 0.0)
    # A break of any size up to this one would meet one of them on either side.
    by_unit = 2.0 * len(conversions) * missed / abs(found.after - found.before)
    stand = _find_stand(run, found.row)
    stopped = stand.length >= FEWEST_STANDING and _goes_on(stand)
    if stopped and by_unit <= CHANCE:
        stopped = _goes_on(_convert_before(stand, *conversions[words]))
    if by_unit <= CHANCE and not stopped:
        text = (
            f"goes from {found.before:.4g} to {found.after:.4g} at row {found.row}, which is "
            f"{words}: the unit changes within the run. Convert one part, or cut the run there "
            "(file@from:to)"
        )
        return DataNote(run.group, "temperature", rows, "unit_change", text)
    if stopped:
        text = (
            f"the thermometer repeats one value {stand.length} times and then jumps from "
            f"{found.before:.4g} to {found.after:.4g} degC: it had stopped reporting. Leave these "
            "rows out ([logs] train takes file@from:to), or record the run again"
        )
        return DataNote(run.group, "temperature", (stand.first, stand.last), "frozen", text)
    text = (
        f"goes from {found.before:.4g} to {found.after:.4g} degC between two rows, and nowhere "
        "else: rows are missing there, though the time goes on, or two recordings were put "
        "together. Cut the run there (file@from:to)"
    )
    return DataNote(run.group, "temperature", rows, "stitched", text)


def find_gain_change(x: Array) -> tuple[float, int]:
    """Return by how much a column's values and noise are multiplied from a row on; row 0: nowhere.

    The row is where the logarithm of the second differences changes its mean most clearly.
    """
    second = np.abs(np.diff(x, 2))
    # A coarse converter's steps cancel but for the last digits of a float.
    moves = second > LAST_DIGITS * float(np.ptp(x))
    if moves.sum() < 8 * SIDE:
        return 1.0, 0
    places = np.flatnonzero(moves)
    loud = np.log(second[moves])
    n = loud.size
    counts = np.arange(1, n)
    sums = np.cumsum(loud)[:-1]
    ahead, behind = sums / counts, (loud.sum() - sums) / (n - counts)
    clear = np.abs(behind - ahead) * np.sqrt(counts * (n - counts) / n)
    clear[: 2 * SIDE] = clear[-2 * SIDE :] = 0.0
    best = int(clear.argmax())
    change = float(behind[best] - ahead[best])
    spread = float(
        np.sqrt((np.var(loud[: best + 1]) * (best + 1) + np.var(loud[best + 1 :]) * (n - best)) / n)
    )
    if spread == 0.0 or abs(change) < np.log(LOUDER) or clear[best] < SURE * spread:
        return 1.0, 0
    near = int(places[best]) + 1
    window = np.arange(max(near - 3, 1), min(near + 4, x.size))
    row = int(window[np.abs(np.diff(x))[window - 1].argmax()])
    if not SIDE <= row <= x.size - SIDE:
        return 1.0, 0
    before, after = (
        _reach(x[row - SIDE : row], SIDE),
        _reach(x[row : row + SIDE], -1),
    )
    noise = float(np.median(second[max(row - 10 * SIDE, 0) : row - 2]))
    if abs(before) >= 4.0 * noise and before * after > 0.0:
        factor = after / before
        if abs(np.log(factor) - change) <= ALIKE * max(abs(change), 1.0):
            return factor, row
    wider = float(np.ptp(x[row:])) / max(float(np.ptp(x[:row])), 1e-300)
    if abs(change) > np.log(PLAIN) and abs(np.log(wider) - change) < np.log(LOUDER):
        return float(np.exp(change)), row
    return 1.0, 0


# Wrong data that one column of one run shows: it stands still, is cut off, jumps or wraps.

FEWEST_STANDING = 30
"""Samples for which a column must stand, ..."""
SHARE_STANDING = 0.04
"""... as a share of the run, ..."""
LONGER = 6.0
"""... and how many times longer than anything else in that column stands."""
LEAVES = 8.0
"""What stood still for a fault goes on elsewhere: so many usual steps away."""
ELSEWHERE, SHARE_ELSEWHERE = 4.0, 0.1
"""Usual errors by which an output is not where it is expected, and the share of a stand's rows in
which it is so."""
ARM = 20
"""Samples on either side of a jump through which straight lines are laid, and at a stand's ends."""
JUMP = 10.0
"""The lines miss each other by this many times the noise, ..."""
SHARPER = 2.5
"""... and by this many times what they miss an arm away."""
USUAL, UNUSUAL = 0.97, 4.0
"""Share of the rows near a signal's jumps that shows what is usual there, and how many times more a
leap is."""
BEYOND_OTHERS = 2.0
"""... and this many times the sharpest change in any other run, whatever made that."""
CAUSE = 4.0
"""A signal whose level jumps by this many times its spread may be why."""
FEW_RUNS = 1 / 3
"""Where more of the runs jump, it is no fault of a log: an effect or a disturbance."""
WRAPS, STAYS = 0.3, 0.1
"""Jumps of this share of a column's range, and the share of a counter's that may stay when its
readings are put together, or be larger than its range."""
LARGE = 20.0
"""A wrap is this many times the output's usual step."""
BEYOND_RAIL = 0.02
"""Share of the range by which other runs pass a level that is no rail, then."""


@dataclass(frozen=True)
class _Stand:
    run: Run
    first: int
    last: int
    value: float

    @property
    def length(self) -> int:
        return self.last - self.first + 1


def find_standing(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on thermometers and outputs that stand still in one run alone."""
    notes = []
    for k, (name, columns) in enumerate(_list_columns(runs, outputs), start=-1):
        thermometer = name == "temperature"
        moving = [float(np.ptp(x)) > 0.0 for x in columns]
        moved = {run.group for run, moves in zip(runs, moving, strict=True) if moves}
        for run, x in zip(runs, columns, strict=True):
            if run.group not in moved and thermometer and len(run) >= FEWEST_STANDING:
                text = (
                    f"the thermometer reads {x[0]:.4g} degC in all {len(run)} rows; expected "
                    "a temperature that moves. Is it connected, and is this its column?"
                )
                notes.append(DataNote(run.group, name, (0, len(run) - 1), "constant", text))
        stands = [
            stand
            for run, x, moves in zip(runs, columns, moving, strict=True)
            if moves
            for stand in _list_stands(run, x)
        ]
        stands.sort(key=lambda stand: -stand.length)
        told = 0
        for stand in stands:
            # Stands of one run at one value are one fault.
            others = [
                s
                for s in stands
                if s.run.group != stand.run.group or (s.run is stand.run and s.value != stand.value)
            ]
            usual = max((s.length for s in others), default=1)
            least = max(FEWEST_STANDING, SHARE_STANDING * len(stand.run))
            if stand.length < max(least, LONGER * usual):
                break
            x = columns[[run is stand.run for run in runs].index(True)]
            if not thermometer and _is_at_rest(stand, k, columns):
                continue
            goes_on = thermometer and _goes_on(stand)
            held = goes_on and _ends_in_jump(stand, x) if thermometer else _is_held(stand, x, k)
            at_limit = stand.value in (x.max(), x.min()) and not held
            # A thermometer at its own limit is wrong where the outputs go on; an output that stands
            # at its own, which no run passes, shows an effect.
            if at_limit and not (goes_on if thermometer else _is_passed(stand, x, runs, columns)):
                continue
            told += not at_limit
            if told > max(1, round(FEW_RUNS * len(runs))):
                break
            notes.append(_tell_stand(stand, name, thermometer, at_limit, usual))
    return list({(note.run, note.column): note for note in reversed(notes)}.values())


def _is_passed(stand: _Stand, own: Array, runs: Sequence[Run], columns: Sequence[Array]) -> bool:
    """Return whether other runs pass a limit; where none does it may be the sensor's own."""
    others = [x for run, x in zip(runs, columns, strict=True) if run.group != stand.run.group]
    margin, high = BEYOND_RAIL * float(np.ptp(own)), bool(stand.value == own.max())
    beyond = [_passes(x, stand.value, margin, high=high) for x in others]
    return not others or sum(beyond) >= min(2, len(others))


def _passes(x: Array, level: float, margin: float, *, high: bool) -> bool:
    """Return whether a column goes beyond a level by a margin, above it or below."""
    return bool(x.max() > level + margin if high else x.min() < level - margin)


def _ends_in_jump(stand: _Stand, x: Array) -> bool:
    """Return whether a column goes on elsewhere behind a stand, as it does not at a limit."""
    if stand.last + 1 >= x.size:
        return False
    steps = np.abs(np.diff(x))
    usual = float(np.median(steps[steps > 0.0])) if steps.any() else 0.0
    # An uneven clock lays a row between both sides.
    return float(steps[stand.last : stand.last + 2].max()) > LEAVES * usual


def _is_held(stand: _Stand, x: Array, k: int) -> bool:
    """Return whether an output stands where load and temperature lead to expect it elsewhere.

    At a limit it is expected there or beyond.
    """
    away = _weigh_stand(stand, x, k) * (1.0 if stand.value == x.max() else -1.0)
    return bool(np.mean(away > ELSEWHERE) > SHARE_ELSEWHERE)


def _goes_on(stand: _Stand) -> bool:
    """Return whether an output drifts away from the ends of a thermometer's stand, to one side.

    It does where the temperature goes on, beyond a limit of the thermometer or after it stopped,
    and rests where an oven holds it, but for what dies away since the log began. An end of the
    stand that a jump follows is not taken for right.
    """
    x, run = stand.run.temperature_degC, stand.run
    since = np.arange(stand.length) * run.sample_period_s
    dying = np.stack([np.ones(since.size), *(np.exp(-since / tau_s) for tau_s in LAGS_S)], axis=1)
    met = [stand.first > 0, stand.last + 1 < x.size and not _ends_in_jump(stand, x)]
    for k in range(run.measured.shape[1]):
        away = _weigh_stand(stand, x, k)
        if stand.first == 0:
            away = away - dying @ np.linalg.lstsq(dying, away, rcond=None)[0]
        else:
            ends = np.array([[0, away[:ARM].mean()], [away.size - 1, away[-ARM:].mean()]])[met]
            away = away - np.interp(np.arange(away.size), *ends.T)
        if max(np.mean(away > ELSEWHERE), np.mean(away < -ELSEWHERE)) > SHARE_ELSEWHERE:
            return True
    return False


def _weigh_stand(stand: _Stand, x: Array, k: int) -> Array:
    """Return how far output k is in a stand's rows from what is expected, in usual errors, [m]."""
    left, usual = _expect_stand(stand, k, x != stand.value)
    return np.asarray(left / max(usual, 1e-300))


def _is_at_rest(stand: _Stand, k: int, columns: Sequence[Array]) -> bool:
    """Return whether output k, [n] in each run, is expected to move by less than a code."""
    code = min((step for x in columns if (step := measure_code(x)) > 0.0), default=0.0)
    rows = np.arange(len(stand.run))
    left, _ = _expect_stand(stand, k, (rows < stand.first) | (rows > stand.last))
    return bool(np.ptp(left) <= code)


def _expect_stand(stand: _Stand, k: int, others: Mask) -> tuple[Array, float]:
    """Return how far output k is in a stand's rows from what is expected [m], and what is usual.

    What is expected is the load and, of the drift, a straight line of the temperature, its lags
    and the load, each at any temperature, through other rows [n].
    """
    run = stand.run
    warm = run.temperature_degC - run.temperature_degC.mean()
    load = run.reference[:, k]
    lags = lag(warm, run.sample_period_s)
    basis = np.stack([np.ones(warm.size), warm, *lags, load, load * warm], axis=1)
    drift = run.drift[:, k]
    factors = np.linalg.lstsq(basis[others], drift[others], rcond=None)[0]
    left = drift - basis @ factors
    usual = NORMAL_OF_MAD * float(np.median(np.abs(left[others] - np.median(left[others]))))
    return left[stand.first : stand.last + 1], usual


def _tell_stand(
    stand: _Stand, name: str, thermometer: bool, at_limit: bool, usual: int
) -> DataNote:
    what = "the thermometer" if thermometer else "the output"
    rows = (stand.first, stand.last)
    if at_limit:
        text = (
            f"{what} stands at {stand.value:.6g}, the end of what it reads in this run, for "
            f"{stand.length} rows, at other values at most for {usual}: it is cut off there. Look "
            "at its range, and record the run again"
        )
        return DataNote(stand.run.group, name, rows, "saturated", text)
    text = (
        f"{what} repeats one value {stand.length} times, elsewhere at most {usual} times: it "
        "stopped reporting. Leave these rows out ([logs] train takes file@from:to), or record the "
        "run again"
    )
    return DataNote(stand.run.group, name, rows, "frozen" if thermometer else "stuck", text)


def find_cut_off(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on outputs that stand at a level in one run which other recordings pass."""
    notes: list[DataNote] = []
    if len({run.source for run in runs}) < 2:
        return notes
    for k, name in enumerate(outputs):
        found = []
        for run in runs:
            x = run.measured[:, k]
            flags = find_rails(x, run.reference[:, k])
            if not flags.any():
                continue
            rows = np.flatnonzero(flags)
            high = x[rows[0]] >= np.median(x)
            level = float(x[rows[0]])
            margin = BEYOND_RAIL * float(np.ptp(x))
            passes = [_passes(r.measured[:, k], level, margin, high=high) for r in runs]
            if any(p for p, r in zip(passes, runs, strict=True) if r.group == run.group):
                continue
            beyond = [p for p, r in zip(passes, runs, strict=True) if r.group != run.group]
            # One run alone that passes it may be the one that is wrong.
            passed = sum(beyond) >= min(2, len(beyond)) > 0
            # A few samples on a short plateau of the load are alike by chance; an output that is
            # cut off stands still while its load moves, or for long.
            if rows[0] == 0 and rows[-1] == rows.size - 1:
                continue  # at rest before the run begins
            load = run.reference[:, k]
            at_rest = float(np.ptp(load)) > 0.0 and float(np.ptp(load[rows])) <= margin
            if passed and not (at_rest and rows.size < FEWEST_VISITS):
                text = (
                    f"{rows.size} samples stand at {level:.6g}, which other runs pass: the "
                    "output was cut off in this run alone. Look at the amplifier's range in "
                    "that recording, or leave the run out"
                )
                found.append(
                    DataNote(run.group, name, (int(rows[0]), int(rows[-1])), "saturated", text)
                )
        # An amplifier has one range: what stands at several levels is not at its end.
        notes += found if len({note.run for note in found}) == 1 else []
    return notes


def find_wraps(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on counters that wrap."""
    found = (_find_wrap(run, name, k) for k, name in enumerate(outputs) for run in runs)
    return [note for note in found if note is not None]


def find_leaps(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on jumps of the zero in few of the runs; none where one log is all there is.

    Whether a jump is the recorder's or the sensor's shows in other recordings alone: parts of one
    log are none.
    """
    notes: list[DataNote] = []
    if len({run.source for run in runs}) < 2:
        return notes
    for k, name in enumerate(outputs):
        found = []
        for run in runs:
            leaps = list_leaps(run, k)
            if leaps:
                found.append((run, leaps))
        if len({run.group for run, _ in found}) > 1:
            continue  # what several runs show is the sensor's
        for run, leaps in found:
            largest = max(abs(size) for _, size in leaps)
            others = [measure_sharpest(other, k) for other in runs if other.group != run.group]
            if largest > BEYOND_OTHERS * max(others, default=0.0):
                notes.append(_tell_leaps(run, name, leaps))
    return notes


def _find_wrap(run: Run, name: str, k: int) -> DataNote | None:
    """Return a note if an output is steady once it is read as a counter that wraps.

    All readings of such a counter lie within what it wraps by; a load, or what follows it, moves an
    output by less than its range.
    """
    drift, size = run.drift[:, k], float(np.ptp(run.measured[:, k]))
    steps = np.diff(drift)
    rows = np.flatnonzero(np.abs(steps) > 0.5 * size)
    # Spikes and values for none are back at once; a counter stays on either side.
    if np.count_nonzero(np.abs(np.diff(_smooth(drift))) > 0.5 * size) < 2:
        return None
    # A reading goes round as often as its load takes it.
    most = 1.5 * max(size, float(np.ptp(run.reference[:, k])))
    if np.count_nonzero(np.abs(steps) > most) > STAYS * rows.size:
        return None
    # A coarse converter at rest goes up and down by its own step.
    if size < LARGE * float(np.median(np.abs(steps[steps != 0.0]))):
        return None
    # An uneven clock lays a row between both sides, which is none of the counter's.
    left = np.abs(np.diff(_smooth(np.unwrap(drift, period=size))))
    if np.count_nonzero(left >= WRAPS * size) > STAYS * rows.size:
        return None
    text = (
        f"jumps up and down by {size:.6g} with no cause in the logs: a counter that wraps. Unwrap "
        "it before logging, or leave these rows out"
    )
    return DataNote(run.group, name, (int(rows[0]), int(rows[-1])), "wrapped", text)


def _smooth(x: Array) -> Array:
    """Return the medians [n - 2] of three rows each, in which a single row counts for nothing."""
    return np.asarray(np.median([x[:-2], x[1:-1], x[2:]], axis=0))


def _tell_leaps(run: Run, name: str, leaps: Sequence[tuple[int, float]]) -> DataNote:
    row, size = max(leaps, key=lambda leap: abs(leap[1]))
    text = (
        f"the zero jumps by {size:.4g} at row {row} and stays there, with no cause in the logs: "
        "re-zeroed or disturbed in mid-run. Split the run there (file@from:to)"
    )
    return DataNote(run.group, name, (row, len(run) - 1), "offset_jump", text)


def list_leaps(run: Run, k: int) -> list[tuple[int, float]]:
    """Return (row, size) of each sharp jump of an output's drift that no signal makes."""
    if len(run) < 6 * ARM:
        return []
    x = run.steady_drift[:, k]
    signals = (run.temperature_degC, run.reference, run.inputs)
    steps = np.diff(x)
    noise = NORMAL_OF_MAD * float(np.median(np.abs(steps - np.median(steps)))) / np.sqrt(2.0)
    if noise == 0.0:
        moving = np.abs(steps)[steps != 0.0]
        noise = float(np.median(moving)) if moving.size else 0.0
    if noise == 0.0:
        return []
    gap = _measure_gap(x)
    size = np.abs(gap)
    near = find_jumps(*signals)
    size[: ARM + 1] = size[-ARM:] = 0.0
    leaps: list[tuple[int, float]] = []
    # Near jumps of a signal, what is usual there is no leap.
    usual = float(np.quantile(size[near], USUAL)) if near.any() else 0.0
    least = np.where(near, np.maximum(JUMP * noise, UNUSUAL * usual), JUMP * noise)
    left = np.where(size < least, 0.0, size)
    while len(leaps) < 64:
        row = int(left.argmax())
        if left[row] == 0.0:
            break
        aside = [size[max(row - ARM - 3, 0)], size[min(row + ARM + 3, x.size - 1)]]
        at_once = abs(float(x[row]) - float(x[row - 1]))
        sharp = at_once >= 0.5 * left[row] and left[row] >= SHARPER * max(aside)
        if sharp and not _has_cause(run, row):
            leaps.append((row, float(gap[row])))
        left[max(row - ARM, 0) : row + ARM + 1] = 0.0
    return sorted(leaps)


def measure_sharpest(run: Run, k: int) -> float:
    """Return the largest change of an output's drift at one row."""
    if len(run) < 6 * ARM:
        return 0.0
    x = run.steady_drift[:, k]
    gap, steps = np.abs(_measure_gap(x)), np.abs(np.diff(x, prepend=x[0]))
    return float(gap[steps >= 0.5 * gap].max(initial=0.0))


def _has_cause(run: Run, row: int) -> bool:
    """Return whether a logged signal changes its level here too."""
    for signal in (*run.reference.T, *run.inputs.values(), run.temperature_degC):
        ends, spread = [], 0.0
        for rows in (np.arange(row - ARM, row - 2), np.arange(row + 2, row + ARM)):
            line = np.polyfit(rows - row, signal[rows], 1)
            ends.append(float(line[1]))
            spread = max(spread, float(np.std(signal[rows] - np.polyval(line, rows - row))))
        change = abs(ends[1] - ends[0])
        if change > CAUSE * spread and change > 1e-3 * float(np.ptp(signal)):
            return True
    return False


def _measure_gap(x: Array) -> Array:
    """Return by how much lines through the samples before and from each row on miss each other."""
    n = x.size
    at = np.arange(ARM, dtype=float)
    centred = at - at.mean()
    # Weights of a least-squares line's value one sample beyond its end, and at its start.
    ahead = 1.0 / ARM + (ARM - at.mean()) * centred / (centred**2).sum()
    start = 1.0 / ARM + (0.0 - at.mean()) * centred / (centred**2).sum()
    windows = np.lib.stride_tricks.sliding_window_view(x, ARM)
    before, after = windows @ ahead, windows @ start
    gap = np.zeros(n)
    gap[ARM : n - ARM + 1] = after[ARM:] - before[: n - 2 * ARM + 1]
    return gap


def _list_columns(runs: Sequence[Run], outputs: Sequence[str]) -> list[tuple[str, list[Array]]]:
    columns = [("temperature", [run.temperature_degC for run in runs])]
    return columns + [
        (name, [run.measured[:, k] for run in runs]) for k, name in enumerate(outputs)
    ]


def _list_stands(run: Run, x: Array) -> list[_Stand]:
    """Return the three longest stands of a column at one value."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(x) != 0.0) + 1])
    lengths = np.diff(np.concatenate([starts, [x.size]]))
    longest = np.argsort(-lengths, kind="stable")[:3]
    return [
        _Stand(run, int(starts[i]), int(starts[i] + lengths[i] - 1), float(x[starts[i]]))
        for i in longest
    ]
