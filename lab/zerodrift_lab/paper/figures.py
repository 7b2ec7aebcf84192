"""Pictures of the paper's experiments on the twin; each says that it is simulated."""

from collections.abc import Mapping, Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.report.svg import (
    DASH_ORDER,
    MARK_ORDER,
    AxisScale,
    Cloud,
    Curve,
    Level,
    Panel,
    Picture,
    spread,
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
WIDTH, LEFT, RIGHT = 1000.0, 66.0, 14.0
LETTER = 6.6
"""Pixels of a letter."""
INKS = ("s0", "s1", "s2", "s3", "s4", "s5")
AXIS_TICKS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
TOLD_TICKS = (0.01, 0.1, 0.5, 1.0)


def list_figures(plan: Plan, outcomes: Outcomes, why: Why) -> dict[str, Picture]:
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


def _finish(panels: Sequence[Panel], height: float, words: str, name: str) -> Picture:
    return Picture(WIDTH, height, tuple(panels), f"{words} (simulated).", name)


def _look(number: int) -> tuple[str, str, str]:
    """Return ink, dash and mark of the nth of several lines."""
    marks = MARK_ORDER[number % len(MARK_ORDER)]
    return INKS[number % len(INKS)], DASH_ORDER[number % len(DASH_ORDER)], marks


def draw_fit(shown: Sequence[Outcome], test: str, axis: str) -> Picture:
    """Return temperature, drift with predictions, and errors of a held-out run."""
    k, first = OUTPUTS.index(axis), shown[0].result["traces"][test]
    minutes, drift = np.array(first["time_s"]) / 60.0, np.array(first["drift"][k])
    predicted, left = [Curve(minutes, drift, "measured", "drift", width=4.0)], []
    for number, outcome in enumerate(shown):
        prediction = np.array(outcome.result["traces"][test]["prediction"][k])
        ink, dash, _ = _look(number)
        title = METHODS[outcome.cell.method].title
        predicted.append(Curve(minutes, prediction, ink, title, dash, 1.6))
        left.append(Curve(minutes, drift - prediction, ink, "", dash, 1.6))
    chip = [Curve(minutes, np.array(first["temperature_degC"]), "measured")]
    rows = (
        ("chip, degC (simulated)", chip, 44.0, 90.0),
        (f"{axis}, {UNITS[k]}", predicted, 182.0, 190.0),
        (f"error, {UNITS[k]}", left, 410.0, 190.0),
    )
    panels = [
        Panel(
            left=LEFT,
            top=top,
            width=WIDTH - LEFT - RIGHT,
            height=height,
            x=AxisScale(*spread(minutes, margin=0.0), "time, min", hidden=curves is not left),
            y=AxisScale(*spread(*(c.y for c in curves))),
            title=title,
            curves=tuple(curves),
            stacked=curves is predicted,
        )
        for title, curves, top, height in rows
    ]
    words = f"A held-out {test} run: drift of {axis} and what the methods make of it"
    return _finish(panels, 646.0, words, f"{test}_fit")


def draw_errors(shown: Sequence[Outcome], test: str) -> Picture:
    """Return the errors of a held-out run on all axes."""
    curves: list[list[Curve]] = [[] for _ in OUTPUTS]
    for number, outcome in enumerate(shown):
        told = outcome.result["traces"][test]
        minutes = np.array(told["time_s"]) / 60.0
        errors = np.array(told["drift"]) - np.array(told["prediction"])
        ink, dash, _ = _look(number)
        for k in range(len(OUTPUTS)):
            title = "" if k else METHODS[outcome.cell.method].title
            curves[k].append(Curve(minutes, errors[k], ink, title, dash, 1.3))
    panels = []
    for k, (axis, unit) in enumerate(zip(OUTPUTS, UNITS, strict=True)):
        x = AxisScale(*spread(curves[k][0].x, margin=0.0), "time, min", hidden=k % 3 != 2)
        panels.append(
            Panel(
                left=LEFT + 0.5 * WIDTH * (k // 3),
                top=62.0 + 196.0 * (k % 3),
                width=0.5 * WIDTH - LEFT - RIGHT,
                height=160.0,
                x=x,
                y=AxisScale(*spread(*(c.y for c in curves[k]))),
                title=f"{axis}, {unit}",
                curves=tuple(curves[k]),
                stacked=k == 0,
            )
        )
    return _finish(panels, 660.0, f"What the methods leave of a held-out {test} run", test)


def draw_ranking(plan: Plan, outcomes: Outcomes) -> Picture:
    """Return each method's error over that of the reference, the paper's beside the twin's."""
    titles = ("chamber, over LSM linear", "cooling, over none", "heating, over none (simulated)")
    places = {method: len(plan.methods) - 0.5 - k for k, method in enumerate(plan.methods)}
    left = LETTER * max(len(METHODS[m].title) for m in plan.methods) + 12.0
    each, panels = (WIDTH - left) / 3.0, []
    for column, table in enumerate((CHAMBER, COOLING, HEATING)):
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
        rows = np.array([places[m] for m in simulated])
        ticks = tuple((t, f"{t:g}" if t in TOLD_TICKS else "") for t in AXIS_TICKS)
        names = tuple((place, METHODS[m].title) for m, place in places.items())
        first = column == 0
        paper = np.array([*printed.values()])
        panels.append(
            Panel(
                left=left + each * column,
                top=62.0,
                width=each - 18.0,
                height=26.0 * len(plan.methods),
                x=AxisScale(0.004, 2.6, "error, share", log=True, ticks=ticks),
                y=AxisScale(0.0, len(plan.methods), ticks=names, hidden=not first),
                title=titles[column],
                curves=(_whisker([*simulated.values()], rows, "model", upright=False),),
                clouds=(
                    _mark([*simulated.values()], rows, "model", "simulated" if first else ""),
                    Cloud(
                        paper,
                        np.array([places[m] for m in printed]),
                        "effect",
                        "paper" if first else "",
                        "ring",
                        6.0,
                    ),
                ),
                stacked=True,
            )
        )
    words = "How much each method leaves, median and quartiles: the paper and the twin"
    return _finish(panels, 62.0 + 26.0 * len(plan.methods) + 46.0, words, "ranking")


def _mark(
    spreads: Sequence[Spread], rows: Array, ink: str, name: str, mark: str = "circle"
) -> Cloud:
    """Return the medians as marks, one a row."""
    return Cloud(np.array([s.median for s in spreads]), rows, ink, name, mark, 4.5)


def _whisker(spreads: Sequence[Spread], places: Array, ink: str, *, upright: bool) -> Curve:
    """Return a line from quartile to quartile at each place."""
    ends = np.array([(s.low, s.high, np.nan) for s in spreads]).ravel()
    along = np.repeat(places, 3)
    return Curve(along, ends, ink) if upright else Curve(ends, along, ink)


def draw_spans(spans: Spans) -> Picture:
    """Return the error against the window's length, with the time constants marked."""
    lengths = np.array([max(length, 1.0) for length in spans.lengths_s])
    curves = []
    for number, (test, spreads) in enumerate(spans.errors.items()):
        ink, dash, mark = _look(number)
        medians = np.array([s.median for s in spreads])
        curves.append(Curve(lengths, medians, ink, test, dash, mark=mark))
        curves.append(_whisker(spreads, lengths, ink, upright=True))
    ticks = tuple((x, "one sample" if x == 1.0 else f"{x:g}") for x in lengths.tolist())
    title = "length of the window, s (dotted: lags found in the logs)"
    levels = tuple(Level(tau, upright=True) for tau in spans.time_constants_s)
    panel = _open_log(curves, "error / noise floor", title, levels, ticks)
    words = "Ten samples over how long a time, MLP trained in the chamber"
    return _finish([panel], 380.0, words, "window_span")


def _open_log(
    curves: Sequence[Curve],
    title: str,
    below: str,
    levels: tuple[Level, ...] = (),
    ticks: tuple[tuple[float, str], ...] | None = None,
) -> Panel:
    """Return a panel of lines on two logarithmic axes."""
    x = np.concatenate([c.x for c in curves])
    y = np.concatenate([c.y[np.isfinite(c.y)] for c in curves])
    return Panel(
        left=LEFT,
        top=44.0,
        width=WIDTH - LEFT - RIGHT,
        height=290.0,
        x=AxisScale(0.8 * float(x.min()), 1.2 * float(x.max()), below, log=True, ticks=ticks),
        y=AxisScale(0.8 * float(y.min()), 1.2 * float(y.max()), log=True),
        title=f"{title} (simulated)",
        curves=tuple(curves),
        levels=levels,
        stacked=True,
    )


def draw_training(training: Training) -> Picture:
    """Return the errors along the recipe, and those of the quick schedule."""
    curves = []
    for number, (method, course) in enumerate(training.courses.items()):
        ink, dash, mark = _look(number)
        title = METHODS[method].title
        seconds, errors = np.array([(at, error) for _, at, error in course]).T
        curves.append(Curve(seconds, errors, ink, f"{title}, recipe", dash, mark=mark))
        at, error = training.quick[method]
        name = f"{title}, one cycle"
        curves.append(Curve(np.array([at]), np.array([error]), ink, name, width=0.0, mark="ring"))
    panel = _open_log(curves, "held-out chamber error, % of the drift", "CPU seconds of training")
    words = f"The same ten samples: {training.epochs} epochs of the recipe, and one cycle"
    return _finish([panel], 380.0, words, "training")


def draw_heat(heat: Heat) -> Picture:
    """Return the errors test by test: a row per training logs, a colour and mark per method."""
    methods = list(dict.fromkeys(method for method, _ in heat.errors))
    rows = list(dict.fromkeys(logs for _, logs in heat.errors))
    tests = list(next(iter(heat.errors.values())))
    names = tuple((float(len(rows) - 1 - k), logs) for k, logs in enumerate(rows))
    place = {logs: at for at, logs in names}
    left = LETTER * max(map(len, rows)) + 12.0
    each, panels = (WIDTH - left) / len(tests), []
    for column, test in enumerate(tests):
        curves, clouds = [], []
        for number, method in enumerate(methods):
            own: Mapping[str, Mapping[str, Spread]] = {
                logs: errors for (m, logs), errors in heat.errors.items() if m == method
            }
            apart = 0.22 * (number - 0.5 * (len(methods) - 1))  # so that equal errors are both seen
            spreads = [errors[test] for errors in own.values()]
            at = np.array([place[logs] - apart for logs in own])
            ink, _, mark = _look(number)
            title = "" if column else METHODS[method].title
            curves.append(_whisker(spreads, at, ink, upright=False))
            clouds.append(_mark(spreads, at, ink, title, mark))
        ends = np.concatenate([c.x[np.isfinite(c.x)] for c in curves])
        panels.append(
            Panel(
                left=left + each * column,
                top=62.0,
                width=each - 18.0,
                height=62.0 * len(rows),
                x=AxisScale(0.8 * ends.min(), 1.2 * ends.max(), "error / noise floor", log=True),
                y=AxisScale(-0.5, len(rows) - 0.5, ticks=names, hidden=column > 0),
                title="plates of the walk" if test == "walking_still" else test,
                curves=tuple(curves),
                clouds=tuple(clouds),
                levels=(Level(1.0, upright=True),),
                stacked=True,
            )
        )
    words = "By what they learnt from: errors in the chamber and in heat from one side"
    return _finish(panels, 62.0 + 62.0 * len(rows) + 46.0, words, "one_sided_heat")
