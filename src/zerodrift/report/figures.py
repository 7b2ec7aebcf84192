"""The figures of the loop; used by the report, the page, `compare`, `history` and `effects`."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.compare import Comparison
from zerodrift.diagnosis.comparison_summary import ComparisonSummary
from zerodrift.diagnosis.diagnosis import Diagnosis, write_probability
from zerodrift.diagnosis.fingerprint import Fingerprint
from zerodrift.diagnosis.history import Step
from zerodrift.diagnosis.run_errors import collect_errors
from zerodrift.report.figures_runs import draw_output
from zerodrift.report.findings import Trace, trace_runs
from zerodrift.report.page import render_page
from zerodrift.report.style import (
    ACCENT,
    FLOOR,
    LEFT,
    MEASURED,
    apply_style,
    colour_of,
    dash_of,
    mark_of,
)
from zerodrift.verify.summary import FirmwareSummary

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
