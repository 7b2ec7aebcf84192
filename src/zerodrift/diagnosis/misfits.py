"""Wrong data of a whole run: another column, sign, gain, noise, unit of time or reference."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.agreement import FEWEST_ROWS, FEWEST_RUNS
from zerodrift.diagnosis.data_notes import DataNote

# Which column an output holds, its gain by the load, and a run's unit of time.

WRONG_GAIN = 0.15
"""A gain is wrong if it is off by more than this share."""
FOLLOWS, WRONG_SLOPE = 0.9, 0.3
"""A column that follows the load to this share has a wrong gain if it is off by this much."""
SAME = 1e-9
"""What two columns of one recorder's readings differ by at most, as a share, if they are one."""
FAMILIAR_GAINS = (1000.0, 100.0, 10.0, 2.0, 9.80665, 4.44822)
RATE = 12.0
"""A run's time is in another unit if its temperature moves this many times faster or slower."""


def find_copies(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on outputs that repeat another column of their log, to the last digit.

    In whatever unit: no two columns of a recorder are a straight line of each other but by copying.
    Where most runs are so, it is the sensor's configuration.
    """
    found: dict[tuple[str, str], DataNote] = {}
    for run in runs:
        if len(run) < FEWEST_ROWS:
            continue
        beside = {"temperature": run.temperature_degC, "time": run.time_s, **run.inputs}
        for k, name in enumerate(outputs):
            others = {
                **beside,
                **{f"reference of {o}": run.reference[:, j] for j, o in enumerate(outputs)},
                **{o: run.measured[:, j] for j, o in enumerate(outputs) if j != k},
            }
            source = _find_source(run.measured[:, k], others)
            if source:
                found[run.group, name] = DataNote(
                    run.group,
                    name,
                    (0, len(run) - 1),
                    "foreign_column",
                    f"repeats {source}, row by row: a foreign column. Name the right one, or log "
                    "the run again",
                )
    return _keep_few(found, runs)


def _find_source(x: Array, others: Mapping[str, Array]) -> str:
    """Return the column that a column [n] repeats, in whatever unit; empty: none."""
    spread = float(np.std(x))
    if spread == 0.0:
        return ""
    for name, y in others.items():
        other = float(np.std(y))
        if other == 0.0:
            continue
        slope = float(np.mean((x - x.mean()) * (y - y.mean()))) / other**2
        if float(np.std(x - slope * y)) < SAME * max(spread, float(np.abs(x).max())):
            return name
    return ""


def _keep_few(found: Mapping[tuple[str, str], DataNote], runs: Sequence[Run]) -> list[DataNote]:
    """Return the notes on columns of which most runs have none."""
    total = len({run.group for run in runs})
    counts = {name: sum(one == name for _, one in found) for _, name in found}
    return [note for (_, name), note in found.items() if total == 1 or 2 * counts[name] < total]


def find_load_columns(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on outputs that read another output's load and not their own.

    That shows within a run. Where most runs are so, it is the sensor, or its configuration.
    """
    found: dict[str, list[tuple[Run, int, int]]] = {}
    for run in runs:
        if run.part > 0 or len(run) < FEWEST_ROWS:
            continue
        measured = run.reference + run.steady_drift
        together = np.concatenate([measured, run.reference], axis=1)
        moves = np.ptp(together, axis=0) > 0.0
        count = len(outputs)
        if not moves.any():
            continue
        safe = np.where(moves, together, together + np.arange(len(run))[:, None] % 2)
        likeness = np.corrcoef(safe.T)[:count, count:] ** 2
        likeness[:, ~moves[count:]] = 0.0
        for j in range(count):
            k = int(likeness[j].argmax())
            load = run.reference[:, k] - run.reference[:, k].mean()
            slope = float(measured[:, j] @ load) / max(float(load @ load), 1e-300)
            if abs(slope - 1.0) > WRONG_SLOPE:
                continue  # crosstalk, or an effect of the load; what reads it reads all of it
            if k != j and likeness[j, k] >= FOLLOWS and likeness[j, j] < 0.5 * likeness[j, k]:
                found.setdefault(run.group, []).append((run, j, k))
    if len(runs) > 1 and 3 * len(found) > len(runs) + 1:
        return []
    notes = []
    for group, pairs in found.items():
        for run, j, k in pairs:
            swapped = any((one, two) == (k, j) for _, one, two in pairs)
            kind, words = (
                ("swapped", f"{outputs[j]} and {outputs[k]} look swapped")
                if swapped
                else ("foreign_column", f"reads the load of {outputs[k]}")
            )
            text = f"{words}: name the columns as they are, or exchange them in the log"
            notes.append(DataNote(group, outputs[j], (0, len(run) - 1), kind, text))
    return notes


def find_load_gains(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on outputs that read another multiple of a varying load than one.

    That shows within a run. Where most runs are so, it is the sensor.
    """
    notes = []
    for k, name in enumerate(outputs):
        slopes: dict[str, tuple[Run, float]] = {}
        for run in runs:
            load = run.reference[:, k] - run.reference[:, k].mean()
            power = float(load @ load)
            if power == 0.0 or run.part > 0:
                continue
            measured = run.reference[:, k] + run.steady_drift[:, k]
            measured = measured - measured.mean()
            slope = float(measured @ load) / power
            followed = slope**2 * power / max(float(measured @ measured), 1e-300)
            if followed < FOLLOWS:
                continue
            # A drift that goes with the load is slow: it has no part in what changes at once.
            fast = np.diff(run.reference[:, k])
            at_once = float(np.diff(run.measured[:, k]) @ fast) / float(fast @ fast)
            slope = min(slope, at_once, key=lambda s: abs(s - 1.0))
            slopes[run.group] = (run, slope)
        wrong = {g: s for g, s in slopes.items() if abs(s[1] - 1.0) > WRONG_SLOPE}
        if len(slopes) > 1 and 3 * len(wrong) > len(slopes) + 1:
            continue
        for group, (run, slope) in wrong.items():
            kind, text = tell_gain(slope, "the column")
            notes.append(DataNote(group, name, (0, len(run) - 1), kind, text))
    return notes


def tell_gain(gain: float, what: str) -> tuple[str, str]:
    """Return kind and text for a column that is so many times what it should be."""
    if gain < 0.0 and abs(np.log(-gain)) <= WRONG_SLOPE:
        return "sign", (
            f"{what} has the opposite sign in this run: reversed, it agrees with the others. "
            "Reverse it in the log"
        )
    familiar = [g for f in FAMILIAR_GAINS for g in (f, 1.0 / f)]
    near = min(familiar, key=lambda g: abs(np.log(abs(gain) / g)) if gain else np.inf)
    said = f"{near:.4g}" if gain and abs(np.log(abs(gain) / near)) < 0.1 else f"{gain:.3g}"
    return "gain", (
        f"{what} is {said} times what the other runs lead to expect: another unit or gain. "
        "Convert it in the log, or leave the run out"
    )


def find_time_units(runs: Sequence[Run]) -> list[DataNote]:
    """Return notes on runs whose temperature moves many times faster or slower than in others."""
    groups = list(dict.fromkeys(run.group for run in runs))
    if len(groups) < FEWEST_RUNS:
        return []
    first = {run.group: run for run in runs if run.part == 0}
    rates = {g: _measure_rate(run) for g, run in first.items()}
    notes = []
    for group, run in first.items():
        others = [rate for g, rate in rates.items() if g != group and rate > 0.0]
        lengths = [len(r) for g, r in first.items() if g != group]
        if not others or rates[group] <= 0.0:
            continue
        faster = rates[group] / float(np.median(others))
        shorter = float(np.median(lengths)) / len(run)
        extreme = faster > RATE * max(others) / float(np.median(others))
        slow = faster < min(others) / float(np.median(others)) / RATE
        if (extreme and shorter > RATE) or (slow and shorter < 1.0 / RATE):
            factor = faster if extreme else 1.0 / faster
            unit = min((60.0, 1000.0, 3600.0), key=lambda u: abs(np.log(factor / u)))
            text = (
                f"everything is about {unit:g} times {'faster' if extreme else 'slower'} than "
                "in the other runs: its time looks to be in another unit. State the unit of "
                "the time column, or convert the log"
            )
            notes.append(DataNote(group, "time", (0, len(run) - 1), "time_unit", text))
    return notes


def _measure_rate(run: Run) -> float:
    """Return how fast a run's temperature moves, K/s: nearly the largest of 20 stretches."""
    count = min(20, max(len(run) // 3, 1))
    edges = np.linspace(0, len(run) - 1, count + 1).astype(int)
    span_s = np.maximum(np.diff(edges), 1) * run.sample_period_s
    rates = np.abs(np.diff(run.temperature_degC[edges])) / span_s
    return float(np.quantile(rates, 0.9))


# A reference that is late, missing or reversed in one run: told by how the output follows it.

APART = 3
"""Rows over which changes are taken: drift is slower, loads are not."""
FOLLOWS_LOAD = 0.5
"""Correlation of the changes of output and reference from which the one follows the other, ..."""
BETTER = 4.0
"""... and how many times more of the output's changes, over what is left of them, it explains where
it is shifted: a load that moves smoothly is much the same a little later."""
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
    known = [f.shift for f in others if f.moves and f.best >= FOLLOWS_LOAD]
    if not one.moves or not known or one.best < max(FOLLOWS_LOAD, SURE / np.sqrt(len(one.run))):
        return None
    away = min(abs(one.shift - shift) for shift in known)
    shifted, now = (c**2 / max(1.0 - c**2, 1e-12) for c in (one.best, one.now))
    if away < LATE or shifted < BETTER * now:
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


# A column whose noise and whose whole course are many times those of the other runs.
#
# Noise is the one thing that a run has in common with runs of another kind, at other temperatures
# and under other loads: where the noise and the range of one column alone are 1,000 times what they
# are elsewhere, its unit or gain is another, whatever the run was for.

ALIKE = 3.0
"""... which agree with each other to this factor, and more than any other output of that run
differs from theirs, ..."""
OF_RANGE = 0.5
"""... and the column's range differs by at least this power of the same factor."""


def find_noise_gains(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on outputs whose noise and range are in one run many times those elsewhere."""
    whole = [run for run in runs if run.part == 0 and len(run) >= FEWEST_ROWS]
    if len(whole) < FEWEST_RUNS:
        return []
    noise = np.stack([_measure_noise(run) for run in whole])
    reach = np.stack([np.ptp(run.measured, axis=0) for run in whole])
    if not outputs or not (noise > 0.0).all():
        return []
    usual = np.median(noise, axis=0)
    notes = []
    for i, run in enumerate(whole):
        others = np.delete(np.arange(len(whole)), i)
        ratios = noise[i] / usual
        for k, name in enumerate(outputs):
            elsewhere = noise[others, k]
            agree = float(elsewhere.max()) < ALIKE * float(elsewhere.min())
            beside = np.append(np.delete(ratios, k), 1.0)
            factor = float(noise[i, k] / np.median(elsewhere))
            stands_out = factor > LOUDER * beside.max() or factor < beside.min() / LOUDER
            if not (agree and stands_out):
                continue
            wider = float(reach[i, k] / np.median(reach[others, k]))
            same_way = wider > factor**OF_RANGE if factor > 1.0 else wider < factor**OF_RANGE
            if same_way:
                rows = (0, len(run) - 1)
                notes.append(DataNote(run.group, name, rows, *tell_gain(factor, "the column")))
    return notes


def _measure_noise(run: Run) -> Array:
    """Return the usual size [K] of the second differences of what is measured."""
    return np.asarray(np.median(np.abs(np.diff(run.measured, n=2, axis=0)), axis=0))
