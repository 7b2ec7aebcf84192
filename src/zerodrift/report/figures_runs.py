"""Measurement, model and residual along the runs, as Plotly figures for notebooks and `compare`."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.comparison_summary import ComparisonSummary
from zerodrift.report.findings import Trace
from zerodrift.report.style import (
    ACCENT,
    FLOOR,
    HEATING,
    LEFT,
    MARKED_EDGE,
    MEASURED,
    apply_style,
    line_across,
    line_up,
    shade,
)
from zerodrift.report.thin import MOST_POINTS, pick_rows
from zerodrift.report.window import HOURS, TimeAxis, Window, choose_clock, find_rows

MOST_OUTLIERS = 500
"""Outliers that are drawn of one run and output."""


def draw_output(
    traces: Sequence[Trace],
    compared: ComparisonSummary,
    output: str,
    *,
    most: int = 700,
) -> go.Figure:
    """Return measured drift and model, and what is left, of one output; runs laid end to end.

    Args:
        traces: the runs.
        compared: what `compare` found.
        output: which one.
        most: points of each line.
    """
    names = list(compared.outputs)
    k, told = names.index(output), compared.outputs[output]
    figure = _open_rows(output, told.unit)
    start_h, ticks, labels = 0.0, [], []
    drawn: list[go.Scatter] = []
    shapes = _mark_floor(float(told.noise_floor))
    for number, trace in enumerate(traces):
        offset_h = start_h - float(trace.time_s[0]) / 3600.0
        drawn += _draw_lines(trace, k, told.unit, offset_h, most, first=number == 0)
        marks, marked = _mark_worst(compared, trace.run, output, offset_h)
        drawn += marks
        shapes += marked
        length_h = float(trace.time_s[-1] - trace.time_s[0]) / 3600.0
        ticks.append(start_h + 0.5 * length_h)
        name = shorten(trace.run)
        labels.append(name if trace.held_out else f"{name} (learnt)")
        start_h += length_h + max(0.02 * length_h, 1e-3)
        if number:
            begins_h = ticks[-1] - 0.5 * length_h
            shapes += [line_up(begins_h, "x", "y"), line_up(begins_h, "x2", "y2")]
    figure.add_traces(drawn)
    figure.update_layout(shapes=shapes)
    figure.update_xaxes(tickvals=ticks, ticktext=labels, tickangle=-35, showgrid=False)
    figure.update_layout(height=560, margin={"l": 84, "b": 122})
    return figure


def shorten(name: str, most: int = 20) -> str:
    """Return a run's name with its middle left out where it is too long for an axis."""
    if len(name) <= most:
        return name
    return f"{name[: most // 2 - 1]}…{name[-(most // 2) :]}"


def draw_run(
    trace: Trace,
    compared: ComparisonSummary,
    output: str,
    window: Window,
    *,
    most: int = MOST_POINTS,
    ghost: Array | None = None,
    ghost_name: str = "",
) -> go.Figure:
    """Return one run of one output, or a part of it, refined to the part that is shown.

    Args:
        trace: the run.
        compared: what `compare` found.
        output: which one.
        window: the part.
        most: points of each line.
        ghost: [n] what an effect would add, drawn over what is left.
        ghost_name: its name.
    """
    names = list(compared.outputs)
    k, told = names.index(output), compared.outputs[output]
    unit = told.unit
    figure = _open_rows(output, unit)
    clock = choose_clock(trace)
    start, stop = find_rows(trace, window)
    drawn = _draw_lines(trace, k, unit, 0.0, most, first=True, rows=(start, stop), clock=clock)
    if ghost is not None:
        rows = pick_rows(ghost, start, stop, most)
        drawn.append(
            go.Scatter(
                x=clock.place(trace.time_s[rows]),
                y=ghost[rows].astype(np.float32),
                name=f"{ghost_name}: this is what it would look like",
                line={"color": HEATING, "width": 2.5, "dash": "dash"},
                hovertemplate=f"%{{y:.4g}} {unit}<extra>{ghost_name}</extra>",
                xaxis="x2",
                yaxis="y2",
            )
        )
    marks, shapes = _mark_worst(compared, trace.run, output, 0.0, clock)
    figure.add_traces([*drawn, *marks])
    figure.update_layout(shapes=[*shapes, *_mark_floor(float(told.noise_floor))])
    figure.update_xaxes(title=clock.title, row=2, col=1)
    # One axis for both rows, so that the cursor is shared.
    figure.update_traces(xaxis="x2")
    figure.update_layout(hovermode="x unified", hoversubplots="axis", xaxis={"visible": False})
    figure.update_yaxes(anchor="x2", row=1, col=1)
    figure.update_layout(height=520, xaxis2={"matches": None, "hoverformat": ".5~g"})
    figure.update_xaxes(showspikes=True, spikemode="across", spikethickness=1, spikecolor=FLOOR)
    if window.from_s is not None and window.to_s is not None:
        figure.update_xaxes(range=[clock.place(window.from_s), clock.place(window.to_s)])
    return figure


