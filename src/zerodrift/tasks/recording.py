"""`record`: a log from a live source, what it should cover, and what can be learnt from it."""

import json
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import FILE_NAME, Config, load_config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.journal import write_text
from zerodrift.base.records import from_json
from zerodrift.base.toml_edit import add_log
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.open_log import list_columns
from zerodrift.dataset.selectors import NoLogsError, expand_selectors, matches_logs
from zerodrift.diagnosis.advice import advise
from zerodrift.recording.coverage import Coverage, Wanted
from zerodrift.recording.open_source import open_source
from zerodrift.recording.recorder import Keeper, Recording, RowRules, Show, check_rules, recover
from zerodrift.recording.status import end_status, telling_status
from zerodrift.report.results import PlanResult, RecordResult
from zerodrift.tasks.plan import KEPT, KeptPlan
from zerodrift.tasks.project import ProjectFolder

BUILD = "build"
LINES = "columns below a header (or --columns), JSON objects, or NAME=VALUE pairs"
MESSAGES = "messages of ROS 2 or JSON with numbers in them"
CHANGES_K = 0.5
"""A set point that differs by less is the same."""


@dataclass(frozen=True)
class RecordRequest:
    """What is recorded, into which file, and until when."""

    project: ProjectFolder
    """Need not hold a zerodrift.toml."""
    source: str
    out: Path
    """The log: a new file, .parquet."""
    columns: str | None = None
    """Names, with commas between, where the source sends numbers alone."""
    dbc: Path | None = None
    """What the frames of a CAN bus mean."""
    period: float | None = None
    """Seconds between rows of CAN, MQTT and MCAP; None: the project's, or 1."""
    hold: float | None = None
    """How long such a value counts without a newer one; None: 5 periods."""
    seconds: float | None = None
    """End after so long."""
    log: int | None = None
    """Which log of the last plan this is; None: the first."""
    until_enough: bool = False
    """End once everything wanted is covered."""


def record(request: RecordRequest, show: Show = lambda *_: None) -> RecordResult:
    """Record until the end, Ctrl-C or SIGTERM; return a summary of the recording.

    Args:
        request: what is recorded.
        show: is called with what is covered so far.

    Raises:
        InputError: the source cannot be opened, the file cannot be written, or the options are
            wrong. Rows recorded before are kept.
    """
    directory, source, out = request.project.directory, request.source, request.out
    config = load_config(directory) if (directory / FILE_NAME).is_file() else None
    wanted = find_wanted(config, request.log)
    if request.until_enough and not wanted.why:
        raise InputError(
            "--until-enough: nothing says what is enough; expected a plan or ranges under "
            "[experiment]. Run: zerodrift plan"
        )
    names = tuple(name.strip() for name in (request.columns or "").split(",") if request.columns)
    period_s = request.period or (config.sample_period_s if config else 1.0)
    rules = RowRules(
        time_column=config.time_column if config else "time_s",
        period_s=period_s,
        hold_s=request.hold or 5.0 * period_s,
        most_s=request.seconds,
        until_enough=request.until_enough,
    )
    check_rules(rules)
    coverage = Coverage(config.temperature_column if config else "temperature_degC", wanted)
    began_s = time.monotonic()
    build = config.build_directory if config else None
    with (
        ending_softly() as ending,
        telling_status(build, out, source, coverage, wanted.why) as telling,
        Keeper(out) as keeper,
    ):
        opened = open_source(source, names, request.dbc, list_read(config))
        try:
            recorder = Recording(opened, keeper, coverage, rules)
            interrupted = recorder.run(telling(show), ending.wait_for_it)
        finally:
            opened.close()
    notes = opened.list_strays()
    if recorder.backwards:
        notes.append(
            f"{recorder.backwards} readings were left out: the source's own time ran backwards "
            "there"
        )
    covered = coverage.describe()
    if not covered.rows:
        told = f" {'; '.join(notes)}." if notes else ""
        expected = MESSAGES if opened.has_times else LINES
        raise InputError(
            f"{source}: no row came in {time.monotonic() - began_s:.0f} s; expected {expected}."
            f"{told} No file was written."
        )
    return RecordResult(
        **vars(covered),
        file=str(out),
        source=source,
        interrupted=interrupted,
        why=wanted.why,
        notes=tuple(notes),
        taught=tuple(explain_taught(config, out)) if config else (),
    )


def finish(directory: Path, log: Path) -> int:
    """Finish the file of a recording that was cut off; return how many rows it has.

    Raises:
        InputError: there is none, or it is still being recorded.
    """
    rows = recover(log)
    end_status(directory / BUILD, log)
    return rows


class Ending:
    """Whether Ctrl-C was pressed, or the system asked to end."""

    def __init__(self) -> None:
        self._waits = self._asked = False

    def wait_for_it(self) -> bool:
        """Return whether it was asked for; from the first call on, a signal is no exception."""
        self._waits = True
        return self._asked

    def take_signal(self, *_: object) -> None:
        """Remember that it was asked for; asked again, or before anybody waits, end at once."""
        if self._asked or not self._waits:
            raise KeyboardInterrupt
        self._asked = True


@contextmanager
def ending_softly() -> Iterator[Ending]:
    """Within this context, Ctrl-C and SIGTERM end a recording between two rows."""
    ending = Ending()
    kinds = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(kind, ending.take_signal) for kind in kinds]
    try:
        yield ending
    finally:
        for kind, handler in zip(kinds, before, strict=True):
            signal.signal(kind, handler)


