"""Recordings that run beside the page: how far each one is, and what to do after it.

What is shown comes from the files in which recorders tell of themselves (recording/status.py).
"""

import time
from collections.abc import Sequence

from dash import html
from dash.development.base_component import Component

from zerodrift.dataset.units import write_duration
from zerodrift.recording.coverage import Covered, CoveredRange, RecordedColumn
from zerodrift.recording.status import CUT_OFF, ENDED, LIVE, STUCK, explain_missing
from zerodrift.report.tables import Table
from zerodrift.workbench.panels import show_table
from zerodrift.workbench.path import Offer
from zerodrift.workbench.watch import WatchedRecording

COMPARE, USE, RECOVER, DISMISS = "compare-log", "use-log", "recover-log", "dismiss-log"
TITLES = {LIVE: "Recording", STUCK: "Recording", CUT_OFF: "Cut off", ENDED: "Recorded"}
MOST_COLUMNS = 24
"""More are left to the terminal."""


def show_recordings(recordings: Sequence[WatchedRecording]) -> list[Component]:
    """Return a card for each recording."""
    return [_show(one) for one in recordings]


def _show(one: WatchedRecording) -> Component:
    covered = one.status.covered
    parts: list[Component] = [
        html.H2([html.Span(className="dot"), f"{TITLES[one.state]}: {one.name}"]),
        html.P(_tell_size(one), className="standing"),
        html.P(one.status.source, className="note"),
    ]
    parts += [html.P(words, className="wrong") for words in _tell_trouble(one)]
    parts += _show_wanted(one)
    if covered.columns:
        parts.append(show_table(_tabulate(covered)))
    parts += _show_next(one)
    kind = {LIVE: "live", STUCK: "stuck", CUT_OFF: "stuck"}.get(one.state, "ended")
    return html.Section(parts, className=f"card recording {kind}")


def _tell_size(one: WatchedRecording) -> str:
    covered = one.status.covered
    parts = [f"{covered.rows:,} rows", write_duration(covered.seconds)]
    for word, rate in (
        ("heated by up to", covered.heating_K_per_min),
        ("cooled by up to", covered.cooling_K_per_min),
    ):
        if rate is not None:
            parts.append(f"{word} {rate:.3g} K/min")
    return ", ".join(parts)


def _tell_trouble(one: WatchedRecording) -> list[str]:
    told = [f"{one.status.silent}."] if one.status.silent and one.state == LIVE else []
    heard = time.strftime("%H:%M:%S", time.localtime(one.status.at_s))
    if one.state == STUCK:
        told.append(f"Its recorder has said nothing since {heard}; it may be suspended.")
    if one.state == CUT_OFF:
        told.append(
            f"Its recorder was heard of last at {heard}, and did not finish the file. The rows are "
            "kept beside it."
        )
    return told


def _show_wanted(one: WatchedRecording) -> list[Component]:
    covered, why = one.status.covered, one.status.why
    if not covered.wanted:
        return []
    bars = [
        html.Li(
            [
                html.Span(part.what, className="what"),
                html.Progress(
                    value=f"{part.share:.3f}",
                    max="1",
                    **{"aria-label": f"{part.what}, covered"},
                ),
                html.Span(_write_share(part), className="share"),
            ],
            className="enough" if part.enough else "",
        )
        for part in covered.wanted
    ]
    missing = explain_missing(covered)
    if covered.enough:
        told = f"All that {why} asks for is covered"
        told += "; Ctrl-C in its terminal ends it." if one.state == LIVE else "."
        words: list[Component] = [html.P(told, className="enough", role="status")]
    else:
        words = [html.P(f"Still to record, by {why}:"), html.Ul([html.Li(m) for m in missing])]
    return [html.Ul(bars, className="covered"), *words]


def _write_share(part: CoveredRange) -> str:
    if part.what == "time":
        return f"{write_duration(part.high)} of {write_duration(part.wanted_high)}"
    span = f"{part.wanted_low:g} to {part.wanted_high:g} {part.unit}".rstrip()
    return f"{100.0 * part.share:.0f} % of {span}"


def _tabulate(covered: Covered) -> Table:
    columns = covered.columns[:MOST_COLUMNS]
    more = len(covered.columns) - len(columns)
    return Table(
        "What came",
        ("column", "now", "lowest", "highest", "no reading"),
        tuple(_write_column(column) for column in columns),
        note=f"{more} further columns are recorded." if more else "",
    )


def _write_column(column: RecordedColumn) -> tuple[str, ...]:
    values = (column.last, column.low, column.high)
    told = ("–" if value is None else f"{value:.7g}" for value in values)
    return (column.name, *told, str(column.missing or ""))


def find_offers(one: WatchedRecording) -> tuple[Offer, ...]:
    """Return what can be done now, the one next step first; nothing while rows come."""
    dismiss = Offer(DISMISS, "Leave it as it is", one.file)
    if one.state == CUT_OFF:
        return Offer(RECOVER, "Finish its file", one.file), dismiss
    if one.state != ENDED:
        return ()
    if one.is_named:
        return Offer(COMPARE, "Compare with the new log", one.file), dismiss
    return Offer(USE, "Add it to the logs", one.file), dismiss


def _show_next(one: WatchedRecording) -> list[Component]:
    buttons = [
        html.Button(
            offer.words,
            className="" if number else "primary",
            **{"data-press": offer.button, "data-effect": offer.effect},
        )
        for number, offer in enumerate(find_offers(one))
    ]
    return [html.Div(buttons, className="actions")] if buttons else []
