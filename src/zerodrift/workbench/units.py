"""The units of the project's registry: what is on each, what `monitor` said last, its history.

Nothing is judged here: the words are those of `zerodrift registry` and `zerodrift monitor`.
"""

import json
from collections import Counter
from collections.abc import Sequence

from dash import html
from dash.development.base_component import Component

from zerodrift.field.registry import (
    HOW_TO_ENTER,
    NO_ALARM,
    Event,
    UnitFinding,
    UnitStanding,
)
from zerodrift.report.tables import Table
from zerodrift.workbench.panels import show_table
from zerodrift.workbench.watch import UnitsSeen

NO_REGISTRY = "There is no registry of units yet; `zerodrift registry init` makes one. "
NO_UNITS = "The registry has no units yet. "
MOST_ALARMS = 12
"""That are told in full; the table has the others too."""
LOG = "log"
HASH = 12
"""Digits of a hash that are shown, as in the terminal."""


def show_units(seen: UnitsSeen) -> list[Component]:
    """Return how many units there are, each alarm with its sentence, and all of them as a table."""
    if seen.wrong:
        return [html.P(seen.wrong, className="wrong")]
    standings = seen.standings
    if not standings:
        words = (NO_UNITS if seen.is_there else NO_REGISTRY) + HOW_TO_ENTER
        return [html.P(_mark_commands(words), className="note")]
    parts: list[Component] = [html.P(_count(standings), className="standing")]
    alarms = [one for one in standings if one.is_alarm]
    if alarms:
        cards = [_show_alarm(one) for one in alarms[:MOST_ALARMS]]
        parts.append(html.Ul(cards, className="alarms", **{"aria-label": "Units with an alarm"}))
    if len(alarms) > MOST_ALARMS:
        more = f"{len(alarms) - MOST_ALARMS} more have an alarm; the table names them."
        parts.append(html.P(more, className="note"))
    parts.append(show_table(_tabulate(standings)))
    return parts


def _mark_commands(words: str) -> list[Component | str]:
    """Return words in which what stands between backquotes is set as code."""
    pieces = words.split("`")
    return [html.Code(text) if number % 2 else text for number, text in enumerate(pieces)]


def _count(standings: Sequence[UnitStanding]) -> str:
    """Return how many units there are, and how many of each state."""
    number, alarms = len(standings), sum(one.is_alarm for one in standings)
    states = Counter(one.told for one in standings if not one.is_alarm)
    parts = [f"{alarms} with an alarm"] if alarms else []
    parts += [f"{count} {state}" for state, count in states.most_common()]
    return f"{number} unit{'s' if number != 1 else ''}: {', '.join(parts)}."


def _show_alarm(one: UnitStanding) -> Component:
    serial = one.unit.serial
    told = [
        html.P([html.B(f"{finding.output}, {finding.state}: "), finding.text])
        for finding in one.findings
        if finding.is_alarm
    ]
    words = f"Reported since {write_date(_find_since(one))}. Last log read: {_tell_watched(one)}."
    button = html.Button(f"History of {serial}", **{"data-unit": serial})
    return html.Li([html.H3(serial), *told, html.P(words, className="note"), button])


def _find_since(one: UnitStanding) -> str:
    """Return since when `monitor` has said of a unit what it says: its first alarm that stands."""
    alarms = [finding.since for finding in one.findings if finding.is_alarm]
    return min(alarms) if alarms else max((f.since for f in one.findings), default="")


def _tell_watched(one: UnitStanding) -> str:
    return f"{one.watched_log}, {write_date(one.watched_at)}" if one.watched_at else "none"


def _tabulate(standings: Sequence[UnitStanding]) -> Table:
    heads = (
        "serial",
        "monitor",
        "since",
        "last log read",
        "calibrated",
        "block",
        "loaded",
        "design",
    )
    ordered = sorted(standings, key=lambda one: not one.is_alarm)
    title = "All units, those with an alarm first; times are UTC"
    return Table(title, heads, tuple(_write_row(one) for one in ordered), texts=len(heads))


def _write_row(one: UnitStanding) -> tuple[str, ...]:
    unit = one.unit
    return (
        unit.serial,
        one.told,
        write_date(_find_since(one)),
        write_date(one.watched_at),
        write_date(unit.calibrated_at),
        unit.block[:HASH] or "–",
        write_date(one.loaded_at),
        unit.design,
    )


def list_serials(seen: UnitsSeen, sensor: str | None) -> str:
    """Return the units that can be chosen as the page's script reads it.

    Args:
        seen: the registry.
        sensor: the unit that the page is of, which is then chosen first.
    """
    serials = [one.unit.serial for one in seen.standings]
    alarms = [one.unit.serial for one in seen.standings if one.is_alarm]
    first = sensor if sensor in serials else (alarms or serials or [""])[0]
    return json.dumps({"choices": [(serial, serial) for serial in serials], "first": first})


def show_history(
    standing: UnitStanding | None, events: Sequence[Event], serial: str
) -> list[Component]:
    """Return a unit: what is on it, what `monitor` said last, what happened, and its logs by hash.

    Args:
        standing: of the unit; None where it is gone.
        events: of the unit, the oldest first.
        serial: of the unit.
    """
    if standing is None:
        return [html.P(f"There is no unit {serial} any more.", className="note")]
    findings = [_show_finding(finding) for finding in standing.findings]
    if not findings:
        findings = [html.Li([html.Code("zerodrift monitor"), " has said nothing of it yet."])]
    entered = [event for event in events if event.kind == LOG]
    happened = [event for event in events if event.kind != LOG]
    parts: list[Component] = [
        html.Ul(findings, className="said"),
        show_table(_tabulate_events(f"History of {serial}, the oldest first", happened)),
    ]
    if entered:
        title = f"Logs of {serial} by hash: {len(entered)}"
        parts.append(show_table(_tabulate_events(title, entered), folded=True))
    return parts


def _tabulate_events(title: str, events: Sequence[Event]) -> Table:
    rows = tuple((write_date(e.at, seconds=True), e.kind, e.text) for e in events)
    return Table(title, ("at (UTC)", "what", "in words"), rows, texts=3)


def _show_finding(finding: UnitFinding) -> Component:
    kind = finding.state if finding.state in NO_ALARM else "alarm"
    state = html.B(f"{finding.output}, {finding.state}: ")
    words = f" (since {write_date(finding.since)})"
    return html.Li([state, finding.text, words], className=kind.replace(" ", "-"))


def write_date(at: str, *, seconds: bool = False) -> str:
    """Return a moment of the registry for people; a dash where there is none.

    Args:
        at: ISO 8601, UTC.
        seconds: whether they are told.
    """
    return at[: 19 if seconds else 16].replace("T", " ") or "–"
