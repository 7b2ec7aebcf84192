"""The figures of the loop; used by the report, the page, `compare`, `history` and `effects`."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.compare import Comparison
from zerodrift.diagnosis.diagnosis import Diagnosis, write_probability
from zerodrift.diagnosis.fingerprint import Fingerprint
from zerodrift.diagnosis.history import Step
from zerodrift.diagnosis.run_errors import collect_errors
from zerodrift.diagnosis.summary import ComparisonSummary
from zerodrift.discovery.summary import PlannedSetting, PlanSummary
from zerodrift.report.findings import Trace, trace_runs
from zerodrift.report.page import render_page
from zerodrift.report.pictures import trace_steps, trace_temperature
from zerodrift.report.window import (
    HOURS,
    MOST_POINTS,
    TimeAxis,
    Window,
    choose_clock,
    find_rows,
    pick_rows,
)
from zerodrift.verify.summary import FirmwareSummary

# Colours, line kinds and type that every figure shares; all readable without colour.

ACCENT = "#1668b8"
"""The model, and whatever a page wants looked at."""
MEASURED = "#8a94a0"
LEFT = "#5b6876"
HEATING = "#d1610a"
STILL = "#8a94a0"
FLOOR = "#7a8794"
MARKED = "rgba(214, 158, 22, 0.20)"
MARKED_EDGE = "#b7860b"
GRID = "rgba(128, 140, 152, 0.22)"
INK = "#3c4650"
"""Type in figures: readable on white and, lightened by the page, on dark ground."""

SERIES = ("#1668b8", "#d1610a", "#3f8f5f", "#8a5aa8", "#8c7a2b", "#b23a5b", "#4b8a99", "#6b7480")
"""Lines of equal standing; their dashes and marks differ too."""
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
MARKS = ("circle", "square", "diamond", "triangle-up", "x", "star", "cross", "hexagon")
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"


def apply_style(figure: go.Figure, height: int, **layout: object) -> go.Figure:
    """Return the figure in the common style: no box, quiet grid, legend on top."""
    figure.update_layout(
        template="none",
        height=height,
        font={"family": FONT, "size": 12, "color": INK},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        margin={"l": 64, "r": 16, "t": 40, "b": 44},
        legend={"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom", "xanchor": "left"},
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": STILL, "activecolor": ACCENT},
        hoverlabel={"font": {"family": FONT, "size": 12}},
        **layout,
    )
    axis = {
        "gridcolor": GRID,
        "zeroline": False,
        "linecolor": GRID,
        "ticks": "outside",
        "tickcolor": GRID,
        "ticklen": 4,
        "title": {"font": {"size": 12}, "standoff": 8},
    }
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis)
    figure.update_annotations(font={"size": 12})
    return figure


def wash(colour: str, opacity: float = 0.28) -> str:
    """Return a colour `#rrggbb` made transparent, which prints smaller than a transparent mark."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity:g})"


def dash_of(number: int) -> str:
    """Return the dash of the nth of several lines."""
    return DASHES[number % len(DASHES)]


def mark_of(number: int) -> str:
    """Return the mark of the nth of several lines."""
    return MARKS[number % len(MARKS)]


def colour_of(number: int) -> str:
    """Return the colour of the nth of several lines."""
    return SERIES[number % len(SERIES)]


def line_across(level: float, x_axis: str, y_axis: str) -> dict[str, object]:
    """Return a dotted level across a subplot, such as axes `x2` and `y2`, as a layout's shape."""
    return {
        "type": "line",
        "xref": f"{x_axis} domain",
        "yref": y_axis,
        "x0": 0,
        "x1": 1,
        "y0": level,
        "y1": level,
        "line": {"dash": "dot", "color": FLOOR, "width": 1},
    }


