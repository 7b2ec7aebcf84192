"""What the page's own script and its stores tell: what is chosen, and what is drawn."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class RunPart:
    """A part of a run that was asked for: a worst segment with as much on either side."""

    output: str
    run: str
    from_s: float
    """On the log's own clock."""
    to_s: float
    number: int = 0
    """Among such requests; the page's script counts them."""


@dataclass(frozen=True)
class View:
    """What is chosen of the chart."""

    output: str | None
    run: str | None
    ghost: str | None = None
    """The effect to draw over what is left."""
    part: RunPart | None = None
    """The worst segment that was asked for last."""


@dataclass(frozen=True)
class Chart:
    """Which chart it is; `shown` counts up when there are new errors."""

    shown: int
    output: str
    run: str
    ghost: str | None


@dataclass(frozen=True)
class Drawn:
    """What is drawn, and what had been asked for until then."""

    chart: Chart
    part: int
    """Number of the last request for a part; 0 without one."""
    presses: Mapping[str, int]
    """Button -> how often it was pressed."""
    moved: Mapping[str, object] | None
    """What the chart told of a zoom."""
    window: tuple[float | None, float | None] = field(default=(None, None), compare=False)
    """From and to in seconds on the log's own clock; null: the run's own end."""


@dataclass(frozen=True)
class JobState:
    """A job that runs."""

    title: str
    progress: str
    seconds: int


@dataclass(frozen=True)
class PageState:
    """Where things stand."""

    version: int
    """Counts up whenever there is something new to show."""
    job: JobState | None
