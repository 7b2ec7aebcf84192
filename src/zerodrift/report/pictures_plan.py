"""The picture of a programme for the page: temperature, loads and inputs over hours."""

from collections.abc import Callable, Sequence

import numpy as np

from zerodrift.discovery.summary import PlannedSetting, PlanSummary
from zerodrift.report.plot import AxisScale, Curve, Panel, Picture, spread

HEIGHT, GAP = 110.0, 42.0


def draw_programme(plan: PlanSummary, width: float = 760.0) -> Picture:
    """Return the chamber's set point, and below it a panel for each load and input."""
    loads = list(dict.fromkeys(name for s in plan.programme for name in s.loads))
    inputs = list(dict.fromkeys(name for s in plan.programme for name in s.inputs))
    rows = [("chamber, degC", *trace_temperature(plan), False)]
    rows += [
        (f"{name}, {plan.units[name]}", *trace_steps(plan, _load(name)), True) for name in loads
    ]
    rows += [(name, *trace_steps(plan, _input(name)), True) for name in inputs]
    panels = tuple(
        _draw(number, title, (hours, values), plan.hours, width, steps=steps)
        for number, (title, hours, values, steps) in enumerate(rows)
    )
    words = "The programme: what the chamber, the loads and the inputs are set to over time."
    return Picture(width, len(rows) * (HEIGHT + GAP) + 30.0, panels, words, "programme")


def _draw(
    number: int,
    title: str,
    points: tuple[Sequence[float], Sequence[float]],
    hours: float,
    width: float,
    *,
    steps: bool,
) -> Panel:
    x, y = np.array(points[0]), np.array(points[1])
    return Panel(
        left=58.0,
        top=24.0 + number * (HEIGHT + GAP),
        width=width - 70.0,
        height=HEIGHT,
        x=AxisScale(0.0, hours, "hours"),
        y=AxisScale(*spread(y)),
        title=title,
        curves=(Curve(x, y, "model", steps=steps),),
    )


def _load(name: str) -> Callable[[PlannedSetting], float]:
    return lambda setting: setting.loads[name]


def _input(name: str) -> Callable[[PlannedSetting], float]:
    return lambda setting: setting.inputs[name]


def trace_temperature(plan: PlanSummary) -> tuple[list[float], list[float]]:
    """Return knots (hours, degC) of the chamber's set point."""
    hours, levels = [0.0], [plan.start_degC]
    now = plan.start_degC
    for log in plan.logs:
        mine = [s for s in plan.programme if s.log == log.log]
        ends = [s.from_s for s in mine[1:]] + [log.from_s + log.lasts_s]
        for s, end_s in zip(mine, ends, strict=True):
            way = s.temperature_degC - now
            if way and s.rate_K_per_min > 0.0:
                over_s = 60.0 * abs(way) / s.rate_K_per_min
                done_s = min(over_s, end_s - s.from_s)
                hours += [s.from_s / 3600.0, (s.from_s + done_s) / 3600.0]
                levels += [now, now + way * done_s / over_s]
                now = levels[-1]
    hours.append(plan.hours)
    levels.append(now)
    return hours, levels


def trace_steps(
    plan: PlanSummary, read: Callable[[PlannedSetting], float]
) -> tuple[list[float], list[float]]:
    """Return (hours, values) of what is stepped."""
    at = [s.from_s / 3600.0 for s in plan.programme] + [plan.hours]
    values = [read(s) for s in plan.programme]
    return at, [*values, values[-1]]
