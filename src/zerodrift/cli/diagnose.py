"""`zerodrift diagnose`: names the physical effect that the model, or a fleet's design, lacks."""

from collections.abc import Sequence
from pathlib import Path

import click
from rich.console import Console

from zerodrift.cli.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import (
    open_console,
    open_table,
    print_advice,
    print_not_testable,
    show_progress,
)
from zerodrift.diagnosis.changes import name_directory
from zerodrift.diagnosis.diagnosis import Diagnosis, write_probability
from zerodrift.fleet.evidence import ERROR, GAIN, SIZE, Difference
from zerodrift.fleet.joint_summary import FleetDiagnosis
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.description import write_values
from zerodrift.report.sentences import explain_others, explain_verdict
from zerodrift.tasks.diagnose import DiagnoseRequest, diagnose
from zerodrift.tasks.project import ProjectFolder

MOST_LISTED = 8
"""Candidates, and units that differ, that the tables list; --json has all of them."""


@click.command()
@directory_option
@sensor_option
@click.option(
    "--auto",
    is_flag=True,
    help="Add what is missing and look again, until nothing is missing or it has no name. "
    "zerodrift.toml is left as it is; `zerodrift add` writes it.",
)
@trust_option
@json_option
@skip_invalid_option
def command(
    directory: Path, sensor: str | None, auto: bool, as_json: bool, skip_invalid: bool
) -> None:
    """Name the physical effect that the model lacks.

    Every effect of the catalogue that is not in the model is tried. What it would gain is judged
    on training runs left out, against what chance could do, and beside the noise floor. The
    verdict is the name of an effect, with those that these logs cannot distinguish from it; or that
    nothing is missing; or that something is, which the catalogue does not know.

    In a fleet's folder all units of the design speak together, and those that differ are named;
    --sensor NAME diagnoses one unit.
    """
    project = ProjectFolder(directory, sensor, skip_invalid)
    with show_progress() as progress:
        found = diagnose(DiagnoseRequest(project, auto), progress)
    catalogue = project.catalogue
    if isinstance(found, FleetDiagnosis):
        if as_json:
            print_result(found)
        else:
            print_fleet_diagnosis(found, catalogue, directory, open_console())
        return
    verdict = found.verdict
    diagnosis, course = verdict.diagnosis, verdict.course
    print_notes((*project.dataset.notes, *diagnosis.remarks))
    if as_json:
        print_result(found.summarise(directory))
        return
    console = open_console()
    written = ["" if one is None else one.write(directory) for one in found.commands]
    if course is not None:
        _print_steps(verdict.steps, written, catalogue, console)
    print_diagnosis(diagnosis, written[-1], catalogue, console)
    for sentence in explain_others(verdict.others, directory):
        console.print(sentence.text)
    for kind in () if course is not None else diagnosis.drop:
        console.print(
            f"{kind} does not help: runs left out are predicted better without it. "
            f"To remove it: zerodrift remove {kind}{name_directory(directory)}"
        )
    for kind in course.drop if course is not None else ():
        console.print(
            f"{kind} no longer earns its place: runs left out are predicted as well without it. "
            f"To remove it: zerodrift remove {kind}{name_directory(directory)}"
        )
    print_advice(found.advice, console)


def print_diagnosis(
    diagnosis: Diagnosis, command: str, catalogue: Catalogue, console: Console
) -> None:
    """Print the candidates and the errors, and then the verdict in sentences."""
    table = open_table(
        "Effects that the model lacks, one at a time",
        ("effect", "term", "fitted values"),
        ("error left", "probability", "p", "excited"),
    )
    for candidate in diagnosis.candidates[:MOST_LISTED]:
        effect = catalogue[candidate.effect]
        table.add_row(
            effect.kind,
            effect.title,
            write_values(effect, candidate.parameters),
            f"{100.0 * candidate.rmse_left_out_ratio:.1f} %",
            write_probability(candidate.probability),
            f"{candidate.p_value:.2g}",
            f"{100.0 * candidate.excitation:.0f} %",
        )
    if diagnosis.candidates:
        console.print(table)
        console.print(
            "Error left: RMSE in runs left out, over that of the model as it is. Probability: that "
            "the effect is missing, among simulated logs of many kinds. p: how often chance alone "
            "does as well. Excited: the part that the model cannot imitate.\n"
        )
    left_out = len(diagnosis.candidates) - MOST_LISTED
    if left_out > 0:
        console.print(f"{left_out} more that help less; --json lists all.\n")
    print_not_testable({one.effect: one.why for one in diagnosis.not_testable}, console)
    _print_errors(diagnosis, console)
    for sentence in explain_verdict(diagnosis, command, catalogue):
        console.print(sentence.text)


