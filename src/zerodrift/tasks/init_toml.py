"""The text of a zerodrift.toml that `init` writes, and the table of the columns it found."""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from zerodrift.base.clock_config import TimeConfig
from zerodrift.base.config import DWELL, TEST, TRAIN
from zerodrift.base.toml_inputs import FORMAT_NOTE
from zerodrift.dataset.code_format import CLOCK
from zerodrift.dataset.design_codes import DESIGN_FORMAT
from zerodrift.dataset.guess import Guess, GuessedOutput, SeenColumn
from zerodrift.dataset.guess_runs import LogFiles
from zerodrift.dataset.selectors import JOINT
from zerodrift.dataset.survey import write_range

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
