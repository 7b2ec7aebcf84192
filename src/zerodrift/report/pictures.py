"""The loop's pictures for page, report and notebooks: runs, staircase, ranking, change, budget."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.compare import Comparison
from zerodrift.diagnosis.diagnosis import Diagnosis, write_probability
from zerodrift.diagnosis.fingerprint import Fingerprint
from zerodrift.diagnosis.formula.proposal import FormulaCurve
from zerodrift.diagnosis.history import Step
from zerodrift.diagnosis.run_errors import collect_errors
from zerodrift.diagnosis.summary import ComparisonSummary
from zerodrift.discovery.summary import PlannedSetting, PlanSummary
from zerodrift.report.findings import Trace, trace_runs
from zerodrift.report.svg import (
    DASH_ORDER,
    MARK_ORDER,
    AxisScale,
    Band,
    Bar,
    Cloud,
    Curve,
    Level,
    Panel,
    Picture,
    spread,
)
from zerodrift.report.window import pick_rows
from zerodrift.verify.summary import FirmwareSummary

# The last formula of `propose` for report and page, against what is left.

MOST_OUTPUTS = 6
"""Outputs that have a panel."""
COLUMNS = 3


def draw_remainder(
    curves: Mapping[str, FormulaCurve], units: Mapping[str, str], width: float = 760.0
) -> Picture:
    """Return what is left against what the formula says of it, one panel for each output."""
    names = list(curves)[:MOST_OUTPUTS]
    columns = min(COLUMNS, len(names))
    each, height = width / max(columns, 1), 210.0
    panels = []
    for number, name in enumerate(names):
        x, y = np.array(curves[name].formula), np.array(curves[name].remainder)
        low, high = spread(x)
        line = np.array([low, high])
        panels.append(
            Panel(
                left=62.0 + each * (number % columns),
                top=46.0 + (height + 84.0) * (number // columns),
                width=each - 78.0,
                height=height,
                x=AxisScale(low, high, f"formula, {units[name]}"),
                y=AxisScale(*spread(y, line)),
                title=f"{name}: remainder, {units[name]}",
                clouds=(Cloud(x, y, "measured", "runs left out"),),
                curves=(Curve(line, line, "model", "all of it", "dash"),),
                stacked=True,
            )
        )
    rows = -(-len(names) // columns) if columns else 0
    words = "What the model leaves of runs left out, against what the formula says of it."
    return Picture(width, rows * (height + 84.0) + 20.0, tuple(panels), words, "formula")


# The picture of a programme for the page: temperature, loads and inputs over hours.

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


# The loop's pictures for page and report: staircase, ranking, change, and error budget.

LETTER = 6.6
"""Pixels of a letter."""
LEAST = 1e-9
INKS = ("s0", "s1", "s2", "s3", "s4", "s5")
MOST_BARS = 10


def draw_stairs(steps: Sequence[Step], width: float = 760.0) -> Picture:
    """Return each output's error of each step over that step's noise floor, as stairs.

    Full marks are errors of runs left out, rings those of test logs.
    """
    outputs = list(dict.fromkeys(name for step in steps for name in step.errors))
    curves, clouds, all_ratios = [], [], [1.0]
    for number, name in enumerate(outputs):
        ink, dash = INKS[number % len(INKS)], DASH_ORDER[number % len(DASH_ORDER)]
        ratios = np.array(
            [_divide(step.errors.get(name), step.noise_floor.get(name)) for step in steps]
        )
        all_ratios += [float(r) for r in ratios if np.isfinite(r)]
        # Each stair is one wide, so that the only one is as well seen as the last of many.
        edges = np.concatenate([[i, i + 1.0] for i in range(len(steps))])
        curves.append(Curve(edges, np.repeat(ratios, 2), ink, "", dash, 2.0, steps=True))
        middles = np.arange(len(steps), dtype=np.float64) + 0.5
        mark = MARK_ORDER[number % len(MARK_ORDER)]
        clouds.append(Cloud(middles, ratios, ink, name, mark, 4.5))
    low, high = min(all_ratios), max(all_ratios)
    labels = tuple(
        (i + 0.5, _shorten(f"{i} {step.label}", width, len(steps))) for i, step in enumerate(steps)
    )
    panel = Panel(
        left=58.0,
        top=30.0,
        width=width - 70.0,
        height=210.0,
        x=AxisScale(0.0, float(len(steps)), "step", ticks=labels),
        y=AxisScale(0.8 * low, 1.35 * max(high, 1.5), log=True),
        title="error / noise floor",
        curves=tuple(curves),
        clouds=tuple(clouds),
        levels=(Level(1.0, "noise floor"),),
    )
    words = "Error of each output over the noise floor, step by step of the model's history."
    return Picture(width, 290.0, (panel,), words, "staircase")


def _shorten(label: str, width: float, count: float) -> str:
    """Return a label as long as fits, where `count` of them fill the picture."""
    most = max(int((width - 70.0) / (LETTER * max(count, 1.0))) - 1, 4)
    return label if len(label) <= most else f"{label[: most - 1]}…"


def _divide(error: float | None, floor: float | None) -> float:
    return error / floor if error is not None and floor else float("nan")


def draw_ranking(diagnosis: Diagnosis, width: float = 760.0) -> Picture:
    """Return the error on runs left out with each candidate, as a share of that without it.

    Full bars are named by the verdict, hatched ones are not.
    """
    named = {diagnosis.effect, *diagnosis.lookalikes, *diagnosis.also}
    shown = diagnosis.candidates[:MOST_BARS]
    bars = tuple(
        Bar(
            c.effect,
            c.rmse_left_out_ratio,
            f"{c.rmse_left_out_ratio:.3f}, {write_probability(c.probability)} likely",
            "model",
            hatched=c.effect not in named,
        )
        for c in shown
    )
    left = 16.0 + LETTER * max((len(c.effect) for c in shown), default=4)
    height = 26.0 * max(len(bars), 1)
    most = max([1.0, *(min(c.rmse_left_out_ratio, 1.5) for c in shown)])
    panel = Panel(
        left=left,
        top=22.0,
        width=max(width - left - 120.0, 80.0),
        height=height,
        x=AxisScale(0.0, 1.02 * most, "RMSE on runs left out: with the effect / without it"),
        y=AxisScale(0.0, 1.0),
        bars=bars,
        levels=(Level(1.0, "no gain", upright=True),),
    )
    words = "Error on runs left out with each candidate over that without it; shorter is better."
    return Picture(width, height + 66.0, (panel,), words, "candidates")


def draw_change(
    before: Mapping[str, float],
    after: Mapping[str, float],
    floor: Mapping[str, float],
    width: float = 760.0,
) -> Picture:
    """Return each output's error before and after a change, in noise floors."""
    outputs = [name for name in after if floor[name] > 0.0]
    series = (("before", before, "measured", "ring"), ("after", after, "model", "circle"))
    told = tuple(
        (name, {n: values[n] / floor[n] for n in outputs}, ink, mark)
        for name, values, ink, mark in series
    )
    label = "error / noise floor"
    return _draw_rows(outputs, told, 1.0, "noise floor", label, "change", width)


