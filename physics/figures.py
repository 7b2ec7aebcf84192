"""Figures of the loop, for pages that stand on their own: no server, no network."""

import html
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from zerodrift.dataset.runs import Dataset, Run
from zerodrift.physics.compare import Comparison
from zerodrift.physics.history import Step
from zerodrift.physics.run_errors import RunError, collect_errors

Array = NDArray[np.float64]

MOST_POINTS = 1200
"""Points of a line; more samples than that are drawn as the least and largest of each step."""
LAGS = 60
MEASURED, MODEL, LEFT, FLOOR = "#4c78a8", "#f58518", "#54a24b", "#9d9d9d"
MARKED = "rgba(228, 87, 86, 0.18)"


def draw_staircase(steps: Sequence[Step]) -> go.Figure:
    """Return the held-out error of each output, over its noise floor, step by step."""
    figure = go.Figure()
    labels = [f"{number}. {step.label}" for number, step in enumerate(steps)]
    outputs = list(dict.fromkeys(name for step in steps for name in step.errors))
    for name in outputs:
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
                line={"shape": "hv"},
                text=texts,
                hoverinfo="text",
            )
        )
    figure.add_hline(y=1.0, line={"dash": "dot", "color": FLOOR}, annotation_text="noise floor")
    figure.update_layout(
        title="Held-out RMSE over the noise floor, step by step",
        yaxis={"title": "held-out RMSE / noise floor", "type": "log"},
        xaxis={"title": "change of the model"},
        template="plotly_white",
    )
    return figure


def draw_comparison(
    dataset: Dataset, predict: Callable[[Run], Array], comparison: Comparison
) -> list[go.Figure]:
    """Return a figure per output: measured drift and model, what is left, its autocorrelation.

    Runs are laid end to end. Runs that were held out show the held-out prediction.
    """
    runs = [*dataset.train, *dataset.test]
    held_out = comparison.method.predictions
    predictions = {
        run.name: held_out[run.name] if run.name in held_out else predict(run) for run in runs
    }
    errors = collect_errors(runs, predictions, comparison.tared, comparison.find_usable)
    return [
        _draw_output(list(errors.values()), comparison, k) for k in range(len(comparison.outputs))
    ]


def _draw_output(errors: Sequence[RunError], comparison: Comparison, k: int) -> go.Figure:
    name, unit = comparison.outputs[k], comparison.units[k]
    figure = make_subplots(
        rows=3,
        cols=1,
        row_heights=[0.4, 0.4, 0.2],
        vertical_spacing=0.08,
        subplot_titles=(
            f"{name}: drift as measured, and the model",
            "what is left, with the worst segments marked",
            "autocorrelation of what is left",
        ),
    )
    start_h, ticks, labels = 0.0, [], []
    for number, error in enumerate(errors):
        period_s = error.runs[0].sample_period_s
        rows = np.arange(error.drift.shape[0], dtype=np.float64)
        time_h = start_h + rows * period_s / 3600.0
        left = error.error[:, k]
        offset = error.offset[k]
        for row, values, colour, label in (
            (1, error.drift[:, k], MEASURED, "measured"),
            (1, error.drift[:, k] - left, MODEL, "model"),
            (2, left, LEFT, "left"),
        ):
            x, y = thin(time_h, values)
            figure.add_trace(
                go.Scatter(
                    x=x,
                    y=y,
                    name=label,
                    legendgroup=label,
                    showlegend=number == 0,
                    line={"color": colour, "width": 1},
                    hovertemplate=f"{error.group}: %{{y:.4g}} {unit}",
                ),
                row=row,
                col=1,
            )
        clock_s = np.concatenate([run.time_s for run in error.runs])
        for segment in comparison.failures.worst:
            if segment.run == error.group and segment.output == name:
                ends = np.searchsorted(clock_s, (segment.from_s, segment.to_s))
                figure.add_vrect(
                    x0=float(time_h[ends[0]]),
                    x1=float(time_h[min(int(ends[1]), time_h.size - 1)]),
                    fillcolor=MARKED,
                    line_width=0,
                    annotation_text=segment.pattern,
                    annotation_font_size=9,
                    row=2,
                    col=1,
                )
        ticks.append(float(time_h[time_h.size // 2]))
        labels.append(error.group if not offset else f"{error.group}*")
        start_h = float(time_h[-1]) + 0.02 * max(float(time_h[-1]) - start_h, 1e-6)
    floor = float(comparison.floor.rms[k])
    for level in (-floor, floor):
        figure.add_hline(y=level, line={"dash": "dot", "color": FLOOR}, row=2, col=1)
    lags_s, correlation = measure_autocorrelation(errors, k)
    figure.add_trace(
        go.Bar(x=lags_s, y=correlation, marker={"color": LEFT}, showlegend=False), row=3, col=1
    )
    for row in (1, 2):
        figure.update_xaxes(tickvals=ticks, ticktext=labels, row=row, col=1)
        figure.update_yaxes(title=unit, row=row, col=1)
    figure.update_xaxes(title="lag, s", row=3, col=1)
    figure.update_layout(height=760, template="plotly_white", title=f"{name}, {unit}")
    return figure


def thin(x: Array, y: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a line with few points that looks the same: least and largest of each step."""
    if x.size <= MOST_POINTS:
        return x.astype(np.float32), y.astype(np.float32)
    size = -(-2 * x.size // MOST_POINTS)
    count = x.size // size
    blocks = y[: count * size].reshape(count, size)
    places = np.sort(np.stack([blocks.argmin(axis=1), blocks.argmax(axis=1)], axis=1), axis=1)
    rows = (places + size * np.arange(count)[:, None]).reshape(-1)
    return x[rows].astype(np.float32), y[rows].astype(np.float32)


def measure_autocorrelation(errors: Sequence[RunError], k: int) -> tuple[Array, Array]:
    """Return lags in seconds, and the autocorrelation of one output's errors within runs."""
    longest = max(error.error.shape[0] for error in errors)
    step = max(1, longest // (4 * LAGS))
    lags = np.arange(LAGS) * step
    total, square = np.zeros(LAGS), 0.0
    for error in errors:
        x = error.error[:, k] - error.error[:, k].mean()
        square += float(x @ x)
        total += [float(x[lag:] @ x[: x.size - lag]) if lag < x.size else 0.0 for lag in lags]
    period_s = errors[0].runs[0].sample_period_s
    return lags * period_s, total / square if square > 0.0 else total


def render_page(title: str, figures: Sequence[go.Figure], notes: Sequence[str] = ()) -> str:
    """Return one HTML page with all figures and the plotting code inside it."""
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<title>{html.escape(title)}</title>",
        f"<script>{get_plotlyjs()}</script>",
        "<style>body{font-family:sans-serif;max-width:72rem;margin:2rem auto}</style>",
        f"</head><body><h1>{html.escape(title)}</h1>",
    ]
    parts += [f"<p>{html.escape(note)}</p>" for note in notes]
    for number, figure in enumerate(figures):
        # A name of its own for each figure, so that the same figures give the same bytes.
        options: dict[str, Any] = {"full_html": False, "include_plotlyjs": False}
        parts.append(figure.to_html(div_id=f"figure-{number}", **options))
    parts.append("</body></html>\n")
    return "\n".join(parts)
