"""The parts of the page, built from what the commands found; nothing is computed here."""

import json
from collections.abc import Sequence

from dash import html
from dash.development.base_component import Component

from zerodrift.base.records import to_dict
from zerodrift.dataset.units import tell_time, write_time
from zerodrift.diagnosis.diagnosis import (
    DETAIL,
    WEAK,
    CandidateReport,
    ExplainedDiagnosis,
    rate_strength,
)
from zerodrift.diagnosis.held_out import TEST_LOGS
from zerodrift.diagnosis.history import Step, find_timeline
from zerodrift.diagnosis.run_spread import measure_spread
from zerodrift.diagnosis.summary import WorstSegment
from zerodrift.report import tables
from zerodrift.report.findings import Findings
from zerodrift.report.pictures import draw_change, draw_ranking, draw_stairs
from zerodrift.report.report import list_notes, list_tiles
from zerodrift.report.results import (
    AddResult,
    RemoveResult,
    is_done,
)
from zerodrift.report.sentences import explain_candidate, write_headline
from zerodrift.report.svg import Picture, render_svg
from zerodrift.report.tables import Table
from zerodrift.workbench.early import READING, TILES
from zerodrift.workbench.state import RunPart


def show_table(table: Table, *, folded: bool = False) -> Component:
    """Return a table; `folded` behind its title.

    Its cells are one attribute, from which the page's script makes the rows: as components of their
    own they would take the page longer than all of its charts.
    """
    cells = {"head": table.headings, "rows": table.rows, "texts": table.texts}
    told = json.dumps(cells, ensure_ascii=False)
    grid = html.Div(className="scroll", tabIndex="0", **{"data-table": told})
    inner = [grid, html.P(table.note, className="note")] if table.note else [grid]
    if folded:
        return html.Details([html.Summary(table.title), *inner])
    return html.Div([html.H3(table.title), *inner], className="table")


def show_picture(picture: Picture) -> Component:
    """Return a picture; it is one attribute, which the page's script puts in as it is."""
    return html.Figure(className="picture", **{"data-picture": render_svg(picture)})


def show_tiles(findings: Findings) -> list[Component]:
    """Return the few figures that come first."""
    return [
        html.Div([html.B(value), html.Span(what)], className="tile")
        for value, what in list_tiles(findings)
    ]


def show_segments(findings: Findings, *, hides: bool = False) -> list[Component]:
    """Return the worst segments as a list, each with a link to its place.

    Args:
        findings: what was found.
        hides: whether a guess is asked for first, so that no pattern is told.
    """
    compared = findings.comparison
    legend = (
        "Dotted lines: ± noise floor. Drag over a stretch to mark it everywhere; double-click for "
        "the whole run."
    )
    if not compared.worst:
        return [html.P(f"No segment stands out of the noise. {legend}", className="note")]
    items = []
    for number, segment in enumerate(compared.worst, 1):
        unit = compared.outputs[segment.output].unit
        words = (
            f"{number}. {segment.run}, {segment.output}, {write_time(segment.from_s)} to "
            f"{tell_time(segment.to_s)}"
        )
        part = to_dict(find_part(findings, segment))
        items.append(
            html.Li(
                [
                    html.Button(words, **{"data-choose": json.dumps(part)}),
                    f" {'' if hides else f'{segment.pattern}, '}RMSE {segment.rmse:.3g} {unit}",
                ]
            )
        )
    return [
        html.P(f"The worst segments, with what was going on. {legend}", className="note"),
        html.Ul(items, className="segments"),
    ]


def find_part(findings: Findings, segment: WorstSegment) -> RunPart:
    """Return the part of a run to be shown of a worst segment: it, and as much on either side.

    Args:
        findings: what was found.
        segment: one of the worst, as `compare` tells it.
    """
    beside = segment.to_s - segment.from_s
    time_s = findings.find_trace(segment.run).time_s
    return RunPart(
        output=segment.output,
        run=segment.run,
        from_s=max(segment.from_s - beside, float(time_s[0])),
        to_s=min(segment.to_s + beside, float(time_s[-1])),
        mark_from_s=segment.from_s,
        mark_to_s=segment.to_s,
    )


