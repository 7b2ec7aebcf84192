"""The parts of the page that tell the verdict: what is missing, why, and why not the others."""

import json
from collections.abc import Sequence

from dash import html
from dash.development.base_component import Component

from zerodrift.diagnosis.diagnosis import CandidateReport
from zerodrift.diagnosis.explained import DETAIL, ExplainedDiagnosis
from zerodrift.report import tables
from zerodrift.report.figures import draw_candidates
from zerodrift.report.findings import Findings
from zerodrift.report.report import list_notes
from zerodrift.report.verdict import explain_candidate, write_headline
from zerodrift.workbench.panels import show_figure, show_table

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
    parts: list[Component] = [
        html.P(headline.label, className="kicker"),
        html.P(headline.sentence, className="sentence", id="verdict-sentence"),
    ]
    sentences = explained.sentences if explained else ()
    parts += [html.P(s.text, className="note") for s in sentences if s.role == DETAIL]
    parts += [html.P(f"Note: {note}", className="note") for note in list_notes(findings)]
    return f"verdict {headline.kind.replace(' ', '-')}", parts


def make_add(effect: str, *, words: str = "", primary: bool = False) -> Component:
    """Return a button that adds an effect.

    Args:
        effect: its kind.
        words: on it; left out, `Add EFFECT`.
        primary: whether it is what the page proposes.
    """
    return html.Button(
        words or f"Add {effect}",
        className="primary" if primary else "",
        **{"data-press": "add", "data-effect": effect},
    )


def show_adds(findings: Findings) -> list[Component]:
    """Return a button for each effect that the verdict names, its look-alikes included."""
    explained = findings.diagnosed
    if explained is None:
        return []
    alike = [
        make_add(name, words=f"Add look-alike {name}" if number else "", primary=not number)
        for number, name in enumerate(explained.named)
    ]
    for other in explained.thermometers[:1]:
        kind = other.command.kind
        alike.append(make_add(kind, words=f"Add {kind} after {other.signal}", primary=True))
    return alike


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
        words = "Held-out error with each candidate; shorter is better. Hatched: not named."
        parts.append(show_figure(draw_candidates(diagnosis), words))
    table = tables.tabulate_candidates(diagnosis, findings.titles)
    return [*parts, show_table(table, folded=True)]


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
    buttons = [make_add(kind, primary=is_named)]
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
