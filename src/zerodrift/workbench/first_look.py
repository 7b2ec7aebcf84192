"""What is drawn before anything is found: one log's drift and temperature, in the chart's place."""

import json
from dataclasses import dataclass

import numpy as np

from zerodrift.base.records import from_json, to_dict
from zerodrift.report.svg import AxisScale, Curve, Panel, Picture, render_svg, spread, write_style
from zerodrift.report.window import MARGIN_LEFT, choose_axis, lay_out_cause

HEADING = 236.0
"""Pixels that the page's list of a pane is wide."""
NARROWEST, WIDEST = 240.0, 2400.0
"""Pixels of a picture."""
FRAME = AxisScale(0.0, 1.0, ticks=((0.0, ""), (1.0, "")), hidden=True)
"""An axis of which nothing is known yet."""
TALL = (True, True, False, False, False)
"""The panes of the chart at first: drift, what is left, temperature, and two more channels."""


@dataclass(frozen=True)
class LoggedLine:
    """A column of a log, thinned."""

    time_s: tuple[float, ...]
    values: tuple[float, ...]


@dataclass(frozen=True)
class FirstLook:
    """One training run, as far as it can be shown without the others."""

    output: str
    unit: str
    of: str
    """The log, and the run in it."""
    drift: LoggedLine
    temperature: LoggedLine
    first_s: float
    last_s: float


@dataclass(frozen=True)
class WaitingPicture:
    """The chart's place while nothing is found yet."""

    svg: str
    width: float
    height: float
    is_drawn: bool
    """Whether a log is shown in it."""
    style: str = ""
    """Colours of the lines, for a page that has none."""
    waiting: bool = True
    """Tells it from the chart."""
    early: bool = False
    """Whether the page itself is still being loaded."""


def read_look(text: str) -> FirstLook | None:
    """Return what was read of one log; None for an empty text."""
    return from_json(FirstLook, json.loads(text)) if text else None


def write_look(look: FirstLook) -> str:
    """Return it as `read_look` reads it."""
    return json.dumps(to_dict(look), ensure_ascii=False, allow_nan=False)


def draw_waiting(look: FirstLook | None, width: float, *, is_early: bool = False) -> WaitingPicture:
    """Return the picture with the panes, and the size, of the chart that takes its place.

    Args:
        look: one log; None as long as there is none.
        width: pixels that there are.
        is_early: whether the page itself is still being loaded, and has no style of its own.
    """
    width = min(max(width, NARROWEST), WIDEST)
    place = lay_out_cause(TALL, width)
    panels = [
        _draw_pane(look, number, (MARGIN_LEFT, top, place.width, height))
        for number, (top, height) in enumerate(place.panes)
    ]
    panels.append(Panel(*place.scatter, FRAME, FRAME, note="What is left is being computed."))
    words = "Nothing is drawn yet." if look is None else f"{look.of}: drift and temperature."
    return WaitingPicture(
        svg=render_svg(Picture(width, place.bottom, tuple(panels), words)),
        width=width,
        height=place.bottom,
        is_drawn=look is not None,
        style=write_style() if is_early else "",
        early=is_early,
    )


def _draw_pane(
    look: FirstLook | None, number: int, place: tuple[float, float, float, float]
) -> Panel:
    """Return one pane: the drift in the first, the temperature in the third, else its frame."""
    if look is None:
        return Panel(*place, FRAME, FRAME)
    clock = choose_axis(look.first_s, look.last_s)
    ends = clock.place(look.first_s), clock.place(look.last_s)
    x = AxisScale(*ends, clock.title, hidden=number < len(TALL) - 1)
    shown = {
        0: (f"drift of {look.output} as measured, {look.unit}", look.drift, "measured"),
        2: ("temperature, degC", look.temperature, "driver"),
    }
    if number not in shown:
        return Panel(*place, x, FRAME)
    title, line, ink = shown[number]
    values = np.array(line.values)
    curve = Curve(clock.place(np.array(line.time_s)), values, ink)
    return Panel(*place, x, AxisScale(*spread(values)), title=title, curves=(curve,))
