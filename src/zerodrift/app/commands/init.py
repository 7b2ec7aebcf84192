"""`zerodrift init LOG...`: a commented zerodrift.toml guessed from the logs' headers."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.app.commands.common import directory_option, json_option, print_result
from zerodrift.base.clock_config import TIME_UNITS
from zerodrift.base.config import FILE_NAME, parse_config
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_text
from zerodrift.dataset.guess import Guess, GuessedOutput, guess_project
from zerodrift.dataset.selectors import CSV_SUFFIXES, PARQUET_SUFFIXES, order_path

if TYPE_CHECKING:
    from zerodrift.report.results import InitResult

#: Use -> words in a log's name that suggest it.
USE_WORDS = {"dwell": ("dwell", "isothermal", "noise"), "test": ("test", "walk", "valid")}


@click.command()
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="LOG...")
@directory_option
@click.option("--force", is_flag=True, help=f"Overwrite an existing {FILE_NAME}.")
@json_option
def command(logs: tuple[Path, ...], directory: Path, force: bool, as_json: bool) -> None:
    """Write a commented zerodrift.toml guessed from the headers of LOG...

    A LOG is a CSV or Parquet file, or a directory of them; names are looked up in the current
    directory, then in DIR. Columns are recognised by name and unit: time_s, temperature_degC,
    Fz_N, ref_Fz_N, supply_V. What was guessed is printed, with what to check.
    """
    target = directory / FILE_NAME
    if target.exists() and not force:
        raise InputError(f"{target}: exists already; --force overwrites it.")
    paths = find_logs(logs, directory)
    uses = _sort_by_use(paths)
    guess = guess_project(uses["train"])
    selectors = {use: _write_selectors(files, directory) for use, files in uses.items()}
    if len(paths) == 1 and len(guess.runs) < 2:
        only = selectors["train"][0]
        selectors = {"train": [f"{only}@0%:60%"], "test": [f"{only}@60%:100%"], "dwell": []}
    text = write_config(guess, selectors)
    parse_config(text, target.absolute())
    write_text(target, text)
    if as_json:
        print_result(_summarise(target, guess, selectors))
        return
    click.echo(_describe_guess(target, guess, selectors))


def write_config(guess: Guess, selectors: dict[str, list[str]]) -> str:
    """Return the text of a zerodrift.toml; every value that was guessed can be edited in place."""
    lines = [
        "# The sensor, its logs and its model. Guessed from the logs' headers: check every line.",
        "",
        "[sensor]",
        f"name = {_quote(guess.sensor_name)}  # prefix of the C names",
        _write_time(guess),
        f"temperature = {_quote(guess.temperature)}  # column, degC: the chip's own thermometer",
        "# The firmware's step: finer logs are averaged to it, coarser ones refused.",
        f"sample_period_s = {guess.sample_period_s!r}",
    ]
    for output in guess.outputs:
        lines += ["", *_write_output(output)]
    lines += ["", "[inputs]  # optional channels, by the name that effects use"]
    lines += [f"{_write_key(name)} = {_quote(column)}" for name, column in guess.inputs.items()]
    if not guess.inputs:
        lines.append('# supply = "supply_V"')
    lines += ["", "[logs]  # globs; one file is one run, or a `run` column splits a file"]
    lines.append(f"train = {json.dumps(selectors['train'], ensure_ascii=False)}")
    if selectors["test"]:
        lines.append(f"test = {json.dumps(selectors['test'], ensure_ascii=False)}")
    else:
        lines.append('# test = ["logs/walk_*.csv"]  # left out: one run is left out at a time')
    if selectors["dwell"]:
        lines.append(f"dwell = {json.dumps(selectors['dwell'], ensure_ascii=False)}")
    else:
        lines.append('# dwell = ["logs/dwell.csv"]  # isothermal, unloaded: sets the noise floor')
    for column, values in guess.groups.items():
        example = f"{{ {_write_key(column)} = {_quote(values[0])} }}"
        lines.append(f"# where = {example}  # one of: {', '.join(values[:8])}")
    lines += [
        "",
        "[[effect]]  # the physical model; `zerodrift effects` lists what there is",
        'kind = "zero_tempco"',
        "",
        "[network]  # learns what physics leaves: lag_bank | gru | mlp | mlp_seq | tcn | none",
        'kind = "lag_bank"',
        "",
        "[quantization]",
        'weights = "int16"  # int16 | int8',
        "",
        "[firmware]",
        'out = "firmware"',
        "",
    ]
    return "\n".join(lines)


def _write_time(guess: Guess) -> str:
    if not guess.time_unit:
        return f"time = {_quote(guess.time)}  # column, seconds, or the unit that its name states"
    others = " | ".join(unit for unit in TIME_UNITS if unit != guess.time_unit)
    table = f"{{ column = {_quote(guess.time)}, unit = {_quote(guess.time_unit)} }}"
    return f"time = {table}  # check: or {others}, and then another sample_period_s"


def _write_output(output: GuessedOutput) -> list[str]:
    reference = "# reference = 0  # a column, or a number; left out = 0"
    if output.reference:
        reference = (
            f"reference = {_quote(output.reference)}  # the true value: a column or a number"
        )
    return [
        f"[outputs.{_write_key(output.name)}]",
        f"measured = {_quote(output.measured)}  # column before compensation",
        reference,
        f"unit = {_quote(output.unit)}",
        f"full_scale = {output.full_scale:g}  # a guess from the largest value in the log",
    ]


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _write_key(key: str) -> str:
    is_bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if is_bare else _quote(key)


def find_logs(logs: Sequence[Path], directory: Path) -> list[Path]:
    """Return the files named, and those of each directory named, sorted by name."""
    paths: list[Path] = []
    for log in logs:
        place = log if log.exists() else directory / log
        if place.is_dir():
            found = [
                path
                for path in place.iterdir()
                if path.suffix.lower() in CSV_SUFFIXES + PARQUET_SUFFIXES
            ]
            if not found:
                raise InputError(f"{place}: holds no log; expected CSV or Parquet files.")
            paths += found
        else:
            paths.append(place)
    return sorted(set(paths), key=lambda path: order_path(path, directory))


def _sort_by_use(paths: Sequence[Path]) -> dict[str, list[Path]]:
    """Sort logs into train, test and dwell by words in their names; never leave train empty."""
    uses: dict[str, list[Path]] = {"train": [], "test": [], "dwell": []}
    for path in paths:
        name = path.stem.lower()
        found = [use for use, words in USE_WORDS.items() if any(word in name for word in words)]
        uses[found[0] if found else "train"].append(path)
    if not uses["train"]:
        return {"train": list(paths), "test": [], "dwell": []}
    return uses


def _write_selectors(paths: Sequence[Path], directory: Path) -> list[str]:
    return [Path(os.path.relpath(path, directory)).as_posix() for path in paths]


def _summarise(target: Path, guess: Guess, selectors: dict[str, list[str]]) -> "InitResult":
    from zerodrift.report.results import GuessedColumns, InitResult

    return InitResult(
        file=str(target),
        time=guess.time,
        temperature=guess.temperature,
        sample_period_s=guess.sample_period_s,
        outputs={
            o.name: GuessedColumns(o.measured, o.reference, o.unit, o.full_scale)
            for o in guess.outputs
        },
        inputs=guess.inputs,
        logs={use: tuple(files) for use, files in selectors.items()},
        check=tuple(guess.checks),
    )


def _describe_guess(target: Path, guess: Guess, selectors: dict[str, list[str]]) -> str:
    lines = [
        f"wrote {target}",
        f"  time         {guess.time}, a row every {guess.sample_period_s:g} s",
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
    return "\n".join([*lines, "next: zerodrift compare"])
