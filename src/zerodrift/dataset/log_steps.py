"""A log to which a finished model is applied: its rows, and the firmware's step of each.

Unlike a training log, it may lack readings, and it needs no reference.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.chip_codes import MEASURED, TEMPERATURE
from zerodrift.dataset.open_log import open_log
from zerodrift.dataset.runs import plan_spans
from zerodrift.dataset.sampling import KEPT_TOLERANCE, Stretch, plan_stretches
from zerodrift.dataset.selectors import Selection, list_files
from zerodrift.dataset.tables import LogTable, Source

FEWEST_ROWS = 2
"""Of a run; one row has no period."""


StepOfRow = NDArray[np.int32] | IntArray
MOST_SHORT = 2**31 - 1
"""Steps that int32 can number."""


@dataclass(frozen=True)
class StepStretch:
    """One uninterrupted stretch of a log at the firmware's period."""

    run: str
    """Value of the `run` column; "" without one."""
    stretch: Stretch
    first_step: int
    """Its first step among those of the whole log."""
    part: int
    """0 where it begins a run, then 1, 2, ..."""
    bridge: int
    """Steps that fill the gap before it."""
    start_s: float
    """The log's own clock at the first row of the run, in s."""


@dataclass(frozen=True)
class LogSteps:
    """A log, and which step of the firmware each of its rows belongs to."""

    source: Source
    table: LogTable
    rows: int
    """Rows of the file, dropped ones included."""
    stretches: tuple[StepStretch, ...]
    steps: int
    """Of all stretches."""
    step_of_row: StepOfRow
    """[rows] the step that holds at each row of the file; -1 for a row that was dropped."""
    notes: tuple[str, ...]
    quantities: Mapping[str, Array] = field(default_factory=dict)
    """Measured column that is converted -> [rows] in the output's unit, NaN for rows that were
    dropped; `source` has it as it was logged."""

    def drop_values(self) -> "LogSteps":
        """Return the log without the columns' values, which need memory; the steps remain."""
        return replace(self, table=LogTable(self.source, {}, (), None), stretches=())

    def resample(self, column: str, one: StepStretch) -> Array:
        """Return a column's values [steps] over one stretch; NaN where half a step has none."""
        values = self.table.columns[column]
        rows = values[one.stretch.start : one.stretch.stop]
        lacks = np.isnan(rows)
        if not lacks.any():
            return one.stretch.resample(values)
        if lacks.all():
            return np.full(one.stretch.steps, np.nan)
        known = np.flatnonzero(~lacks)
        last = np.maximum.accumulate(np.where(lacks, known[0], np.arange(rows.size)))
        held = values.copy()
        held[one.stretch.start : one.stretch.stop] = rows[last]
        missing = np.zeros_like(values)
        missing[one.stretch.start : one.stretch.stop] = lacks
        steps = np.array(one.stretch.resample(held))
        steps[one.stretch.resample(missing) > 0.5] = np.nan
        return steps


