"""The parts of the page that tell the verdict: what is missing, why, and why not the others."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from dash import html

from zerodrift.report import tables
from zerodrift.report.figures import draw_candidates
from zerodrift.report.findings import Findings
from zerodrift.report.report import list_details
from zerodrift.report.verdict import explain_candidate, write_headline
from zerodrift.workbench.panels import show_figure, show_table

MOST_CARDS = 4
"""Candidates that are told in full; the table has all."""


def show_verdict(findings: Findings, *, diagnosing: bool, hides: bool) -> tuple[str, list[Any]]:
    """Return the verdict card's class and content.

    Args:
        findings: what was found.
        diagnosing: whether the verdict is still being found.
        hides: whether a guess is asked for first.
    """
    diagnosed = findings.told["diagnose"]
    if hides:
        text = "Something may be hidden in these simulated logs. Guess first, then let it tell you."
        return "verdict none", [html.P(text, className="sentence")]
    if diagnosed is None and diagnosing:
        return "verdict none", [html.P("Diagnosing …", className="sentence")]
    headline = write_headline(diagnosed, findings.told["titles"])
    parts: list[Any] = [
        html.P(headline.label, className="kicker"),
        html.P(headline.sentence, className="sentence", id="verdict-sentence"),
    ]
    details = list_details(findings.told["diagnose_sentences"])
    parts += [html.P(s, className="note") for s in details if not s.startswith("To add it")]
    notes = dict.fromkeys((*findings.told["notes"], *(diagnosed or {}).get("notes", ())))
    parts += [html.P(f"Note: {note}", className="note") for note in notes]
    return f"verdict {headline.kind.replace(' ', '-')}", parts


def list_addable(findings: Findings) -> list[str]:
    """Return the effects that the verdict names, the likeliest first, look-alikes after it."""
    diagnosed = findings.told["diagnose"]
    if diagnosed is None or diagnosed["effect"] is None:
        return []
    return [diagnosed["effect"], *diagnosed["lookalikes"]]


def make_add(effect: str, *, words: str = "", primary: bool = False) -> Any:
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


def show_adds(findings: Findings) -> list[Any]:
    """Return a button for each effect that the verdict names, its look-alikes included."""
    diagnosed = findings.told["diagnose"]
    names = list_addable(findings)
    alike = [
        make_add(name, words=f"Add look-alike {name}" if number else "", primary=not number)
        for number, name in enumerate(names)
    ]
    others = diagnosed["thermometers"] if diagnosed is not None else []
    if others:
        told = others[0]
        kind = told["command"].split()[2]
        alike.append(make_add(kind, words=f"Add {kind} after {told['signal']}", primary=True))
    return alike


def show_candidates(findings: Findings, previews: Sequence[str]) -> list[Any]:
    """Return the ranking of what could be missing: the first in full, then all of them.

    Args:
        findings: what was found.
        previews: effects that can be drawn over what is left.
    """
    diagnosed = findings.told["diagnose"]
    if diagnosed is None:
        return [html.P("Not diagnosed yet.", className="note")]
    named = set(list_addable(findings))
    cards = [
        _show_candidate(findings, candidate, candidate["effect"] in named, previews)
        for candidate in diagnosed["candidates"][:MOST_CARDS]
    ]
    parts: list[Any] = [html.Ol(cards, className="ranking")] if cards else []
    if diagnosed["candidates"]:
        words = "Held-out error with each candidate; shorter is better. Hatched: not named."
        parts.append(show_figure(draw_candidates(diagnosed), words))
    table = tables.tabulate_candidates(diagnosed, findings.told["titles"])
    return [*parts, show_table(table, folded=True)]


def _show_candidate(
    findings: Findings, candidate: Mapping[str, Any], is_named: bool, previews: Sequence[str]
) -> Any:
    """Return one candidate: why or why not, its equation, and what can be done with it."""
    kind = candidate["effect"]
    effect = findings.told["catalogue"].get(kind, {})
    units = {told["name"]: told["unit"] for told in effect.get("parameters", ())}
    fitted = ", ".join(
        f"{name} {value:.4g} {units.get(name, '').removeprefix('1')}".rstrip()
        for name, value in candidate["parameters"].items()
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
            html.H3([html.Code(kind), " ", effect.get("title", "")]),
            html.P(
                explain_candidate(findings.told["diagnose"], candidate),
                className="standing" if is_named else "",
            ),
            html.P(
                [
                    f"Fitted: {fitted}. " if fitted else "",
                    f"{100.0 * candidate['excitation']:.0f} % of it cannot be imitated by the "
                    "effects in the model.",
                ],
                className="note",
            ),
            html.P(html.Code(effect.get("equation", ""))),
            html.P(f"Looks like: {effect.get('fingerprint', '')}", className="note"),
            html.Div(buttons, className="actions"),
        ],
        className="named" if is_named else "",
    )


def show_effect(findings: Findings, kind: str) -> list[Any]:
    """Return what the catalogue says about an effect, and its standing in the diagnosis."""
    effect: Mapping[str, Any] | None = findings.told["catalogue"].get(kind)
    if effect is None:
        return []
    diagnosed = findings.told["diagnose"]
    parts: list[Any] = [
        html.P([html.B(effect["title"]), ". ", effect["physics"]]),
        html.P(html.Code(effect["equation"])),
        html.P(["Looks like: ", effect["fingerprint"]], className="note"),
        html.P(["To provoke it: ", effect["provoke"]], className="note"),
        html.P(["Cure in hardware: ", effect["cure"]], className="note"),
    ]
    for candidate in diagnosed["candidates"] if diagnosed else ():
        if candidate["effect"] == kind:
            words = explain_candidate(diagnosed, candidate)
            parts.insert(0, html.P(words, className="standing"))
    for untested in diagnosed["not_testable"] if diagnosed else ():
        if untested["effect"] == kind:
            why = f"Here: not testable with these logs: {untested['why']}."
            parts.insert(0, html.P(why, className="standing"))
    return parts
