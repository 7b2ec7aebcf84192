"""`zerodrift init LOG...`: a commented zerodrift.toml guessed from the logs."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.base.clock_config import TIME_UNITS
from zerodrift.base.config import FILE_NAME, TRAIN, Config, parse_config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.journal import write_text
from zerodrift.cli.common import directory_option, json_option, print_result
from zerodrift.cli.console import show_progress
from zerodrift.dataset.guess import Guess, guess_project
from zerodrift.dataset.guess_runs import LogFiles
from zerodrift.tasks.init_toml import (
    TARED,
    find_temperature_unit,
    render_seen,
    write_config,
    write_selectors,
)
from zerodrift.tasks.trust import claim

if TYPE_CHECKING:
    from zerodrift.dataset.runs import Dataset
    from zerodrift.report.results import InitResult

NOT_YET = "the logs cannot be used yet"
#: Use -> words in a log's name that suggest it.
USE_WORDS = {"dwell": ("dwell", "isothermal", "noise"), "test": ("test", "walk", "valid")}


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
    then in DIR. Columns are told by name, unit and values: time_s, temperature_degC, Fz_N,
    ref_Fz_N, supply_V. What was seen is printed, and what to check; in the file, `# check:` names
    what else a value may be.

    --upgrade takes no LOG and guesses nothing. Where a project leaves the codes of its inputs to
    its logs, so that units of one design may get different ones, those chosen so far are written
    down: of a fleet those that hold the logs of every unit.
    """
    from zerodrift.dataset.load import load_dataset

    target = directory / FILE_NAME
    if is_upgrade:
        if logs or force or interactive or period_s is not None:
            raise InputError(
                "init --upgrade: reads the logs that zerodrift.toml names and guesses nothing; "
                "expected no LOG, --force, --interactive or --period-s beside it. Take them out."
            )
        _upgrade(directory, as_json)
        return
    if not logs:
        raise InputError(
            "init: no log is named; expected files or folders to guess from, such as `zerodrift "
            "init logs/`, or --upgrade for a project that there is."
        )
    if target.exists() and not force:
        raise InputError(f"{target}: exists already; --force overwrites it.")
    places = [log if log.exists() else directory / log for log in logs]
    guess = guess_project(places, period_s, directory)
    if interactive:
        guess = ask(guess)
    uses = _sort_by_use(guess.logs)
    selectors = {use: write_selectors(runs, directory) for use, runs in uses.items()}
    if len(guess.logs) == 1 and len(guess.runs) < 2:
        only = selectors[TRAIN][0]
        selectors = {"train": [f"{only}@0%:60%"], "test": [f"{only}@60%:100%"], "dwell": []}
    text = write_config(guess, selectors)
    config = parse_config(text, target.absolute())
    try:
        told = _explain_tare(config, load_dataset(config))
    except InputError as error:
        guess = replace(guess, refused=str(error), checks=(*guess.checks, f"{NOT_YET}: {error}"))
    else:
        if told:
            guess = replace(
                guess,
                checks=(*guess.checks, f"[logs] tared is not stated: {told}"),
                alternatives={**guess.alternatives, TARED: (told,)},
            )
            text = write_config(guess, selectors)
    write_text(target, text)
    claim(directory)
    if as_json:
        print_result(_summarise(target, guess, selectors))
        return
    click.echo(_describe_guess(target, guess, selectors))


def _explain_tare(config: Config, dataset: "Dataset") -> str:
    """Return why the logs look as if each had been zeroed by itself; "" where they do not.

    What cannot be fitted yet is left to the next command, which names it.
    """
    import numpy as np

    from zerodrift.physics.fit import fit_config

    try:
        model = fit_config(config, dataset)
    except ZerodriftError:
        return ""
    if not model.tared:
        return ""
    spread = [float(x) for x in np.std([*model.offsets.values()], axis=0)]
    named = ", ".join(
        f"{name} {x:.2g} {unit}"
        for name, unit, x in zip(dataset.outputs, dataset.units, spread, strict=True)
    )
    return (
        f"at the same temperature the runs differ by offsets of their own ({named} RMS): true if"
        " each log was zeroed by itself, false if these are errors of the sensor"
    )


def _upgrade(directory: Path, as_json: bool) -> None:
    from zerodrift.tasks.upgrade import describe, upgrade

    with show_progress() as progress:
        result = upgrade(directory, progress)
    if as_json:
        print_result(result)
    else:
        click.echo(describe(result))


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


def _sort_by_use(logs: Sequence[LogFiles]) -> dict[str, list[LogFiles]]:
    """Sort logs into train, test and dwell by words in their names; never leave train empty."""
    uses: dict[str, list[LogFiles]] = {"train": [], "test": [], "dwell": []}
    for log in logs:
        name = log.path.stem.lower()
        found = [use for use, words in USE_WORDS.items() if any(word in name for word in words)]
        uses[found[0] if found else "train"].append(log)
    if not uses[TRAIN]:
        return {"train": list(logs), "test": [], "dwell": []}
    return uses


def _summarise(target: Path, guess: Guess, selectors: dict[str, list[str]]) -> "InitResult":
    from zerodrift.report.results import GuessedColumns, InitColumn, InitResult

    return InitResult(
        file=str(target),
        time=guess.time.name,
        temperature=guess.temperature,
        sample_period_s=guess.sample_period_s,
        outputs={
            o.name: GuessedColumns(o.measured, o.reference, o.unit, o.full_scale)
            for o in guess.outputs
        },
        inputs=guess.inputs,
        logs={use: tuple(files) for use, files in selectors.items()},
        check=tuple(guess.checks),
        columns=tuple(
            InitColumn(c.file, c.column, c.role, c.unit, c.low, c.high, c.why) for c in guess.seen
        ),
    )


def _describe_guess(target: Path, guess: Guess, selectors: dict[str, list[str]]) -> str:
    time = guess.time.name or "none"
    lines = [
        *render_seen(guess.seen),
        f"wrote {target}",
        f"  time         {time}, a row every {guess.sample_period_s:g} s",
        f"  temperature  {guess.temperature}",
    ]
    lines += [
        f"  output       {output.name} in {output.unit}: {output.measured} against "
        f"{output.reference or 0}, full scale {output.full_scale:g} {output.unit}"
        for output in guess.outputs
    ]
    lines += [f"  input        {name}: {column}" for name, column in guess.inputs.items()]
    lines += [f"  {use:<12} {', '.join(files)}" for use, files in selectors.items() if files]
    lines += [f"check: {check}" for check in guess.checks]
    begin = "mend what the logs do not allow yet, then " if guess.refused else ""
    return "\n".join([*lines, f"next: {begin}zerodrift compare"])
