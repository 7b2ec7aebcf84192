"""A project's beginning: a zerodrift.toml guessed from its logs, or brought up to date."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zerodrift.base.column_config import TimeConfig
from zerodrift.base.config import DWELL, FILE_NAME, TEST, TRAIN, Config, load_config, parse_config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.fleet_config import PLACEHOLDER
from zerodrift.base.journal import write_text
from zerodrift.base.progress import SILENT, Progress
from zerodrift.base.toml_edit import FORMAT_NOTE, set_columns, set_format
from zerodrift.dataset.chip_codes import (
    CLOCK,
    DESIGN_FORMAT,
    choose_input_codes,
    choose_temperature_codes,
    explain_stated,
    list_unstated,
)
from zerodrift.dataset.guess import Guess, GuessedOutput, SeenColumn, guess_project
from zerodrift.dataset.guess_runs import LogFiles
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.dataset.selectors import JOINT
from zerodrift.dataset.survey import write_range
from zerodrift.fleet.sensors import configure_sensor, find_sensors, list_selectors
from zerodrift.physics.fit import fit_config
from zerodrift.report.results import GuessedColumns, InitColumn, InitResult
from zerodrift.tasks.trust import claim

if TYPE_CHECKING:
    from zerodrift.report.results import UpgradeResult


# The text of a zerodrift.toml that `init` writes, and the table of the columns it found.

TARED = "logs.tared"
"""Key of `Guess.alternatives`: why the logs look tared."""


def write_config(guess: Guess, selectors: Mapping[str, Sequence[str]]) -> str:
    """Return the text of a zerodrift.toml; every value that was guessed can be edited in place."""
    check = guess.alternatives
    usual = "  # column, degC: the chip's own thermometer"
    lines = [
        "# The sensor, its logs and its model. Guessed from the logs: check every line, and those",
        "# with `# check:` first, which name what else it may be.",
        f"format = {DESIGN_FORMAT}{FORMAT_NOTE}",
        "",
        "[sensor]",
        f"name = {_quote(guess.sensor_name)}  # prefix of the C names",
        *_write_time(guess),
        f"temperature = {_write_temperature(guess)}{_write_check(check, 'temperature') or usual}",
        "# The firmware's step: finer logs are averaged to it, coarser ones refused.",
        f"sample_period_s = {guess.sample_period_s!r}{_write_check(check, 'sample_period_s')}",
    ]
    for output in guess.outputs:
        lines += ["", *_write_output(output, check)]
    lines += [
        "",
        "[inputs]  # optional channels, by the name that effects use; lsb: what one code is worth",
    ]
    lines += [_write_input(guess, name) for name in guess.inputs]
    if not guess.inputs:
        lines.append('# supply = "supply_V"')
    lines += ["", *_write_logs(guess, selectors)]
    lines += [
        "",
        "[[effect]]  # the physical model; `zerodrift effects` lists what there is",
        'kind = "zero_tempco"',
        "",
        "[network]  # learns the rest: lag_bank | gru | lstm | mlp | mlp_seq | tcn | none | auto",
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


def write_selectors(logs: Sequence[LogFiles], directory: Path) -> list[str]:
    """Return the runs as `[logs]` selects them."""
    return [
        _write_path(log.path, directory)
        if len(log.files) == 1 or log.path.is_dir()
        else JOINT.join(_write_path(file, directory) for file in log.files)
        for log in logs
    ]


def render_seen(seen: Sequence[SeenColumn]) -> list[str]:
    """Return the table of the columns: name, role, unit, range, why."""
    rows = [("column", "role", "unit", "range", "why")]
    several = len({column.file for column in seen}) > 1
    for column in seen:
        name = f"{column.file}: {column.column}" if several else column.column
        low, high = column.low, column.high
        span = "" if low is None or high is None else write_range(low, high)
        rows.append((name, column.role, column.unit or "-", span, column.why))
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    return [
        "  " + "  ".join([*(f"{row[k]:<{widths[k]}}" for k in range(4)), row[4]]).rstrip()
        for row in rows
    ]


def _write_path(path: Path, directory: Path) -> str:
    return Path(os.path.relpath(path, directory)).as_posix()


def _write_check(alternatives: Mapping[str, tuple[str, ...]], key: str, before: str = "or ") -> str:
    """Return the comment that names the alternatives to a key's value, or nothing."""
    found = alternatives.get(key)
    return f"  # check: {before}{' | '.join(found)}" if found else ""


