"""Places within a run where a column goes on elsewhere: another unit, or rows that are missing.

A thermometer has a heat capacity. Where its reading is somewhere else from one row to the next, the
row before and the row behind were not recorded one after the other, or not in one unit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.data_notes import DataNote

ARM = 12
"""Rows on either side of a break through which straight lines are laid."""
BREAK = 12.0
"""The lines miss each other by this many times what they miss elsewhere (the median of all rows
without a break), ..."""
ONCE = 0.6
"""... of which one step is this share at least, ..."""
LARGEST = 5.0
"""... and this step is so many times larger than the largest elsewhere in that column."""
CHANCE = 0.1
"""Chance with which a break would look by itself like a change of unit, or like a thermometer that
had stopped: the less likely of the two is told, from here on missing rows."""
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
            notes.append(_tell_break(run, found, runs))
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
    if x.size < 4 * ARM:
        return None
    steps = np.abs(np.diff(x))
    row = int(steps.argmax()) + 1
    if not ARM <= row <= x.size - ARM:
        return None
    rest = np.delete(steps, row - 1)
    step = float(steps[row - 1])
    if step <= LARGEST * max(float(rest.max()), elsewhere):
        return None
    before, after = _reach(x[row - ARM : row], ARM), _reach(x[row : row + ARM], -1)
    usual = float(np.median(steps)) + float(np.std(np.diff(x[row - ARM : row])))
    gap = abs(after - before)
    if gap < BREAK * usual or step < ONCE * gap:
        return None
    return ColumnBreak(row, before, after, usual)


def _measure_stand(x: Array, row: int) -> int:
    """Return how many rows before a row hold the value of the last of them."""
    others = np.flatnonzero(x[:row] != x[row - 1])
    return row - (int(others[-1]) + 1 if others.size else 0)


def _reach(x: Array, at: int) -> float:
    """Return what a line through values says at a row beside them."""
    return float(np.polyval(np.polyfit(np.arange(x.size), x, 1), at))


def _share_standing(runs: Sequence[Run], length: int) -> float:
    """Return the share of rows up to which the thermometer has held one value for so many rows."""
    held = 0
    for run in runs:
        edges = np.flatnonzero(np.diff(run.temperature_degC) != 0.0)
        lengths = np.diff(np.concatenate([[-1], edges, [len(run) - 1]]))
        held += int(np.maximum(lengths - length + 1, 0).sum())
    return held / sum(map(len, runs))


def _tell_break(run: Run, found: ColumnBreak, runs: Sequence[Run]) -> DataNote:
    rows = (found.row, len(run) - 1)
    conversions = {
        "degC before it and degF behind": 1.8 * found.before + 32.0,
        "degF before it and degC behind": (found.before - 32.0) / 1.8,
        "degC before it and kelvin behind": found.before + 273.15,
        "kelvin before it and degC behind": found.before - 273.15,
    }
    words = min(conversions, key=lambda words: abs(found.after - conversions[words]))
    missed = max(abs(found.after - conversions[words]) - 2.0 * found.usual, 0.0)
    # A break of any size up to this one would meet one of them on either side.
    by_unit = 2.0 * len(conversions) * missed / abs(found.after - found.before)
    stand = _measure_stand(run.temperature_degC, found.row)
    by_stand = _share_standing(runs, stand)
    if by_unit <= min(by_stand, CHANCE):
        text = (
            f"goes from {found.before:.4g} to {found.after:.4g} at row {found.row}, which is "
            f"{words}: the unit changes within the run. Convert one part, or cut the run there "
            "(file@from:to)"
        )
        return DataNote(run.group, "temperature", rows, "unit_change", text)
    if by_stand <= CHANCE:
        text = (
            f"the thermometer repeats one value {stand} times and then jumps from "
            f"{found.before:.4g} to {found.after:.4g} degC: it had stopped reporting. Leave these "
            "rows out ([logs] train takes file@from:to), or record the run again"
        )
        return DataNote(
            run.group, "temperature", (found.row - stand, found.row - 1), "frozen", text
        )
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
    if moves.sum() < 8 * ARM:
        return 1.0, 0
    places = np.flatnonzero(moves)
    loud = np.log(second[moves])
    n = loud.size
    counts = np.arange(1, n)
    sums = np.cumsum(loud)[:-1]
    ahead, behind = sums / counts, (loud.sum() - sums) / (n - counts)
    clear = np.abs(behind - ahead) * np.sqrt(counts * (n - counts) / n)
    clear[: 2 * ARM] = clear[-2 * ARM :] = 0.0
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
    if not ARM <= row <= x.size - ARM:
        return 1.0, 0
    before, after = _reach(x[row - ARM : row], ARM), _reach(x[row : row + ARM], -1)
    noise = float(np.median(second[max(row - 10 * ARM, 0) : row - 2]))
    if abs(before) >= 4.0 * noise and before * after > 0.0:
        factor = after / before
        if abs(np.log(factor) - change) <= ALIKE * max(abs(change), 1.0):
            return factor, row
    wider = float(np.ptp(x[row:])) / max(float(np.ptp(x[:row])), 1e-300)
    if abs(change) > np.log(PLAIN) and abs(np.log(wider) - change) < np.log(LOUDER):
        return float(np.exp(change)), row
    return 1.0, 0
