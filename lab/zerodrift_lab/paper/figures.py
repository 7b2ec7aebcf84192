"""Pictures of the paper's experiments on the twin; each says that it is simulated."""

from collections.abc import Sequence
from textwrap import wrap

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from zerodrift.report.figures import (
    ACCENT,
    FLOOR,
    MEASURED,
    apply_style,
    colour_of,
    dash_of,
    mark_of,
    wash,
)
from zerodrift_lab.methods import METHODS
from zerodrift_lab.paper.plan import DEFAULT, PAPER_GRU, Plan
from zerodrift_lab.paper.published import CHAMBER, COOLING, HEATING, NONE
from zerodrift_lab.paper.store import Cell
from zerodrift_lab.paper.study import Outcome
from zerodrift_lab.paper.summary import Outcomes, Spread, compare_errors, summarise
from zerodrift_lab.paper.tables import find_cells
from zerodrift_lab.paper.why import Heat, Spans, Training, Why
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS

SHOWN = ("lsm_linear", "mlp", PAPER_GRU, DEFAULT)
"""Lines of the fit figures."""


def list_figures(plan: Plan, outcomes: Outcomes, why: Why) -> dict[str, go.Figure]:
    """Return every figure by the name of its file."""
    sensor, seed = plan.sensors[0], plan.seeds[0]
    cells = [Cell(m, sensor, seed) for m in SHOWN if m in plan.methods]
    shown = outcomes.get(cells)
    return {
        "fit": draw_fit(shown, "chamber", "Fz"),
        "fit_all_axes": draw_errors(shown, "chamber"),
        "heating_all_axes": draw_errors(shown, "heating"),
        "ranking": draw_ranking(plan, outcomes),
        "why_window_span": draw_spans(why.spans),
        "why_training": draw_training(why.training),
        "why_one_sided_heat": draw_heat(why.heat),
    }


def _entitle(figure: go.Figure, text: str) -> None:
    figure.update_layout(
        title={
            "text": f"{text} (simulated)",
            **{"x": 0.0, "xref": "paper", "xanchor": "left"},
            **{"y": 0.985, "yref": "container", "yanchor": "top"},
            "font": {"size": 14},
        },
        margin={"l": 70, "r": 24, "t": 76, "b": 48},
        legend={"y": 1.02},
    )


def draw_fit(shown: Sequence[Outcome], test: str, axis: str) -> go.Figure:
    """Return temperature, drift with predictions, and errors of a held-out run."""
    k = OUTPUTS.index(axis)
    figure = make_subplots(rows=3, shared_xaxes=True, row_heights=[0.2, 0.4, 0.4])
    first = shown[0].result["traces"][test]
    minutes = np.array(first["time_s"]) / 60.0
    figure.add_scatter(
        x=minutes,
        y=first["temperature_degC"],
        line={"color": MEASURED},
        showlegend=False,
        row=1,
        col=1,
    )
    drift = np.array(first["drift"][k])
    figure.add_scatter(
        x=minutes, y=drift, name="drift", line={"color": MEASURED, "width": 5}, row=2, col=1
    )
    for number, outcome in enumerate(shown):
        prediction = np.array(outcome.result["traces"][test]["prediction"][k])
        style = {"color": colour_of(number), "dash": dash_of(number), "width": 1.6}
        title = METHODS[outcome.cell.method].title
        figure.add_scatter(x=minutes, y=prediction, name=title, line=style, row=2, col=1)
        figure.add_scatter(
            x=minutes, y=drift - prediction, line=style, showlegend=False, row=3, col=1
        )
    apply_style(figure, 620)
    unit = UNITS[k]
    figure.update_yaxes(title="chip, degC", row=1, col=1)
    figure.update_yaxes(title=f"{axis}, {unit}", row=2, col=1)
    figure.update_yaxes(title=f"error, {unit}", row=3, col=1)
    figure.update_xaxes(title="time, min", row=3, col=1)
    _entitle(figure, f"A held-out {test} run: drift of {axis} and what the methods make of it")
    return figure


