"""The cause picture of the page: what it shows of which run, and what can be chosen."""

from dataclasses import replace

from zerodrift.base.errors import InputError
from zerodrift.diagnosis.drivers import LAG, TAU_S, TEMPERATURE, read_driver
from zerodrift.report import cause, tables
from zerodrift.report.findings import Findings, Trace
from zerodrift.report.svg import Picture, render_svg
from zerodrift.report.window import Window, choose_clock, find_rows, pick_spread
from zerodrift.workbench.first_look import HEADING, NARROWEST, WIDEST
from zerodrift.workbench.state import DrawnPicture, PageChoice, PictureWish, Sheet
from zerodrift.workbench.workplace import Workplace

MOST_ROWS = 100
"""Rows of the table beside the chart."""
MOVES = ("earlier", "later", "closer", "wider", "whole")
"""Buttons that move the part that is shown, for those who use no mouse."""
CLOSER = 0.5
STEP = 0.5
"""Of the width that is shown, for one press of earlier or later."""


def draw_wish(place: Workplace, wish: PictureWish, *, hides: bool) -> DrawnPicture:
    """Return the picture that was asked for.

    Args:
        place: the project.
        wish: what is chosen.
        hides: whether the verdict waits for a guess, so that nothing is drawn that tells it.

    Raises:
        InputError: nothing was found yet.
    """
    findings = place.findings
    if findings is None:
        raise InputError("nothing was found yet; the page draws as soon as the errors are known.")
    output, run = choose_first(findings)
    if wish.output in findings.outputs and wish.output is not None:
        output = wish.output
    if wish.run in [trace.run for trace in findings.traces] and wish.run is not None:
        run = wish.run
    trace = findings.find_trace(run)
    named = "" if hides else cause.name_effect(findings)
    effect = named if wish.effect is None else wish.effect
    curve = place.preview(effect, run) if effect and not hides else None
    channels = cause.list_channels(findings)
    suspects = cause.find_suspects(findings, effect, output) if not hides else ()
    against = read_driver(wish.against) or cause.choose_against(suspects)
    if against.channel not in channels:
        against = cause.choose_against(suspects)
    width = min(max(wish.width, NARROWEST), WIDEST)
    view = cause.CauseView(
        trace=trace,
        output=output,
        window=choose_window(trace, wish),
        panes=wish.panes or cause.choose_panes(suspects, channels, fills=True),
        against=against,
        effect=effect if curve is not None else "",
        contribution=None if curve is None else curve[findings.outputs.index(output)],
        width=width,
        heading=HEADING,
    )
    picture = cause.draw_cause(
        view, findings.comparison, channels, lambda driver: place.read(trace, driver)
    )
    tau_s = next((d.tau_s for d in suspects if d.form == LAG), TAU_S)
    choices = cause.list_choices(channels, tau_s, view.effect)
    clock = choose_clock(trace)
    table = tabulate_part(findings, findings.outputs.index(output), view.window)
    return DrawnPicture(
        shown=place.shown,
        svg=render_svg(picture.picture),
        # The script has the text; the parts that it was made of would only be sent twice.
        cause=replace(picture, picture=Picture(width, picture.picture.height, (), "")),
        output=output,
        run=run,
        effect=view.effect,
        panes=tuple(PageChoice(key, words) for key, words in choices),
        drivers=tuple(
            PageChoice(key, words) for key, words in choices if read_driver(key) is not None
        ),
        against=against.key,
        is_whole=view.window.from_s is None,
        seconds=clock.seconds,
        clock=clock.unit,
        from_s=clock.from_s,
        sheet=Sheet(table.headings, table.rows, table.texts),
    )


def choose_first(findings: Findings) -> tuple[str, str]:
    """Return the output and the run that are shown at first: those of the worst segment."""
    worst = findings.comparison.worst
    if worst:
        return worst[0].output, worst[0].run
    return findings.outputs[0], findings.traces[0].run


def choose_window(trace: Trace, wish: PictureWish) -> Window:
    """Return the part of a run to be shown: what was shown of it, moved as was asked."""
    window = Window(trace.run)
    first, last = float(trace.time_s[0]), float(trace.time_s[-1])
    if wish.from_s is not None and wish.to_s is not None:
        low, high = sorted((wish.from_s, wish.to_s))
        low, high = max(low, first), min(high, last)
        if high - low >= 2.0 * trace.sample_period_s and (low > first or high < last):
            window = Window(trace.run, low, high)
    return move_window(trace, window, wish.move) if wish.move in MOVES else window


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
        *("time, s", f"{TEMPERATURE}, degC", f"drift as measured, {unit}"),
        *(f"model, {unit}", f"what is left, {unit}"),
    )
    note = "Samples, evenly spread over the part that is shown; zoom for more."
    return tables.Table("Samples", headings, cells, texts=0, note=note)