def _write_temperature(guess: Guess) -> str:
    if not guess.temperature_unit:
        return _quote(guess.temperature)
    return f"{{ column = {_quote(guess.temperature)}, unit = {_quote(guess.temperature_unit)} }}"


def _write_input(guess: Guess, name: str) -> str:
    column = _quote(guess.inputs[name])
    if guess.inputs[name] not in guess.codes or name == CLOCK:
        return f"{_write_key(name)} = {column}"
    raw, lsb = guess.codes[guess.inputs[name]]
    unit = find_temperature_unit(guess, guess.inputs[name])
    stated = f"unit = {_quote(unit)}, " if unit else ""
    return f'{_write_key(name)} = {{ column = {column}, {stated}raw = "{raw}", lsb = {lsb!r} }}'


def find_temperature_unit(guess: Guess, column: str) -> str:
    """Return degF or K where a column is a temperature in that, else nothing."""
    units = [seen.unit for seen in guess.seen if seen.column == column]
    return units[0] if units and units[0] in ("degF", "K") else ""


def _write_time(guess: Guess) -> list[str]:
    if not guess.time.columns:
        return ["# time: none in the logs; [logs] period_s says how far apart rows are"]
    check = _write_check(guess.alternatives, "time")
    usual = "" if check else "  # column: seconds, the unit that its name states, or dates"
    return [f"time = {_write_time_table(guess.time)}{check or usual}"]


def _write_time_table(time: TimeConfig) -> str:
    several = len(time.columns) > 1
    column = json.dumps(list(time.columns), ensure_ascii=False) if several else _quote(time.name)
    more = [
        f"{key} = {_quote(value)}"
        for key, value in (("unit", time.unit), ("format", time.format), ("zone", time.zone))
        if value
    ]
    return (
        column if not more and not several else f"{{ {', '.join([f'column = {column}', *more])} }}"
    )


def _write_output(output: GuessedOutput, check: Mapping[str, tuple[str, ...]]) -> list[str]:
    key = f"outputs.{output.name}"
    reference = "# reference = 0  # a column, or a number; left out = 0"
    if isinstance(output.reference, str):
        reference = (
            f"reference = {_quote(output.reference)}  # the true value: a column or a number"
        )
    elif output.reference is not None:
        reference = f"reference = {output.reference!r}{_write_check(check, f'{key}.reference')}"
    return [
        f"[outputs.{_write_key(output.name)}]",
        f"measured = {_quote(output.measured)}"
        f"{_write_check(check, f'{key}.measured') or '  # column before compensation'}",
        reference,
        f"unit = {_quote(output.unit)}{_write_check(check, f'{key}.unit')}",
        f"full_scale = {output.full_scale:g}  # a guess from the largest value in the log",
    ]


def _write_logs(guess: Guess, selectors: Mapping[str, Sequence[str]]) -> list[str]:
    lines = ["[logs]  # globs; one file or folder is one run, or a `run` column splits a file"]
    lines.append(f"train = {json.dumps(list(selectors[TRAIN]), ensure_ascii=False)}")
    if selectors[TEST]:
        lines.append(f"test = {json.dumps(list(selectors[TEST]), ensure_ascii=False)}")
    else:
        lines.append('# test = ["logs/walk_*.csv"]  # left out: one run is left out at a time')
    if selectors[DWELL]:
        lines.append(f"dwell = {json.dumps(list(selectors[DWELL]), ensure_ascii=False)}")
    else:
        lines.append('# dwell = ["logs/dwell.csv"]  # isothermal, unloaded: sets the noise floor')
    if TARED in guess.alternatives:
        lines.append(f"# tared = true{_write_check(guess.alternatives, TARED, before='')}")
    if guess.period_by_hand_s is not None:
        lines.append(
            f"period_s = {guess.period_by_hand_s!r}  # rows without times are so far apart"
        )
    if guess.times_by_file:
        tables = ", ".join(
            f"{_quote(name)} = {_write_time_table(time)}"
            for name, time in guess.times_by_file.items()
        )
        lines.append(f"time = {{ {tables} }}  # files whose times are another column")
    if any(len(log.files) > 1 for log in guess.logs):
        names = list(dict.fromkeys(column.file for column in guess.seen))
        lines.append(
            f"# offset_s = {{ {_quote(names[-1])} = 0.0 }}  # a clock's offset, which data cannot "
            "tell from a lag"
        )
    lines += _propose_fleet(guess, selectors)
    for column, values in guess.groups.items():
        example = f"{{ {_write_key(column)} = {_quote(values[0])} }}"
        lines.append(f"# where = {example}  # one of: {', '.join(values[:8])}")
    return lines


