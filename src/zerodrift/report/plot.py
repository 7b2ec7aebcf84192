"""A picture as typed parts: panels with lines, dots, bars and marks; `report.svg` draws it."""

import math
from dataclasses import dataclass, field

import numpy as np

from zerodrift.base.arrays import Array

INKS = {
    "measured": ("#8a94a0", "#97a2ae"),
    "model": ("#1668b8", "#6cb1f0"),
    "left": ("#5b6876", "#aebac6"),
    "effect": ("#c2570a", "#f09a4c"),
    "driver": ("#2d7a5c", "#6fc7a1"),
    "heating": ("#c2570a", "#f09a4c"),
    "cooling": ("#1668b8", "#6cb1f0"),
    "still": ("#7a8591", "#8f9ba7"),
    "floor": ("#7a8794", "#8f9ba7"),
    "good": ("#2d6e49", "#7cc79b"),
    "worst": ("#8a6500", "#e8bd66"),
    "s0": ("#1668b8", "#6cb1f0"),
    "s1": ("#c2570a", "#f09a4c"),
    "s2": ("#2d7a5c", "#6fc7a1"),
    "s3": ("#8a5aa8", "#c39ddc"),
    "s4": ("#7d6c1f", "#d3c268"),
    "s5": ("#b23a5b", "#ef8fa8"),
}
"""Ink -> its colour on light and on dark ground. No two that meet differ by colour alone."""
DASHES = {"solid": "", "dash": "7 4", "dot": "2 3", "dashdot": "7 3 2 3", "long": "12 4"}
DASH_ORDER = tuple(DASHES)
MARK_ORDER = ("circle", "square", "diamond", "triangle", "cross", "ring")


@dataclass(frozen=True)
class Curve:
    """A line through points."""

    x: Array
    y: Array
    ink: str
    name: str = ""
    """In the legend; empty: not there."""
    dash: str = "solid"
    width: float = 1.5
    steps: bool = False
    """Whether it goes on level and then up or down, as stairs do."""
    mark: str = ""
    """circle | square | diamond | triangle | cross | ring at each point; empty: none."""


@dataclass(frozen=True)
class Cloud:
    """Points that are not joined."""

    x: Array
    y: Array
    ink: str
    name: str = ""
    mark: str = ""
    """As `Curve.mark`; empty: small dots."""
    size: float = 3.0


@dataclass(frozen=True)
class Bar:
    """A bar from the left edge, in a panel of bars one below the other."""

    label: str
    value: float
    told: str
    """What is written at its end."""
    ink: str
    hatched: bool = False


@dataclass(frozen=True)
class Band:
    """A stretch of the x axis that is shaded."""

    low: float
    high: float
    label: str = ""


@dataclass(frozen=True)
class Level:
    """A dotted line across a panel."""

    at: float
    label: str = ""
    upright: bool = False


@dataclass(frozen=True)
class AxisScale:
    """One axis: what of it is shown, and what is written along it."""

    low: float
    high: float
    title: str = ""
    log: bool = False
    ticks: tuple[tuple[float, str], ...] | None = None
    """Places and words; None: round numbers."""
    hidden: bool = False
    """Whether neither numbers nor title are written."""

    def place(self, values: Array) -> Array:
        """Return where values stand on it, 0 at its low and 1 at its high end."""
        if self.log:
            low, high = math.log10(self.low), math.log10(self.high)
            safe = np.maximum(np.asarray(values, dtype=np.float64), 1e-300)
            return np.asarray((np.log10(safe) - low) / ((high - low) or 1.0))
        span = (self.high - self.low) or 1.0
        return np.asarray((np.asarray(values, dtype=np.float64) - self.low) / span)

    def list_ticks(self, most: int) -> tuple[tuple[float, str], ...]:
        """Return places and words along it, at most so many."""
        if self.ticks is not None:
            return self.ticks
        if self.log:
            return list_log_ticks(self.low, self.high)
        return list_round_ticks(self.low, self.high, most)


@dataclass(frozen=True)
class Panel:
    """One pair of axes with what is drawn in it; places in pixels of the picture."""

    left: float
    top: float
    width: float
    height: float
    x: AxisScale
    y: AxisScale
    title: str = ""
    curves: tuple[Curve, ...] = ()
    clouds: tuple[Cloud, ...] = ()
    bars: tuple[Bar, ...] = ()
    bands: tuple[Band, ...] = ()
    levels: tuple[Level, ...] = ()
    note: str = ""
    """Written in the middle of it."""
    legend_at: float = 0.0
    """Where the legend begins, right of `left`; 0: behind the title."""
    stacked: bool = False
    """Whether the title stands above the legend, for narrow panels."""


@dataclass(frozen=True)
class Picture:
    """Panels on one sheet."""

    width: float
    height: float
    panels: tuple[Panel, ...]
    label: str
    """For those who cannot see it."""
    name: str = field(default="")
    """For its file."""


def list_round_ticks(low: float, high: float, most: int) -> tuple[tuple[float, str], ...]:
    """Return 1, 2 or 5 times powers of ten between two numbers, at most so many."""
    span = high - low
    if not span > 0.0 or not math.isfinite(span):
        return ((low, f"{low:.4g}"),)
    power = 10.0 ** math.floor(math.log10(span))
    steps = [power * scale * s for scale in (1.0, 0.1, 0.01) for s in (5.0, 2.0, 1.0)]
    counts = [(math.ceil(low / s - 1e-9), math.floor(high / s + 1e-9), s) for s in steps]
    # The finest that is not too dense; one number alone tells nothing of a scale.
    fitting = [told for told in counts if told[1] - told[0] < most]
    first, last, step = fitting[-1]
    if first >= last:
        first, last, step = next(told for told in counts if told[1] > told[0])
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    ticks = []
    for number in range(first, last + 1):
        value = number * step
        far = abs(value) >= 1e5 or (digits > 4 and value != 0.0)
        text = f"{value:.4g}" if far else f"{value:.{digits}f}"
        ticks.append((value, text.replace("-", "−")))
    return tuple(ticks)


def list_log_ticks(low: float, high: float) -> tuple[tuple[float, str], ...]:
    """Return powers of ten between two numbers; where few, 2 and 5 times them as well."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    factors = (1.0,) if last - first > 4 else (1.0, 2.0, 5.0)
    values = [f * 10.0**power for power in range(first, last + 1) for f in factors]
    return tuple((v, f"{v:g}") for v in values if low * 0.999 <= v <= high * 1.001)


def spread(
    *values: Array, margin: float = 0.06, around: tuple[float, ...] = ()
) -> tuple[float, float]:
    """Return a range that holds all finite values, with some room on both sides."""
    ends = [float(x) for x in around]
    for array in values:
        finite = np.asarray(array)[np.isfinite(array)]
        if finite.size:
            ends += [float(finite.min()), float(finite.max())]
    if not ends:
        return 0.0, 1.0
    low, high = min(ends), max(ends)
    room = margin * (high - low) or margin * abs(high) or 1.0
    return low - room, high + room
