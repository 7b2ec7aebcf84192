"""The parts of the page, built from what the commands found; nothing is computed here."""

from collections.abc import Mapping, Sequence
from typing import Any

from dash import dcc, html

from zerodrift.report import tables
from zerodrift.report.figures import draw_budget, draw_candidates, draw_staircase
from zerodrift.report.findings import Findings
from zerodrift.report.report import list_details, list_tiles, read_steps
from zerodrift.report.tables import Table
from zerodrift.report.verdict import write_headline

GRAPH = {"displaylogo": False, "responsive": True}


def show_table(table: Table, *, folded: bool = False) -> Any:
    """Return a table; `folded` behind its title."""

    def cell(make: Any, text: str, number: int) -> Any:
        return make(text, className="" if number < table.texts else "number")

    grid = html.Div(
        html.Table(
            [
                html.Thead(html.Tr([cell(html.Th, h, i) for i, h in enumerate(table.headings)])),
                html.Tbody(
                    [
                        html.Tr([cell(html.Td, text, i) for i, text in enumerate(row)])
                        for row in table.rows
                    ]
                ),
            ]
        ),
        className="scroll",
        tabIndex="0",
    )
    inner = [grid, html.P(table.note, className="note")] if table.note else [grid]
    if folded:
        return html.Details([html.Summary(table.title), *inner])
    return html.Div([html.H3(table.title), *inner], className="table")


def show_figure(figure: Any, label: str) -> Any:
    """Return a figure with words for those who cannot see it."""
    return html.Figure(
        [
            dcc.Graph(figure=figure, config=GRAPH, style={"height": figure.layout.height}),
            html.Figcaption(label, className="hidden"),
        ]
    )


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
    parts: list[Any] = [html.P(headline.sentence, className="sentence", id="verdict-sentence")]
    details = list_details(findings.told["diagnose_sentences"])
    parts += [html.P(s, className="note") for s in details if not s.startswith("To add it")]
    return f"verdict {headline.kind.replace(' ', '-')}", parts


def list_addable(findings: Findings) -> list[str]:
    """Return the effects that the verdict names, the likeliest first."""
    diagnosed = findings.told["diagnose"]
    if diagnosed is None or diagnosed["effect"] is None:
        return []
    return [diagnosed["effect"], *diagnosed["lookalikes"]]


def show_tiles(findings: Findings) -> list[Any]:
    """Return the few figures that come first."""
    return [
        html.Div([html.B(value), html.Span(what)], className="tile")
        for value, what in list_tiles(findings)
    ]


def show_candidates(findings: Findings) -> list[Any]:
    """Return the ranking of what could be missing."""
    diagnosed = findings.told["diagnose"]
    if diagnosed is None:
        return [html.P("Not diagnosed yet.", className="note")]
    parts: list[Any] = []
    if diagnosed["candidates"]:
        words = "Held-out error with each candidate; shorter is better. Hatched: not named."
        parts.append(show_figure(draw_candidates(diagnosed), words))
    table = tables.tabulate_candidates(diagnosed, findings.told["titles"])
    return [*parts, show_table(table, folded=True)]


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
            standing = tables.explain_standing(diagnosed, candidate)
            ratio, p = candidate["heldout_rmse_ratio"], candidate["p_value"]
            words = (
                f"Here: {standing}; with it the held-out RMSE is {ratio:.3f} of what it is now, "
                f"p = {p:.2g}, excitation {100.0 * candidate['excitation']:.0f} %."
            )
            parts.insert(0, html.P(words, className="standing"))
    for untested in diagnosed["not_testable"] if diagnosed else ():
        if untested["effect"] == kind:
            why = f"Here: not testable with these logs: {untested['why']}."
            parts.insert(0, html.P(why, className="standing"))
    return parts