def line_up(place: float, x_axis: str, y_axis: str) -> dict[str, object]:
    """Return a thin line from the bottom to the top of a subplot, as a layout's shape."""
    return {
        "type": "line",
        "xref": x_axis,
        "yref": f"{y_axis} domain",
        "x0": place,
        "x1": place,
        "y0": 0,
        "y1": 1,
        "line": {"color": FLOOR, "width": 0.5},
    }


def shade(start: float, stop: float, x_axis: str, y_axis: str) -> dict[str, object]:
    """Return a marked stretch of a subplot, as a layout's shape."""
    return {
        "type": "rect",
        "xref": x_axis,
        "yref": f"{y_axis} domain",
        "x0": start,
        "x1": stop,
        "y0": 0,
        "y1": 1,
        "fillcolor": MARKED,
        "line": {"width": 1, "color": MARKED_EDGE, "dash": "dot"},
    }


# Measurement, model and residual along the runs, as Plotly figures for notebooks and `compare`.

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


# The picture of a programme: temperature, loads and inputs over time.

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


__all__ = [
    "draw_autocorrelation",
    "draw_budget",
    "draw_candidates",
    "draw_comparison",
    "draw_fingerprint",
    "draw_revision",
    "draw_staircase",
    "render_page",
]


# The figures of the loop; used by the report, the page, `compare`, `history` and `effects`.

LAGS = 60
LEAST_RATIO = 1e-6
"""Of an error to its floor, on a logarithmic axis."""


def draw_staircase(steps: Sequence[Step]) -> go.Figure:
    """Return the held-out error of each output over its noise floor, step by step."""
    figure = go.Figure()
    labels = [f"{number}. {step.label}" for number, step in enumerate(steps)]
    outputs = list(dict.fromkeys(name for step in steps for name in step.errors))
    for number, name in enumerate(outputs):
        ratios, texts = [], []
        for step in steps:
            error, floor = step.errors.get(name), step.noise_floor.get(name, 0.0)
            ratios.append(error / floor if error is not None and floor > 0.0 else None)
            unit = step.units.get(name, "")
            told = "-" if error is None else f"{error:.4g} {unit}, floor {floor:.4g} {unit}"
            texts.append(f"{name}: {told}<br>{step.reason}")
        figure.add_trace(
            go.Scatter(
                x=labels,
                y=ratios,
                name=name,
                mode="lines+markers",
                line={
                    "shape": "hv",
                    "color": colour_of(number),
                    "dash": dash_of(number),
                    "width": 2,
                },
                marker={"symbol": mark_of(number), "size": 8},
                text=texts,
                hoverinfo="text",
            )
        )
    figure.add_hline(
        y=1.0,
        line={"dash": "dot", "color": FLOOR, "width": 1.5},
    )
    # On a logarithmic axis an annotation stands at the logarithm.
    figure.add_annotation(
        text="noise floor", x=0, xref="paper", xanchor="left", y=0.0, yanchor="top", showarrow=False
    )
    apply_style(figure, 380)
    figure.update_yaxes(title="held-out RMSE / noise floor", **_log_axis(figure))
    figure.update_xaxes(title="change of the model", type="category", showgrid=False)
    return figure


def _log_axis(figure: go.Figure) -> dict[str, object]:
    """Return a logarithmic axis that reaches a little below 1 and above the largest value."""
    values = [v for trace in figure.data for v in (trace.y or ()) if v is not None and v > 0.0]
    top = max([*values, 1.5])
    low = min([*values, 1.0])
    ticks = [t for t in (0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000) if 0.6 * low <= t <= top]
    return {
        "type": "log",
        "range": [float(np.log10(0.75 * low)), float(np.log10(1.35 * top))],
        "tickvals": ticks,
        "ticktext": [f"{t:g}" for t in ticks],
    }


