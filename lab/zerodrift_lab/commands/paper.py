"""`zerodrift paper`: the paper's tables and its fit figure, from the twin."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_text
from zerodrift.cli.common import json_option, print_json, print_notes
from zerodrift.cli.console import open_console, show_progress

if TYPE_CHECKING:
    from zerodrift.report.svg import Picture
    from zerodrift_lab.paper.findings import Finding
    from zerodrift_lab.paper.plan import Plan
    from zerodrift_lab.paper.study import Outcome
    from zerodrift_lab.paper.tables import Table
    from zerodrift_lab.paper.why import Why

KEPT = "fits"
"""In the output directory: a file per fit."""
CALLED = "# The paper's experiments on the twin"


@click.command("paper")
@click.option("--quick", is_flag=True, help="Minutes: 2 sensors, 1 seed, the paper's methods.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("paper"),
    show_default=True,
    help="Where tables, pictures and the fits are kept.",
)
@click.option(
    "--sensors",
    type=click.IntRange(1, 1000),
    help="Simulated sensors (default 5, or 2 with --quick).",
)
@click.option("--seeds", type=click.IntRange(1, 1000), help="Starts of a method (default 3, or 1).")
@click.option(
    "--recipe-epochs",
    type=click.IntRange(1, 2000),
    help="How far the paper's recipe of 2000 epochs is followed (default 100, or 10).",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    help="Fits at a time, each in a process of its own.",
)
@json_option
def command(
    quick: bool,
    out: Path,
    sensors: int | None,
    seeds: int | None,
    recipe_epochs: int | None,
    jobs: int,
    as_json: bool,
) -> None:
    """Reproduce the paper's tables and its fit figure on the twin (all data simulated).

    Chamber fit, cooling, heating and walking, by every method, over several simulated sensors and
    seeds, beside the figures that the paper prints; which of its claims come out, and three small
    experiments on why. Every fit is kept in DIR/fits as soon as it is done: an interrupted run is
    taken up again by the same command.
    """
    from zerodrift_lab.paper.figures import list_figures
    from zerodrift_lab.paper.findings import find_all, summarise_default
    from zerodrift_lab.paper.plan import make_plan
    from zerodrift_lab.paper.store import Store
    from zerodrift_lab.paper.study import run_study
    from zerodrift_lab.paper.summary import Outcomes
    from zerodrift_lab.paper.tables import build_tables, render_csv
    from zerodrift_lab.paper.why import investigate

    plan, note = make_plan(quick, sensors or 0, seeds or 0, recipe_epochs or 0)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{out}: cannot be made ({error.strerror}); expected a place for a directory. Name "
            "another by --out."
        ) from error
    with show_progress("simulating logs") as say:

        def tell(done: int, total: int, what: str) -> None:
            say(f"{done} of {total} fits: {what}")

        found = run_study(plan.list_cells(), Store(out / KEPT), jobs, tell)
        outcomes = Outcomes(found)
        tables = build_tables(plan, outcomes)
        findings = find_all(plan, outcomes)
        say("window spans, training, heat")
        why = investigate(plan, outcomes)
        sentences = summarise_default(plan, outcomes)
        notes = tuple(x for x in (note,) if x)
        text = render_page(plan, tables, findings, why, sentences, found)
        write_text(out / "tables.md", text)
        write_text(out / "tables.csv", render_csv(tables))
        say("drawing")
        figures = list_figures(plan, outcomes, why)
        files, missing = draw(figures, out)
    print_notes((*notes, *((missing,) if missing else ())))
    paths = [out / "tables.md", out / "tables.csv", *files]
    if as_json:
        print_json(
            {
                "simulated": True,
                "sensors": list(plan.sensors),
                "seeds": list(plan.seeds),
                "tables": [describe_table(table) for table in tables],
                "findings": [finding.to_dict() for finding in findings],
                "why": why.to_dict(),
                "sentences": [*sentences, *why.explain()],
                "files": [str(path) for path in paths],
            }
        )
        return
    console = open_console()
    console.print(text, soft_wrap=True)
    console.print(f"Wrote {', '.join(str(path) for path in paths)}", soft_wrap=True)


def render_page(
    plan: "Plan",
    tables: "list[Table]",
    findings: "list[Finding]",
    why: "Why",
    sentences: list[str],
    found: "list[Outcome]",
) -> str:
    """Return everything as Markdown."""
    from zerodrift_lab.methods import METHODS
    from zerodrift_lab.paper.published import RECIPE, SOURCE
    from zerodrift_lab.paper.tables import render_table

    lines = [
        CALLED,
        "",
        f"**Everything called simulated is simulated**: {len(plan.sensors)} specimens of the "
        f"six-axis twin, {len(plan.seeds)} start(s) of every method that has starts. Medians with "
        f"quartiles over specimens and starts. The paper's figures are those it prints ({SOURCE}); "
        "its data are not public, and the twin was not fitted to them. All methods are trained on "
        "the same simulated chamber logs, with one thermometer; networks by one learning-rate "
        f"cycle of 40 epochs unless the recipe is named ({RECIPE}).",
        "",
    ]
    lines += [render_table(table) for table in tables]
    lines += ["## What the methods cost (simulated logs)", ""]
    lines += ["| | parameters | MACs per step | CPU seconds of a fit |", "|---|---:|---:|---:|"]
    for method in plan.methods:
        told = [
            o.result
            for o in found
            if o.cell.method == method and o.cell.logs == "chamber" and not o.cell.course
        ]
        if told:
            seconds = sorted(r["fit_cpu_s"] for r in told)[len(told) // 2]
            lines.append(
                f"| {METHODS[method].title} | {told[0]['parameters']} | "
                f"{told[0]['macs_per_step'] or '-'} | {seconds:.2g} |"
            )
    lines += ["", "## Which of the paper's claims come out (simulated)", ""]
    lines += [f"- {finding.explain()}" for finding in findings]
    lines += ["", "## Why", ""]
    lines += [f"- {sentence}" for sentence in why.explain()]
    lines += [f"- {sentence}" for sentence in sentences]
    return "\n".join(lines) + "\n"


def describe_table(table: "Table") -> dict[str, Any]:
    """Return a table as JSON values."""
    return {
        "name": table.name,
        "axes": list(table.axes),
        "units": list(table.units),
        "rows": [
            {
                "method": line.name,
                "paper": list(line.published),
                "simulated": [
                    {"median": s.median, "quartiles": [s.low, s.high], "fits": s.count}
                    for s in line.simulated
                ],
            }
            for line in table.lines
        ],
    }


KINDS = ("svg", "pdf", "png")


def draw(figures: "dict[str, Picture]", out: Path) -> tuple[list[Path], str]:
    """Write the figures: one HTML page, and SVG, PDF and PNG where there is a browser."""
    from zerodrift.report.browser import write_pictures
    from zerodrift.report.page import render_page as render_pictures

    page = out / "figures.html"
    write_text(
        page,
        render_pictures("The paper's experiments on the twin (simulated)", list(figures.values())),
    )
    try:
        return [page, *write_pictures(figures, out / "pictures", out, KINDS)], ""
    except InputError as error:
        return [page], f"no SVG, PDF or PNG was made, {page} holds the pictures: {error}"
