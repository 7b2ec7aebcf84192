"""Finds wrong data: run, column, rows, what it looks like and what to do.

Nothing here changes a figure. A missing effect is not wrong data: what several runs show in the
same way is left to the diagnosis.
"""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.config import Config
from zerodrift.base.remember import remember_last
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.data_notes import DataNote, name_columns
from zerodrift.diagnosis.misfits import (
    FEWEST_ROWS,
    FEWEST_RUNS,
    Bench,
    find_load_columns,
    find_load_gains,
    find_time_units,
)
from zerodrift.diagnosis.noise_gains import find_noise_gains
from zerodrift.diagnosis.standing import find_cut_off, find_leaps, find_standing

FURTHER = 0.1
"""Share of the training logs' span by which test logs may reach further."""
SHORT_ROWS, SHORT_SHARE = 60, 0.02
"""A test run of fewer rows, or a smaller share of a training run, says nothing."""


def review_logs(config: Config, dataset: Dataset) -> tuple[DataNote, ...]:
    """Return what looks wrong with a project's logs, by the names of their own columns."""
    return name_columns(review(dataset), config)


@remember_last
def review(dataset: Dataset) -> tuple[DataNote, ...]:
    """Return what looks wrong with the logs of a data set.

    Args:
        dataset: the runs. With one run only faults within it are found; with two runs it is unknown
            which one is wrong.
    """
    outputs = dataset.outputs
    notes: list[DataNote] = []
    runs = (*dataset.train, *dataset.test)
    for check in (find_standing, find_cut_off, find_load_columns, find_load_gains, find_leaps):
        told = {(note.run, note.column) for note in notes}
        notes += [n for n in check(runs, outputs) if (n.run, n.column) not in told]
    told = {(note.run, note.column) for note in notes}
    notes += [n for n in find_noise_gains(runs, outputs) if (n.run, n.column) not in told]
    whole = [run for run in runs if run.part == 0 and len(run) >= FEWEST_ROWS]
    if any(note.kind == "gain" for note in notes) and len(whole) >= FEWEST_RUNS:
        # A drift that goes with the load looks like a gain, unless the other runs have it too.
        bench = Bench(whole, outputs, np.array(dataset.full_scale))
        notes = [
            note
            for note in notes
            if note.kind != "gain"
            or note.column not in outputs
            or not bench.agrees(note.run, note.column)
        ]
    notes += find_time_units(runs)
    spoilt = {note.run for note in notes}
    sound = [run for run in whole if run.group not in spoilt]
    if len(sound) >= FEWEST_RUNS and outputs:
        notes += Bench(sound, outputs, np.array(dataset.full_scale)).review()
    notes += _look_at_test(dataset, {note.run for note in notes})
    return tuple(notes)


def _look_at_test(dataset: Dataset, spoilt: set[str]) -> list[DataNote]:
    """Return notes on test runs that are too short, or reach further than the training runs."""
    if not dataset.test or not dataset.train:
        return []
    notes: list[DataNote] = []
    usual = float(np.median([len(run) for run in dataset.train]))
    low, high = _reach(dataset.train)
    margin = FURTHER * max(high - low, 1e-9)
    for run in dataset.test:
        if run.group in spoilt:
            continue
        if run.part == 0 and len(run) < max(SHORT_ROWS, SHORT_SHARE * usual):
            notes.append(
                DataNote(
                    run.group,
                    "time",
                    (0, len(run) - 1),
                    "too_short",
                    f"a test of {len(run)} rows says next to nothing about the error; training "
                    f"runs have {usual:.0f}. Test with a longer log",
                )
            )
        t = run.temperature_degC
        beyond = np.flatnonzero((t < low - margin) | (t > high + margin))
        if beyond.size:
            notes.append(
                DataNote(
                    run.group,
                    "temperature",
                    (int(beyond[0]), int(beyond[-1])),
                    "beyond_training",
                    f"reaches {t.min():.1f} to {t.max():.1f} degC, the training logs {low:.1f} to "
                    f"{high:.1f} degC: what a model says beyond them is not known. Train on logs "
                    "that reach as far",
                )
            )
    return notes


def _reach(runs: Sequence[Run]) -> tuple[float, float]:
    return (
        min(float(run.temperature_degC.min()) for run in runs),
        max(float(run.temperature_degC.max()) for run in runs),
    )
