"""Guesses a project from its logs: which files are runs, what each column is, and how sure."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from zerodrift.base.column_config import TIME_UNITS, ConversionConfig, TimeConfig
from zerodrift.base.config import MAX_OUTPUTS
from zerodrift.base.errors import InputError
from zerodrift.dataset.checks import COLDEST_DEGC, HOTTEST_DEGC
from zerodrift.dataset.chip_codes import CLOCK, propose_codes
from zerodrift.dataset.conversions import convert
from zerodrift.dataset.guess_runs import (
    FoundRun,
    LogFiles,
    SurveyedFile,
    choose_runs,
    find_runs,
    pool_runs,
)
from zerodrift.dataset.join import propose_zone
from zerodrift.dataset.roles import (
    INPUT,
    OUTPUT,
    REFERENCE,
    REFERENCE_WORDS,
    STEADY,
    TEMPERATURE,
    UNUSED,
    Role,
    guess_unit,
)
from zerodrift.dataset.sampling import look_at_sampling
from zerodrift.dataset.survey import Times, words
from zerodrift.dataset.times import find_zone
from zerodrift.dataset.units import (
    FASTEST_S,
    SLOWEST_S,
    is_unix,
    read_time_unit,
    read_unit,
    strip_unit,
)

# The further channels of a project that `init` finds, and the LSB of each.


def write_column(files: Sequence[SurveyedFile], file: SurveyedFile, role: Role) -> str:
    """Return a column's name as zerodrift.toml has it: with its file where several have it."""
    name = role.column.name
    holders = [each for each in files if name in each.survey.source.names]
    return name if len(holders) == 1 else f"{file.name}:{name}"


def choose_inputs(files: Sequence[SurveyedFile], shared: set[str]) -> dict[str, str]:
    """Return channel -> column of one run's files, the clock first."""
    inputs: dict[str, str] = {}
    for file in files:
        for role in file.list(INPUT):
            if role.column.name in shared:
                inputs.setdefault(role.channel, write_column(files, file, role))
    clock = inputs.pop("clock", None)
    return ({"clock": clock} if clock else {}) | inputs


def choose_codes(
    columns: Sequence[tuple[str, str]], runs: Sequence[Sequence[SurveyedFile]]
) -> dict[str, tuple[str, float]]:
    """Return column -> `raw` and `lsb` that hold its lowest and highest value of all runs.

    Args:
        columns: input and its column as zerodrift.toml names it.
        runs: the files of each run, of all units of a fleet.
    """
    chosen = {}
    for name, column in columns:
        held = [
            role
            for files in runs
            for file in files
            for role in file.roles
            if column in (role.column.name, write_column(files, file, role))
        ]
        if held and name != CLOCK:
            low = min(role.column.low for role in held)
            high = max(role.column.high for role in held)
            is_degc = held[0].role == TEMPERATURE
            if held[0].column.unit in ("degF", "K"):
                by = ConversionConfig(unit=held[0].column.unit)
                low, high = (float(end) for end in convert(np.array([low, high]), by))
            chosen[column] = propose_codes(name, column, low, high, is_degc)
    return chosen


# Guesses a project from its logs: which files are runs, what each column is, and how sure.

FULL_SCALE_STEPS = (1.0, 2.0, 5.0, 10.0)
GENERIC_NAMES = re.compile(
    r"(logs?|data|out|output|measurements?|values|runs?|train|training|tests?|records?|recordings?"
    r"|dwells?)?"
)
"""Of files and folders: they name no sensor."""


@dataclass(frozen=True)
class GuessedOutput:
    """One output as the logs suggest it."""

    name: str
    measured: str
    reference: str | float | None
    unit: str
    full_scale: float
    unit_from: str = ""
    """Where the unit was taken from; empty: nothing states it."""


@dataclass(frozen=True)
class SeenColumn:
    """One column and what it was taken for."""

    file: str
    column: str
    role: str
    unit: str
    low: float | None
    high: float | None
    why: str


