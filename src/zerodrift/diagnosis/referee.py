"""Finds wrong data: run, column, rows, what it looks like and what to do.

Nothing here changes a figure. A missing effect is not wrong data: what several runs show in the
same way is left to the diagnosis.
"""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.config import Config, locate_key
from zerodrift.base.errors import InputError, nearest
from zerodrift.base.remember import remember_last
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.agreement import FEWEST_ROWS, FEWEST_RUNS, Bench
from zerodrift.diagnosis.data_notes import DataNote, name_columns
from zerodrift.diagnosis.explanations import explain, find_reading, find_units, tell_other, weigh
from zerodrift.diagnosis.leaks import find_leaks
from zerodrift.diagnosis.misfits import (
    find_copies,
    find_load_columns,
    find_load_gains,
    find_noise_gains,
    find_reference_faults,
    find_time_units,
)
from zerodrift.diagnosis.sentinels import find_sentinels, find_spikes
from zerodrift.diagnosis.standing import (
    find_breaks,
    find_cut_off,
    find_leaps,
    find_standing,
    find_unit_changes,
    find_wraps,
)

SEEN = ("saturated", "stuck", "foreign_column")
"""What is seen in the column itself: it gives way to an exchange of columns, or to another unit of
the temperature, and not to rows that are left out beside it."""
OF_A_COLUMN = (
    *("gain", "sign", "offset_jump", "wrapped", "late_reference", "unit_change"),
    *SEEN,
)
"""What one column shows where it may be the run that is wrong: a thermometer in an output's column,
or another sensor's log."""
OF_REFERENCE = "reference of "

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
    runs = (*dataset.train, *dataset.test)
    notes = _look_at_columns(runs, outputs)
    notes += find_leaks(dataset.train, dataset.test, outputs)
    told = {(note.run, note.column) for note in notes}
    notes += [n for n in find_noise_gains(runs, outputs) if (n.run, n.column) not in told]
    notes += find_time_units(runs)
    notes = _hold_together(notes, runs, dataset)
    told = {(note.run, note.column) for note in notes}
    dwell = _look_at_dwell(dataset)
    told |= {(note.run, note.column) for note in dwell}
    spikes = find_spikes((*runs, *dataset.dwell), outputs)
    notes += [n for n in spikes if (n.run, n.column) not in told]
    notes += dwell
    notes += _look_at_test(dataset, {note.run for note in notes})
    return tuple(notes)


def _look_at_columns(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return what single columns show; of a column what is told first."""
    notes: list[DataNote] = []
    checks = (
        *(find_copies, find_unit_changes, find_sentinels, find_wraps, find_standing, find_cut_off),
        *(find_load_columns, find_reference_faults, find_breaks, find_load_gains, find_leaps),
    )
    for check in checks:
        told = {(note.run, note.column.removeprefix(OF_REFERENCE)) for note in notes}
        found = check(runs, outputs)
        notes += [n for n in found if (n.run, n.column.removeprefix(OF_REFERENCE)) not in told]
    return notes


def _hold_together(
    notes: Sequence[DataNote], runs: Sequence[Run], dataset: Dataset
) -> list[DataNote]:
    """Return the notes, with those on runs that do not agree with the others.

    What was told of a run's columns gives way where another reading of the run explains more.
    """
    rows = {group: sum(len(r) for r in runs if r.group == group) for group in _list_groups(runs)}
    whole = [run for run in runs if rows[run.group] >= FEWEST_ROWS]
    groups = _list_groups(whole)
    if len(groups) < FEWEST_RUNS or not dataset.outputs:
        return list(notes)
    bench = Bench(whole, dataset.outputs, np.array(dataset.full_scale))
    accused = {note.run for note in notes if note.stops}
    sound = frozenset(i for i, group in enumerate(groups) if group not in accused)
    # A drift that goes with the load looks like a gain, unless the other runs have it too.
    kept = [
        note
        for note in notes
        if note.kind != "gain"
        or note.column not in dataset.outputs
        or note.run not in groups
        or not bench.agrees(note.run, note.column, sound)
    ]
    told: list[DataNote] = [note for note in kept if note.run not in groups]
    for i, group in enumerate(groups):
        own = [note for note in kept if note.run == group]
        if own and all(_may_be_more(note) for note in own):
            own = _look_again(own, bench, i, sound | {i})
        told += own
    accused = {note.run for note in told if note.stops}
    rest = frozenset(i for i, group in enumerate(groups) if group not in accused)
    units = find_units(bench, rest)
    told += units
    rest -= {groups.index(note.run) for note in units}
    most = max(1, len(groups) // 3) - (len(groups) - len(rest))
    while most > 0:
        worst = bench.find_worst(rest)
        found = find_reading(bench, rest) if worst is None else (worst, explain(bench, worst, rest))
        if found is None:
            break
        told += found[1]
        rest -= {found[0]}
        most -= 1
    return told


def _list_groups(runs: Sequence[Run]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(run.group for run in runs))


def _may_be_more(note: DataNote) -> bool:
    """Return whether what was told of a column may be what another fault of the run looks like."""
    return note.kind in OF_A_COLUMN and (note.kind, note.column) != ("unit_change", "temperature")


def _look_again(own: list[DataNote], bench: Bench, i: int, rest: frozenset[int]) -> list[DataNote]:
    """Return what was told of a run's columns, or what explains more of it."""
    now = bench.assess(i, rest) if len(rest) >= FEWEST_RUNS else None
    if now is None or now.doubt.max() < 1.0:
        return own
    found = weigh(bench, i, rest, now)
    is_seen = any(note.kind in SEEN for note in own)
    if found is not None:
        whole = not found.seen and (
            found.notes[0].column == "temperature" or found.notes[0].kind == "swapped"
        )
        return own if is_seen and not whole else list(found.notes)
    columns = {note.column.removeprefix(OF_REFERENCE) for note in own}
    far = [name for name, doubt in zip(bench.outputs, now.doubt, strict=True) if doubt >= 1.0]
    if is_seen or 2 * len(far) <= len(bench.outputs) or columns.issuperset(far):
        return own
    return [tell_other(bench, i, now)]


def _look_at_dwell(dataset: Dataset) -> list[DataNote]:
    """Return what the columns of the dwell show, which sets the noise floor.

    That its thermometer stands still is what a dwell is for.
    """
    notes = []
    for check in (find_sentinels, find_standing, find_breaks):
        notes += [
            note
            for note in check(dataset.dwell, dataset.outputs)
            if note.column != "temperature" or note.kind not in ("constant", "frozen", "saturated")
        ]
    return list({(note.run, note.column): note for note in reversed(notes)}.values())


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
            text = (
                f"a test of {len(run)} rows says next to nothing about the error; training "
                f"runs have {usual:.0f}. Test with a longer log"
            )
            notes.append(DataNote(run.group, "time", (0, len(run) - 1), "too_short", text))
        t = run.temperature_degC
        beyond = np.flatnonzero((t < low - margin) | (t > high + margin))
        if beyond.size:
            text = (
                f"reaches {t.min():.1f} to {t.max():.1f} degC, the training logs {low:.1f} to "
                f"{high:.1f} degC: what a model says beyond them is not known. Train on logs "
                "that reach as far"
            )
            notes.append(
                DataNote(
                    run.group,
                    "temperature",
                    (int(beyond[0]), int(beyond[-1])),
                    "beyond_training",
                    text,
                )
            )
    return notes


def _reach(runs: Sequence[Run]) -> tuple[float, float]:
    return (
        min(float(run.temperature_degC.min()) for run in runs),
        max(float(run.temperature_degC.max()) for run in runs),
    )
