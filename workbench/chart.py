"""The chart of one run: what part of it is shown, and what went on there."""

from typing import Any

from dash import ctx, no_update

from zerodrift.report import tables
from zerodrift.report.figures_runs import Window, choose_clock, draw_run, find_rows
from zerodrift.report.findings import Findings, Trace
from zerodrift.report.thin import pick_spread
from zerodrift.workbench import panels
from zerodrift.workbench.workplace import Workplace

MOST_ROWS = 100
"""Rows of the table beside the chart."""
MOVES = ("earlier", "later", "closer", "wider", "whole")
"""Buttons that move the part that is shown, for those who use no mouse."""
CLOSER = 0.5
STEP = 0.5
"""Of the width that is shown, for one press of earlier or later."""


def draw_main(
    place: Workplace,
    output: str | None,
    run: str | None,
    ghost: str | None,
    goto: dict[str, Any] | None,
    moved: dict[str, Any] | None,
    drawn: list[Any] | None,
) -> tuple[Any, ...]:
    """Return the chart of one run, refined to the part that is shown, and what went on there.

    Args:
        place: the project.
        output: chosen.
        run: chosen.
        ghost: effect to draw over what is left.
        goto: the segment that was asked for last.
        moved: what the chart tells of a zoom.
        drawn: what is drawn now: what of, from when to when, and the zoom that was answered.
    """
    findings = place.findings
    names = [trace.run for trace in findings.traces] if findings is not None else []
    if findings is None or output not in findings.outputs or run not in names:
        return tuple([no_update] * 4)
    trace = findings.find_trace(run)
    wanted = [place.shown, output, run, ghost]
    causes = {told["prop_id"].partition(".")[0] for told in ctx.triggered}
    window = Window(run)
    if drawn and drawn[2] == run:
        window = Window(run, *drawn[4])
    if "goto" in causes and goto is not None and (goto["run"], goto["output"]) == (run, output):
        window = Window(run, goto["from_s"], goto["to_s"])
    elif drawn and drawn[:4] == wanted:
        # A request may be answered by a later one of the same chart, so what was answered is
        # looked at, and not what changed last.
        moves = causes & set(MOVES)
        found = read_zoom(trace, moved) if moved and moved != drawn[5] else None
        if moves:
            window = move_window(trace, window, moves.pop())
        elif found is not None:
            window = found
        else:
            return tuple([no_update] * 4)
    k = findings.outputs.index(output)
    curve = place.preview(ghost, run) if ghost else None
    figure = draw_run(
        trace,
        findings.told["compare"],
        output,
        window,
        ghost=None if curve is None else curve[k],
        ghost_name=ghost or "",
    )
    return (
        figure,
        panels.show_segments(findings, run, output),
        panels.show_table(tabulate_part(findings, k, window)),
        [*wanted, [window.from_s, window.to_s], moved],
    )


def read_zoom(trace: Trace, moved: dict[str, Any]) -> Window | None:
    """Return the part that was zoomed to; None where nothing of the time axis changed."""
    ends = moved.get("xaxis2.range") or [moved.get(f"xaxis2.range[{i}]") for i in (0, 1)]
    if ends[0] is not None and ends[1] is not None:
        clock = choose_clock(trace)
        return Window(trace.run, *sorted(clock.seconds * float(end) for end in ends))
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


def go_to_segment(place: Workplace) -> tuple[Any, ...]:
    """Return output, run and part of the worst segment whose button was pressed."""
    findings = place.findings
    if findings is None or not ctx.triggered or not ctx.triggered[0]["value"]:
        return tuple([no_update] * 3)
    worst = findings.told["compare"]["worst"]
    number = int(ctx.triggered_id["number"])
    if number > len(worst):
        return tuple([no_update] * 3)
    segment = worst[number - 1]
    beside = segment["to_s"] - segment["from_s"]
    time_s = findings.find_trace(segment["run"]).time_s
    goto = {
        "run": segment["run"],
        "output": segment["output"],
        "from_s": max(segment["from_s"] - beside, float(time_s[0])),
        "to_s": min(segment["to_s"] + beside, float(time_s[-1])),
    }
    return segment["output"], segment["run"], goto


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
