"""Which column an output holds, its gain by the load, and a run's unit of time."""

from collections.abc import Mapping, Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.agreement import FEWEST_ROWS, FEWEST_RUNS
from zerodrift.diagnosis.data_notes import DataNote

WRONG_GAIN = 0.15
"""A gain is wrong if it is off by more than this share."""
FOLLOWS, WRONG_SLOPE = 0.9, 0.3
"""A column that follows the load to this share has a wrong gain if it is off by this much."""
LOST = 0.1
"""Share of an output's changes that its load has where it reads something else."""
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
