"""The chart of one run: what part of it is shown, and what went on there."""

from collections.abc import Mapping
from dataclasses import replace

from dash import no_update

from zerodrift.base.records import from_json, to_dict
from zerodrift.report import tables
from zerodrift.report.figures_runs import Window, choose_clock, draw_run, find_rows
from zerodrift.report.findings import Findings, Trace
from zerodrift.report.thin import pick_spread
from zerodrift.workbench import panels
from zerodrift.workbench.state import Chart, Drawn, RunPart, View
from zerodrift.workbench.views import Shown, choose_first
from zerodrift.workbench.workplace import Workplace

MOST_ROWS = 100
"""Rows of the table beside the chart."""
MOVES = ("earlier", "later", "closer", "wider", "whole")
"""Buttons that move the part that is shown, for those who use no mouse."""
CLOSER = 0.5
STEP = 0.5
"""Of the width that is shown, for one press of earlier or later."""
MOST_PRESSES = 50
"""Presses of one button that are answered at once; no run is longer than that."""


def draw_main(
    place: Workplace,
    view: Mapping[str, object] | None,
    presses: Mapping[str, int | None],
    moved: Mapping[str, object] | None,
    drawn: Mapping[str, object] | None,
) -> Shown:
    """Return the chart of one run, refined to the part that is shown, and what went on there.

    A request may be answered by a later one of the same chart, and two may be made as one. So what
    is asked for is told from what was drawn last, and not from what changed last.

    Args:
        place: the project.
        view: a `View` as the page's script writes it; None where it has told nothing yet.
        presses: how often each of `MOVES` was pressed.
        moved: what the chart tells of a zoom.
        drawn: a `Drawn` as it was returned last: what is drawn now.
    """
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 4)
    chosen = View(*choose_first(findings)) if view is None else from_json(View, view)
    output, run, ghost, part = chosen.output, chosen.run, chosen.ghost, chosen.part
    runs = [trace.run for trace in findings.traces]
    if output is None or output not in findings.outputs or run is None or run not in runs:
        return tuple([no_update] * 4)
    trace = findings.find_trace(run)
    k = findings.outputs.index(output)
    curve = place.preview(ghost, run) if ghost else None
    wanted = Drawn(
        chart=Chart(place.shown, output, run, ghost if curve is not None else None),
        part=part.number if part else 0,
        presses={name: presses.get(name) or 0 for name in MOVES},
        moved=moved,
    )
    last = None if drawn is None else from_json(Drawn, drawn)
    is_same_but_moved = last is not None and replace(wanted, moved=last.moved) == last
    if is_same_but_moved and (wanted == last or read_zoom(trace, moved or {}) is None):
        return tuple([no_update] * 4)
    window = choose_window(trace, part, wanted, last)
    figure = draw_run(
        trace,
        findings.comparison,
        output,
        window,
        ghost=None if curve is None else curve[k],
        ghost_name=ghost or "",
    )
    return (
        figure,
        panels.show_segments(findings, run, output),
        panels.show_table(tabulate_part(findings, k, window)),
        to_dict(replace(wanted, window=(window.from_s, window.to_s))),
    )


def choose_window(trace: Trace, part: RunPart | None, wanted: Drawn, drawn: Drawn | None) -> Window:
    """Return the part of a run to be shown: what was shown of it, and moved as was asked since.

    Args:
        trace: the run.
        part: the worst segment that was asked for last.
        wanted: what is to be drawn.
        drawn: what was drawn last.
    """
    is_new = wanted.part != (drawn.part if drawn else 0)
    if part is not None and is_new and (part.run, part.output) == (trace.run, wanted.chart.output):
        return Window(trace.run, part.from_s, part.to_s)
    if drawn is None or drawn.chart.run != trace.run:
        return Window(trace.run)
    window = Window(trace.run, *drawn.window)
    if wanted.moved != drawn.moved:
        window = read_zoom(trace, wanted.moved or {}) or window
    for move in MOVES:
        for _ in range(min(wanted.presses[move] - drawn.presses[move], MOST_PRESSES)):
            window = move_window(trace, window, move)
    return window


def read_zoom(trace: Trace, moved: Mapping[str, object]) -> Window | None:
    """Return the part that was zoomed to; None where nothing of the time axis changed."""
    both = moved.get("xaxis2.range")
    ends = both if isinstance(both, list) else [moved.get(f"xaxis2.range[{i}]") for i in (0, 1)]
    if ends[0] is not None and ends[1] is not None:
        clock = choose_clock(trace)
        return Window(trace.run, *sorted(clock.seconds * float(str(end)) for end in ends))
    return Window(trace.run) if moved.get("xaxis2.autorange") else None


def move_window(trace: Trace, window: Window, move: str) -> Window:
    """Return the part that is shown after a button was pressed, inside of the run.

    Args:
        trace: the run.
        window: what is shown.
        move: one of `MOVES`.
    """
    first, last = float(trace.time_s[0]), float(trace.time_s[-1])
    low = first if window.from_s is None else window.from_s
    high = last if window.to_s is None else window.to_s
    width, middle = high - low, 0.5 * (low + high)
    if move == "earlier":
        middle -= STEP * width
    elif move == "later":
        middle += STEP * width
    elif move == "closer":
        width = max(CLOSER * width, 4.0 * trace.sample_period_s)
    elif move == "wider":
        width /= CLOSER
    if move == "whole" or width >= last - first:
        return Window(trace.run)
    middle = min(max(middle, first + 0.5 * width), last - 0.5 * width)
    return Window(trace.run, middle - 0.5 * width, middle + 0.5 * width)


def tabulate_part(findings: Findings, k: int, window: Window) -> tables.Table:
    """Return rows of the part that is drawn, evenly spread, a hundred at most."""
    trace = findings.find_trace(window.run)
    start, stop = find_rows(trace, window)
    rows = start + pick_spread(stop - start, MOST_ROWS)
    cells = tuple(
        tuple(
            tables.write_number(float(value), 6)
            for value in (
                trace.time_s[row],
                trace.temperature_degC[row],
                trace.drift[k, row],
                trace.drift[k, row] - trace.error[k, row],
                trace.error[k, row],
            )
        )
        for row in rows
    )
    unit = findings.units[k]
    headings = (
        *("time, s", "temperature, degC", f"drift as measured, {unit}"),
        *(f"model, {unit}", f"what is left, {unit}"),
    )
    note = "Samples, evenly spread over the part that is shown; zoom for more."
    return tables.Table("Samples", headings, cells, texts=0, note=note)