@dataclass(frozen=True)
class Guess:
    """A project as its logs suggest it, and what its user has to check."""

    sensor_name: str
    time: TimeConfig
    temperature: str
    sample_period_s: float
    outputs: tuple[GuessedOutput, ...]
    inputs: Mapping[str, str]
    runs: tuple[str, ...]
    """Values of the first log's `run` column; empty without one."""
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Text columns with several values -> these, candidates for `[logs] where`."""
    checks: tuple[str, ...] = ()
    """What was uncertain, for the user to check."""
    alternatives: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Key of zerodrift.toml (time, temperature, sample_period_s, `outputs.NAME.unit`, ...) -> what
    else it may be."""
    seen: tuple[SeenColumn, ...] = ()
    """Every column of one run, with its range in all of them."""
    logs: tuple[LogFiles, ...] = ()
    """The runs that have these columns."""
    period_by_hand_s: float | None = None
    """Interval in s between rows that have no times."""
    temperature_unit: str = ""
    """degF or K; empty: degC."""
    times_by_file: Mapping[str, TimeConfig] = field(default_factory=dict)
    """File -> its times, where they are not as `time` says."""
    codes: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    """Column of an input, or of another thermometer -> `raw` and `lsb` that hold all runs; none
    of the clock, which counts seconds."""
    refused: str = ""
    """Why the logs cannot be used as they are, where the proposal was tried; empty: they can."""


def guess_project(
    logs: Sequence[Path | LogFiles], period_s: float | None = None, directory: Path | None = None
) -> Guess:
    """Guess runs, columns, units and sample period of a project.

    Args:
        logs: files, folders of runs, or runs whose files are known already.
        period_s: the interval between rows in s, for logs without times.
        directory: of the project; runs are sorted by their place relative to it.

    Raises:
        InputError: a log cannot be read, or it lacks times, a thermometer or what drifts.
    """
    found, refused = find_runs(logs, period_s, directory or Path())
    first, runs, left = choose_runs(found, period_s)
    files = pool_runs(first, runs)
    checks = [*refused, *first.left_out, *left]
    shared = set.intersection(*(run.names() for run in runs))
    if unlike := [
        name
        for run in runs
        for file in run.files
        for name in file.survey.source.names
        if name not in shared and not name.startswith("\0")
    ]:
        names = ", ".join(dict.fromkeys(unlike))
        checks.append(f"not every log has these columns, which were left out: {names}")
    alternatives: dict[str, tuple[str, ...]] = {}
    time, by_file = _choose_time(files, runs, period_s, alternatives, checks)
    thermometers = [
        (file, role)
        for file in files
        for role in file.list(TEMPERATURE)
        if role.column.name in shared
    ]
    outputs = _choose_outputs(files, shared, alternatives, checks)
    temperature = write_column(files, *thermometers[0])
    others = [write_column(files, *each) for each in thermometers[1:]]
    inputs = choose_inputs(files, shared)
    for name in others:
        bare = name.rpartition(":")[2]
        inputs.setdefault(_name_channel(bare), name)
    if others:
        alternatives["temperature"] = tuple(others)
        checks.append(f"'{temperature}' was taken as the chip's own thermometer")
    unit = thermometers[0][1].column.unit
    if unit in ("degF", "K"):
        checks.append(f"'{temperature}' seems to be in {unit}, and is converted to degC")
    column = thermometers[0][1].column
    checks += _tell_contradictions(files)
    if unit not in ("degF", "K") and not COLDEST_DEGC <= column.low <= column.high <= HOTTEST_DEGC:
        alternatives["temperature"] = (
            *alternatives.get("temperature", ()),
            f'{{ column = "{temperature}", scale = 0.01, unit = "degC" }}',
        )
        checks.append(
            f"'{temperature}' is {column.low:g} to {column.high:g}, which is no temperature in degC"
            ": state what one is worth by scale, or its conversion"
        )
    used = {temperature, *inputs.values(), *(output.measured for output in outputs)}
    used |= {output.reference for output in outputs if isinstance(output.reference, str)}
    period = _choose_period(files, used, period_s, alternatives, checks)
    seen = tuple(_describe(files, used))
    if unused := [
        f"{column.column} ({column.why})" if column.why else column.column
        for column in seen
        if column.role == UNUSED
    ]:
        checks.append(f"not used: {', '.join(unused)}")
    groups = _find_groups(files, shared)
    for name, values in groups.items():
        named = ", ".join(values[:3]) + (", ..." if len(values) > 3 else "")
        checks.append(
            f"'{name}' has {len(values)} values ({named}), all taken as one sensor; "
            "[logs] where picks one"
        )
    checks += [f"full_scale of {output.name} is a guess from the data" for output in outputs]
    return Guess(
        sensor_name=_name_sensor([run.log for run in runs], outputs[0].name if outputs else ""),
        time=time,
        temperature=temperature,
        temperature_unit=unit if unit in ("degF", "K") else "",
        sample_period_s=period,
        outputs=tuple(outputs),
        inputs=inputs,
        runs=files[0].survey.runs if len(files) == 1 and "run" in shared else (),
        groups=groups,
        checks=tuple(dict.fromkeys(checks)),
        alternatives=alternatives,
        seen=seen,
        logs=tuple(run.log for run in runs),
        period_by_hand_s=period_s if any(f.survey.times is None for f in files) else None,
        times_by_file=by_file,
        codes=choose_codes(
            [*inputs.items(), ("temperature", temperature)], [run.files for run in runs]
        ),
    )


