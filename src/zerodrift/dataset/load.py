"""From zerodrift.toml to runs: selects, reads, checks and resamples the logs."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array, find_median, find_quantile
from zerodrift.base.config import DWELL, TEST, TRAIN, USES, Config, locate_key
from zerodrift.base.errors import InputError
from zerodrift.base.files import show_path
from zerodrift.dataset.checks import check_period, guess_temperature_unit, locate_row
from zerodrift.dataset.conversions import KELVIN
from zerodrift.dataset.open_log import open_log
from zerodrift.dataset.runs import Dataset, Run, share_resolution
from zerodrift.dataset.sampling import (
    COARSEST,
    MIN_STEPS,
    Sampling,
    Stretch,
    look_at_sampling,
    plan_stretches,
)
from zerodrift.dataset.selectors import Selection, expand_selectors, order_path
from zerodrift.dataset.shared_rows import (
    KnownRun,
    Repeats,
    RunKey,
    find_repeats,
    name_runs,
    refuse_overlaps,
)
from zerodrift.dataset.tables import LogTable
from zerodrift.dataset.units import are_alike, read_time_unit, read_unit, refuse_unit, tell_time

# What is odd in logs that can be read: a run in another unit, readings far from their neighbours.
#
# Nothing here is refused: each may be right, but misleads a fit where it is a mistake.

UNIT_RATIOS = {
    1000.0: "one in thousandths of the other's unit",
    0.001: "one in thousandths of the other's unit",
    -1.0: "the sign of one reversed",
    9.80665: "one in newtons, the other in kilograms",
    1 / 9.80665: "one in newtons, the other in kilograms",
}
"""Slopes of a reading against its reference that speak for a wrong unit, and what they mean."""
RATIO_TOLERANCE = 0.02
FOLLOWS = 0.98
"""A reading follows its reference if this share of its variance lies on a line through it."""
APART_K = 150.0
"""A run this much hotter than every other one, throughout, is looked at."""
SAMPLE = 20_000
"""Rows, evenly spaced, from which a run's usual range and steps are taken."""
BLOCK = 1 << 16
"""Rows that are searched at once, so that a long log takes no memory of its size."""
SPIKE_K = 5.0
SPIKE_RANGES = 3.0
SPIKE_STEPS = 30.0
"""A row is a spike if it stands out of both neighbours by so many kelvin or, in an output, by so
many times the range of the drift and by so many usual steps; the neighbours agree to a tenth."""


def find_oddities(config: Config, runs: Sequence[Run]) -> list[str]:
    """Return a note on each kind of oddity, with the first run that shows it."""
    notes = _find_kelvin_runs(config, runs)
    where = [
        (run, row) for run in runs for row in _find_spikes(run.temperature_degC, SPIKE_K).tolist()
    ]
    notes += _tell_spikes(where, config.temperature_column, "temperature")
    for index, output in enumerate(config.outputs):
        where = [(run, row) for run in runs for row in _find_drift_spikes(run, index)]
        notes += _tell_spikes(where, output.measured, f"output {output.name}")
        notes += _find_unit_mismatch(runs, index, output.measured, output.reference)
    return notes


def _find_kelvin_runs(config: Config, runs: Sequence[Run]) -> list[str]:
    """Return a note if some runs, and not all, look as if they were in kelvin."""
    lowest = {run.name: float(run.temperature_degC.min()) for run in runs}
    highest = {run.name: float(run.temperature_degC.max()) for run in runs}
    kelvin = [run for run in runs if lowest[run.name] > KELVIN - 100]
    others = [run for run in runs if lowest[run.name] <= KELVIN - 100]
    if not kelvin or not others:
        return []
    hottest = max(highest[run.name] for run in others)
    odd = [run.group for run in kelvin if lowest[run.name] - hottest > APART_K]
    if not odd:
        return []
    names = list(dict.fromkeys(odd))
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return [
        f"run {names[0]}{more}: '{config.temperature_column}' is {APART_K:g} K and more above all "
        "other runs: if it is in kelvin, subtract 273.15"
    ]


