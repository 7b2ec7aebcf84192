"""Runs that are looked at row by row, kept while each is held against several others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from zerodrift.base.arrays import Array
from zerodrift.dataset.resolution import find_steps

MOST_KEPT = 1 << 23
"""Values of columns and their steps that are kept, beside those of the two runs at hand."""


@dataclass(frozen=True)
class ReadRun:
    """A run that is looked at row by row."""

    columns: Sequence[Array]
    """[n] of each column."""
    _steps: dict[int, Array] = field(default_factory=dict)
    """Column -> its steps, once they were asked for."""

    @property
    def values(self) -> int:
        """How many values are kept of it: of its columns, and as many of their steps."""
        return 2 * sum(column.size for column in self.columns)

    def find_steps(self, column: int, rows: slice) -> Array:
        """Return the steps, [rows] or [1], in which rows of a column are written.

        How a column is written is the whole run's, not that of the rows that are asked for.
        """
        if column not in self._steps:
            self._steps[column] = find_steps(self.columns[column])
        steps = self._steps[column]
        return steps[rows] if steps.size > 1 else steps


class ReadRuns:
    """Runs by their numbers, read again only where there was no room to keep them."""

    def __init__(self, read: Callable[[int], Sequence[Array]], most: int = MOST_KEPT) -> None:
        """Keep nothing yet.

        Args:
            read: a run's number -> its columns.
            most: values that are kept.
        """
        self._read, self._most = read, most
        self._kept: dict[int, ReadRun] = {}

    def take(self, number: int) -> ReadRun:
        """Return a run; where there is no room the one read last goes.

        Runs are asked for in turns, so the one read last is the last to be asked for again.
        """
        if number not in self._kept:
            run = ReadRun(self._read(number))
            while self._kept and self._count() + run.values > self._most:
                self._kept.popitem()
            self._kept[number] = run
        return self._kept[number]

    def _count(self) -> int:
        return sum(run.values for run in self._kept.values())