def show_revision(revision: Mapping[str, Any]) -> list[Any]:
    """Return what the last `add` or `remove` printed: errors before and after, per output."""
    before, after = revision["before"]["rmse_heldout"], revision["after"]["rmse_heldout"]
    floor, units = revision["noise_floor"], revision["units"]
    rows = tuple(
        (
            name,
            units[name],
            tables.write_number(before[name]),
            tables.write_number(after[name]),
            f"{after[name] / before[name]:.3f}" if before[name] > 0.0 else "–",
            tables.write_number(floor[name]),
            f"{after[name] / floor[name]:.2f}" if floor[name] > 0.0 else "–",
        )
        for name in after
    )
    done = revision.get("added", revision.get("removed", False))
    verb = {"add": "Added", "remove": "Removed"}[revision["command"]]
    title = f"{verb} {revision['effect']}" if done else f"{revision['effect']} was not added"
    headings = ("output", "unit", "before", "after", "after/before", "noise floor", "× floor")
    values = ", ".join(
        f"{name} = {p['value']:.4g} {'' if p['unit'] == '1' else p['unit']}".rstrip()
        + (f" ± {p['std_error']:.2g}" if p["std_error"] is not None else "")
        for name, p in revision["parameters"].items()
    )
    reason = revision["reason"]
    parts: list[Any] = [html.H2(title), html.P(f"{reason[0].upper()}{reason[1:]}.")]
    if values:
        parts.append(html.P(f"Fitted: {values}.", className="note"))
    table = Table(f"Held-out RMSE ({revision['held_out']})", headings, rows, texts=2)
    return [*parts, show_table(table)]


def show_staircase(findings: Findings) -> list[Any]:
    """Return the staircase of errors, once there is a step."""
    steps = read_steps(findings.told["history"])
    if not steps:
        return [html.P("No step yet: adding an effect makes the first.", className="note")]
    words = "Held-out error over the noise floor, step by step."
    return [
        show_figure(draw_staircase(steps), words),
        show_table(tables.tabulate_steps(findings.told["history"]), folded=True),
    ]


def show_errors(findings: Findings) -> list[Any]:
    """Return the errors per output and run, and where the model fails."""
    compared = findings.told["compare"]
    parts: list[Any] = [html.P(s, className="note") for s in findings.told["compare_sentences"]]
    parts.append(show_table(tables.tabulate_outputs(compared)))
    parts.append(show_table(tables.tabulate_runs(compared), folded=True))
    parts.append(html.H3("Where the model fails"))
    parts += [html.P(s) for s in findings.told["patterns"]] or [
        html.P("No pattern was found that holds on runs left out.")
    ]
    if compared["worst"]:
        parts.append(show_table(tables.tabulate_worst(compared)))
    return parts


def show_model(findings: Findings) -> list[Any]:
    """Return the effects in the model with their parameters."""
    model = findings.told["model"]
    return [
        show_table(tables.tabulate_parameters(model)),
        show_table(tables.tabulate_coefficients(model), folded=True),
    ]


def show_firmware(findings: Findings) -> list[Any]:
    """Return error budget, sizes and certificate of the last firmware, where it is current."""
    firmware, certificate = findings.told["firmware"], findings.told["certificate"]
    if firmware is None:
        return [html.P(findings.told["firmware_note"], className="note")]
    compared = findings.told["compare"]
    return [
        show_figure(draw_budget(firmware, compared), "Error budget in percent of full scale."),
        show_table(tables.tabulate_budget(firmware, compared), folded=True),
        show_table(tables.tabulate_firmware(firmware)),
        show_table(tables.tabulate_certificate(certificate), folded=True),
    ]


def show_outcome(outcome: Mapping[str, Any]) -> list[Any]:
    """Return what the last `train`, `firmware` or `verify` printed, in a sentence."""
    name, told = outcome["name"], outcome["told"]
    if name == "verify":
        equal = "equal in every bit" if told["bit_exact"] else "DIFFERENT"
        backends = " = ".join(told["backends"])
        return [html.P(f"Verified: {equal} over {told['vectors']} steps on {backends}.")]
    if name == "firmware":
        return [
            html.P(
                f"Built: flash {told['flash_bytes']} B, RAM {told['ram_bytes']} B, stack "
                f"{told['stack_bytes']} B on {told['core']}; "
                f"{'bit-exact' if told['bit_exact'] else 'DIFFERENT'} over {told['vectors']} "
                f"steps. Files: {', '.join(told['files'])}."
            )
        ]
    if name == "train":
        rmse = ", ".join(
            f"{n} {tables.write_number(o['held_out']['rmse'])} {o['unit']}"
            for n, o in told["outputs"].items()
        )
        kept = "with a network" if told["network"] else "without a network"
        return [html.P(f"Trained {kept}; held-out RMSE: {rmse}.")]
    return [
        html.P(
            ["Report written: ", html.A("open report.html", href="/report.html", target="_blank")]
        )
    ]


def show_start(logs: Sequence[str], directory: str) -> list[Any]:
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
        html.Button("Guess columns and begin", id="begin", className="primary", disabled=not logs),
        html.H2("Or practise"),
        html.P(
            "Simulated logs of a six-axis sensor with one hidden effect are written into this "
            "directory: guess what is hidden, then let the page tell you."
        ),
        html.Button("Write simulated logs with something hidden", id="practise"),
    ]
