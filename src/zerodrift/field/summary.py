"""What `monitor` finds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from zerodrift.field.neighbours import Lost
from zerodrift.field.registry import LEARNING, NO_REFERENCE, SOUND, Event, Unit

ALARM = "alarm"
STATES = (LEARNING, SOUND, ALARM, NO_REFERENCE)


@dataclass(frozen=True)
class ChangeVerdict:
    """What has changed, if anything."""

    cause: str = ""
    """step | ageing | other model | other unit | undecided; "" without an alarm."""
    probability: float | None = None
    """Of the cause, given that something has changed."""
    alarm_at: str = ""
    """Date of the block at which the alarm was raised; "" without one."""
    since: str = ""
    """Date at which the change most likely began."""
    size: float | None = None
    """By how much the zero has moved, in the unit: by a step, or by ageing until the cause was
    told; null for another unit or model."""
    from_s: float | None = None
    """The change began between `from_s` and `to_s` with a probability of 0.99, given the cause;
    times as `last_s`. Where there are no logs between, the zero moved at once or slowly."""
    to_s: float | None = None
    """The end of that time; null without an alarm."""
    per_day: float | None = None
    """Of ageing: by how much the zero moves a day, in the unit."""


@dataclass(frozen=True)
class OutputWatched:
    """One output of a unit in use, in its unit."""

    unit: str
    state: str
    """learning | sound | alarm | no reference."""
    blocks: int
    """Means over a block of time that the test has seen."""
    blocks_to_learn: int
    """Means from which the noise is learnt."""
    rms_residual: float | None
    """Of the last call's logs; null without a true value."""
    uncertainty: float | None
    """Standard uncertainty of the model when it was calibrated; null where none is known."""
    zero_moved: float | None
    """Median of the last day's means less that of the days that were learnt from."""
    verdict: ChangeVerdict
    text: str
    """What to do, in a sentence."""


NAMED, POSSIBLE, NONE, TOO_LITTLE = ("named", "possible", "none", "too little")


@dataclass(frozen=True)
class UnitSought:
    """Which other unit of the design is in place, after an alarm that it is another."""

    state: str
    """named | possible (not ruled out, and not sure) | none (fits) | too little (was seen yet)."""
    named: str
    """Serial number of the unit that is in place; "" where none is named."""
    possible: tuple[str, ...]
    """Units that are not ruled out, the likeliest first."""
    known: int
    """Other units whose models were tried."""
    false_name: float
    """Chance of a name although another unit is in place, at most; however many are known."""
    text: str
    """The same in a sentence."""


@dataclass(frozen=True)
class RangeUsed:
    """One input over the last call's logs, in its unit."""

    unit: str
    low: float
    high: float
    calibrated_low: float
    calibrated_high: float
    outside: float
    """Share of the steps that are outside the calibrated range."""


@dataclass(frozen=True)
class MonitorResult:
    """The deployed model against new data."""

    SCHEMA: ClassVar = "monitor/1"

    sensor: str
    model_hash: str
    alarm: bool
    """Whether an output carries an alarm."""
    alarms_per_unit_month: float
    """The false-alarm rate that the test is set to, all outputs together."""
    logs: tuple[str, ...]
    """What was read by this call."""
    steps: int
    """Steps of the firmware in them."""
    steps_in_all: int
    """Since the model came into use, as far as they were shown to `monitor`."""
    flags: Mapping[str, int]
    """Flag, in words -> steps of this call that carry it."""
    flags_in_all: Mapping[str, int]
    ranges: Mapping[str, RangeUsed]
    """Input -> what was used of its calibrated range."""
    outputs: Mapping[str, OutputWatched]
    last_s: float | None
    """Time of the last step, in seconds from 1970 or on the log's own clock; null without one."""
    notes: tuple[str, ...]
    other_unit: UnitSought | None = None
    """Null without an alarm that another unit is in place, and where no other unit is known."""


@dataclass(frozen=True)
class RegistryResult:
    """The units of a registry (`registry list`)."""

    SCHEMA: ClassVar = "registry/1"

    units: tuple[Unit, ...]


@dataclass(frozen=True)
class UnitHistoryResult:
    """What happened to a unit (`registry history`)."""

    SCHEMA: ClassVar = "registry-history/1"

    serial: str
    events: tuple[Event, ...]
    """The oldest first."""


@dataclass(frozen=True)
class NeighbourResult:
    """A model as another program takes it, and what that loses (`neighbour`)."""

    SCHEMA: ClassVar = "neighbour/1"

    kind: str
    model_hash: str
    file: str
    lost: Mapping[str, Lost]
    """Output -> what is lost against the full model, in its unit."""
    notes: tuple[str, ...]