def draw_error_budget(
    firmware: FirmwareSummary, compared: ComparisonSummary, width: float = 760.0
) -> Picture:
    """Return each output's error in %FS: uncompensated, float, integer, and the noise floor."""
    outputs = list(firmware.units)
    scale = {name: 100.0 / compared.outputs[name].full_scale for name in outputs}
    series = (
        ("uncompensated", firmware.rmse.uncompensated, "measured", "diamond"),
        ("float model", firmware.rmse.float, "left", "ring"),
        ("chip", firmware.rmse.integer, "model", "circle"),
        ("chip − float", firmware.rmse_integer_to_float, "effect", "cross"),
        ("noise floor", {n: compared.outputs[n].noise_floor for n in outputs}, "floor", "square"),
    )
    told = tuple(
        (name, {n: scale[n] * values[n] for n in outputs}, ink, mark)
        for name, values, ink, mark in series
    )
    return _draw_rows(outputs, told, None, "", "RMSE, % of full scale", "error_budget", width)


Series = tuple[str, Mapping[str, float], str, str]


def _draw_rows(
    outputs: Sequence[str],
    series: Sequence[Series],
    level: float | None,
    level_words: str,
    title: str,
    name: str,
    width: float,
) -> Picture:
    """Return one row of marks per output on a logarithmic axis."""
    count = max(len(outputs), 1)
    values = [v for _, told, _, _ in series for v in told.values() if v > LEAST]
    values += [level] if level is not None else []
    low, high = (min(values), max(values)) if values else (0.1, 1.0)
    places = np.arange(len(outputs), dtype=np.float64)[::-1] + 0.5
    clouds = tuple(
        Cloud(np.array([told[n] for n in outputs]), places, ink, words, mark, 5.0)
        for words, told, ink, mark in series
    )
    left = 20.0 + LETTER * max((len(n) for n in outputs), default=4)
    height = 28.0 * count
    panel = Panel(
        left=left,
        top=30.0,
        width=width - left - 16.0,
        height=height,
        x=AxisScale(0.8 * low, 1.3 * high, title, log=True),
        y=AxisScale(0.0, float(count), ticks=tuple(zip(places.tolist(), outputs, strict=True))),
        clouds=clouds,
        levels=(Level(level, "", upright=True),) if level is not None else (),
    )
    words = f"{title} of each output: {', '.join(one[0] for one in series)}."
    return Picture(width, height + 76.0, (panel,), words, name)


