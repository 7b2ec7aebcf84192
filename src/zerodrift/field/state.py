"""What `monitor` keeps from one call to the next: a sealed JSON file of some tens of kilobytes."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.base.files import write_whole
from zerodrift.base.records import from_json, read_format, read_sealed, render_sealed, to_dict
from zerodrift.field.watch import BlockMeans, ChangeFound, Learned

FORMAT = 1
FILE_NAME = "monitor.json"


@dataclass(frozen=True)
class OutputState:
    """One output's means, and what they told."""

    place: tuple[int, ...] = ()
    count: tuple[float, ...] = ()
    residual: tuple[float, ...] = ()
    temperature: tuple[float, ...] = ()
    learned: Learned | None = None
    finding: ChangeFound | None = None

    @property
    def blocks(self) -> BlockMeans:
        """The means."""
        return BlockMeans(
            np.array(self.place, dtype=np.int64),
            np.array(self.count, dtype=np.float64),
            np.array(self.residual, dtype=np.float64),
            np.array(self.temperature, dtype=np.float64),
        )


def shorten(values: Array) -> tuple[float, ...]:
    """Return numbers as they are kept, to 9 digits."""
    return tuple(float(f"{value:.9g}") for value in values)


def keep_output(
    blocks: BlockMeans, learned: Learned | None, finding: ChangeFound | None
) -> OutputState:
    """Return the state of an output; the numbers are kept to 9 digits."""
    return OutputState(
        tuple(int(p) for p in blocks.place),
        shorten(blocks.count),
        shorten(blocks.residual),
        shorten(blocks.temperature),
        learned,
        finding,
    )


@dataclass(frozen=True)
class SearchedOutput:
    """One output's means since another unit is in place, and what each known unit would leave."""

    place: tuple[int, ...]
    count: tuple[float, ...]
    temperature: tuple[float, ...]
    own: tuple[float, ...]
    """Of the unit that should be there."""
    others: Mapping[str, tuple[float, ...]]
    """Serial number -> the same of another unit."""
    flagged: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Serial number -> share of each block's steps that the unit's own model flags; without it,
    none, as in states that were kept before there was this."""
    looks: tuple[int, ...] = ()
    """Counts of blocks at which a name was sought."""


@dataclass(frozen=True)
class UnitSearch:
    """Which other unit is in place, as far as it is known."""

    models: Mapping[str, str]
    """Serial number -> hash of the model that was tried."""
    outputs: Mapping[str, SearchedOutput]
    possible: tuple[str, ...] | None = None
    """Units that are not ruled out; null before enough was seen."""
    named: str = ""
    """Once named, a unit stays so."""


@dataclass(frozen=True)
class LogSeen:
    """A log that was read."""

    name: str
    sha256: str
    outputs: tuple[str, ...] | None = None
    """Those that were tested on it, as their true value was known; None in states that were kept
    before there was this."""
    shift_s: float = 0.0
    """What was added to its times."""
    after_s: float | None = None
    """Only its later steps were new; None: all."""


@dataclass(frozen=True)
class MonitorState:
    """A unit since its model came into use."""

    sensor: str
    model_hash: str
    block_s: float
    per_month: float
    learn_s: float
    last_s: float | None = None
    """Time of the last step that was read."""
    steps: int = 0
    flags: Mapping[str, int] = field(default_factory=dict)
    outputs: Mapping[str, OutputState] = field(default_factory=dict)
    logs: tuple[LogSeen, ...] = ()
    sought: UnitSearch | None = None


def load_state(path: Path) -> MonitorState | None:
    """Return the state that an earlier call left; None where there is none.

    Raises:
        InputError: the file is damaged, of another format, or cannot be read.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); expected the state of `zerodrift monitor`."
        ) from error
    try:
        if read_format(content) != FORMAT:
            raise ValueError(f"format {read_format(content)!r}; expected {FORMAT}")
        body = {key: value for key, value in read_sealed(content).items() if key != "format"}
        return from_json(MonitorState, body)
    except (ValueError, json.JSONDecodeError) as error:
        raise InputError(
            f"{path}: is no state of `zerodrift monitor` ({error}); expected what it wrote."
            " Take it from a backup, or begin anew with --reset."
        ) from error


def save_state(path: Path, state: MonitorState) -> None:
    """Write the state, whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    write_whole(path, render_sealed({"format": FORMAT, **to_dict(state)}))