def _find_spikes(values: Array, least: float) -> np.ndarray:
    """Return the rows that differ from both neighbours by more than `least`, which agree."""
    if values.size < 3:
        return np.zeros(0, dtype=np.intp)
    found = []
    for begin in range(0, values.size - 2, BLOCK):
        steps = np.diff(values[begin : begin + BLOCK + 2])
        if max(steps.max(), -steps.min()) > least:
            up, down = steps[:-1], -steps[1:]
            height = np.abs(up + down) / 2
            spikes = (height > least) & (np.abs(up - down) < height / 10)
            found.append(np.flatnonzero(spikes) + begin + 1)
    return np.concatenate(found) if found else np.zeros(0, dtype=np.intp)


def _find_drift_spikes(run: Run, index: int) -> list[int]:
    """Return the rows of one output whose drift differs much from both neighbours and all
    others."""
    drift = run.measured[:, index] - run.reference[:, index]
    if drift.size < 3:
        return []
    some = np.arange(0, drift.size - 1, _spread(drift.size))
    low, high = (find_quantile(drift[some], share) for share in (0.01, 0.99))
    usual = find_median(np.abs(drift[some + 1] - drift[some]))
    least = max(SPIKE_RANGES * (high - low), SPIKE_STEPS * usual)
    return [int(row) for row in _find_spikes(drift, least)] if least > 0 else []


