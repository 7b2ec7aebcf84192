"""`zerodrift diagnose`: names the physical effect that the model lacks."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

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
    write_values,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from zerodrift.base.config import Config
    from zerodrift.diagnosis.diagnosis import Diagnosis
    from zerodrift.diagnosis.explained import Sentence
    from zerodrift.physics.catalogue import Catalogue

MOST_LISTED = 8
"""Candidates that the table lists; --json has all of them."""


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
    verdict is the name of an effect, with those that these logs cannot tell from it; or that
    nothing is missing; or that something is, which the catalogue does not know.

    In a fleet's folder all units of the design speak together, and those that differ are named;
    --sensor NAME diagnoses one unit.
    """
    from zerodrift.base.config import load_config
    from zerodrift.tasks.project import ProjectFolder, is_fleet, open_project

    if sensor is None and is_fleet(project := load_config(directory)):
        _diagnose_all(project, directory, auto, as_json, skip_invalid)
        return
    from zerodrift.diagnosis.advice import advise
    from zerodrift.diagnosis.changes import name_directory
    from zerodrift.physics.catalogue import load_catalogue
    from zerodrift.tasks.verdict import (
        explain_others,
        find_verdict,
        list_commands,
        summarise_verdict,
    )

    with show_progress() as say:
        config, dataset = open_project(ProjectFolder(directory, sensor, skip_invalid), say)
        catalogue = load_catalogue(config.plugin_files)
        verdict = find_verdict(config, dataset, catalogue, auto=auto, say=say)
        diagnosis, course = verdict.diagnosis, verdict.course
        say("looking at what the logs can teach")
        advice = advise(config, dataset, config.effects if course is None else course.effects)
    print_notes((*dataset.notes, *diagnosis.remarks))
    commands = list_commands(config.effects, verdict.steps, catalogue)
    if as_json:
        print_result(
            summarise_verdict(verdict, commands, advice.summarise() if advice else None, directory)
        )
        return
    console = open_console()
    written = ["" if one is None else one.write(directory) for one in commands]
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
    print_advice(advice, console)


def _diagnose_all(
    config: "Config", directory: Path, auto: bool, as_json: bool, skip_invalid: bool
) -> None:
    """Diagnose the design of a fleet by all of its units."""
    from zerodrift.base.errors import InputError
    from zerodrift.cli.diagnose_fleet import diagnose_fleet, print_fleet_diagnosis

    if auto:
        raise InputError(
            "diagnose --auto: found a fleet; expected one model. Name a unit by --sensor, or leave "
            "--auto out to see what all units lack."
        )
    with show_progress("looking for units") as say:
        found, catalogue = diagnose_fleet(config, skip_invalid, say)
    if as_json:
        print_result(found)
        return
    print_fleet_diagnosis(found, catalogue, directory, open_console())


def print_diagnosis(
    diagnosis: "Diagnosis", command: str, catalogue: "Catalogue", console: "Console"
) -> None:
    """Print the candidates and the errors, and then the verdict in sentences."""
    from zerodrift.diagnosis.diagnosis import write_probability

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


def _print_errors(diagnosis: "Diagnosis", console: "Console") -> None:
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


def explain_verdict(
    diagnosis: "Diagnosis", command: str, catalogue: "Catalogue"
) -> "list[Sentence]":
    """Return the verdict in sentences.

    Args:
        diagnosis: the result.
        command: the command line that adds the missing effect.
        catalogue: the known effects.
    """
    from zerodrift.diagnosis.diagnosis import LIKELY
    from zerodrift.diagnosis.explained import HEADLINE, STEP, Sentence

    floor = f"{diagnosis.floor_ratio_before:.2f} times the noise floor"
    if diagnosis.noise_floor_source != "dwell":
        floor += " (estimated)"
    sentences: list[Sentence] = []
    thin = " (thin evidence)" if diagnosis.evidence.startswith("thin") else ""
    if diagnosis.verdict == "missing" and diagnosis.effect is not None:
        effect = catalogue[diagnosis.effect]
        named = f"{effect.kind} ({effect.title}){diagnosis.tell_odds()}"
        sentences.append(Sentence(f"MISSING{thin}: {named}.", HEADLINE))
        values = write_values(effect, diagnosis.parameters)
        if values:
            sentences.append(Sentence(f"Fitted: {values}."))
        sentences.append(
            Sentence(
                f"Error in runs left out: {floor} now, "
                f"{diagnosis.floor_ratio_after:.2f} times with it.",
                HEADLINE,
            )
        )
        if diagnosis.lookalikes:
            names = ", ".join(diagnosis.lookalikes)
            sentences.append(Sentence(f"These logs cannot tell it from: {names}.", HEADLINE))
        if diagnosis.also:
            sentences.append(Sentence(f"Missing beside it: {', '.join(diagnosis.also)}.", HEADLINE))
        sentences.append(Sentence(effect.physics))
    elif diagnosis.verdict == "complete":
        sentences.append(
            Sentence(f"COMPLETE{thin}: no effect that these logs can test helps.", HEADLINE)
        )
        sentences.append(Sentence(f"Error in runs left out: {floor}.", HEADLINE))
    else:
        sentences.append(
            Sentence(
                f"UNKNOWN{thin}: something is missing that no effect of the catalogue explains.",
                HEADLINE,
            )
        )
        sentences.append(Sentence(f"Error in runs left out: {floor}.", HEADLINE))
        if diagnosis.nearest is not None:
            sentences.append(
                Sentence(f"Nearest, and not all of it: {diagnosis.nearest}.", HEADLINE)
            )
        sentences += [
            Sentence(
                f"What is left follows {pattern.follows} ({100.0 * pattern.share:.0f} % of it)."
            )
            for pattern in diagnosis.remainder
        ]
        if not diagnosis.remainder:
            sentences.append(Sentence("What is left follows no signal in the logs."))
        if not diagnosis.wrong_runs:
            sentences.append(Sentence("To look for a formula of it: zerodrift propose", STEP))
    if diagnosis.wrong_runs:
        runs = diagnosis.tell_wrong_runs()
        sentences.append(
            Sentence(
                f"First look at {runs}, whose data look wrong (see the notes): mend them or leave "
                "them out, then diagnose again.",
                STEP,
            )
        )
    sentences.append(Sentence(f"Evidence: {diagnosis.evidence}."))
    if diagnosis.next_experiment:
        sentences.append(Sentence(f"Next experiment: {diagnosis.next_experiment}."))
    if diagnosis.lookalikes:
        sentences.append(
            Sentence("To compute the experiment that tells them apart: zerodrift plan", STEP)
        )
    if diagnosis.effect is not None:
        sentences.append(Sentence(f"To add it: {command}", STEP))
        if diagnosis.something_else >= LIKELY:
            sentences.append(
                Sentence("Then, to look for a formula of what is left: zerodrift propose", STEP)
            )
        if thin:
            sentences.append(
                Sentence(
                    "On evidence this thin `add` may refuse it; --force keeps what the hardware "
                    "has."
                )
            )
    return sentences


def _print_steps(
    steps: "Sequence[Diagnosis]",
    commands: "Sequence[str]",
    catalogue: "Catalogue",
    console: "Console",
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