def draw_comparison(
    dataset: Dataset, predict: Callable[[Run], Array], comparison: Comparison
) -> list[go.Figure]:
    """Return the figures of `compare`: per output the runs, and the autocorrelation of the errors.

    Runs are laid end to end. Runs that were held out show the held-out prediction.
    """
    runs = [*dataset.train, *dataset.test]
    held_out = comparison.method.predictions
    predictions = {
        run.name: held_out[run.name] if run.name in held_out else predict(run) for run in runs
    }
    errors = collect_errors(runs, predictions, comparison.tared, comparison.find_usable)
    traces = trace_runs(errors, [run.name for run in comparison.runs if run.held_out is not None])
    told = comparison.summarise()
    figures = []
    for name in comparison.outputs:
        figures.append(draw_output(traces, told, name))
        figures.append(draw_autocorrelation(traces, told, name))
    return figures


def draw_autocorrelation(
    traces: Sequence[Trace], compared: ComparisonSummary, output: str
) -> go.Figure:
    """Return the autocorrelation of what is left of one output, within runs."""
    k = list(compared.outputs).index(output)
    lags_s, correlation = measure_autocorrelation(traces, k)
    figure = go.Figure(go.Bar(x=lags_s, y=correlation, marker={"color": LEFT}, name=output))
    apply_style(figure, 240, bargap=0.35, showlegend=False)
    figure.update_xaxes(title="lag, s", showgrid=False)
    figure.update_yaxes(title=f"autocorrelation, {output}", range=[-1.05, 1.05])
    return figure


