"""What looks wrong with the logs themselves, as commands, report and page tell it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from zerodrift.base.config import Config

LIMITS = ("beyond_training", "too_short")
"""Kinds that say what test logs cannot show; the others say that data are wrong."""


@dataclass(frozen=True)
class DataNote:
    """Something in the logs that looks wrong; no figure is changed by it."""

    run: str
    """Empty where two runs disagree and nothing tells which one is wrong."""
    column: str
    """The log's column; the output's or input's name where that is not known."""
    rows: tuple[int, int]
    """First and last sample of the run, counted from 0."""
    kind: str
    """gain | sign | swapped | foreign_column | fahrenheit | celsius | kelvin | time_unit |
    offset_jump | frozen | constant | stuck | saturated | wrapped | another_sensor |
    beyond_training | too_short."""
    text: str
    """What it looks like, and what to do."""

    def write(self) -> str:
        """Return the note as a line."""
        where = f"run {self.run}, " if self.run else ""
        return f"{where}column {self.column}, rows {self.rows[0]} to {self.rows[1]}: {self.text}"


def name_columns(notes: Sequence[DataNote], config: Config) -> tuple[DataNote, ...]:
    """Return the notes with the logs' own column names in place of outputs and signals."""
    columns: Mapping[str, str] = {
        "temperature": config.temperature_column,
        "time": config.time_column,
        **{output.name: output.measured for output in config.outputs},
        **{
            f"reference of {output.name}": str(output.reference)
            for output in config.outputs
            if isinstance(output.reference, str)
        },
    }
    return tuple(replace(note, column=columns.get(note.column, note.column)) for note in notes)