def _tell_contradictions(files: Sequence[SurveyedFile]) -> list[str]:
    """Return notes on columns whose name and row of units state different units."""
    return [
        f"'{column.name}' is in {column.unit} by the row of units and in "
        f"{read_unit(column.name)} by its name; taken as {column.unit}"
        for file in files
        for column in file.survey.columns
        if column.unit and read_unit(column.name) not in ("", column.unit)
    ]


def _name_sensor(logs: Sequence[LogFiles], output: str) -> str:
    """Return a name by the first run's file, by the folder, or else by the first output.

    Of several runs, neither a number at the file's end nor what all files are called is a name.
    """
    path = logs[0].path
    stem = path.name if len(logs[0].files) > 1 else path.stem
    folders = {log.path.parent for log in logs}
    folder = path.parent if len(folders) == 1 else path.parent.parent
    if len(logs) > 1:
        alike = len(folders) > 1 or len({log.path.stem for log in logs}) == 1
        stem = "" if alike else re.sub(r"([_.\s-]+\d+)+$", "", stem)
    for text in (stem, folder.name, output):
        name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_").lower()
        if not GENERIC_NAMES.fullmatch(name.strip("0123456789_")):
            # A name in C begins with a letter.
            return re.sub(r"^[0-9_]+", "", name)
    return "sensor"


def _name_channel(column: str) -> str:
    bare = re.sub(r"_(degC|degF|K|C)$", "", column)
    return re.sub(r"[^A-Za-z0-9_]+", "_", strip_unit(bare)).strip("_").lower() or "thermometer"