def _propose_fleet(guess: Guess, selectors: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the comment by which folders of runs, side by side, become the units of a fleet."""
    units = {log.path.parent for log in guess.logs}
    tops = {unit.parent for unit in units}
    first = Path(selectors[TRAIN][0]) if selectors[TRAIN] else Path()
    if len(units) < 2 or len(tops) > 1 or len(first.parts) < 3:
        return []
    place = "/".join(first.parts[:-2])
    return [
        f"# [fleet] folder = {_quote(place + '/{sensor}')}  # if each folder there is a unit of its"
        f" own; train is then by names within it, such as {_quote(first.name)}"
    ]


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _write_key(key: str) -> str:
    is_bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if is_bare else _quote(key)


# `zerodrift init --upgrade`: codes that the logs decided so far are written into the project.

THERMOMETER = "[sensor] temperature"


def upgrade(directory: Path, progress: Progress = SILENT) -> "UpgradeResult":
    """Write the codes that zerodrift.toml leaves to the logs into it, and its format.

    They are the codes that followed from the training logs so far, in a fleet the codes that hold
    the logs of all units; from then on they no longer depend on unit or logs.

    Raises:
        InputError: a log cannot be read, or the file's layout is not understood.
    """
    from zerodrift.report.results import UpgradedInput, UpgradeResult

    config = load_config(directory)
    units = _list_units(config)
    kept = {name: why for name in config.inputs if (why := explain_stated(config, name))}
    wanted = list_unstated(config)
    by_logs = _asks_for_thermometer(config)
    changed = {}
    path = directory / FILE_NAME
    before = text = path.read_text(encoding="utf-8")
    if wanted or by_logs:
        runs = []
        for number, unit in enumerate(units, 1):
            if len(units) > 1:
                progress(f"reading the logs of unit {number} of {len(units)}")
            runs += _read_extremes(unit, wanted)
        former = replace(config, format=1)
        for name in wanted:
            codes = choose_input_codes(former, name, runs)
            raw = config.input_codes[name].raw or f"int{codes.bits}"
            changed[name] = UpgradedInput(config.inputs[name], raw, codes.lsb)
        if wanted:
            keys = {n: {"raw": c.raw, "lsb": c.lsb} for n, c in changed.items()}
            text = set_columns(text, keys, path)
        if by_logs:
            lsb = choose_temperature_codes(former, runs).lsb
            changed[THERMOMETER] = UpgradedInput(config.temperature_column, "int16", lsb)
            text = set_columns(text, {"temperature": {"lsb": lsb}}, path, "sensor")
    if config.format < DESIGN_FORMAT:
        text = set_format(text, DESIGN_FORMAT)
    if text != before:
        _confirm(parse_config(text, path.absolute()), config, path)
        write_text(path, text)
    return UpgradeResult(
        file=str(path),
        units=len(units),
        changed=changed,
        kept=kept,
        format_before=config.format,
        format=DESIGN_FORMAT,
    )


def describe(result: "UpgradeResult") -> str:
    """Return what was done, line by line."""
    whose = "its logs" if result.units == 1 else f"the logs of {result.units} units"
    lines = [
        f'{name}: raw = "{one.raw}", lsb = {one.lsb:.10g}: what {whose} chose, now the same for'
        " every unit"
        for name, one in result.changed.items()
    ]
    lines += [f"{name}: left as it is: {why}" for name, why in result.kept.items()]
    if THERMOMETER not in result.changed:
        lines.append("temperature: left as it is: its lsb does not follow from logs")
    if result.format_before == result.format and not result.changed:
        return "\n".join([*lines, f"{result.file}: nothing to upgrade, and nothing written"])
    if result.format_before != result.format:
        lines.append(
            f"format = {result.format}: from now on logs have no say in what a code is worth"
        )
    return "\n".join([*lines, f"wrote {result.file}", "next: zerodrift firmware"])


def _asks_for_thermometer(config: Config) -> bool:
    """Tell whether the thermometer's lsb follows from logs: int16 is all that is stated."""
    stated = config.temperature_codes
    return config.format < DESIGN_FORMAT and stated.bits == 16 and stated.lsb is None


def _list_units(config: Config) -> list[Config]:
    is_fleet = bool(config.fleet.folder) or any(
        PLACEHOLDER in text for text in list_selectors(config, "train")
    )
    if not is_fleet:
        return [config]
    return [configure_sensor(config, sensor) for sensor in find_sensors(config)]


def _read_extremes(config: Config, names: Sequence[str]) -> list[Run]:
    """Return the training runs, reduced to the lowest and the highest value of each input."""
    runs = load_dataset(config).train
    ends = [{n: np.array([r.inputs[n].min(), r.inputs[n].max()]) for n in names} for r in runs]
    return [replace(run, inputs=own) for run, own in zip(runs, ends, strict=True)]


def _confirm(after: Config, before: Config, path: Path) -> None:
    """Raise where an edit changed more than codes."""
    if _strip_codes(after, path) != _strip_codes(before, path):
        raise InputError(
            f"{path}: its layout is not understood well enough to edit it; expected [inputs] with "
            "one key to a line. Write raw and lsb by hand."
        )


def _strip_codes(config: Config, path: Path) -> Config:
    """Return a project without what an upgrade may change."""
    codes = {n: replace(c, bits=None, lsb=None) for n, c in config.input_codes.items()}
    own = replace(config.temperature_codes, lsb=None)
    effects = tuple(replace(effect, line=0) for effect in config.effects)
    return replace(
        config, input_codes=codes, temperature_codes=own, effects=effects, format=1, path=path
    )


# A project's beginning: a zerodrift.toml guessed from its logs, or brought up to date.

NOT_YET = "the logs cannot be used yet"
#: Use -> words in a log's name that suggest it.
USE_WORDS = {"dwell": ("dwell", "isothermal", "noise"), "test": ("test", "walk", "valid")}


@dataclass(frozen=True)
class InitRequest:
    """Which logs a project begins with."""

    directory: Path
    """Of the zerodrift.toml to be written."""
    logs: tuple[Path, ...]
    """Files or folders, seen from the current directory, then from the project's."""
    force: bool = False
    """Overwrite an existing zerodrift.toml."""
    period_s: float | None = None
    """Interval between rows, for logs without times."""

    def __post_init__(self) -> None:
        """Refuse a beginning without a log, or over a project that there is.

        Raises:
            InputError: as said.
        """
        if not self.logs:
            raise InputError(
                "init: no log is named; expected files or folders to guess from, such as"
                " `zerodrift init logs/`, or --upgrade for a project that there is."
            )
        if self.target.exists() and not self.force:
            raise InputError(f"{self.target}: exists already; --force overwrites it.")

    @property
    def target(self) -> Path:
        """The file that is written."""
        return self.directory / FILE_NAME


@dataclass(frozen=True)
class InitOutcome:
    """What was guessed, and written."""

    target: Path
    guess: Guess
    selectors: dict[str, list[str]]
    """train | test | dwell -> selectors."""

    @property
    def result(self) -> InitResult:
        """As the command prints it."""
        guess = self.guess
        return InitResult(
            file=str(self.target),
            time=guess.time.name,
            temperature=guess.temperature,
            sample_period_s=guess.sample_period_s,
            outputs={
                o.name: GuessedColumns(o.measured, o.reference, o.unit, o.full_scale)
                for o in guess.outputs
            },
            inputs=guess.inputs,
            logs={use: tuple(files) for use, files in self.selectors.items()},
            check=tuple(guess.checks),
            columns=tuple(
                InitColumn(c.file, c.column, c.role, c.unit, c.low, c.high, c.why)
                for c in guess.seen
            ),
        )


def begin(request: InitRequest, ask: Callable[[Guess], Guess] = lambda guess: guess) -> InitOutcome:
    """Write a commented zerodrift.toml guessed from logs.

    Args:
        request: which logs, and where.
        ask: returns the guess with the user's answers.

    Raises:
        InputError: the logs cannot be read, or hold nothing that can be guessed.
    """
    directory, target = request.directory, request.target
    places = [log if log.exists() else directory / log for log in request.logs]
    guess = ask(guess_project(places, request.period_s, directory))
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
    return InitOutcome(target, guess, selectors)


def _explain_tare(config: Config, dataset: Dataset) -> str:
    """Return why the logs look as if each had been zeroed by itself; "" where they do not.

    What cannot be fitted yet is left to the next command, which names it.
    """
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