def _spread(rows: int) -> int:
    """Return the distance in rows at which about `SAMPLE` of them are taken."""
    return max(rows // SAMPLE, 1)


def _tell_spikes(where: Sequence[tuple[Run, int]], column: str, what: str) -> list[str]:
    if not where:
        return []
    run, row = where[0]
    values = run.temperature_degC if what == "temperature" else None
    height = "" if values is None else f" to {values[row]:.4g} degC"
    rows = "one row" if len(where) == 1 else f"{len(where)} rows, the first"
    return [
        f"'{column}' ({what}) jumps{height} and back in {rows} at "
        f"{tell_time(run.time_s[row])} of {run.source.name}: if no sensor did that, take the "
        "row out"
    ]


def _find_unit_mismatch(
    runs: Sequence[Run], index: int, measured: str, reference: float | str
) -> list[str]:
    """Return a note if a reading is its reference times a factor that units or signs explain."""
    if not isinstance(reference, str):
        return []
    odd: dict[float, list[str]] = {}
    for run in runs:
        some = slice(None, None, _spread(len(run)))
        reading, truth = run.measured[some, index], run.reference[some, index]
        reading, truth = reading - reading.mean(), truth - truth.mean()
        power = float(truth @ truth)
        if power == 0 or not (reading @ reading) > 0:
            continue
        slope = float(reading @ truth) / power
        if slope * slope * power < FOLLOWS * float(reading @ reading):
            continue
        for ratio in UNIT_RATIOS:
            if abs(slope / ratio - 1) < RATIO_TOLERANCE:
                odd.setdefault(ratio, []).append(run.group)
    notes = []
    for ratio, names in odd.items():
        who = "every run" if len(names) == len(runs) else f"run {names[0]}"
        notes.append(
            f"in {who} '{measured}' is {ratio:g} times '{reference}': {UNIT_RATIOS[ratio]}?"
        )
    return notes


# From zerodrift.toml to runs: selects, reads, checks and resamples the logs.

SMALL_SPAN_K = 2.0
"""Train logs that span less than this are noted: little can be learnt from them."""
MOST_KEPT = 1 << 20
"""Values of small logs that are kept, 8 MB, so that they need not be read again."""


@dataclass(frozen=True)
class _Piece:
    """One stretch to be filled, column by column."""

    key: RunKey
    part: int
    stretch: Stretch
    temperature_degC: Array
    measured: Array
    reference: Array
    inputs: dict[str, Array]


def load_dataset(config: Config, skip_invalid: bool = False) -> Dataset:
    """Read, check and resample every log of a project.

    Args:
        config: the project.
        skip_invalid: drop invalid rows (no number, no temperature, time not rising) and note how
            many, instead of raising.

    Returns:
        The runs by use, at `config.sample_period_s`; `notes` has what the user should know.

    Raises:
        InputError: a log is missing or damaged, or holds impossible values.
    """
    notes: list[str] = []
    selections = {use: expand_selectors(config, use) for use in USES}
    files = {selection.path.resolve() for use in USES for selection in selections[use]}
    known: list[KnownRun] = []
    kept = _KeptTables()
    pieces: dict[str, list[_Piece]] = {}
    for use in USES:
        pieces[use] = []
        for selection in selections[use]:
            table, spans = open_log(config, selection, skip_invalid, notes)
            of_log: list[_Piece] = []
            for span in spans:
                planned, rows = _plan_run(config, table, selection, span, notes)
                of_log += planned
                if len(files) > 1 or len(table.runs) > 1:
                    known.append(KnownRun.mark(use, planned[0].key, selection, table, rows, config))
            kept.keep(selection, table)
            # Resampled column by column, to keep the memory low.
            _fill(config, table, of_log)
            pieces[use] += of_log
        pieces[use].sort(key=lambda piece: _order(piece.key, config.directory))
    learnt_or_tested = pieces[TRAIN] + pieces[TEST]
    refuse_overlaps([piece.key for piece in learnt_or_tested if piece.part == 0])
    known.sort(key=lambda run: (USES.index(run.use), _order(run.key, config.directory)))
    repeats = find_repeats(
        known,
        lambda selection: (
            kept.tables.get(selection) or open_log(config, selection, skip_invalid, [])[0]
        ),
        config.time_column,
    )
    notes += repeats.notes
    for use in USES:
        pieces[use] = _keep_once(pieces[use], repeats)
    names = name_runs([piece.key for use in USES for piece in pieces[use]], config.directory)
    finished = {use: [_finish(piece, names, config) for piece in pieces[use]] for use in USES}
    steps = share_resolution([run for use in USES for run in finished[use]])
    runs = {use: _link(replace(run, output_steps=steps) for run in finished[use]) for use in USES}
    _check_training(config, runs[TRAIN], notes)
    notes += find_oddities(config, [*runs[TRAIN], *runs[TEST]])
    return Dataset(
        train=runs[TRAIN],
        test=runs[TEST],
        dwell=runs[DWELL],
        outputs=tuple(output.name for output in config.outputs),
        units=tuple(output.unit for output in config.outputs),
        full_scale=tuple(output.full_scale for output in config.outputs),
        notes=tuple(dict.fromkeys(notes)),
    )


@dataclass(frozen=True)
class _KeptTables:
    """Logs that are small enough to be kept as they are until copies have been looked for."""

    tables: dict[Selection, LogTable] = field(default_factory=dict)

    def keep(self, selection: Selection, table: LogTable) -> None:
        """Keep a log's columns beside those that are taken out of the table, if there is room."""
        tables = (*self.tables.values(), table)
        if sum(len(each) * len(each.columns) for each in tables) <= MOST_KEPT:
            self.tables[selection] = replace(table, columns=dict(table.columns))


def _plan_run(
    config: Config,
    table: LogTable,
    selection: Selection,
    span: tuple[str, int, int],
    notes: list[str],
) -> tuple[list[_Piece], slice]:
    """Choose how one run (or the part of it that is selected) becomes stretches of steps.

    Returns:
        The stretches, to be filled, and the rows of the table that are selected.
    """
    run, start, stop = span
    source = table.source
    who = f"{source.label}: run '{run}'" if run else source.label
    if len(selection.files) > 1:
        who = show_path(selection.path, config.directory)
    time_s = table.columns[config.time_column]
    span_s = (0.0, math.inf)
    start_s = float(time_s[start])
    place = 0 if table.run_of_row is None else int(table.run_of_row[start])
    if selection.cut is not None:
        span_s = selection.cut.to_span(float(time_s[stop - 1] - time_s[start]))
        cut = selection.cut.find_rows(time_s[start:stop])
        start, stop = start + cut.start, start + cut.stop
    if stop - start < 2:
        raise InputError(_explain_too_few(who, stop - start, 0, config))
    sampling = look_at_sampling(time_s[start:stop], config.sample_period_s)
    median_s = sampling.usual_s
    setting = locate_key(config.path, "sensor", "sample_period_s")
    # Only numbers leave their unit open.
    is_number = table.clock is None or table.clock.kind == "number"
    stated = config.time.unit or read_time_unit(config.time_column) if is_number else "s"
    period_s = config.sample_period_s
    refuse_unit(who, config.time_column, stated, start_s, median_s, period_s, setting)
    _judge_sampling(config, table, who, start, sampling, notes)
    check_period(who, median_s, config.sample_period_s, COARSEST, setting)
    stretches, gaps = plan_stretches(time_s, start, stop, config.sample_period_s)
    long_enough = [stretch for stretch in stretches if stretch.steps >= MIN_STEPS]
    if not long_enough:
        steps = max(stretch.steps for stretch in stretches)
        raise InputError(_explain_too_few(who, stop - start, steps, config))
    _note_stretches(who, time_s, gaps, stretches, notes)
    if median_s > 1.05 * config.sample_period_s:
        notes.append(
            f"{who}: a row every {median_s:.4g} s is interpolated to steps of "
            f"{config.sample_period_s:g} s"
        )
    cut_text = selection.cut.text if selection.cut else ""
    key = RunKey(
        selection.path, run, cut_text, span_s, selection.where, start_s, place, selection.files
    )
    parts = [_allocate(config, key, part, stretch) for part, stretch in enumerate(long_enough)]
    return parts, slice(start, stop)


def _judge_sampling(
    config: Config, table: LogTable, who: str, start: int, sampling: Sampling, notes: list[str]
) -> None:
    """Refuse a cadence that is too slow for the firmware's step; tell what a change costs."""
    period_s = config.sample_period_s
    if sampling.bursts is not None:
        rows = float(np.median(np.diff(sampling.bursts)))
        notes.append(
            f"{who}: rows come in bursts of {rows:g} every {sampling.usual_s:.4g} s; each is taken "
            "as its mean"
        )
    if len(sampling.cadences) == 1:
        return
    (_, first_s), (row, second_s) = sampling.cadences[:2]
    place = locate_row(table.source, table.position(min(start + row, len(table) - 1)))
    if sampling.slowest_s > COARSEST * period_s:
        raise InputError(
            f"{place.text}: the sample period changes from {first_s:.4g} s to {second_s:.4g} s; "
            f"expected a row at least every {COARSEST * period_s:.4g} s throughout, for "
            f"sample_period_s = {period_s:g}. Set sample_period_s = {sampling.slowest_s:.3g}, or "
            "split the file there and leave the slower part out."
        )
    ratio = (sampling.slowest_s / sampling.fastest_s) ** 0.5
    notes.append(
        f"{place.text}: the sample period changes from {first_s:.4g} s to {second_s:.4g} s; "
        f"brought to {period_s:g} s with {period_s / sampling.fastest_s:.3g} to "
        f"{period_s / sampling.slowest_s:.3g} rows in a step, whose noise differs by up to "
        f"{ratio:.2g} times where that of rows is white"
    )


def _note_stretches(
    who: str, time_s: Array, gaps: Sequence[int], stretches: Sequence[Stretch], notes: list[str]
) -> None:
    if gaps:
        longest = max(gaps, key=lambda row: time_s[row + 1] - time_s[row])
        length_s = float(time_s[longest + 1] - time_s[longest])
        times = "once" if len(gaps) == 1 else f"{len(gaps)} times"
        notes.append(
            f"{who}: interrupted {times} (longest {length_s:.4g} s, after "
            f"{tell_time(time_s[longest])}); not bridged, read as {len(stretches)} stretches"
        )
    short = [stretch for stretch in stretches if stretch.steps < MIN_STEPS]
    if short:
        notes.append(
            f"{who}: left out {len(short)} of {len(stretches)} stretches, of fewer than "
            f"{MIN_STEPS} steps each"
        )


def _explain_too_few(who: str, rows: int, steps: int, config: Config) -> str:
    return (
        f"{who}: too few rows: {rows}, which is {steps} steps of {config.sample_period_s:g} s; "
        f"expected at least {MIN_STEPS} steps without a gap. Record longer, or take it out of "
        "[logs]."
    )


def _allocate(config: Config, key: RunKey, part: int, stretch: Stretch) -> _Piece:
    # Column by column in memory: each column is written as it is read, and touched only then.
    shape = (stretch.steps, len(config.outputs))
    reference = np.zeros(shape, order="F")
    for index, output in enumerate(config.outputs):
        if not isinstance(output.reference, str) and output.reference != 0:
            reference[:, index] = output.reference
    return _Piece(
        key, part, stretch, np.empty(stretch.steps), np.empty(shape, order="F"), reference, {}
    )


def _fill(config: Config, table: LogTable, pieces: Sequence[_Piece]) -> None:
    """Resample each column into the pieces, letting go of it at once."""
    for column in list(table.columns):
        values = table.columns.pop(column)
        for piece in pieces:
            steps = piece.stretch.resample(values)
            if column == config.temperature_column:
                piece.temperature_degC[:] = steps
            for index, output in enumerate(config.outputs):
                if output.measured == column:
                    piece.measured[:, index] = steps
                if output.reference == column:
                    piece.reference[:, index] = steps
            for name, input_column in config.inputs.items():
                if input_column == column:
                    piece.inputs[name] = steps.copy()


def _keep_once(pieces: Sequence[_Piece], repeats: Repeats) -> list[_Piece]:
    """Return the stretches without those, and without the steps, that another run has too."""
    kept = []
    for piece in pieces:
        if piece.key in repeats.left_out:
            continue
        time_s = piece.stretch.time_s
        steps = int(np.searchsorted(time_s, repeats.ends_s.get(piece.key, math.inf)))
        if steps == time_s.size:
            kept.append(piece)
        elif steps >= MIN_STEPS:
            first = slice(steps)
            kept.append(
                replace(
                    piece,
                    stretch=replace(piece.stretch, time_s=time_s[first]),
                    temperature_degC=piece.temperature_degC[first],
                    measured=piece.measured[first],
                    reference=piece.reference[first],
                    inputs={name: values[first] for name, values in piece.inputs.items()},
                )
            )
    return kept


def _finish(piece: _Piece, names: dict[RunKey, str], config: Config) -> Run:
    group = names[piece.key]
    return Run(
        name=group if piece.part == 0 else f"{group}#{piece.part + 1}",
        group=group,
        part=piece.part,
        source=piece.key.path,
        sample_period_s=config.sample_period_s,
        time_s=piece.stretch.time_s,
        temperature_degC=piece.temperature_degC,
        measured=piece.measured,
        reference=piece.reference,
        inputs={name: piece.inputs[name] for name in config.inputs},
        start_s=piece.key.start_s,
        files=piece.key.files,
        tared=config.tared,
    )


def _order(key: RunKey, directory: Path) -> tuple[tuple[str, ...], int, float, float, str]:
    """Return what runs are sorted by before anything is fitted: file, place in it, part."""
    return order_path(key.path, directory), key.place, *key.span_s, key.cut


def _link(runs: Iterable[Run]) -> tuple[Run, ...]:
    """Return the stretches, each of a run's later ones with the one before it."""
    linked: list[Run] = []
    for run in runs:
        follows = run.part > 0 and linked and linked[-1].group == run.group
        linked.append(replace(run, before=linked[-1]) if follows else run)
    return tuple(linked)


def _check_training(config: Config, train: Sequence[Run], notes: list[str]) -> None:
    """Refuse logs that nothing can be learnt from; note what looks odd."""
    low = min(float(run.temperature_degC.min()) for run in train)
    high = max(float(run.temperature_degC.max()) for run in train)
    if low == high:
        raise InputError(
            f"{locate_key(config.path, 'logs', 'train')}: the temperature "
            f"('{config.temperature_column}') is {low:g} degC in every row of the train logs; "
            "expected it to move, as there is nothing to learn otherwise. Record a log with the "
            "temperature changing, or name the right column."
        )
    if high - low < SMALL_SPAN_K:
        notes.append(
            f"the train logs span only {high - low:.2g} K ({low:.4g} to {high:.4g} degC); the "
            "compensation holds nowhere else"
        )
    medians = np.array([np.median(run.temperature_degC) for run in train])
    hint = guess_temperature_unit(config.temperature_column, medians)
    hint = "" if config.temperature_codes.range else hint  # who says the range means degC
    if hint and (low > 0 or read_unit(config.temperature_column) not in ("", "degC")):
        notes.append(f"'{config.temperature_column}' is read as degC.{hint}")
    for index, output in enumerate(config.outputs):
        measured = [run.measured[:, index] for run in train]
        if min(part.min() for part in measured) == max(part.max() for part in measured):
            notes.append(
                f"'{output.measured}' of output {output.name} is {measured[0][0]:g} {output.unit} "
                "in every row of the train logs: is the channel connected?"
            )
        suffix = read_unit(output.measured)
        if suffix and not are_alike(suffix, output.unit):
            notes.append(
                f"'{output.measured}' ends in {suffix}, but [outputs.{output.name}] unit is "
                f"{output.unit}"
            )
