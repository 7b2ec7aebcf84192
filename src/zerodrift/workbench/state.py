"""What the page's own script tells: what is to be drawn; and what it is told."""

from dataclasses import dataclass, field

from zerodrift.report.cause import CausePicture


@dataclass(frozen=True)
class RunPart:
    """A part of a run that was asked for: a worst segment, shown with as much on either side."""

    output: str
    run: str
    from_s: float
    """On the log's own clock."""
    to_s: float
    mark_from_s: float
    """The segment itself, which is marked everywhere."""
    mark_to_s: float


@dataclass(frozen=True)
class PictureWish:
    """What is to be drawn; what is left out is the page's own choice."""

    output: str | None = None
    run: str | None = None
    effect: str | None = None
    """Whose contribution is drawn; empty: none; null: that of the verdict."""
    panes: tuple[str, ...] = ()
    """From top to bottom; empty: those that the diagnosis suspects."""
    against: str = ""
    """A driver's key; empty: the one that the diagnosis suspects."""
    from_s: float | None = None
    to_s: float | None = None
    move: str = ""
    """earlier | later | closer | wider | whole: to be done to the part that is shown."""
    width: float = 1000.0
    """Pixels that there are."""


@dataclass(frozen=True)
class PageChoice:
    """One that can be chosen."""

    key: str
    words: str


@dataclass(frozen=True)
class Sheet:
    """A table as the page's script writes it."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int


@dataclass(frozen=True)
class DrawnPicture:
    """A picture with what is needed to read it, and what was chosen in the end."""

    shown: int
    """Which findings it is of."""
    svg: str
    cause: CausePicture
    output: str
    run: str
    effect: str
    panes: tuple[PageChoice, ...]
    """What can be put into a pane."""
    drivers: tuple[PageChoice, ...]
    """The signals that the residual can be plotted against."""
    against: str
    is_whole: bool
    seconds: float
    """One unit of the time axis."""
    clock: str
    from_s: float
    """Zero of the time axis, on the log's clock."""
    sheet: Sheet
    note: str = field(default="")


@dataclass(frozen=True)
class JobState:
    """A job that runs."""

    title: str
    progress: str
    seconds: int


@dataclass(frozen=True)
class PageState:
    """The page's version and its running job."""

    version: int
    """Counts up whenever there is something new to show."""
    job: JobState | None
