"""Finds which files are the runs of a project, by their content, and what a run lacks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.errors import InputError
from zerodrift.dataset.logs import open_sources
from zerodrift.dataset.roles import OUTPUT, RAW_THERMOMETER, STEADY, TEMPERATURE, Role, assign_roles
from zerodrift.dataset.selectors import list_files, list_suffixes, order_path
from zerodrift.dataset.survey import Survey, survey_source, write_range
from zerodrift.dataset.text_format import NUMBER


@dataclass(frozen=True)
class LogFiles:
    """One run as `[logs]` is to select it."""

    path: Path
    files: tuple[Path, ...]
    """Several: joined on time."""


@dataclass(frozen=True)
class SurveyedFile:
    """A file and what its columns are for."""

    survey: Survey
    roles: tuple[Role, ...]

    @property
    def name(self) -> str:
        """Return the file's name."""
        return self.survey.source.name

    def list(self, role: str) -> list[Role]:
        """Return the columns of a role, thermometers by their rank."""
        return sorted((each for each in self.roles if each.role == role), key=lambda r: r.rank)


@dataclass(frozen=True)
class FoundRun:
    """A run and what its files hold."""

    log: LogFiles
    files: tuple[SurveyedFile, ...]
    left_out: tuple[str, ...] = ()
    """Notes on other files in the same folder."""

    def names(self) -> set[str]:
        """Return all columns of its files."""
        return {name for file in self.files for name in file.survey.source.names}


def find_runs(
    logs: Sequence[Path | LogFiles], period_s: float | None, directory: Path
) -> tuple[list[FoundRun], list[str]]:
    """Return the runs among the logs, and notes on the files that are none."""
    runs: list[FoundRun] = []
    refused: list[str] = []
    files = []
    for log in logs:
        if isinstance(log, LogFiles):
            opened = [file for path in log.files for file in _open(path)]
            runs.append(FoundRun(log, tuple(opened)))
        elif log.is_dir():
            found = _find_in_folder(log, period_s, refused)
            if not found:
                told = f" ({'; '.join(refused)})" if refused else ""
                raise InputError(
                    f"{log}: holds no log{told}; expected files of rows that end in "
                    f"{', '.join(list_suffixes())}, or folders of them. Name another folder."
                )
            runs += found
        else:
            files.append(log)
    tables = [_open(path) for path in files]
    is_one = len(files) > 1 and all(len(each) == 1 for each in tables)
    if is_one and not any(_is_whole(each[0], period_s) for each in tables):
        several = LogFiles(files[0], tuple(files))
        runs.append(FoundRun(several, tuple(each[0] for each in tables)))
    else:
        runs += [
            FoundRun(LogFiles(path, (path,)), tuple(each))
            for path, each in zip(files, tables, strict=True)
        ]
    runs.sort(key=lambda run: order_path(run.log.path, directory))
    return runs, refused


def _open(path: Path) -> list[SurveyedFile]:
    """Return the tables of a file, in a file of several those with numbers."""
    surveys = []
    for source in open_sources(path, str(path), {}):
        try:
            surveys.append(survey_source(source))
        except InputError:
            if not source.part:
                raise
    found = [SurveyedFile(survey, tuple(assign_roles(survey))) for survey in surveys]
    return [file for file in found if file.survey.columns] or found[:1]


def _is_whole(file: SurveyedFile, period_s: float | None) -> bool:
    has_time = file.survey.times is not None or period_s is not None
    return has_time and bool(file.list(TEMPERATURE)) and bool(file.list(OUTPUT))


