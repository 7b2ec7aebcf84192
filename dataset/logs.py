"""One log of a project as a table: its file, its clock, its columns."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from zerodrift.base.config import Config
from zerodrift.dataset.tables import Source, Table, label_log, open_source, read_table
from zerodrift.dataset.times import SAMPLE, Clock, find_clock


def read_log(config: Config, path: Path, needed: Mapping[str, str]) -> Table:
    """Read the needed columns of a log, times in seconds.

    Args:
        config: the project.
        path: the log.
        needed: column -> where the config names it; the times are called `config.time_column`.

    Raises:
        InputError: the log cannot be read, or a column of it.
    """
    source = open_source(path, label_log(path, config.directory), config.where)
    return read_table(source, needed, clock=find_log_clock(config, source))


def find_log_clock(config: Config, source: Source) -> Clock | None:
    """Return how the times of one log are read; None: it has no such column, which is told later.

    Raises:
        InputError: its times cannot be told.
    """
    offset_s = config.clocks.offset_s(source.path) or 0.0
    period_s = config.clocks.period_s(source.path)
    time = config.clocks.time(source.path, config.time)
    if period_s is not None:
        name = config.time_column
        return Clock((), "rows", name, period_s=period_s, offset_s=offset_s)
    if any(column not in source.names for column in time.columns):
        return None
    first = source.sample(time.columns, SAMPLE)
    if not len(first[0]):
        return None
    clock = find_clock(time, first, source.label, lambda: source.sample(time.columns, None))
    return replace(clock, name=config.time_column, offset_s=offset_s)
