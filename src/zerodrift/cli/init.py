"""`zerodrift init LOG...`: a commented zerodrift.toml guessed from the logs."""

import re
from dataclasses import replace
from pathlib import Path

import click

from zerodrift.base.column_config import TIME_UNITS
from zerodrift.base.config import FILE_NAME
from zerodrift.base.errors import InputError
from zerodrift.cli.common import directory_option, json_option, print_result
from zerodrift.cli.console import show_progress
from zerodrift.dataset.guess import Guess
from zerodrift.tasks.init import (
    InitOutcome,
    InitRequest,
    begin,
    describe,
    find_temperature_unit,
    render_seen,
    upgrade,
)


@click.command()
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path), metavar="[LOG...]")
@directory_option
@click.option("--force", is_flag=True, help=f"Overwrite an existing {FILE_NAME}.")
@click.option(
    "--period-s",
    type=click.FloatRange(min=0, min_open=True),
    default=None,
    metavar="SECONDS",
    help="Interval between rows, for logs without times.",
)
@click.option("--interactive", is_flag=True, help="Ask wherever there is a choice.")
@click.option(
    "--upgrade",
    "is_upgrade",
    is_flag=True,
    help=f"Write into an existing {FILE_NAME} what its logs chose so far: the codes of inputs.",
)
@json_option
def command(
    logs: tuple[Path, ...],
    directory: Path,
    force: bool,
    period_s: float | None,
    interactive: bool,
    is_upgrade: bool,
    as_json: bool,
) -> None:
    """Write a commented zerodrift.toml guessed from LOG...

    A LOG is a file, or a folder: of runs, of folders of runs, or of the files that are one run
    together, say a meter's and a climate logger's; names are looked up in the current directory,
    then in DIR. Columns are known by name, unit of measure and values: time_s, temperature_degC,
    Fz_N, ref_Fz_N, supply_V. What was seen is printed, and what to check; in the file, `# check:`
    names what else a value may be.

    --upgrade takes no LOG and guesses nothing. Where a project leaves the codes of its inputs to
    its logs, so that units of one design may get different ones, those chosen so far are written
    down: of a fleet those that hold the logs of every unit.
    """
    if is_upgrade:
        if logs or force or interactive or period_s is not None:
            raise InputError(
                "init --upgrade: reads the logs that zerodrift.toml names and guesses nothing; "
                "expected no LOG, --force, --interactive or --period-s beside it. Take them out."
            )
        with show_progress() as progress:
            upgraded = upgrade(directory, progress)
        if as_json:
            print_result(upgraded)
        else:
            click.echo(describe(upgraded))
        return
    request = InitRequest(directory, logs, force, period_s)
    found = begin(request, ask) if interactive else begin(request)
    if as_json:
        print_result(found.result)
    else:
        click.echo(_describe_guess(found))


def ask(guess: Guess) -> Guess:
    """Return the guess with the user's answers wherever there is a choice."""
    click.echo("\n".join(render_seen(guess.seen)))
    guess = _ask_time(guess)
    found = guess.alternatives.get("temperature", ())
    others = tuple(name for name in found if name[:1] != "{")
    alternatives = dict(guess.alternatives)
    if others:
        names = (guess.temperature, *others)
        chosen = click.prompt("thermometer on the chip", default=names[0], type=click.Choice(names))
        inputs = {name: column for name, column in guess.inputs.items() if column != chosen}
        if chosen != guess.temperature:
            inputs["thermometer"] = guess.temperature
        unit = find_temperature_unit(guess, chosen)
        guess = replace(guess, temperature=chosen, temperature_unit=unit, inputs=inputs)
        alternatives.update(temperature=found[len(others) :])
    outputs = []
    for output in guess.outputs:
        if len(guess.outputs) > 1 and not click.confirm(
            f"{output.measured}: does it drift, and is it to be compensated?", default=True
        ):
            continue
        alternatives.pop(f"outputs.{output.name}.measured", None)
        if f"outputs.{output.name}.unit" in guess.alternatives:
            unit = click.prompt(f"unit of {output.measured}", default=output.unit)
            output = replace(output, unit=unit, unit_from="you")  # noqa: PLW2901
            alternatives.pop(f"outputs.{output.name}.unit")
        if f"outputs.{output.name}.reference" in guess.alternatives:
            true = click.prompt(
                f"true value of {output.measured}", default=output.reference, type=float
            )
            output = replace(output, reference=true)  # noqa: PLW2901
            alternatives.pop(f"outputs.{output.name}.reference")
        outputs.append(output)
    period_s = click.prompt(
        "sample period in seconds",
        default=guess.sample_period_s,
        type=click.FloatRange(min=0, min_open=True),
    )
    alternatives.pop("sample_period_s", None)
    if not outputs:
        raise InputError("init --interactive: no output is left; expected one at least.")
    return replace(
        guess, outputs=tuple(outputs), sample_period_s=period_s, alternatives=alternatives
    )


def _ask_time(guess: Guess) -> Guess:
    """Return the guess with the format, unit or zone of its times that the user chose."""
    found = guess.alternatives.get("time")
    if not found:
        return guess
    time, period_s = guess.time, guess.sample_period_s
    formats = [
        match[1] for match in (re.match(r'format = "(.*?)"', each) for each in found) if match
    ]
    if formats:
        choices = click.Choice([time.format, *formats])
        written = click.prompt(f"'{time.name}' is written", default=time.format, type=choices)
        time = replace(time, format=written)
    elif time.zone:
        time = replace(time, zone=click.prompt("zone of the clock without one", default=time.zone))
    else:
        units = click.Choice(list(TIME_UNITS))
        unit = click.prompt(f"unit of '{time.name}'", default=time.unit or "s", type=units)
        period_s = float(f"{period_s * TIME_UNITS[unit] / TIME_UNITS[time.unit or 's']:.6g}")
        time = replace(time, unit=unit)
    left = {key: each for key, each in guess.alternatives.items() if key != "time"}
    return replace(guess, time=time, sample_period_s=period_s, alternatives=left)


def _describe_guess(found: InitOutcome) -> str:
    guess = found.guess
    time = guess.time.name or "none"
    lines = [
        *render_seen(guess.seen),
        f"wrote {found.target}",
        f"  time         {time}, a row every {guess.sample_period_s:g} s",
        f"  temperature  {guess.temperature}",
    ]
    lines += [
        f"  output       {output.name} in {output.unit}: {output.measured} against "
        f"{output.reference or 0}, full scale {output.full_scale:g} {output.unit}"
        for output in guess.outputs
    ]
    lines += [f"  input        {name}: {column}" for name, column in guess.inputs.items()]
    lines += [f"  {use:<12} {', '.join(files)}" for use, files in found.selectors.items() if files]
    lines += [f"check: {check}" for check in guess.checks]
    begin = "mend what the logs do not allow yet, then " if guess.refused else ""
    return "\n".join([*lines, f"next: {begin}zerodrift compare"])