def _find_in_folder(folder: Path, period_s: float | None, refused: list[str]) -> list[FoundRun]:
    """Return the runs of a folder and of those in it.

    Files that each have times, thermometer and value are a run each; if none has, all are one.
    """
    opened: list[SurveyedFile] = []
    runs: list[FoundRun] = []
    for path in list_files(folder):
        try:
            tables = _open(path)
        except InputError as error:
            is_remark = path.suffix.lower() == ".txt" and not isinstance(error.__cause__, OSError)
            if not is_remark and not isinstance(error.__cause__, ImportError):
                raise
            if not is_remark:
                refused.append(f"not read: {error}")
            continue
        if len(tables) > 1:
            runs.append(FoundRun(LogFiles(path, (path,)), tuple(tables)))
        else:
            opened += [file for file in tables if file.survey.columns]
    whole = [file for file in opened if _is_whole(file, period_s)]
    if whole:
        left = tuple(
            f"{file.survey.source.path.name} beside it is left out: {_tell_lack(file)}"
            for file in opened
            if file not in whole
        )
        for file in whole:
            path = file.survey.source.path
            runs.append(FoundRun(LogFiles(path, (path,)), (file,), left))
    elif len(opened) == 1:
        path = opened[0].survey.source.path
        runs.append(FoundRun(LogFiles(path, (path,)), (opened[0],)))
    elif opened:
        runs.append(FoundRun(LogFiles(folder, tuple(list_files(folder))), tuple(opened)))
    for inner in sorted(path for path in folder.iterdir() if path.is_dir()):
        runs += _find_in_folder(inner, period_s, refused)
    return runs


def _tell_lack(file: SurveyedFile) -> str:
    lacks = []
    if file.survey.times is None:
        lacks.append("no times")
    if not file.list(TEMPERATURE):
        lacks.append("no thermometer")
    if not file.list(OUTPUT):
        lacks.append("nothing that drifts")
    return ", ".join(lacks)


def choose_runs(
    runs: Sequence[FoundRun], period_s: float | None
) -> tuple[FoundRun, list[FoundRun], list[str]]:
    """Return the run that names the columns, the runs that have them, and notes on the others."""
    good = [run for run in runs if not _list_lacks(run, period_s)]
    if not good:
        raise InputError(_explain_lacks(runs[0], period_s))
    wanted = {run.log: _list_key_columns(run) for run in good}
    # The columns that the most runs share, seen where the most of them move: a dwell shows little.
    counts = [sum(wanted[run.log] <= other.names() for other in good) for run in good]
    first = max(zip(good, counts, strict=True), key=lambda each: (each[1], _count_moving(each[0])))[
        0
    ]
    alike = [run for run in good if wanted[first.log] <= run.names()]
    told = []
    others = [run for run in good if run not in alike]
    scaled = _find_other_scale(alike)
    if scaled:
        alike = [run for run in alike if run not in scaled]
        first = alike[0]
        names = ", ".join(run.log.path.name for run in scaled)
        where = ", ".join(run.log.path.parent.name for run in scaled)
        told.append(
            f"{names} (in {where}) left out: a value that hardly moves is another there by powers "
            "of ten, as in another unit"
        )
    if others:
        names = ", ".join(
            f"{run.log.path.name} ({', '.join(sorted(wanted[run.log] - first.names()))})"
            for run in others
        )
        told.append(f"other runs have other columns, and are left out: {names}")
    if bad := [run for run in runs if run not in good]:
        names = "; ".join(
            f"{run.log.path.name} ({', '.join(_list_lacks(run, period_s))})" for run in bad
        )
        told.append(f"runs that lack something are left out: {names}")
    return first, alike, told


def pool_runs(first: FoundRun, runs: Sequence[FoundRun]) -> tuple[SurveyedFile, ...]:
    """Return the first run's files, each column with its range in all runs and its role then.

    What stands still in one run may move in others, or stand elsewhere there.
    """
    pooled = []
    for place, file in enumerate(first.files):
        beside = [run.files[place] for run in runs if len(run.files) == len(first.files)]
        columns = []
        for column in file.survey.columns:
            alike = [
                other
                for each in beside
                for other in each.survey.columns
                if (other.name, other.unit) == (column.name, column.unit)
            ]
            columns.append(
                replace(
                    column,
                    low=min(other.low for other in (column, *alike)),
                    high=max(other.high for other in (column, *alike)),
                    distinct=max(other.distinct for other in (column, *alike)),
                    changes=max(other.changes for other in (column, *alike)),
                )
            )
        survey = replace(file.survey, columns=tuple(columns))
        pooled.append(SurveyedFile(survey, tuple(assign_roles(survey))))
    return tuple(pooled)