def show_revision(revision: AddResult | RemoveResult) -> list[Component]:
    """Return what the last `add` or `remove` found: errors before and after, per output."""
    before, after = revision.before.rmse_heldout, revision.after.rmse_heldout
    floor = revision.noise_floor
    rows = tuple(
        (
            name,
            revision.units[name],
            tables.write_number(before[name]),
            tables.write_number(after[name]),
            f"{after[name] / before[name]:.3f}" if before[name] > 0.0 else "–",
            tables.write_number(floor[name]),
            f"{after[name] / floor[name]:.2f}" if floor[name] > 0.0 else "–",
        )
        for name in after
    )
    verb = "Removed" if isinstance(revision, RemoveResult) else "Added"
    title = f"{verb} {revision.effect}" if is_done(revision) else f"{revision.effect} was not added"
    headings = ("output", "unit", "before", "after", "after/before", "noise floor", "× floor")
    values = ", ".join(
        f"{name} = {p.value:.4g} {'' if p.unit == '1' else p.unit}".rstrip()
        + (f" ± {p.std_error:.2g}" if p.std_error is not None else "")
        for name, p in revision.parameters.items()
    )
    reason = revision.reason
    parts = [html.H2(title), html.P(f"{reason[0].upper()}{reason[1:]}.")]
    if values:
        parts.append(html.P(f"Fitted: {values}.", className="note"))
    beside = [said for said in (revision.explain_test(), revision.explain_offsets()) if said]
    parts += [html.P(f"{said[0].upper()}{said[1:]}.", className="note") for said in beside]
    if any(level > 0.0 for level in floor.values()):
        parts.append(show_picture(draw_change(before, after, floor)))
    table = Table(f"Held-out RMSE ({revision.held_out})", headings, rows, texts=2)
    return [*parts, show_table(table)]


def show_staircase(findings: Findings) -> list[Component]:
    """Return the staircase of errors, once there is a step; each step can be gone back to."""
    steps = findings.steps
    if not steps:
        return [html.P("No step yet: adding an effect makes the first.", className="note")]
    current = find_timeline(steps).current
    items = []
    for number, step in enumerate(steps):
        is_now = number == current
        is_kept = bool(step.settings) or not step.effects
        back = html.Button(
            "Go back to this",
            disabled=is_now or not is_kept,
            **{"data-press": "restore", "data-step": str(number)},
        )
        items.append(
            html.Li(
                [
                    html.B(f"{number} {step.label}"),
                    " (the model now) " if is_now else " ",
                    html.Span(_tell_step(step)),
                    " " if is_now else back,
                    html.Span(f" {step.reason}." if step.reason else "", className="note"),
                ],
                className="now" if is_now else "",
            )
        )
    return [
        show_picture(draw_stairs(steps)),
        html.Ol(items, className="timeline"),
        show_table(tables.tabulate_steps(steps), folded=True),
    ]


def _tell_step(step: Step) -> str:
    """Return a step's errors with their floors, and on which runs they are told."""
    where = "test logs" if step.held_out == TEST_LOGS else "runs left out"
    errors = ", ".join(
        f"{name} {tables.write_number(error)} {step.units.get(name, '')} (floor "
        f"{tables.write_number(step.noise_floor.get(name))})"
        for name, error in step.errors.items()
    )
    return f"RMSE on {where}: {errors}."


def show_errors(findings: Findings, *, hides: bool = False) -> list[Component]:
    """Return the errors per output and run, and where the model fails."""
    compared = findings.comparison
    parts: list[Component] = [html.P(s, className="note") for s in findings.comparison_sentences]
    parts.append(show_table(tables.tabulate_errors(compared, measure_spread(compared))))
    parts.append(show_table(tables.tabulate_runs(compared), folded=True))
    if hides:
        return parts
    parts.append(html.H3("Where the model fails"))
    parts += [html.P(s) for s in findings.patterns] or [
        html.P("No pattern was found that holds on runs left out.")
    ]
    if compared.worst:
        parts.append(show_table(tables.tabulate_worst(compared)))
    return parts


