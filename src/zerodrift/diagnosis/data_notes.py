"""What looks wrong with the logs themselves, as commands, report and page tell it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from zerodrift.base.config import Config


@dataclass(frozen=True)
class WrongKind:
    """One kind of wrong data, as the documentation tells it."""

    looks: str
    """What it looks like."""
    cure: str
    stops: bool = True
    """Whether `train`, `firmware` and `fleet` stop at it: a model learnt from such rows is wrong.
    The others say what test logs cannot show."""


KINDS: Mapping[str, WrongKind] = {
    "sign": WrongKind("a run's output has the opposite sign", "reverse it in the log"),
    "gain": WrongKind(
        "an output or a reference is a multiple of what the other runs have",
        "state the unit, or convert it in the log",
    ),
    "fahrenheit": WrongKind("a run's temperature is in degF", "state the column's unit"),
    "kelvin": WrongKind("a run's temperature is in kelvin", "state the column's unit"),
    "unit_change": WrongKind(
        "a column changes its unit within a run", "convert one part, or cut the run there"
    ),
    "swapped": WrongKind("two columns of a run are exchanged", "exchange them in the log"),
    "foreign_column": WrongKind("an output reads what another one reads", "name the right column"),
    "another_sensor": WrongKind(
        "a run does not agree with the others, whatever is tried",
        "find out where it comes from; leave it out",
    ),
    "time_unit": WrongKind("a run's time is in another unit", "state the unit of the time column"),
    "stitched": WrongKind("rows are missing within a run whose time goes on", "cut the run there"),
    "offset_jump": WrongKind("an output's zero jumps within a run", "cut the run there"),
    "constant": WrongKind(
        "the thermometer reads one value for a whole run in which the output drifts",
        "record the run again",
    ),
    "frozen": WrongKind("the thermometer repeats one value for a stretch", "leave the rows out"),
    "stuck": WrongKind("an output repeats one value for a stretch", "leave the rows out"),
    "saturated": WrongKind(
        "an output or the thermometer stands at a limit of its range, in one run or in all",
        "look at the amplifier's range; record the run again",
    ),
    "wrapped": WrongKind("an output jumps to and fro by one size: a counter", "unwrap it"),
    "sentinel": WrongKind(
        "one value far off recurs exactly: -127, -200, 85, 9999", "state it: [logs] missing"
    ),
    "spikes": WrongKind("many single rows far off from their neighbours", "leave the rows out"),
    "late_reference": WrongKind("the reference follows the output late, or before it", "shift it"),
    "missing_reference": WrongKind(
        "the output moves with a load that the reference lacks", "log it"
    ),
    "reversed_reference": WrongKind(
        "a run's reference has the opposite sign", "reverse it in the log"
    ),
    "leak": WrongKind(
        "a test run is a training run, resampled or with noise on it", "test with another run"
    ),
    "beyond_training": WrongKind("a test run reaches further than training", "train as far", False),
    "too_short": WrongKind(
        "a test run is too short to say anything", "test with a longer log", False
    ),
}
"""What a note's `kind` may be. The table of docs/reference/wrong-data.md is held against it."""
INFORMS = tuple(kind for kind, told in KINDS.items() if not told.stops)


@dataclass(frozen=True)
class DataNote:
    """Something in the logs that looks wrong; no figure is changed by it."""

    ALIASES: ClassVar = ("stops",)

    run: str
    """Empty where two runs disagree and nothing tells which one is wrong."""
    column: str
    """The log's column; the output's or input's name where that is not known."""
    rows: tuple[int, int]
    """First and last sample of the run, counted from 0."""
    kind: str
    """One of `KINDS`."""
    text: str
    """What it looks like, and what to do."""

    @property
    def stops(self) -> bool:
        """Whether firmware is refused for it, unless `[logs] accept` names it."""
        return KINDS[self.kind].stops

    @property
    def entry(self) -> str:
        """The entry of `[logs] accept` that takes it on."""
        return f"{self.run}: {self.kind}"

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
