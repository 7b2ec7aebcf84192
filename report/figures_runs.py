"""Measurement, model and residual along the runs, and the residual against what drives it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from zerodrift.diagnosis.comparison_summary import ComparisonSummary
from zerodrift.report.findings import Trace, find_threshold
from zerodrift.report.style import (
    ACCENT,
    COOLING,
    FLOOR,
    HEATING,
    LEFT,
    MARKED_EDGE,
    MEASURED,
    STILL,
    apply_style,
    line_across,
    line_up,
    shade,
    wash,
)
from zerodrift.report.thin import MOST_POINTS, pick_rows, pick_spread

Array = NDArray[np.float64]

CLOUD = 900
"""Points of a branch's cloud in one panel."""
BINS = 14
MOST_OUTLIERS = 500
"""Outliers that are drawn of one run and output."""
FEWEST_IN_BIN = 0.005
"""Share of a branch's samples below which a bin's mean is not drawn."""


@dataclass(frozen=True)
class Window:
    """What part of one run is shown."""

    run: str
    from_s: float | None = None
    """On the log's own clock; None: from its start."""
    to_s: float | None = None


@dataclass(frozen=True)
class TimeAxis:
    """The unit of a time axis."""

    unit: str
    seconds: float
    """One unit."""


HOURS = TimeAxis("h", 3600.0)
CLOCKS = (TimeAxis("s", 1.0), TimeAxis("min", 60.0), HOURS)
LONGEST_IN_UNITS = 300.0


def choose_clock(trace: Trace) -> TimeAxis:
    """Return the unit in which a run's time reads best."""
    length_s = float(trace.time_s[-1] - trace.time_s[0])
    return next((c for c in CLOCKS if length_s <= LONGEST_IN_UNITS * c.seconds), HOURS)


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
                x=trace.time_s[rows] / clock.seconds,
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
    figure.update_xaxes(title=f"time on the log's clock, {clock.unit}", row=2, col=1)
    # One axis for both rows, so that the cursor is shared.
    figure.update_traces(xaxis="x2")
    figure.update_layout(hovermode="x unified", hoversubplots="axis", xaxis={"visible": False})
    figure.update_yaxes(anchor="x2", row=1, col=1)
    figure.update_layout(height=520, xaxis2={"matches": None, "hoverformat": ".5~g"})
    figure.update_xaxes(showspikes=True, spikemode="across", spikethickness=1, spikecolor=FLOOR)
    if window.from_s is not None and window.to_s is not None:
        figure.update_xaxes(range=[window.from_s / clock.seconds, window.to_s / clock.seconds])
    return figure


def find_rows(trace: Trace, window: Window) -> tuple[int, int]:
    """Return the rows of the part that is shown, one more on each side."""
    if window.from_s is None or window.to_s is None:
        return 0, trace.time_s.size
    first = int(np.searchsorted(trace.time_s, window.from_s)) - 1
    last = int(np.searchsorted(trace.time_s, window.to_s)) + 1
    first = min(max(first, 0), trace.time_s.size - 2)
    return first, min(max(last, first + 2), trace.time_s.size)


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
                x=(time_s[kept] / clock.seconds + offset_h).astype(np.float32),
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
                x=(trace.time_s[wild] / clock.seconds + offset_h).astype(np.float32),
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
        x0, x1 = (end / clock.seconds + offset for end in (segment.from_s, segment.to_s))
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