def _choose_time(
    files: Sequence[SurveyedFile],
    runs: Sequence[FoundRun],
    period_s: float | None,
    alternatives: dict[str, tuple[str, ...]],
    checks: list[str],
) -> tuple[TimeConfig, dict[str, TimeConfig]]:
    """Return `[sensor] time`, and the times of files that are written in another way."""
    timed = [(file, file.survey.times) for file in files if file.survey.times is not None]
    if not timed:
        checks.append(f"rows without times are taken as {period_s:g} s apart")
        return TimeConfig(()), {}
    main = timed[0][1]
    config = main.config
    if main.is_unit_guessed:
        others = " | ".join(unit for unit in TIME_UNITS if unit != config.unit)
        alternatives["time"] = (f"{others}, and then another sample_period_s",)
        checks.append(
            f"'{config.name}' is taken as {config.unit}, a row every {main.period_s:.3g} s; if it "
            f"is another unit, of {', '.join(TIME_UNITS)}, change it and sample_period_s"
        )
    if main.alternatives:
        alternatives["time"] = tuple(
            f'format = "{each.written}" ({each.words})' for each in main.alternatives
        )
        checks.append(
            f"'{config.name}' is read by {config.format}; the log itself leaves day and month open"
        )
    by_file = {}
    for file, times in timed[1:]:
        if times.config.columns != config.columns or times.config.unit != config.unit:
            by_file[file.name] = times.config
    zone = _choose_zone(timed)
    if not zone and (zone := _find_put_back(runs)):
        checks.append(f"the clock goes back by an hour in the logs, as those of {zone} did")
        alternatives["time"] = ("the zone by name in which the logger's clock stood",)
        config = replace(config, zone=zone)
    elif zone:
        checks.append(f"a clock without a zone is taken as {zone}, by which the files overlap best")
        alternatives["time"] = ("the zone by name, such as Europe/Berlin",)
        local = [file.name for file, times in timed if times.clock.kind == "local"]
        by_file = {n: replace(t, zone=zone) if n in local else t for n, t in by_file.items()}
        if any(name not in by_file for name in local):
            config = replace(config, zone=zone)
    return config, by_file


def _find_put_back(runs: Sequence[FoundRun]) -> str:
    """Return the zone of a local clock that was put back in some run; "" where none was."""
    times = (file.survey.times for run in runs for file in run.files)
    local = [each for each in times if each is not None and each.clock.kind == "local"]
    return next((zone for each in local if (zone := find_zone(each.seconds))), "")


def _choose_zone(timed: Sequence[tuple[SurveyedFile, Times]]) -> str:
    """Return the zone of files by a local clock, if others count from 1970 in UTC."""
    local = [times for _, times in timed if times.clock.kind == "local"]
    utc = [
        times
        for _, times in timed
        if times.clock.kind == "zoned"
        or (times.clock.kind == "number" and is_unix(times.seconds[0]))
    ]
    return propose_zone(local[0].seconds, utc[0].seconds) if local and utc else ""


def _choose_outputs(
    files: Sequence[SurveyedFile],
    shared: set[str],
    alternatives: dict[str, tuple[str, ...]],
    checks: list[str],
) -> list[GuessedOutput]:
    found = [
        (file, role) for file in files for role in file.list(OUTPUT) if role.column.name in shared
    ][:MAX_OUTPUTS]
    references = [
        (file, role)
        for file in files
        for role in file.list(REFERENCE)
        if role.column.name in shared
    ]
    outputs: list[GuessedOutput] = []
    for file, role in found:
        column = role.column
        measured = write_column(files, file, role)
        reference: str | float | None = None
        for other, candidate in references:
            if _is_reference(column.name, candidate.column.name, len(found), references):
                reference = write_column(files, other, candidate)
                break
        unit, source = guess_unit(column, file.survey)
        short = re.sub(r"[^A-Za-z0-9_]+", "_", strip_unit(column.name)).strip("_")
        if short[:1].isdigit():
            short = f"column_{short}"
        if not short or short in [output.name for output in outputs]:
            short = re.sub(r"[^A-Za-z0-9_]+", "_", measured).strip("_")
        peak = max(abs(column.low), abs(column.high))
        if reference is None and column.high - column.low < STEADY * peak:
            reference = float(f"{column.median:.3g}")
            alternatives[f"outputs.{short}.reference"] = (
                "the true value, as a number or a column",
            )
            checks.append(
                f"{short} moves by less than {100 * STEADY:g} % of itself, so its true value is "
                f"taken as {reference:g}"
            )
        if not source:
            alternatives[f"outputs.{short}.measured"] = (
                "an input, a true value, or of no use: it moves, and nothing else claims it",
            )
            alternatives[f"outputs.{short}.unit"] = ("V", "mV", "ohm", "N", "g", "ppm")
            checks.append(f"the log does not state the unit of measure of {short}; taken as LSB")
        elif not column.unit:
            checks.append(f"the unit of {short}, {unit}, is taken from {source}")
        outputs.append(GuessedOutput(short, measured, reference, unit, round_up(peak), source))
    return outputs