def measure_autocorrelation(traces: Sequence[Trace], k: int) -> tuple[Array, Array]:
    """Return lags in seconds, and the autocorrelation of one output's errors within runs."""
    longest = max(trace.time_s.size for trace in traces)
    step = max(1, longest // (4 * LAGS))
    lags = np.arange(LAGS) * step
    total, square = np.zeros(LAGS), 0.0
    for trace in traces:
        x = trace.error[k] - trace.error[k].mean()
        square += float(x @ x)
        total += [float(x[lag:] @ x[: x.size - lag]) if lag < x.size else 0.0 for lag in lags]
    shares = total / square if square > 0.0 else total
    return np.asarray(lags * traces[0].sample_period_s), np.asarray(shares)


def draw_candidates(diagnosis: Diagnosis, most: int = 12) -> go.Figure:
    """Return the held-out error with each candidate, as a share of what it is without.

    Args:
        diagnosis: what was found.
        most: how many candidates to show.
    """
    shown = diagnosis.candidates[:most][::-1]
    named = {diagnosis.effect, *diagnosis.lookalikes}
    ratios = [c.rmse_left_out_ratio for c in shown]
    figure = go.Figure(
        go.Bar(
            x=ratios,
            y=[c.effect for c in shown],
            orientation="h",
            marker={
                "color": [ACCENT if c.effect in named else MEASURED for c in shown],
                "pattern": {"shape": ["" if c.effect in named else "/" for c in shown]},
            },
            text=[
                f"{c.rmse_left_out_ratio:.3f}   {write_probability(c.probability)} likely"
                for c in shown
            ],
            textposition="outside",
            cliponaxis=False,
            hoverinfo="y+text",
        )
    )
    figure.add_vline(x=1.0, line={"dash": "dot", "color": FLOOR, "width": 1.5})
    apply_style(figure, 90 + 26 * max(len(shown), 1), showlegend=False, bargap=0.35)
    figure.update_layout(margin={"l": 150, "r": 90})
    figure.update_xaxes(
        title="held-out RMSE with the effect / without it",
        range=[0.0, 1.15 * max([1.0, *ratios])],
    )
    figure.update_yaxes(showgrid=False, ticks="")
    return figure


def draw_revision(
    before: Mapping[str, float], after: Mapping[str, float], floor: Mapping[str, float]
) -> go.Figure:
    """Return each output's held-out error before and after a change, in noise floors.

    Args:
        before: output -> RMSE, in its unit.
        after: the same with the change.
        floor: the same of the noise.
    """
    outputs = [name for name in after if floor[name] > 0.0]
    series = (
        ("before", before, MEASURED, "circle-open", 13),
        ("after", after, ACCENT, "circle", 10),
    )
    figure = go.Figure()
    for name, values, colour, symbol, size in series:
        figure.add_trace(
            go.Scatter(
                x=[values[n] / floor[n] for n in outputs],
                y=outputs,
                name=name,
                mode="markers",
                marker=_mark(symbol, size, colour),
                hovertemplate=f"{name}: %{{x:.3g}} × floor<extra>%{{y}}</extra>",
            )
        )
    figure.add_vline(x=1.0, line={"dash": "dot", "color": FLOOR, "width": 1.5})
    for name in outputs:
        figure.add_annotation(
            x=np.log10(max(after[name] / floor[name], LEAST_RATIO)),
            ax=np.log10(max(before[name] / floor[name], LEAST_RATIO)),
            y=name,
            ay=name,
            xref="x",
            axref="x",
            yref="y",
            ayref="y",
            showarrow=True,
            arrowhead=2,
            arrowwidth=1.5,
            arrowcolor=LEFT,
            standoff=7,
            startstandoff=8,
            text="",
        )
    apply_style(figure, 130 + 30 * len(outputs))
    figure.update_xaxes(title="held-out RMSE / noise floor", type="log", tickformat="~g")
    figure.update_yaxes(autorange="reversed", ticks="")
    return figure


def draw_budget(firmware: FirmwareSummary, compared: ComparisonSummary) -> go.Figure:
    """Return each output's error in %FS: uncompensated, float, integer, and the noise floor.

    Args:
        firmware: as `firmware` found it.
        compared: what `compare` found, for full scale and floor.
    """
    outputs = list(firmware.units)
    scale = {name: 100.0 / compared.outputs[name].full_scale for name in outputs}
    series = [
        ("uncompensated", firmware.rmse.uncompensated, MEASURED, "diamond-open", 11),
        ("float", firmware.rmse.float, LEFT, "circle-open", 17),
        ("integer", firmware.rmse.integer, ACCENT, "circle", 7),
        ("integer − float", firmware.rmse_integer_to_float, ACCENT, "x-thin", 9),
        (
            "noise floor",
            {n: compared.outputs[n].noise_floor for n in outputs},
            FLOOR,
            "line-ns-open",
            15,
        ),
    ]
    figure = go.Figure()
    for name, values, colour, symbol, size in series:
        figure.add_trace(
            go.Scatter(
                x=[scale[n] * values[n] for n in outputs],
                y=outputs,
                name=name,
                mode="markers",
                marker=_mark(symbol, size, colour),
                customdata=[f"{values[n]:.4g} {firmware.units[n]}" for n in outputs],
                hovertemplate=f"{name}: %{{customdata}} (%{{x:.3g}} %FS)<extra>%{{y}}</extra>",
            )
        )
    apply_style(figure, 150 + 30 * len(outputs))
    figure.update_xaxes(title="RMSE, % of full scale", type="log", dtick=1, tickformat="~g")
    figure.update_yaxes(autorange="reversed", ticks="")
    return figure


def _mark(symbol: str, size: int, colour: str) -> dict[str, object]:
    return {"symbol": symbol, "size": size, "color": colour, "line": {"width": 2, "color": colour}}


def draw_fingerprint(title: str, picture: Fingerprint) -> go.Figure:
    """Return what an effect looks like in the experiment that shows it best."""
    figure = go.Figure(
        go.Scatter(
            x=picture.x.astype(np.float32),
            y=picture.y.astype(np.float32),
            mode="lines",
            name=title,
            line={"color": ACCENT, "width": 2},
            hoverinfo="skip",
        )
    )
    apply_style(figure, 320, showlegend=False, title={"text": picture.experiment, "x": 0.06})
    figure.update_xaxes(title=picture.x_label)
    figure.update_yaxes(title="drift, share of its largest")
    return figure