def _count_moving(run: FoundRun) -> int:
    """Return how many columns of a run move."""
    return sum(not column.is_constant for file in run.files for column in file.survey.columns)


def _find_other_scale(runs: Sequence[FoundRun]) -> list[FoundRun]:
    """Return the runs whose steady values differ in scale from those of the majority of rows."""
    sizes: dict[int, list[FoundRun]] = {}
    for run in runs:
        columns = [role.column for file in run.files for role in file.list(OUTPUT)]
        steady = [c for c in columns if c.high - c.low < STEADY * max(abs(c.low), abs(c.high))]
        if not steady:
            return []
        sizes.setdefault(round(float(np.log10(abs(steady[0].median)))), []).append(run)
    most = max(sizes.values(), key=lambda same: sum(f.survey.rows for r in same for f in r.files))
    return [run for run in runs if run not in most]


def _list_key_columns(run: FoundRun) -> set[str]:
    """Return the columns without which a run is of no use: times, thermometer, outputs."""
    names: set[str] = set()
    for file in run.files:
        if file.survey.times is not None:
            names |= set(file.survey.times.config.columns)
        names |= {role.column.name for role in file.list(OUTPUT)}
    thermometers = [role.column.name for file in run.files for role in file.list(TEMPERATURE)]
    return names | set(thermometers[:1])


def _list_lacks(run: FoundRun, period_s: float | None) -> list[str]:
    lacks = []
    timed = [file for file in run.files if file.survey.times is not None]
    if not timed and period_s is None:
        lacks.append("times")
    if not any(file.list(TEMPERATURE) for file in run.files):
        lacks.append("a thermometer")
    if not any(file.list(OUTPUT) for file in run.files):
        lacks.append("a quantity that drifts")
    return lacks


def _explain_lacks(run: FoundRun, period_s: float | None) -> str:
    """Return exactly what a log lacks, with what was seen of it."""
    lacks = _list_lacks(run, period_s)
    who = run.files[0].survey.source.label if len(run.files) == 1 else str(run.log.path)
    text = run.files[0].survey.source.text
    line = f":{text.header_line}" if len(run.files) == 1 and text and text.header_line else ""
    told = {
        "times": "no column of numbers looks like the time, and none of text",
        "a thermometer": "no column looks like the temperature",
        "a quantity that drifts": "no column looks like a quantity that drifts",
    }
    remedies = {
        "times": "name a column time_s, or give the interval between rows: init --period-s SECONDS",
        "a thermometer": "name one such as temperature_degC, or add the file that has it",
        "a quantity that drifts": "name one with its unit, such as Fz_N, or add the file with it",
    }
    columns = [_tell_column(file, role) for file in run.files for role in file.roles]
    texts = [
        _tell_text(name, values)
        for file in run.files
        for name, values in file.survey.texts.items()
        if values
    ]
    columns += texts
    seen = "; ".join(columns)
    found = "; ".join(told[lack] for lack in lacks)
    if any(RAW_THERMOMETER in role.why for file in run.files for role in file.roles):
        remedies["a thermometer"] += (
            ", or write a zerodrift.toml whose temperature says how the raw one is converted: "
            '{ column = ..., convert = "ntc", ... }'
        )
    todo = "; ".join(remedies[lack] for lack in lacks)
    todo += ", or mend the text of a column that should hold numbers" if texts else ""
    return (
        f"{who}{line}: {found} (found: {seen or 'no numbers'}); expected {' and '.join(lacks)}. "
        f"To go on: {todo}."
    )


def _tell_text(name: str, values: Sequence[str]) -> str:
    """Return a column of text with the first value that is no number."""
    odd = next((value for value in values if not NUMBER.fullmatch(value.strip())), values[0])
    return f"{name} holds text, such as '{odd[:24]}'"


def _tell_column(file: SurveyedFile, role: Role) -> str:
    column = role.column
    unit = f" {column.unit}" if column.unit else ""
    span = write_range(column.low, column.high)
    return f"{column.name} {span}{unit} ({role.role}: {role.why})"