# Measurement, model and what is left along the runs, as `compare` finds them.

POINTS = 700
"""Of each line in a run."""
MOST_OUTLIERS = 500
"""Outliers that are drawn of one run and output."""
LAGS = 60
BETWEEN = 0.02
"""Room between two runs, as a share of the first one's length."""


def draw_comparison(
    dataset: Dataset, predict: Callable[[Run], Array], comparison: Comparison
) -> list[Picture]:
    """Return the pictures of `compare`: per output the runs, and the autocorrelation of the errors.

    Runs that were held out show the held-out prediction.
    """
    runs = [*dataset.train, *dataset.test]
    held_out = comparison.method.predictions
    predictions = {
        run.name: held_out[run.name] if run.name in held_out else predict(run) for run in runs
    }
    errors = collect_errors(runs, predictions, comparison.tared, comparison.find_usable)
    traces = trace_runs(errors, [run.name for run in comparison.runs if run.held_out is not None])
    told = comparison.summarise()
    return [
        draw(traces, told, name)
        for name in comparison.outputs
        for draw in (draw_runs, draw_autocorrelation)
    ]


def draw_runs(
    traces: Sequence[Trace], compared: ComparisonSummary, output: str, width: float = 1000.0
) -> Picture:
    """Return measured drift and model, and what is left, of one output; runs laid end to end.

    Runs in brackets are those that the model learnt from. The worst segments are numbered as
    tabled.
    """
    k, told = list(compared.outputs).index(output), compared.outputs[output]
    drifts, models, lefts, wild = (list[tuple[Array, Array]]() for _ in range(4))
    middles, begins, bands, end_h = [], [0.0], [], 0.0
    for trace in traces:
        hours = (trace.time_s - trace.time_s[0]) / 3600.0 + end_h
        drift, error = trace.drift[k], trace.error[k]
        for line, values in ((drifts, drift), (models, drift - error), (lefts, error)):
            kept = pick_rows(values, 0, values.size, POINTS)
            line += [(hours[kept], values[kept]), (np.full(1, np.nan), np.full(1, np.nan))]
        rows = trace.outliers[trace.outliers[:, 1] == k, 0][:MOST_OUTLIERS]
        wild.append((hours[rows], drift[rows]))
        start_h = float(trace.time_s[0]) / 3600.0 - end_h
        bands += [
            Band(one.from_s / 3600.0 - start_h, one.to_s / 3600.0 - start_h, str(number))
            for number, one in enumerate(compared.worst, 1)
            if (one.run, one.output) == (trace.run, output)
        ]
        middles.append(0.5 * float(hours[0] + hours[-1]))
        end_h = float(hours[-1]) + max(BETWEEN * float(hours[-1] - hours[0]), 1e-3)
        begins.append(end_h)
    names = [
        _shorten(trace.run if trace.held_out else f"({trace.run})", width, end_h / (after - before))
        for trace, before, after in zip(traces, begins, begins[1:], strict=False)
    ]
    drift, model, left = map(_join, (drifts, models, lefts))
    floor, edges = float(told.noise_floor), [Level(at, upright=True) for at in begins[1:-1]]
    x = AxisScale(0.0, end_h, ticks=tuple(zip(middles, names, strict=True)))
    upper = Panel(
        left=62.0,
        top=26.0,
        width=width - 74.0,
        height=190.0,
        x=replace(x, hidden=True),
        y=AxisScale(*spread(drift[1], model[1])),
        title=f"drift of {output}, {told.unit}",
        curves=(
            Curve(*drift, "measured", "drift as measured", width=2.2),
            Curve(*model, "model", "model", "dash", 1.6),
        ),
        clouds=(Cloud(*_join(wild), "worst", "outliers, hardly counted", "cross"),)
        if any(rows.size for rows, _ in wild)
        else (),
        levels=tuple(edges),
    )
    lower = Panel(
        left=62.0,
        top=252.0,
        width=width - 74.0,
        height=150.0,
        x=replace(x, title="runs; in brackets those that the model learnt from"),
        y=AxisScale(*spread(left[1], around=(-floor, floor))),
        title=f"what is left, {told.unit}",
        curves=(Curve(*left, "left"),),
        bands=tuple(bands),
        levels=(*edges, Level(-floor), Level(floor, "noise floor")),
    )
    words = f"Measured drift and model of {output} along all runs, and what is left."
    return Picture(width, 450.0, (upper, lower), words, f"{output}_runs")


