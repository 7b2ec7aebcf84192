"""The way from logs to a report as the page shows it: its steps, and the one thing to do now."""

from dash import html
from dash.development.base_component import Component

from zerodrift.workbench.path import BUSY, DONE, NEXT, Offer, ProjectStanding, ProjectWay, find_path
from zerodrift.workbench.workplace import Workplace

SIGNS = {DONE: "✓", NEXT: "→", BUSY: "…"}
WORDS = {DONE: " (done)", NEXT: " (next)", BUSY: " (being done)"}
"""For those who hear the page."""


def describe_standing(place: Workplace) -> ProjectStanding:
    """Return what is known of a project, as far as the way goes."""
    return ProjectStanding(
        findings=place.findings,
        job=find_job(place),
        refused=dict(place.refused),
        proposed="propose" in place.done,
        planned="plan" in place.done,
        verified="verify" in place.done,
        applied="apply" in place.done,
        reported="report" in place.done,
    )


def find_job(place: Workplace) -> str:
    """Return what runs and has to be waited for; curves that follow a verdict do not count."""
    job, findings = place.job, place.findings
    if job is None or not job.running:
        return ""
    is_told = findings is not None and findings.diagnosed is not None and not place.outdated
    return "" if job.name == "look" and is_told else job.name


def show_way(place: Workplace) -> list[Component]:
    """Return the steps, the next one with its reason, and what else there is."""
    path = find_path(describe_standing(place))
    steps = [
        html.Li(
            [
                html.Span(SIGNS.get(step.state, "○"), className="sign", **{"aria-hidden": "true"}),
                html.B(step.title),
                html.Span(WORDS.get(step.state, ""), className="hidden"),
                html.Span(step.found, className="found"),
            ],
            className=step.state,
        )
        for step in path.steps
    ]
    return [html.Ol(steps, className="way"), html.Div(_show_now(path), className="now")]


def _show_now(path: ProjectWay) -> list[Component]:
    parts: list[Component] = []
    if path.weak:
        parts.append(html.P(f"Weak evidence: {path.weak}.", className="weak"))
    buttons = [make_offer(path.offer, primary=True)] if path.offer is not None else []
    buttons += [make_offer(offer) for offer in path.others]
    parts.append(html.P(path.reason, className="reason"))
    parts.append(html.Div(buttons, className="adds", id="adds"))
    return parts


def make_offer(offer: Offer, *, primary: bool = False) -> Component:
    """Return what is offered as a button, or as a link where it is a download."""
    kind = "primary" if primary else ""
    if offer.button == "download":
        return html.A(offer.words, href="/firmware.zip", download="", className=f"button {kind}")
    more = {"data-effect": offer.effect} if offer.effect else {}
    return html.Button(offer.words, className=kind, **{"data-press": offer.button, **more})