def draw_errors(shown: Sequence[Outcome], test: str) -> go.Figure:
    """Return the errors of a held-out run on all axes."""
    figure = make_subplots(
        rows=3,
        cols=2,
        shared_xaxes=True,
        horizontal_spacing=0.1,
        vertical_spacing=0.06,
    )
    for number, outcome in enumerate(shown):
        told = outcome.result["traces"][test]
        minutes = np.array(told["time_s"]) / 60.0
        errors = np.array(told["drift"]) - np.array(told["prediction"])
        for k in range(len(OUTPUTS)):
            figure.add_scatter(
                x=minutes,
                y=errors[k],
                name=METHODS[outcome.cell.method].title,
                legendgroup=outcome.cell.method,
                showlegend=k == 0,
                line={"color": colour_of(number), "dash": dash_of(number), "width": 1.3},
                row=k % 3 + 1,
                col=k // 3 + 1,
            )
    apply_style(figure, 620)
    for k, (axis, unit) in enumerate(zip(OUTPUTS, UNITS, strict=True)):
        figure.update_yaxes(title=f"{axis}, {unit}", row=k % 3 + 1, col=k // 3 + 1)
    figure.update_xaxes(title="time, min", row=3)
    _entitle(figure, f"What the methods leave of a held-out {test} run")
    return figure


def draw_ranking(plan: Plan, outcomes: Outcomes) -> go.Figure:
    """Return each method's error over that of the reference, the paper's beside the twin's."""
    tables = (CHAMBER, COOLING, HEATING)
    figure = make_subplots(
        cols=3,
        shared_yaxes=True,
        horizontal_spacing=0.04,
        subplot_titles=[
            "chamber, over LSM linear",
            "cooling, over uncompensated",
            "heating, over uncompensated",
        ],
    )
    for col, table in enumerate(tables, 1):
        base = "lsm_linear" if table is CHAMBER else NONE
        simulated = {}
        for method in plan.methods:
            found = outcomes.get(find_cells(plan, method))
            linear = outcomes.get(find_cells(plan, "lsm_linear"))
            if base == NONE:
                ratios = [compare_errors(o.rmse(table.name), o.none(table.name)) for o in found]
            else:
                pairs = outcomes.pair(found, linear)
                ratios = [compare_errors(a.rmse(table.name), b.rmse(table.name)) for a, b in pairs]
            simulated[method] = summarise(ratios)
        printed = {
            method: compare_errors(np.array(table.rows[method]), np.array(table.rows[base]))
            for method in plan.methods
            if method in table.rows
        }
        figure.add_scatter(
            x=[s.median for s in simulated.values()],
            y=[METHODS[m].title for m in simulated],
            error_x={
                "type": "data",
                "symmetric": False,
                "array": [s.high - s.median for s in simulated.values()],
                "arrayminus": [s.median - s.low for s in simulated.values()],
                "color": ACCENT,
                "thickness": 1.5,
            },
            mode="markers",
            name="simulated: median and quartiles",
            marker={"color": ACCENT, "size": 9},
            showlegend=col == 1,
            row=1,
            col=col,
        )
        figure.add_scatter(
            x=list(printed.values()),
            y=[METHODS[m].title for m in printed],
            mode="markers",
            name="paper",
            marker={"symbol": "diamond-open", "size": 12, "color": "#d1610a", "line": {"width": 2}},
            showlegend=col == 1,
            row=1,
            col=col,
        )
    apply_style(figure, 160 + 26 * len(plan.methods))
    ticks = [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0]
    texts = [f"{tick:g}" if f"{tick:g}"[-1] == "1" or tick == 0.5 else "" for tick in ticks]
    figure.update_xaxes(type="log", tickvals=ticks, ticktext=texts, title="error, share")
    figure.update_yaxes(autorange="reversed", showgrid=True)
    _entitle(figure, "How much each method leaves: the paper and the twin")
    figure.update_yaxes(automargin=True, col=1)
    figure.update_layout(margin={"t": 110}, legend={"y": 1.12})
    return figure


def draw_spans(spans: Spans) -> go.Figure:
    """Return the error against the window's length, with the time constants marked."""
    figure = go.Figure()
    lengths = [max(length, 1.0) for length in spans.lengths_s]
    for number, (test, spreads) in enumerate(spans.errors.items()):
        figure.add_scatter(
            x=lengths,
            y=[s.median for s in spreads],
            error_y=_whiskers(spreads, colour_of(number)),
            name=test,
            mode="lines+markers",
            line={"color": colour_of(number), "dash": dash_of(number)},
            marker={"symbol": mark_of(number), "size": 9},
        )
    for tau in spans.time_constants_s:
        figure.add_vline(x=tau, line={"color": FLOOR, "dash": "dot", "width": 1.5})
    apply_style(figure, 380)
    ticks = [1.0, *(x for x in spans.lengths_s if x > 0.0)]
    figure.update_xaxes(
        type="log",
        title="length of the window, s (dotted: lags found in the logs)",
        tickvals=ticks,
        ticktext=["one sample", *(f"{x:g}" for x in ticks[1:])],
    )
    figure.update_yaxes(title="error / noise floor", type="log", tickformat="~g", dtick="D2")
    _entitle(figure, "Ten samples over how long a time, MLP trained in the chamber")
    return figure


def _whiskers(spreads: Sequence[Spread], colour: str) -> dict[str, object]:
    return {
        "type": "data",
        "symmetric": False,
        "array": [s.high - s.median for s in spreads],
        "arrayminus": [s.median - s.low for s in spreads],
        "color": wash(colour, 0.6),
        "thickness": 1.5,
    }


def draw_training(training: Training) -> go.Figure:
    """Return the errors along the recipe, and those of the quick schedule."""
    figure = go.Figure()
    for number, (method, course) in enumerate(training.courses.items()):
        title = METHODS[method].title
        colour = colour_of(number)
        figure.add_scatter(
            x=[seconds for _, seconds, _ in course],
            y=[error for _, _, error in course],
            name=f"{title}, recipe",
            mode="lines+markers",
            line={"color": colour, "dash": dash_of(number)},
            marker={"symbol": mark_of(number), "size": 7},
        )
        seconds, error = training.quick[method]
        figure.add_scatter(
            x=[seconds],
            y=[error],
            name=f"{title}, one cycle",
            mode="markers",
            marker={"symbol": f"{mark_of(number)}-open", "size": 15, "color": colour},
        )
    apply_style(figure, 420)
    figure.update_xaxes(type="log", title="CPU seconds of training", tickformat="~g", dtick="D2")
    figure.update_yaxes(
        type="log", title="held-out chamber error, % of the drift", tickformat="~g", dtick="D2"
    )
    _entitle(figure, f"The same ten samples: {training.epochs} epochs of the recipe, and one cycle")
    figure.update_layout(margin={"t": 110})
    return figure


def draw_heat(heat: Heat) -> go.Figure:
    """Return the errors test by test: a row per training logs, a colour and mark per method."""
    methods = list(dict.fromkeys(method for method, _ in heat.errors))
    rows = list(dict.fromkeys(logs for _, logs in heat.errors))
    tests = list(next(iter(heat.errors.values())))
    figure = make_subplots(
        cols=len(tests),
        shared_yaxes=True,
        horizontal_spacing=0.03,
        subplot_titles=["plates of the walk" if t == "walking_still" else t for t in tests],
    )
    for number, method in enumerate(methods):
        own = {logs: errors for (m, logs), errors in heat.errors.items() if m == method}
        apart = 0.22 * (number - 0.5 * (len(methods) - 1))  # so that equal errors are both seen
        for col, test in enumerate(tests, 1):
            spreads = [errors[test] for errors in own.values()]
            figure.add_scatter(
                x=[s.median for s in spreads],
                y=[rows.index(logs) + apart for logs in own],
                error_x=_whiskers(spreads, colour_of(number)),
                name=METHODS[method].title,
                legendgroup=method,
                showlegend=col == 1,
                mode="markers",
                marker={"symbol": mark_of(number), "size": 10, "color": colour_of(number)},
                row=1,
                col=col,
            )
    figure.add_vline(x=1.0, line={"color": FLOOR, "dash": "dot"})
    apply_style(figure, 200 + 70 * len(rows))
    figure.update_xaxes(title="error / noise floor", type="log", tickformat="~g", dtick="D2")
    figure.update_yaxes(range=[len(rows) - 0.5, -0.5], showgrid=False)
    figure.update_yaxes(
        tickvals=list(range(len(rows))),
        ticktext=["<br>".join(wrap(logs, 28)) for logs in rows],
        automargin=True,
        col=1,
    )
    _entitle(figure, "By what they learnt from: errors in the chamber and in heat from one side")
    figure.update_layout(margin={"t": 110}, legend={"y": 1.16})
    return figure
