"""What a recording should cover, by its project, and what can be learnt from it."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.journal import write_text
from zerodrift.base.records import from_json
from zerodrift.base.toml_logs import add_log
from zerodrift.dataset.selectors import NoLogsError, expand_selectors, matches_logs
from zerodrift.recording.coverage import Wanted
from zerodrift.report.results import PlanResult
from zerodrift.tasks.plan import KEPT, KeptPlan

CHANGES_K = 0.5
"""A set point that differs by less is the same."""


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
    from zerodrift.dataset.open_log import list_columns

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
    from zerodrift.dataset.load import load_dataset
    from zerodrift.diagnosis.advice import advise

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
