"""Runs that share rows: refused between two uses, counted once within one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.checks import locate_row
from zerodrift.dataset.copies import Marks, SharedRows, confirm, find_alignments, mark_run
from zerodrift.dataset.naming import RunKey
from zerodrift.dataset.selectors import Selection
from zerodrift.dataset.tables import LogTable

WHOLLY = 0.95
"""A run is a copy if so many of its rows are another one's."""
_USES = {"train": "learnt from", "test": "tested on", "dwell": "taken for the noise"}


@dataclass(frozen=True)
class KnownRun:
    """A run as it is logged, known by its content."""

    use: str
    """train | test | dwell."""
    key: RunKey
    selection: Selection
    columns: tuple[str, ...]
    """What is measured: the outputs, then the thermometer."""
    rows: slice
    """Its rows in the log's table."""
    marks: Marks

    @staticmethod
    def mark(
        use: str, key: RunKey, selection: Selection, table: LogTable, rows: slice, config: Config
    ) -> "KnownRun":
        """Mark a run before its log is resampled."""
        columns = (*(each.measured for each in config.outputs), config.temperature_column)
        marks = mark_run([table.columns[column][rows] for column in columns])
        return KnownRun(use, key, selection, columns, rows, marks)

    def take(self, table: LogTable) -> tuple[Array, ...]:
        """Return the run's measured columns, each [n], of its log's table."""
        return tuple(table.columns[column][self.rows] for column in self.columns)

    def name_rows(self, table: LogTable, first: int, count: int) -> str:
        """Return `log.csv:2 to log.csv:61` for rows of the run."""
        start = self.rows.start + first
        ends = (start, start + count - 1)
        return " to ".join(locate_row(table.source, table.position(row)).text for row in ends)


@dataclass(frozen=True)
class Repeats:
    """The rows of a project's runs that occur twice within one use, and so are counted once."""

    left_out: Mapping[RunKey, str]
    """Run of which another holds all rows -> why."""
    ends_s: Mapping[RunKey, float]
    """Run whose last rows another run has too -> time of the first of them, in s by the log's own
    clock."""
    notes: tuple[str, ...]


def find_repeats(
    runs: Sequence[KnownRun], read: Callable[[Selection], LogTable], time_column: str
) -> Repeats:
    """Return the runs to leave out, and those to end early, as another of the same use continues.

    Of two runs that overlap, the one whose last rows are shared is cut short: cutting the other
    one's beginning would take away its power-on and its history.

    Args:
        runs: of a project, in the order in which they are fitted. Parts that selectors cut out of
            one run are not compared with each other.
        read: reads a log again, as it was read before.
        time_column: the column of times, which `read` has converted to seconds.

    Raises:
        InputError: runs of different use share rows, or the shared rows of one use end neither run.
    """
    groups = [(run.key.path.resolve(), run.key.run) for run in runs]
    alignments = find_alignments([run.marks for run in runs], groups)
    if not alignments:
        return Repeats({}, {}, ())
    kept: dict[Selection, LogTable] = {}

    def read_table(number: int) -> LogTable:
        selection = runs[number].selection
        if selection not in kept:
            while len(kept) > 1:
                del kept[next(iter(kept))]
            kept[selection] = read(selection)
        return kept[selection]

    shared = confirm(alignments, lambda number: runs[number].take(read_table(number)))
    left_out: dict[RunKey, str] = {}
    ends_s: dict[RunKey, float] = {}
    overlaps: dict[tuple[RunKey, RunKey], str] = {}
    for (one, other), found in shared.items():
        first, second = runs[one], runs[other]
        if first.use == second.use and {first.key, second.key} & left_out.keys():
            continue
        tables = read_table(one), read_table(other)
        same = f"{_name(first, second, found[0], tables)}"
        if first.use != second.use:
            raise InputError(_explain_leak(first, second, same))
        count = sum(stretch.rows for stretch in found)
        sizes = [run.rows.stop - run.rows.start for run in (first, second)]
        if count < WHOLLY * min(sizes):
            end_s, early, late = _find_end(first, second, found, tables, time_column, same)
            ends_s[early.key] = min(end_s, ends_s.get(early.key, end_s))
            overlaps[early.key, late.key] = (
                f"{_write(early)} and {_write(late)} overlap ({same}): counted once, "
                f"{_write(early)} ends there, as by '@:{end_s - early.key.start_s:.10g}'"
            )
            continue
        copy, other_name = (second, first) if sizes[1] <= sizes[0] else (first, second)
        left_out[copy.key] = (
            f"{_write(copy)} is a copy of rows of {_write(other_name)} ({same}): counted once, "
            f"{_write(copy)} is left out"
        )
    told = [note for keys, note in overlaps.items() if not left_out.keys() & set(keys)]
    return Repeats(left_out, ends_s, (*left_out.values(), *told))


def _find_end(
    first: KnownRun,
    second: KnownRun,
    found: Sequence[SharedRows],
    tables: tuple[LogTable, LogTable],
    time_column: str,
    same: str,
) -> tuple[float, KnownRun, KnownRun]:
    """Return the new end in s of the run whose last rows are shared, that run, and the other one.

    Raises:
        InputError: neither ends with what they share.
    """
    if len(found) == 1:
        (shared,) = found
        # Where both end with them, the later one in order is cut: of three alike one stays whole.
        for run, other, table, row in (
            (second, first, tables[1], shared.other_row),
            (first, second, tables[0], shared.row),
        ):
            if row + shared.rows == run.rows.stop - run.rows.start:
                time_s = table.columns[time_column]
                return float(time_s[run.rows.start + row]), run, other
    raise InputError(_explain_part(first, second, same))


def _write(run: KnownRun) -> str:
    name = run.key.path.name + (f" run '{run.key.run}'" if run.key.run else "")
    return f"{name}@{run.key.cut}" if run.key.cut else name


def _name(
    first: KnownRun, second: KnownRun, found: SharedRows, tables: tuple[LogTable, LogTable]
) -> str:
    there = second.name_rows(tables[1], found.other_row, found.rows)
    here = first.name_rows(tables[0], found.row, found.rows)
    return f"{there} are the rows of {here}, {found.rows} rows"


def _explain_leak(first: KnownRun, second: KnownRun, same: str) -> str:
    return (
        f"{second.key.where}: {_write(second)} and {_write(first)} hold the same measurements: "
        f"{same} with the same noise. They would be both {_USES[first.use]} and "
        f"{_USES[second.use]}; expected every row once, as the held-out error would be none. Take "
        "one of the two logs out of [logs], or select parts of one of them: '@0%:60%' and "
        "'@60%:100%'."
    )


def _explain_part(first: KnownRun, second: KnownRun, same: str) -> str:
    return (
        f"{second.key.where}: {_write(second)} and {_write(first)} overlap: {same} with the same "
        "noise, and neither ends with them; expected every row once, as one that is there twice "
        "counts double. Take one of the two out of [logs], or select what only it holds, by "
        "'@FROM:TO' in seconds since its first row."
    )