def _open_rows(output: str, unit: str) -> go.Figure:
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.07)
    apply_style(figure, 480)
    figure.update_yaxes(title=f"drift of {output}, {unit}", row=1, col=1)
    figure.update_yaxes(title=f"what is left, {unit}", row=2, col=1)
    return figure


def _draw_lines(
    trace: Trace,
    k: int,
    unit: str,
    offset_h: float,
    most: int,
    *,
    first: bool,
    rows: tuple[int, int] | None = None,
    clock: TimeAxis = HOURS,
) -> list[go.Scatter]:
    """Return one run's lines: measured, model, and what is left."""
    start, stop = rows or (0, trace.time_s.size)
    part = slice(start, stop)
    drift, error = trace.drift[k, part], trace.error[k, part]
    time_s = trace.time_s[part]
    lines = (
        ("", drift, "drift as measured", {"color": MEASURED, "width": 2.5}),
        ("", drift - error, "model", {"color": ACCENT, "width": 1.5, "dash": "dash"}),
        ("2", error, "what is left", {"color": LEFT, "width": 1.2}),
    )
    drawn = []
    for axis, values, label, line in lines:
        kept = pick_rows(values, 0, values.size, most)
        drawn.append(
            go.Scatter(
                x=(clock.place(time_s[kept]) + offset_h).astype(np.float32),
                y=values[kept].astype(np.float32),
                name=label,
                legendgroup=label,
                showlegend=first,
                mode="lines",
                line=line,
                hovertemplate=f"%{{y:.4g}} {unit}<extra>{trace.run}, {label}</extra>",
                xaxis=f"x{axis}",
                yaxis=f"y{axis}",
            )
        )
    wild = trace.outliers[trace.outliers[:, 1] == k, 0]
    wild = wild[(wild >= start) & (wild < stop)][:MOST_OUTLIERS]
    if wild.size:
        drawn.append(
            go.Scatter(
                x=(clock.place(trace.time_s[wild]) + offset_h).astype(np.float32),
                y=trace.drift[k, wild].astype(np.float32),
                name="outliers, hardly counted",
                legendgroup="outliers",
                showlegend=first,
                mode="markers",
                marker={"symbol": "x-thin-open", "size": 7, "color": MARKED_EDGE},
                hovertemplate=f"%{{y:.4g}} {unit}<extra>{trace.run}, outlier</extra>",
                xaxis="x",
                yaxis="y",
            )
        )
    return drawn


def _mark_worst(
    compared: ComparisonSummary, run: str, output: str, offset: float, clock: TimeAxis = HOURS
) -> tuple[list[go.Scatter], list[dict[str, object]]]:
    """Return marks and shades of the worst segments of one run and output, numbered as tabled."""
    marks, shapes = [], []
    for number, segment in enumerate(compared.worst, 1):
        if segment.run != run or segment.output != output:
            continue
        x0, x1 = (clock.place(end) + offset for end in (segment.from_s, segment.to_s))
        shapes.append(shade(x0, x1, "x2", "y2"))
        # A point to hover over, since a shape tells nothing.
        marks.append(
            go.Scatter(
                x=[0.5 * (x0 + x1)],
                y=[segment.mean_error],
                mode="markers+text",
                marker={"symbol": "star", "size": 9, "color": MARKED_EDGE},
                text=[f"<b>{number}</b>"],
                textposition="top center",
                hovertext=[f"worst {number}: {segment.pattern}"],
                hoverinfo="text",
                name="worst segments",
                legendgroup="worst",
                showlegend=False,
                cliponaxis=False,
                xaxis="x2",
                yaxis="y2",
            )
        )
    return marks, shapes


def _mark_floor(floor: float, x_axis: str = "x2", y_axis: str = "y2") -> list[dict[str, object]]:
    """Return the levels of the noise floor in one subplot."""
    return [line_across(level, x_axis, y_axis) for level in (-floor, floor)]