def show_model(findings: Findings) -> list[Component]:
    """Return the effects in the model with their parameters."""
    model = findings.model
    return [
        show_table(tables.tabulate_parameters(model)),
        show_table(tables.tabulate_coefficients(model), folded=True),
    ]


def show_unknown(name: str, facts: Sequence[str]) -> list[Component]:
    """Return the page of a project of which nothing could be found out.

    Args:
        name: of its directory.
        facts: what is known without reading a log.
    """
    words = (
        "Nothing could be found out yet; the message above says why. The page looks again as "
        "soon as zerodrift.toml or a log changes."
    )
    return [
        html.H2(name, className="first"),
        html.P(words),
        html.Ul([html.Li(fact) for fact in facts]),
    ]


def show_reading(facts: Sequence[str]) -> list[Component]:
    """Return what stands in the verdict's place while the logs are read."""
    told = [html.P(fact, className="note") for fact in facts]
    return [html.P(READING, className="sentence", role="status"), *told]


def show_empty_tiles() -> list[Component]:
    """Return the places of the few figures that come first."""
    return [html.Div([html.B("…"), html.Span("")], className="tile") for _ in range(TILES)]


def show_start(logs: Sequence[str], directory: str) -> list[Component]:
    """Return the page of a directory without a project."""
    return [
        html.H2("A new project", className="first"),
        html.P(
            [
                "There is no zerodrift.toml in ",
                html.Code(directory),
                " yet. Give it logs, CSV or Parquet, one run to a file; the columns are guessed "
                "from their headers.",
            ]
        ),
        html.Div(
            [
                html.P("Drop logs here, or choose them"),
                html.Button("Choose files …", id="choose", className="upload"),
            ],
            id="drop",
            className="drop",
        ),
        html.P("Logs in the directory: " + (", ".join(logs) or "none yet") + ".", id="logs-there"),
        html.Button(
            "Guess columns and begin",
            id="begin",
            className="primary",
            disabled=not logs,
            **{"data-press": "begin"},
        ),
        html.H2("Or practise"),
        html.P(
            "Simulated logs of a six-axis sensor with one hidden effect are written into this "
            "directory: guess what is hidden, then let the page tell you."
        ),
        html.Button(
            "Write simulated logs with something hidden",
            id="practise",
            **{"data-press": "practise"},
        ),
    ]


# The parts of the page that tell the verdict: what is missing, why, and why not the others.

MOST_WRONG = 6
"""Notes of wrong data that stand below the verdict; all of them are among what it rests on."""
MOST_CARDS = 4
"""Candidates that are told in full; the table has all."""


def show_verdict(
    findings: Findings, *, diagnosing: bool, hides: bool
) -> tuple[str, list[Component]]:
    """Return the verdict card's class and content.

    Args:
        findings: what was found.
        diagnosing: whether the verdict is still being found.
        hides: whether a guess is asked for first.
    """
    explained = findings.diagnosed
    if hides:
        text = "Something may be hidden in these simulated logs. Guess first, then let it tell you."
        return "verdict none", [html.P(text, className="sentence")]
    if explained is None and diagnosing:
        return "verdict none", [html.P("Diagnosing …", className="sentence")]
    headline = write_headline(explained.diagnosis if explained else None, findings.titles)
    strength = rate_strength(explained.diagnosis) if explained else None
    is_weak = strength is not None and strength.level == WEAK
    label = f"{headline.label}, on weak evidence" if is_weak else headline.label
    parts: list[Component] = [
        html.P(label, className="kicker"),
        html.P(headline.sentence, className="sentence", id="verdict-sentence"),
    ]
    wrong = [note for note in findings.reviewed if note.stops]
    parts += [html.P(f"{note.write()}.", className="wrong") for note in wrong[:MOST_WRONG]]
    sentences = explained.sentences if explained else ()
    notes = [html.P(s.text, className="note") for s in sentences if s.role == DETAIL]
    notes += [html.P(f"Note: {note}", className="note") for note in list_notes(findings)]
    if notes:
        parts.append(
            html.Details([html.Summary("What it rests on, and what to record next"), *notes])
        )
    kind = f"verdict {headline.kind.replace(' ', '-')}"
    return f"{kind} weak" if is_weak else kind, parts