def read_log_steps(
    config: Config,
    path: Path,
    columns: Mapping[str, str],
    skip_invalid: bool = False,
    streamed: frozenset[str] = frozenset(),
) -> LogSteps:
    """Read a log for a finished model.

    Args:
        config: the project; says how times and columns are to be read.
        path: the log.
        columns: column -> where it is named, of all that is needed.
        skip_invalid: drop rows whose time is no number or does not rise, instead of raising.
        streamed: columns that have to be there, whose values are read from `source` row by row.

    Raises:
        InputError: a column is missing, the file is damaged, or a time cannot be right.
    """
    notes: list[str] = []
    selection = Selection(path, tuple(list_files(path)), None, None, f"the log {path}")
    time = config.time_column
    needed = {time: "[sensor] time", **columns}
    table, spans = open_log(config, selection, skip_invalid, notes, needed, streamed)
    if len(selection.files) > 1 or table.source.part:
        _make_source(table, path)
    rows = len(table) if table.kept is None else int(table.kept.max()) + 1
    measured = {output.measured for output in config.outputs}
    quantities = {}
    for column in measured & {*table.converted}:
        quantities[column] = np.full(rows, np.nan)
        quantities[column][table.positions] = table.columns[column]
    step_of_row: StepOfRow = np.full(rows, -1, dtype=np.int32)
    stretches: list[StepStretch] = []
    first = 0
    for run, start, stop in spans:
        if stop - start < FEWEST_ROWS:
            raise InputError(
                f"{table.source.label}: {f'run {run!r}' if run else 'the log'} has {stop - start} "
                f"row; expected {FEWEST_ROWS} at least, as one row has no period. Leave it out."
            )
        time_s = table.columns[time]
        planned, gaps = plan_stretches(time_s, start, stop, config.sample_period_s)
        planned = [one for one in planned if one.steps]
        if gaps:
            notes.append(
                f"{table.source.label}: {f'run {run!r}' if run else 'the log'} is interrupted "
                f"{len(gaps)} times; a straight line stands for what was not logged"
            )
        bridges, _ = plan_spans([one.time_s for one in planned], config.sample_period_s)
        for part, (stretch, bridge) in enumerate(zip(planned, (0, *bridges), strict=True)):
            own = slice(stretch.start, stretch.stop)
            at = own if table.kept is None else table.kept[own]
            if first + stretch.steps > MOST_SHORT:
                step_of_row = step_of_row.astype(np.int64)
            step_of_row[at] = _find_steps(stretch, time_s[own])
            step_of_row[at] += first
            stretches.append(StepStretch(run, stretch, first, part, bridge, float(time_s[start])))
            first += stretch.steps
    return LogSteps(
        table.source, table, rows, tuple(stretches), first, step_of_row, tuple(notes), quantities
    )


def _make_source(table: LogTable, path: Path) -> None:
    """Write the joined rows as the log that is read row by row; converted columns as logged."""
    frame = pl.DataFrame({**table.columns, **table.logged})
    table.source = Source(path, path.name, tuple(frame.columns), {}, frame=frame)
    table.kept = None


def _find_steps(stretch: Stretch, time_s: Array) -> StepOfRow:
    """Return the step that holds at each row [n]: the last one that is complete by then."""
    if stretch.method == "kept":
        if time_s.size <= MOST_SHORT:
            return np.arange(time_s.size, dtype=np.int32)
        return np.arange(time_s.size, dtype=np.int64)
    period_s = float(stretch.time_s[1] - stretch.time_s[0]) if stretch.steps > 1 else 0.0
    late = time_s + KEPT_TOLERANCE * period_s
    found = np.searchsorted(stretch.time_s, late, side="right") - 1
    return np.maximum(found, 0).astype(np.int64)


def name_columns(config: Config, sources: Sequence[str]) -> dict[str, str]:
    """Return column -> where it is named, for the sources of a model's channels.

    Args:
        config: the project.
        sources: `temperature_degC`, `measured:Fz` of an output, or an input's name.

    Raises:
        InputError: the project has no such input.
    """
    columns = {}
    for source in sources:
        column = find_column(config, source)
        if source == TEMPERATURE:
            columns[column] = "[sensor] temperature"
        elif source.startswith(MEASURED):
            columns[column] = f"[outputs.{source.removeprefix(MEASURED)}] measured"
        else:
            columns[column] = f"[inputs] {source}"
    return columns


def find_column(config: Config, source: str) -> str:
    """Return the column of a channel's source.

    Raises:
        InputError: zerodrift.toml has no such input.
    """
    if source == TEMPERATURE:
        return config.temperature_column
    if source.startswith(MEASURED):
        name = source.removeprefix(MEASURED)
        found = next((o.measured for o in config.outputs if o.name == name), None)
    else:
        found = config.inputs.get(source)
    if found is None:
        raise InputError(
            f"{config.path}: the model takes '{source}', which the project does not name; expected "
            "what the firmware was built with. Run `zerodrift firmware` again."
        )
    return found


def lay_bridge(before: Array, after: Array, steps: int) -> Array:
    """Return straight lines [steps, C] from the last of one stretch to the first of the next."""
    return np.linspace(before[-1], after[0], steps + 2)[1:-1]