def _is_reference(
    measured: str,
    reference: str,
    outputs: int,
    references: Sequence[tuple[SurveyedFile, Role]],
) -> bool:
    if words(reference) - REFERENCE_WORDS == words(measured):
        return True
    alike = [r for _, r in references if read_unit(r.column.name) == read_unit(measured)]
    return outputs == 1 and len(alike) == 1 and alike[0].column.name == reference


def round_up(peak: float) -> float:
    """Return a round full scale that holds a peak."""
    largest = peak if peak > 0 and np.isfinite(peak) else 1.0
    decade = 10.0 ** np.floor(np.log10(largest))
    scale = next(s * decade for s in FULL_SCALE_STEPS if s * decade >= largest)
    return float(f"{scale:.3g}")


def _choose_period(
    files: Sequence[SurveyedFile],
    used: set[str],
    period_s: float | None,
    alternatives: dict[str, tuple[str, ...]],
    checks: list[str],
) -> float:
    """Return the interval of the slowest file that is used, to three digits."""
    slowest = period_s or 0.0
    for file in files:
        times = file.survey.times
        names = {write_column(files, file, role) for role in file.roles}
        if times is None or not names & used:
            continue
        rising = np.unique(times.seconds)
        if rising.size < 2 or times.period_s == 0:
            raise InputError(
                f"{file.survey.source.label}: '{times.config.name}' never rises; expected times "
                "that rise from row to row."
            )
        usual_s = times.period_s
        if not file.survey.runs and np.all(np.diff(times.seconds) > 0):
            sampling = look_at_sampling(times.seconds, np.inf)
            usual_s = max(sampling.usual_s, sampling.slowest_s)
        slowest = max(slowest, usual_s)
    period = float(f"{slowest:.3g}")
    if period >= SLOWEST_S or period <= FASTEST_S:
        unit = ""
        first = next((f.survey.times for f in files if f.survey.times is not None), None)
        if first is not None and not read_time_unit(first.config.name):
            unit = ": are the times in another unit of measure?"
        alternatives["sample_period_s"] = ("another, if the unit of the times is another",)
        checks.append(f"a row every {period:g} s is unusual{unit}")
    return period


def _describe(files: Sequence[SurveyedFile], used: set[str]) -> list[SeenColumn]:
    """Return what was seen, column by column."""
    seen = []
    for file in files:
        times = file.survey.times
        if times is not None:
            kind = {
                "number": f"counts {times.config.unit or read_time_unit(times.config.name) or 's'}",
                "zoned": "dates with a zone",
                "local": "dates by a local clock",
                "day": "times of day",
            }[times.clock.kind]
            why = f"{kind}, a row every {times.period_s:.4g} s"
            low, high = float(times.seconds.min()), float(times.seconds.max())
            seen.append(SeenColumn(file.name, times.config.name, "time", "s", low, high, why))
        for role in file.roles:
            column = role.column
            name = write_column(files, file, role)
            shown, why = role.role, role.why
            if role.role == INPUT:
                shown = f"input {role.channel}"
            elif (role.role == TEMPERATURE and name not in used) or (
                role.role == OUTPUT and name not in used
            ):
                shown = UNUSED
            elif role.role == REFERENCE and name not in used:
                shown, why = UNUSED, "a reference of nothing that drifts"
            if shown == UNUSED and role.role != UNUSED:
                why = "another one is taken, or not every log has it"
                why = role.why if role.role == REFERENCE else why
            seen.append(
                SeenColumn(file.name, name, shown, column.unit, column.low, column.high, why)
            )
    return seen


def _find_groups(files: Sequence[SurveyedFile], shared: set[str]) -> dict[str, tuple[str, ...]]:
    """Return the columns of text that may distinguish units or parts of a log."""
    return {
        name: values
        for file in files
        for name, values in file.survey.texts.items()
        if name in shared and 1 < len(values) <= 32 and file.survey.times is not None
    }