def _join(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    x, y = zip(*parts, strict=True)
    return np.concatenate(x), np.concatenate(y)


def draw_autocorrelation(
    traces: Sequence[Trace], compared: ComparisonSummary, output: str, width: float = 1000.0
) -> Picture:
    """Return the autocorrelation of what is left of one output, within runs."""
    k = list(compared.outputs).index(output)
    lags_s, correlation = measure_autocorrelation(traces, k)
    gap = np.full(lags_s.size, np.nan)
    panel = Panel(
        left=62.0,
        top=26.0,
        width=width - 74.0,
        height=110.0,
        x=AxisScale(-0.5 * float(lags_s[1]), float(lags_s[-1] + 0.5 * lags_s[1]), "lag, s"),
        y=AxisScale(-1.05, 1.05),
        title=f"autocorrelation, {output}",
        curves=(
            Curve(
                np.column_stack([lags_s, lags_s, gap]).ravel(),
                np.column_stack([np.zeros(lags_s.size), correlation, gap]).ravel(),
                "left",
                width=5.0,
            ),
        ),
    )
    words = f"Autocorrelation of what is left of {output}, within runs."
    return Picture(width, 182.0, (panel,), words, f"{output}_autocorrelation")


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


def draw_fingerprint(title: str, told: Fingerprint, width: float = 760.0) -> Picture:
    """Return what an effect looks like in the experiment that shows it best."""
    panel = Panel(
        left=62.0,
        top=26.0,
        width=width - 74.0,
        height=230.0,
        x=AxisScale(*spread(told.x, margin=0.0), told.x_label),
        y=AxisScale(*spread(told.y)),
        title=f"drift, share of its largest; {told.experiment}",
        curves=(Curve(told.x, told.y, "model", width=2.0),),
    )
    return Picture(width, 302.0, (panel,), f"{title}: {told.experiment}", "fingerprint")
