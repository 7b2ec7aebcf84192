"""A reference that is late, missing or reversed in one run: told by how the output follows it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.misfits import tell_gain

APART = 3
"""Rows over which changes are taken: drift is slower, loads are not."""
FOLLOWS = 0.5
"""Correlation of the changes of output and reference from which the one follows the other, ..."""
BETTER = 0.5
"""... and share of its square below which it does not."""
SURE = 8.0
"""Standard errors of a correlation: of all shifts of all outputs and runs, chance reaches 6."""
LATE = 2
"""Rows by which a shift differs from that of the other runs: one is how rows are averaged."""
LOUDER = 5.0
"""What a reference lacks is this many times what drift does at once in the other runs."""
FOLLOWED = 0.9
"""Correlation from which the factor between output and load is taken."""
CHANCE = 1e-4
"""Probability that any factor of a set of right logs is told as wrong."""
FEWEST_OTHERS = 3
"""Of two factors no scatter is known."""
LEAST_GAIN = 0.02
"""A smaller error of gain is that of a sensor's calibration."""
LOADED = 0.5
"""Share of the other runs whose reference moves, where one that stands is missing."""
LEAST = 0.02
"""... and the share of their loads' changes that it is at least."""


@dataclass(frozen=True)
class _Followed:
    """How one output of a run follows its reference."""

    run: Run
    moves: bool
    shift: int
    """Rows by which the reference is late."""
    best: float
    """Correlation of their changes at that shift, ..."""
    now: float
    """... and as they are."""
    fast_drift: float
    """RMS of the changes of measured minus reference, ..."""
    fast_load: float
    """... and of the reference."""
    slope: float
    """Change of the output per change of the reference, ..."""
    doubt: float
    """... and its standard error as a share of it, by what the output does beside."""


def find_reference_faults(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on references that are late or missing in one run."""
    notes: list[DataNote] = []
    followed: dict[str, list[_Followed]] = {}
    whole = [run for run in runs if len(run) >= 20 * APART]
    for k, name in enumerate(outputs):
        found = [_follow(run, k) for run in whole]
        for one in found:
            others = [f for f in found if f.run.group != one.run.group]
            if not others:
                continue
            note = _tell_late(one, others, name) or _tell_missing(one, others, name)
            notes += [note] if note is not None else []
        told = {note.run for note in notes}
        followed[name] = [
            f for f in found if f.moves and f.now >= FOLLOWED and f.run.group not in told
        ]
    return notes + _tell_gains(followed)


def _tell_gains(followed: Mapping[str, Sequence[_Followed]]) -> list[DataNote]:
    """Return notes on outputs that follow their load by another factor than in all other runs.

    The other runs' factors tell how far one may be off: their scatter, of all outputs together, by
    Student's quantile for the share of chance over all runs and outputs.
    """
    tests = sum(len(found) for found in followed.values())
    notes = []
    for name, found in followed.items():
        for one in found:
            rest = {
                each: [f.slope for f in runs if f.run.group != one.run.group]
                for each, runs in followed.items()
            }
            others = rest[name]
            if len(others) < FEWEST_OTHERS:
                continue
            squares = [
                (slope / float(np.mean(slopes)) - 1.0) ** 2
                for slopes in rest.values()
                if len(slopes) >= FEWEST_OTHERS
                for slope in slopes
            ]
            freedom = len(squares) - sum(len(s) >= FEWEST_OTHERS for s in rest.values())
            usual = float(np.sqrt(sum(squares) / freedom))
            middle = float(np.mean(others))
            bound = float(student.isf(CHANCE / (2.0 * tests), freedom))
            factor = one.slope / middle
            spread = np.sqrt(usual**2 * (1.0 + 1.0 / len(others)) + one.doubt**2)
            limit = max(bound * float(spread), LEAST_GAIN)
            if abs(factor - 1.0) <= limit:
                continue
            rows = (0, len(one.run) - 1)
            notes.append(DataNote(one.run.group, name, rows, *tell_gain(factor, "the column")))
    return notes


def _follow(run: Run, k: int) -> _Followed:
    measured, reference = run.measured[:, k], run.reference[:, k]
    m = measured[APART:] - measured[:-APART]
    r = reference[APART:] - reference[:-APART]
    moves = float(np.ptp(reference)) > 0.0
    shift, best, now = _find_shift(m, r) if moves else (0, 0.0, 0.0)
    fast_drift, fast_load = (float(np.sqrt(np.mean(x**2))) for x in (m - r, r))
    power = float(r @ r)
    slope = float(m @ r) / power if power else 0.0
    # A few large changes of a load tell as much as so many equal ones.
    changes = power**2 / float(np.sum(r**4)) if power else 0.0
    doubt = np.sqrt(max(1.0 / now**2 - 1.0, 0.0) / changes) if now and changes else np.inf
    return _Followed(run, moves, shift, best, now, fast_drift, fast_load, slope, float(doubt))


def _find_shift(m: Array, r: Array) -> tuple[int, float, float]:
    """Return the rows by which r is late, the correlation there, and that without a shift."""
    m, r = m - m.mean(), r - r.mean()
    norm = float(np.sqrt((m @ m) * (r @ r)))
    if norm == 0.0:
        return 0, 0.0, 0.0
    size = 1 << int(np.ceil(np.log2(2 * m.size)))
    product = np.fft.irfft(np.conj(np.fft.rfft(m, size)) * np.fft.rfft(r, size)) / norm
    reach = m.size // 4
    likeness = np.concatenate([product[-reach:], product[: reach + 1]])
    place = int(np.abs(likeness).argmax())
    return place - reach, float(likeness[place]), float(likeness[reach])


def _tell_late(one: _Followed, others: Sequence[_Followed], name: str) -> DataNote | None:
    known = [f.shift for f in others if f.moves and f.best >= FOLLOWS]
    if not one.moves or not known or one.best < max(FOLLOWS, SURE / np.sqrt(len(one.run))):
        return None
    away = min(abs(one.shift - shift) for shift in known)
    if away < LATE or one.now**2 > BETTER * one.best**2:
        return None
    seconds = one.shift * one.run.sample_period_s
    words = "late" if seconds > 0.0 else "early"
    text = (
        f"is {abs(seconds):.4g} s {words} in this run: moved by that, its changes are those of the "
        f"output (correlation {one.best:.2f}, now {one.now:.2f}). Set the clocks right, or shift "
        "the column"
    )
    return DataNote(
        one.run.group, f"reference of {name}", (0, len(one.run) - 1), "late_reference", text
    )


def _tell_missing(one: _Followed, others: Sequence[_Followed], name: str) -> DataNote | None:
    loaded = [f for f in others if f.moves]
    if one.moves or len(loaded) < LOADED * len(others):
        return None
    usual = float(np.median([f.fast_drift for f in others]))
    loads = float(np.median([f.fast_load for f in loaded]))
    if one.fast_drift < max(LOUDER * usual, LEAST * loads):
        return None
    text = (
        "stands still, while the output changes "
        f"{one.fast_drift / max(usual, 1e-300):.0f} times as much from row to row as "
        "drift does in the other runs: the load is not in the log. Log it, or leave the run out"
    )
    return DataNote(
        one.run.group, f"reference of {name}", (0, len(one.run) - 1), "missing_reference", text
    )