def make_add(effect: str) -> Component:
    """Return a button that adds an effect; what the page proposes is at the way's next step."""
    return html.Button(f"Add {effect}", **{"data-press": "add", "data-effect": effect})


def show_candidates(findings: Findings, previews: Sequence[str]) -> list[Component]:
    """Return the ranking of what could be missing: the first in full, then all of them.

    Args:
        findings: what was found.
        previews: effects that can be drawn over what is left.
    """
    explained = findings.diagnosed
    if explained is None:
        return [html.P("Not diagnosed yet.", className="note")]
    diagnosis = explained.diagnosis
    cards = [
        _show_candidate(findings, explained, candidate, previews)
        for candidate in diagnosis.candidates[:MOST_CARDS]
    ]
    parts: list[Component] = [html.Ol(cards, className="ranking")] if cards else []
    if diagnosis.candidates:
        parts.append(show_picture(draw_ranking(diagnosis)))
        words = "Full bars: named by the verdict; hatched: not named. Shorter is better."
        parts.append(html.P(words, className="note"))
    table = tables.tabulate_candidates(diagnosis, findings.titles)
    parts.append(show_table(table, folded=True))
    if diagnosis.verdict == "complete":
        words = "None of them helps: why not, one by one"
        return [html.Details([html.Summary(words), *parts])]
    return parts


def _show_candidate(
    findings: Findings,
    explained: ExplainedDiagnosis,
    candidate: CandidateReport,
    previews: Sequence[str],
) -> Component:
    """Return one candidate: why or why not, its equation, and what can be done with it."""
    kind, is_named = candidate.effect, candidate.effect in explained.named
    effect = findings.catalogue.get(kind)
    units = {parameter.name: parameter.unit for parameter in effect.parameters} if effect else {}
    fitted = ", ".join(
        f"{name} {value:.4g} {units.get(name, '').removeprefix('1')}".rstrip()
        for name, value in candidate.parameters.items()
    )
    buttons = [make_add(kind)]
    if kind in previews:
        draw = html.Button(
            "Draw it over what is left",
            className="draw",
            **{"data-choose": json.dumps({"ghost": kind})},
        )
        buttons.insert(0, draw)
    return html.Li(
        [
            html.H3([html.Code(kind), " ", effect.title if effect else ""]),
            html.P(
                explain_candidate(explained.diagnosis, candidate),
                className="standing" if is_named else "",
            ),
            html.P(
                [
                    f"Fitted: {fitted}. " if fitted else "",
                    f"{100.0 * candidate.excitation:.0f} % of it cannot be imitated by the "
                    "effects in the model.",
                ],
                className="note",
            ),
            html.P(html.Code(effect.equation if effect else "")),
            html.P(f"Looks like: {effect.fingerprint if effect else ''}", className="note"),
            html.Div(buttons, className="actions"),
        ],
        className="named" if is_named else "",
    )


def show_effect(findings: Findings, kind: str) -> list[Component]:
    """Return what the catalogue says about an effect, and its standing in the diagnosis."""
    effect = findings.catalogue.get(kind)
    if effect is None:
        return []
    diagnosis = findings.diagnosed.diagnosis if findings.diagnosed is not None else None
    parts: list[Component] = [
        html.P([html.B(effect.title), ". ", effect.physics]),
        html.P(html.Code(effect.equation)),
        html.P(["Looks like: ", effect.fingerprint], className="note"),
        html.P(["To provoke it: ", effect.provoke], className="note"),
        html.P(["Cure in hardware: ", effect.cure], className="note"),
    ]
    for candidate in diagnosis.candidates if diagnosis else ():
        if diagnosis is not None and candidate.effect == kind:
            words = explain_candidate(diagnosis, candidate)
            parts.insert(0, html.P(words, className="standing"))
    for untested in diagnosis.not_testable if diagnosis else ():
        if untested.effect == kind:
            why = f"Here: not testable with these logs: {untested.why}."
            parts.insert(0, html.P(why, className="standing"))
    return parts
