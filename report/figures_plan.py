"""The picture of a programme: temperature, loads and inputs over time."""

from collections.abc import Callable

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from zerodrift.discovery.summary import PlannedSetting, PlanSummary
from zerodrift.report.style import ACCENT, STILL, apply_style, colour_of, dash_of, wash

ROW_HEIGHT = 190
ABOVE = 90


def draw_plan(plan: PlanSummary) -> go.Figure:
    """Return the set points of a programme over hours; rests are shaded."""
    loads = list(dict.fromkeys(name for s in plan.programme for name in s.loads))
    inputs = list(dict.fromkeys(name for s in plan.programme for name in s.inputs))
    rows = 1 + bool(loads) + len(inputs)
    figure = make_subplots(rows=rows, shared_xaxes=True, vertical_spacing=0.09)
    hours, levels = _trace_temperature(plan)
    figure.add_trace(
        go.Scatter(x=hours, y=levels, name="chamber", line={"color": ACCENT, "width": 2}),
        row=1,
        col=1,
    )
    figure.update_yaxes(title_text="degC", row=1, col=1)
    for number, name in enumerate(loads):
        at, values = _trace_steps(plan, _read_load(name))
        figure.add_trace(
            go.Scatter(
                x=at,
                y=values,
                name=f"{name} {plan.units[name]}",
                line={
                    "shape": "hv",
                    "color": colour_of(number + 1),
                    "dash": dash_of(number),
                    "width": 1.6,
                },
            ),
            row=2,
            col=1,
        )
    if loads:
        figure.update_yaxes(title_text="load", row=2, col=1)
    for number, name in enumerate(inputs):
        row = 2 + bool(loads) + number
        at, values = _trace_steps(plan, _read_input(name))
        figure.add_trace(
            go.Scatter(
                x=at,
                y=values,
                name=name,
                line={"shape": "hv", "color": colour_of(number + 3), "width": 1.6},
            ),
            row=row,
            col=1,
        )
        figure.update_yaxes(title_text=name, row=row, col=1)
    figure.update_xaxes(title_text="hours", row=rows, col=1)
    for log in plan.logs:
        end = (log.from_s + log.lasts_s) / 3600.0
        if plan.rest_s > 0.0:
            figure.add_vrect(
                x0=end,
                x1=end + plan.rest_s / 3600.0,
                fillcolor=wash(STILL, 0.35),
                line_width=0,
                layer="below",
            )
    return apply_style(figure, ABOVE + rows * ROW_HEIGHT)


def _trace_temperature(plan: PlanSummary) -> tuple[list[float], list[float]]:
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


def _trace_steps(
    plan: PlanSummary, read: Callable[[PlannedSetting], float]
) -> tuple[list[float], list[float]]:
    """Return (hours, values) of what is stepped."""
    at = [s.from_s / 3600.0 for s in plan.programme] + [plan.hours]
    values = [read(s) for s in plan.programme]
    return at, [*values, values[-1]]


def _read_load(name: str) -> Callable[[PlannedSetting], float]:
    return lambda setting: setting.loads[name]


def _read_input(name: str) -> Callable[[PlannedSetting], float]:
    return lambda setting: setting.inputs[name]
