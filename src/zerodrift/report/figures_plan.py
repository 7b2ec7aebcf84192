"""The picture of a programme: temperature, loads and inputs over time."""

from collections.abc import Callable

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from zerodrift.discovery.summary import PlannedSetting, PlanSummary
from zerodrift.report.pictures_plan import trace_steps, trace_temperature
from zerodrift.report.style import ACCENT, STILL, apply_style, colour_of, dash_of, wash

ROW_HEIGHT = 190
ABOVE = 90


def draw_plan(plan: PlanSummary) -> go.Figure:
    """Return the set points of a programme over hours; rests are shaded."""
    loads = list(dict.fromkeys(name for s in plan.programme for name in s.loads))
    inputs = list(dict.fromkeys(name for s in plan.programme for name in s.inputs))
    rows = 1 + bool(loads) + len(inputs)
    figure = make_subplots(rows=rows, shared_xaxes=True, vertical_spacing=0.09)
    hours, levels = trace_temperature(plan)
    figure.add_trace(
        go.Scatter(x=hours, y=levels, name="chamber", line={"color": ACCENT, "width": 2}),
        row=1,
        col=1,
    )
    figure.update_yaxes(title_text="degC", row=1, col=1)
    for number, name in enumerate(loads):
        at, values = trace_steps(plan, _read_load(name))
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
        at, values = trace_steps(plan, _read_input(name))
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


def _read_load(name: str) -> Callable[[PlannedSetting], float]:
    return lambda setting: setting.loads[name]


def _read_input(name: str) -> Callable[[PlannedSetting], float]:
    return lambda setting: setting.inputs[name]