def find_wanted(config: Config | None, log: int | None) -> Wanted:
    """Return what the next recording should cover: a log of the last plan, or `[experiment]`.

    Args:
        config: the project; None without one.
        log: number of the planned log; None: the first, where there is a plan.

    Raises:
        InputError: there is no such plan or log.
    """
    plan = None if config is None else read_plan(config)
    if plan is None:
        if log is not None:
            raise InputError(
                f"--log {log}: this project has no plan; expected one. Run: zerodrift plan"
            )
        return Wanted() if config is None else _want_limits(config)
    assert config is not None
    number = 1 if log is None else log
    if number not in {one.log for one in plan.logs}:
        raise InputError(
            f"--log {number}: the plan has {len(plan.logs)} logs; expected one of them."
        )
    return _want_log(config, plan, number)


def list_read(config: Config | None) -> tuple[str, ...]:
    """Return the columns that a project reads of its logs; none without a project."""
    return () if config is None else tuple(list_columns(config))


def use_log(directory: Path, log: Path) -> str:
    """Name a log under `[logs] train`; return its name there.

    Raises:
        InputError: there is no such log, the project's selectors match it already, or `train`
            cannot be edited.
    """
    config = load_config(directory)
    if not log.is_file():
        raise InputError(f"--use {log}: there is no such log; expected one that was recorded.")
    if matches_logs(config, log):
        raise InputError(f"--use {log}: [logs] matches it already; expected another log.")
    place, home = log.resolve(), config.directory.resolve()
    name = place.relative_to(home).as_posix() if place.is_relative_to(home) else place.as_posix()
    text = config.path.read_bytes().decode("utf-8")
    write_text(config.path, add_log(text, name, path=config.path))
    return name


def read_plan(config: Config) -> PlanResult | None:
    """Return the project's last plan; None where none is kept, or one of another version."""
    path = config.build_directory / KEPT
    if not path.is_file():
        return None
    try:
        return from_json(KeptPlan, json.loads(path.read_text(encoding="utf-8")), str(path)).plan
    except ValueError:
        return None


def _want_limits(config: Config) -> Wanted:
    limits = config.experiment
    if limits.temperature_degC is None:
        return Wanted()
    return Wanted(
        temperature_degC=limits.temperature_degC,
        columns={config.inputs[n]: (r.low, r.high) for n, r in limits.inputs.items()}
        | _name_loads(config, {n: (r.low, r.high) for n, r in limits.loads.items()}),
        why="[experiment]",
    )


def _want_log(config: Config, plan: PlanResult, number: int) -> Wanted:
    settings = [one for one in plan.programme if one.log == number]
    levels = [plan.start_degC, *(one.temperature_degC for one in settings)]
    heating, cooling = 0.0, 0.0
    now = plan.start_degC
    for one in settings:
        if one.temperature_degC > now + CHANGES_K:
            heating = max(heating, one.rate_K_per_min)
        elif one.temperature_degC < now - CHANGES_K:
            cooling = max(cooling, one.rate_K_per_min)
        now = one.temperature_degC
    loads = {
        name: (min(0.0, *values), max(0.0, *values))
        for name in {name for one in settings for name in one.loads}
        if (values := [one.loads.get(name, 0.0) for one in settings]) and any(values)
    }
    inputs = {
        config.inputs[name]: (min(values), max(values))
        for name in sorted({name for one in settings for name in one.inputs} & set(config.inputs))
        if len(set(values := [one.inputs[name] for one in settings if name in one.inputs])) > 1
    }
    return Wanted(
        temperature_degC=(min(levels), max(levels)) if max(levels) > min(levels) else None,
        heating_K_per_min=heating or None,
        cooling_K_per_min=cooling or None,
        columns=inputs | _name_loads(config, loads),
        seconds=next(one.lasts_s for one in plan.logs if one.log == number),
        why=f"log {number} of the last plan",
    )


def _name_loads(
    config: Config, loads: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Return the loads' ranges by column: that of the reference, or else of the reading."""
    columns = {
        output.name: output.reference if isinstance(output.reference, str) else output.measured
        for output in config.outputs
    }
    return {columns[name]: span for name, span in sorted(loads.items()) if name in columns}


def explain_taught(config: Config, file: Path) -> list[str]:
    """Return what can be learnt from the project's logs, the new one included, and what is next.

    Empty where they cannot be read together yet; nothing is raised for that.
    """
    try:
        dataset = load_dataset(_include(config, file.resolve()), skip_invalid=True)
        advice = advise(config, dataset)
    except ZerodriftError:
        return []
    return [] if advice is None else advice.explain()


def _include(config: Config, file: Path) -> Config:
    """Return the project with one more training log, unless its selectors match it."""
    there = set()
    kept = []
    for use, patterns in (("train", config.train_logs), ("test", config.test_logs)):
        for pattern in patterns:
            one = replace(config, train_logs=(pattern,))
            try:
                there |= {each.path.resolve() for each in expand_selectors(one, "train")}
            except NoLogsError:  # the first log of its kind is still to come
                continue
            if use == "train":
                kept.append(pattern)
    new = () if file in there else (str(file),)
    return replace(config, train_logs=(*kept, *new))
