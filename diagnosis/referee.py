"""Finds wrong data: run, column, rows, what it looks like and what to do.

Nothing here changes a figure. A missing effect is not wrong data: what several runs show in the
same way is left to the diagnosis.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.config import Config, locate_key
from zerodrift.base.errors import InputError, nearest
from zerodrift.base.remember import remember_last
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.breaks import find_breaks
from zerodrift.diagnosis.data_notes import DataNote, name_columns
from zerodrift.diagnosis.leaks import find_leaks
from zerodrift.diagnosis.misfits import (
    FEWEST_ROWS,
    FEWEST_RUNS,
    Bench,
    find_load_columns,
    find_load_gains,
    find_time_units,
)
from zerodrift.diagnosis.noise_gains import find_noise_gains
from zerodrift.diagnosis.references import find_reference_faults
from zerodrift.diagnosis.sentinels import find_sentinels, find_spikes
from zerodrift.diagnosis.standing import find_cut_off, find_leaps, find_standing

STANDS = ("saturated", "stuck")
OF_A_COLUMN = (
    *("gain", "sign", "offset_jump", "wrapped", "foreign_column", "late_reference"),
    *STANDS,
)
"""What one column shows where it is the run that is wrong: a thermometer in an output's column, or
another sensor's log."""
OF_REFERENCE = "reference of "
Array = NDArray[np.float64]

FURTHER = 0.1
"""Share of the training logs' span by which test logs may reach further."""
SHORT_ROWS, SHORT_SHARE = 60, 0.02
"""A test run of fewer rows, or a smaller share of a training run, says nothing."""


def review_logs(config: Config, dataset: Dataset) -> tuple[DataNote, ...]:
    """Return what looks wrong with a project's logs, by the names of their own columns."""
    return name_columns(review(dataset), config)


def find_refusals(
    config: Config, dataset: Dataset, *, one_of_many: bool = False
) -> tuple[DataNote, ...]:
    """Return the notes at which `train`, `firmware` and `fleet` stop, before anything is fitted.

    Args:
        config: the project; what its `[logs] accept` names does not stop.
        dataset: its logs.
        one_of_many: it is a unit of a fleet, whose `accept` speaks of all units' runs.

    Raises:
        InputError: an entry of `accept` matches no note.
    """
    notes = review_logs(config, dataset)
    if not one_of_many:
        _refuse_unmatched(config, notes)
    accepted = {_normalise(entry) for entry in config.accept}
    return tuple(note for note in notes if note.stops and _normalise(note.entry) not in accepted)


def _refuse_unmatched(config: Config, notes: Sequence[DataNote]) -> None:
    """Refuse an entry of `[logs] accept` that takes on nothing: a typing error, or mended logs."""
    told = list(dict.fromkeys(note.entry for note in notes if note.stops))
    known = {_normalise(entry) for entry in told}
    for entry in config.accept:
        if _normalise(entry) not in known:
            found = f"Found: {', '.join(told)}" if told else "No note stops these logs"
            raise InputError(
                f"{locate_key(config.path, 'logs', 'accept')}: [logs] accept holds '{entry}', "
                f"which is no note on these logs{nearest(entry, told) or '.'} {found}; expected "
                '"RUN: KIND" of one of them. Correct the entry, or take it out.'
            )


def _normalise(entry: str) -> str:
    run, _, kind = entry.rpartition(":")
    return f"{run.strip()}: {kind.strip()}"


def explain_refusals(notes: Sequence[DataNote], config: Config) -> str:
    """Return the message for logs that are refused: what is wrong, and what would accept it."""
    lines = "\n  ".join(note.write() for note in notes)
    entries = ", ".join(f'"{entry}"' for entry in dict.fromkeys(note.entry for note in notes))
    return (
        f"the logs are refused, before anything is fitted:\n  {lines}\nMend the logs, or leave "
        f"the runs out. If they are right as they are, say so in {config.path.name}:\n  [logs] "
        f"accept = [{entries}]"
    )


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
    checks = (
        *(find_sentinels, find_standing, find_cut_off, find_breaks, find_load_columns),
        *(find_reference_faults, find_load_gains, find_leaps),
    )
    for check in checks:
        told = {(note.run, note.column.removeprefix(OF_REFERENCE)) for note in notes}
        found = check(runs, outputs)
        notes += [n for n in found if (n.run, n.column.removeprefix(OF_REFERENCE)) not in told]
    notes += find_leaks(dataset.train, dataset.test, outputs)
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
    notes = _look_again(notes, whole, outputs, np.array(dataset.full_scale))
    notes += find_time_units(runs)
    spoilt = {note.run for note in notes}
    sound = [run for run in whole if run.group not in spoilt]
    if len(sound) >= FEWEST_RUNS and outputs:
        notes += Bench(sound, outputs, np.array(dataset.full_scale)).review()
    told = {(note.run, note.column) for note in notes}
    notes += [n for n in find_spikes(runs, outputs) if (n.run, n.column) not in told]
    notes += _look_at_test(dataset, {note.run for note in notes})
    return tuple(notes)


def _look_again(
    notes: Sequence[DataNote], whole: Sequence[Run], outputs: Sequence[str], scales: Array
) -> list[DataNote]:
    """Return the notes; all of a run's are one where the run as a whole tells more."""
    accused = {note.run for note in notes}
    sound = [run for run in whole if run.group not in accused]
    told: list[DataNote] = []
    for group in dict.fromkeys(note.run for note in notes):
        own = [note for note in notes if note.run == group]
        runs = [run for run in whole if run.group == group]
        if runs and len(sound) >= FEWEST_RUNS - 1 and all(n.kind in OF_A_COLUMN for n in own):
            columns = [note.column.removeprefix(OF_REFERENCE) for note in own]
            is_seen = any(note.kind in STANDS for note in own)
            bench = Bench([*sound, runs[0]], outputs, scales)
            found = bench.look_again(None if is_seen else columns)
            own = found or [_name_reference(note, bench) for note in own]
        told += own
    return told


def _name_reference(note: DataNote, bench: Bench) -> DataNote:
    """Return a note on a wrong sign; of the reference, where that is what is reversed."""
    if note.kind != "sign" or note.column not in bench.outputs:
        return note
    if not np.ptp(bench.courses[-1].reference[:, bench.outputs.index(note.column)]):
        return note
    if not bench.is_reference_reversed(note.column):
        return note
    return replace(
        note,
        column=f"{OF_REFERENCE}{note.column}",
        kind="reversed_reference",
        text="has the opposite sign in this run: reversed, the drift agrees with that of the other "
        "runs. Reverse it in the log",
    )


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
