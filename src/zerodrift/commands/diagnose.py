"""`zerodrift diagnose`: names the physical effect that the model lacks."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zerodrift.commands.common import (
    directory_option,
    json_option,
    print_json,
    print_notes,
    skip_invalid_option,
)
from zerodrift.commands.console import open_console, open_table, show_progress

if TYPE_CHECKING:
    from rich.console import Console

    from zerodrift.physics.catalogue import Catalogue
    from zerodrift.physics.course import Course
    from zerodrift.physics.diagnosis import Diagnosis

MOST_LISTED = 8
"""Candidates that the table lists; --json has all of them."""


@click.command()
@directory_option
@click.option(
    "--auto",
    is_flag=True,
    help="Add what is missing and look again, until nothing is missing or it has no name. "
    "zerodrift.toml is left as it is; `zerodrift add` writes it.",
)
@json_option
@skip_invalid_option
def command(directory: Path, auto: bool, as_json: bool, skip_invalid: bool) -> None:
    """Name the physical effect that the model lacks.

    Every effect of the catalogue that is not in the model is tried. What it would gain is judged
    on training runs left out, against what chance could do, and beside the noise floor. The
    verdict is the name of an effect, with those that these logs cannot tell from it; or that
    nothing is missing; or that something is, which the catalogue does not know.
    """
    from zerodrift.commands.project import open_project
    from zerodrift.physics.catalogue import load_catalogue
    from zerodrift.physics.course import diagnose_until_done
    from zerodrift.physics.diagnose import diagnose

    with show_progress("reading logs") as say:
        config, dataset = open_project(directory, skip_invalid)
        catalogue = load_catalogue(config.plugin_files)

        def advance(kind: str) -> None:
            say(f"tried {kind}")

        if auto:
            course = diagnose_until_done(config.effects, dataset, catalogue, advance)
            diagnosis = course.steps[-1]
        else:
            course = None
            diagnosis = diagnose(config.effects, dataset, catalogue, advance)
    print_notes((*dataset.notes, *diagnosis.notes))
    if as_json:
        print_json(diagnosis.to_dict() if course is None else _tell_course(course))
        return
    console = open_console()
    if course is None:
        print_diagnosis(diagnosis, catalogue, console)
    else:
        _print_course(course, catalogue, console)


def _tell_course(course: "Course") -> dict[str, Any]:
    """Return the last diagnosis as JSON, with the steps before it."""
    return {
        **course.steps[-1].to_dict(),
        "added": [
            {"effect": step.effect, "parameters": dict(step.parameters)}
            for step in course.steps
            if step.effect is not None
        ],
        "steps": [step.to_dict() for step in course.steps],
        "drop": list(course.drop),
    }


def print_diagnosis(diagnosis: "Diagnosis", catalogue: "Catalogue", console: "Console") -> None:
    """Print the candidates, and then the verdict in sentences."""
    table = open_table(
        "Effects that the model lacks",
        ("effect", "term", "values"),
        ("held-out RMSE, of now", "p", "excitation"),
    )
    for candidate in diagnosis.candidates[:MOST_LISTED]:
        effect = catalogue[candidate.effect]
        values = ", ".join(f"{name} {value:.4g}" for name, value in candidate.parameters.items())
        table.add_row(
            effect.kind,
            effect.title,
            values,
            f"{candidate.heldout_rmse_ratio:.3f}",
            f"{candidate.p_value:.2g}",
            f"{100.0 * candidate.excitation:.0f} %",
        )
    console.print(table)
    left_out = len(diagnosis.candidates) - MOST_LISTED
    if left_out > 0:
        console.print(f"{left_out} more that help less; --json lists all.\n")
    for untested in diagnosis.not_testable:
        console.print(f"Not testable: {untested.effect}: {untested.why}.")
    if diagnosis.not_testable:
        console.print()
    for sentence in explain_verdict(diagnosis, catalogue):
        console.print(sentence)


def explain_verdict(diagnosis: "Diagnosis", catalogue: "Catalogue") -> list[str]:
    """Return the verdict in sentences."""
    floor = f"{diagnosis.floor_ratio_before:.2f} times the noise floor"
    if diagnosis.floor_source != "dwell":
        floor += " (estimated)"
    sentences = []
    if diagnosis.verdict == "missing" and diagnosis.effect is not None:
        effect = catalogue[diagnosis.effect]
        sentences.append(f"MISSING: {effect.kind} ({effect.title}).")
        values = [
            f"{name} = {value:.4g} {_write_unit(effect.parameter(name).unit)}".rstrip()
            for name, value in diagnosis.parameters.items()
        ]
        if values:
            sentences.append(f"Fitted: {', '.join(values)}.")
        sentences.append(
            f"Held-out error: {floor} now, {diagnosis.floor_ratio_after:.2f} times with it."
        )
        if diagnosis.lookalikes:
            names = ", ".join(diagnosis.lookalikes)
            sentences.append(f"These logs cannot tell it from: {names}.")
        if diagnosis.also:
            sentences.append(f"Missing beside it: {', '.join(diagnosis.also)}.")
        sentences.append(effect.physics)
    elif diagnosis.verdict == "complete":
        sentences.append("COMPLETE: no effect that these logs can test helps.")
        sentences.append(f"Held-out error: {floor}.")
    else:
        sentences.append("UNKNOWN: something is missing that no effect of the catalogue explains.")
        sentences.append(f"Held-out error: {floor}.")
        if diagnosis.nearest is not None:
            sentences.append(f"Nearest, and not it: {diagnosis.nearest}.")
        sentences += [
            f"What is left follows {pattern.follows} ({100.0 * pattern.share:.0f} % of it)."
            for pattern in diagnosis.remainder
        ]
        if not diagnosis.remainder:
            sentences.append("What is left follows no signal in the logs.")
    sentences.append(f"Evidence: {diagnosis.evidence}.")
    if diagnosis.next_experiment:
        sentences.append(f"Next experiment: {diagnosis.next_experiment}.")
    if diagnosis.effect is not None:
        sentences.append(f"To add it: zerodrift add {diagnosis.effect}")
    return sentences


def _write_unit(unit: str) -> str:
    """Return a unit for print; plain numbers have none."""
    return "" if unit == "1" else unit


def _print_course(course: "Course", catalogue: "Catalogue", console: "Console") -> None:
    """Print what was added one after the other, and the last verdict."""
    table = open_table(
        "Added one after the other", ("effect", "values"), ("x floor before", "x floor with it")
    )
    for step in course.steps:
        if step.effect is not None:
            values = ", ".join(f"{k} {v:.4g}" for k, v in step.parameters.items())
            table.add_row(
                step.effect,
                values,
                f"{step.floor_ratio_before:.2f}",
                f"{step.floor_ratio_after:.2f}",
            )
    if len(course.steps) > 1:
        console.print(table)
    print_diagnosis(course.steps[-1], catalogue, console)
    for kind in course.drop:
        console.print(
            f"{kind} no longer earns its place: runs left out are predicted as well without it. "
            f"To remove it: zerodrift remove {kind}"
        )