def draw_residual(traces: Sequence[Trace], compared: ComparisonSummary, output: str) -> go.Figure:
    """Return what is left of one output against T, dT/dt, load and time, heating and cooling apart.

    Each panel shows a thin cloud of samples and the means of bins; only runs that were held out
    are shown where there are any.
    """
    told = compared.outputs[output]
    k, unit = list(compared.outputs).index(output), told.unit
    shown = [t for t in traces if t.held_out] or list(traces)
    error = np.concatenate([t.error[k] for t in shown])
    rate = np.concatenate([t.rate_K_per_min for t in shown])
    panels = [
        ("temperature, degC", np.concatenate([t.temperature_degC for t in shown])),
        ("dT/dt, K/min", rate),
        (f"load on {output}, {unit}", np.concatenate([t.load[k] for t in shown])),
        ("time in the run, min", np.concatenate([(t.time_s - t.time_s[0]) / 60.0 for t in shown])),
    ]
    figure = make_subplots(rows=2, cols=2, horizontal_spacing=0.09, vertical_spacing=0.17)
    apply_style(figure, 540)
    drawn: list[go.Scatter] = []
    shapes: list[dict[str, object]] = []
    moving = find_threshold(shown)
    reach = 1.25 * float(np.quantile(np.abs(error), 0.998)) or 1.0
    for number, (label, x) in enumerate(panels):
        row, col = number // 2 + 1, number % 2 + 1
        axis = str(number + 1) if number else ""
        drawn += _draw_branches(axis, x, error, rate, moving)
        shapes += _mark_floor(float(told.noise_floor), f"x{axis}", f"y{axis}")
        figure.update_xaxes(title=label, row=row, col=col)
        figure.update_yaxes(
            title=f"what is left, {unit}" if col == 1 else "",
            range=[-reach, reach],
            row=row,
            col=col,
        )
        if float(np.ptp(x)) == 0.0:
            figure.add_annotation(
                text="does not move in these logs",
                showarrow=False,
                x=0.5,
                y=0.9,
                xref="x domain",
                yref="y domain",
                row=row,
                col=col,
            )
    figure.add_traces(drawn)
    figure.update_layout(shapes=shapes)
    return figure


def list_means(figure: go.Figure) -> list[tuple[str, str, float, float]]:
    """Return what `draw_residual` draws: against what, branch, bin's centre, mean."""
    rows = []
    for trace in figure.data:
        if trace.mode != "lines+markers":
            continue
        axis = figure.layout[f"xaxis{trace.xaxis.removeprefix('x')}"]
        rows += [
            (str(axis.title.text), str(trace.name), float(x), float(y))
            for x, y in zip(trace.x, trace.y, strict=True)
        ]
    return rows


def _draw_branches(
    axis: str, x: Array, error: Array, rate: Array, moving: float
) -> list[go.Scatter]:
    """Return cloud and bin means of each branch, in the panel of these axes."""
    branches = (
        ("heating", rate > moving, HEATING, "circle", "solid"),
        ("cooling", rate < -moving, COOLING, "square-open", "dash"),
        ("at rest", np.abs(rate) <= moving, STILL, "x", "dot"),
    )
    drawn = []
    for name, here, colour, symbol, dash in branches:
        mine = np.flatnonzero(here)
        if not mine.size:
            continue
        cloud = mine[pick_spread(mine.size, CLOUD)]
        drawn.append(
            go.Scatter(
                x=x[cloud].astype(np.float32),
                y=error[cloud].astype(np.float32),
                mode="markers",
                marker={"size": 3, "color": wash(colour), "line": {"width": 0}, "opacity": 1.0},
                legendgroup=name,
                showlegend=False,
                hoverinfo="skip",
                xaxis=f"x{axis}",
                yaxis=f"y{axis}",
            )
        )
        centres, means = bin_means(x[mine], error[mine])
        drawn.append(
            go.Scatter(
                x=centres,
                y=means,
                name=name,
                mode="lines+markers",
                line={"color": colour, "width": 2, "dash": dash},
                marker={"symbol": symbol, "size": 7, "color": colour},
                legendgroup=name,
                showlegend=not axis,
                xaxis=f"x{axis}",
                yaxis=f"y{axis}",
            )
        )
    return drawn


def bin_means(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the centres and mean values of bins of equal width that hold enough samples."""
    low, high = float(x.min()), float(x.max())
    if low == high:
        return np.array([low]), np.array([float(y.mean())])
    edges = np.linspace(low, high, BINS + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    sums = np.bincount(place, weights=y, minlength=BINS)
    centres = np.bincount(place, weights=x, minlength=BINS)
    kept = counts >= max(FEWEST_IN_BIN * x.size, 1)
    return centres[kept] / counts[kept], sums[kept] / counts[kept]
