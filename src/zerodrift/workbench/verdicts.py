"""The parts of the page that tell the verdict: what is missing, why, and why not the others."""

import json
from collections.abc import Sequence

from dash import html
from dash.development.base_component import Component

from zerodrift.diagnosis.diagnosis import CandidateReport
from zerodrift.diagnosis.explained import DETAIL, ExplainedDiagnosis
from zerodrift.diagnosis.strength import WEAK, rate_strength
from zerodrift.report import tables
from zerodrift.report.findings import Findings
from zerodrift.report.pictures import draw_ranking
from zerodrift.report.report import list_notes
from zerodrift.report.verdict import explain_candidate, write_headline
from zerodrift.workbench.panels import show_picture, show_table

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