def _print_errors(diagnosis: Diagnosis, console: Console) -> None:
    """Print each output's error in its unit, beside the noise floor."""
    after = f"with {diagnosis.effect}" if diagnosis.effect is not None else ""
    source = "noise floor" if diagnosis.noise_floor_source == "dwell" else "noise floor (estimated)"
    headings = ("RMSE now", *((after,) if after else ()), source)
    table = open_table("Error in runs left out", ("output", "unit"), headings)
    for name, output in diagnosis.outputs.items():
        with_it = (output.rmse_left_out_after,) if after else ()
        figures = [output.rmse_left_out, *with_it, output.noise_floor]
        table.add_row(name, output.unit, *("-" if x is None else f"{x:.4g}" for x in figures))
    console.print(table)


def _print_steps(
    steps: Sequence[Diagnosis],
    commands: Sequence[str],
    catalogue: Catalogue,
    console: Console,
) -> None:
    """Print the effects that were added, in order."""
    table = open_table(
        "Added one after the other",
        ("effect", "fitted values", "command"),
        ("x floor before", "x floor with it"),
    )
    for step, command in zip(steps, commands, strict=True):
        if step.effect is not None:
            table.add_row(
                step.effect,
                write_values(catalogue[step.effect], step.parameters),
                command,
                f"{step.floor_ratio_before:.2f}",
                f"{step.floor_ratio_after:.2f}",
            )
    if table.row_count:
        console.print(table)


def print_fleet_diagnosis(
    found: FleetDiagnosis, catalogue: Catalogue, directory: Path, console: Console
) -> None:
    """Print candidates, verdict, units that differ, and units that could not be examined."""
    table = open_table(
        "Effects that the design's model lacks, one at a time, over all units",
        ("effect", "term", "values (median)"),
        ("error left", "p", "units gaining", "size"),
    )
    for candidate in found.candidates[:MOST_LISTED]:
        effect = catalogue[candidate.effect]
        table.add_row(
            effect.kind,
            effect.title,
            write_values(effect, candidate.parameters),
            f"{100.0 * candidate.rmse_left_out_ratio:.1f} %",
            f"{candidate.p_value:.2g}",
            f"{candidate.gaining} of {len(found.units)}",
            f"{candidate.size:.2f}",
        )
    if found.candidates:
        console.print(table)
        console.print(
            "Error left: RMSE in runs left out, over that of the model as it is; mean over the "
            "units. p: how often signs by chance rank some effect as high. Size: RMS in noise "
            "floors, in the median unit.\n"
        )
    print_not_testable(found.not_testable, console)
    _print_fleet_verdict(found, catalogue, console)
    for one in found.differ[:MOST_LISTED]:
        console.print(f"UNLIKE THE OTHERS: {tell_difference(one, directory)}")
    if len(found.differ) > MOST_LISTED:
        console.print(f"{len(found.differ) - MOST_LISTED} more differ; --json lists all.")
    for name, error in found.errors.items():
        console.print(f"not examined: {name}: {error}")


def _print_fleet_verdict(found: FleetDiagnosis, catalogue: Catalogue, console: Console) -> None:
    if found.effect is not None:
        effect = catalogue[found.effect]
        console.print(
            f"MISSING in the design: {effect.kind} ({effect.title}), p {found.p_value:.2g}."
        )
        values = write_values(effect, found.parameters)
        if values:
            console.print(f"Fitted, median of the units: {values}.")
        if found.lookalikes:
            console.print(f"These units cannot tell it from: {', '.join(found.lookalikes)}.")
        if found.also:
            console.print(f"Missing beside it: {', '.join(found.also)}.")
        console.print(effect.physics)
        choices = [p for p in effect.parameters if p.choices and p.name in found.parameters]
        held = "".join(f", {p.name} = {found.parameters[p.name]:g}" for p in choices)
        console.print(
            f'To add it to the design: [[effect]] with kind = "{effect.kind}"{held} in '
            "zerodrift.toml, then zerodrift fleet."
        )
    elif found.verdict == "complete":
        console.print("COMPLETE: no effect that these units can test helps the design.")
    else:
        console.print(
            "UNKNOWN: something is missing in most units that no effect of the catalogue explains."
        )
        if found.nearest is not None:
            console.print(f"Nearest, and not all of it: {found.nearest}.")
    console.print(f"Evidence: {found.evidence}.")


def tell_difference(one: Difference, directory: Path) -> str:
    """Return a sentence on how a unit differs, and what to do."""
    z = f"z = {one.z:+.1f}"
    look = f"zerodrift diagnose --sensor {one.sensor}{name_directory(directory)}"
    if one.quantity == GAIN:
        return f"{one.sensor} lacks {one.effect}, the others do not ({z}). Look at it: {look}"
    what = f"{one.value:.3g} against {one.median:.3g} in the median unit ({z})"
    if one.quantity == ERROR:
        nearest = f", nearest {one.effect}" if one.effect else ""
        return f"{one.sensor}: the error is {what}, in noise floors{nearest}. Look at it: {look}"
    if one.quantity == SIZE:
        return f"{one.sensor}: {one.effect} is {what}, in noise floors. Look at it: {look}"
    return f"{one.sensor}: {one.effect} {one.quantity} is {what}. Look at it: {look}"
