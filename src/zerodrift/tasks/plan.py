"""The next experiment of a project, computed."""

import json
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.experiment_config import read_experiment
from zerodrift.base.files import write_whole
from zerodrift.base.progress import SILENT, Progress
from zerodrift.base.records import from_json, to_dict
from zerodrift.base.toml_table import TomlTable, index_lines
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.selectors import NoLogsError, expand_selectors
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.discovery.plan import HOURS, Planned, Question, plan_experiment, refuse_alike
from zerodrift.discovery.precise import PlannedPrecisely, plan_precisely
from zerodrift.discovery.summary import (
    PastPlan,
    list_protocols,
    summarise_plan,
    summarise_precise,
    write_plan,
)
from zerodrift.physics.catalogue import Catalogue
from zerodrift.report.page import render_page
from zerodrift.report.pictures import draw_programme
from zerodrift.report.results import PlanResult
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.trust import require_trust

KEPT = "plan.json"
"""In build/: the last plan, to be compared with what came of it."""


@dataclass(frozen=True)
class KeptPlan:
    """A plan, and how many runs there were when it was made."""

    runs: int
    plan: PlanResult


@dataclass(frozen=True)
class PlanRequest:
    """Which experiment is wanted; `discovery.plan.Question` says what each means."""

    project: ProjectFolder
    hours: float | None = None
    """How long it may take; None: [experiment] hours, or 8."""
    between: tuple[str, ...] = ()
    target: float | None = None
    budget_s: float = 60.0
    criterion: str = "discrimination"
    profile: str | None = None
    units: int = 0
    within: str | None = None
    """Limits beside those of [experiment]: a .toml file, or `KEY = VALUE; KEY = VALUE`."""
    file: Path | None = None
    """Where the programme is written as CSV, and beside it a protocol of each log."""
    picture: Path | None = None
    """Where a page with the programme is written."""

    def __post_init__(self) -> None:
        """Refuse names that no file of the kind has.

        Raises:
            InputError: one has another ending.
        """
        if self.file is not None and self.file.suffix != ".csv":
            raise InputError(f"--out {self.file}: expected a name that ends in .csv.")
        if self.picture is not None and self.picture.suffix != ".html":
            raise InputError(f"--picture {self.picture}: expected a name that ends in .html.")


@dataclass(frozen=True)
class PlanOutcome:
    """The next experiment."""

    result: PlanResult
    notes: tuple[str, ...]


def plan(request: PlanRequest, progress: Progress = SILENT) -> PlanOutcome:
    """Plan the next experiment, keep it for the next plan, and write it as the request says.

    Raises:
        InputError: limits that contradict each other, or nothing left to distinguish.
    """
    project = request.project
    progress("reading logs")
    config = project.config
    if request.within is not None:
        config = read_within(config, request.within)
    require_trust(config.plugin_files, project.directory, progress)
    dataset = project.dataset if has_logs(config) else None
    question = Question(
        hours=request.hours or config.experiment.hours or HOURS,
        between=request.between,
        target=request.target,
        budget_s=request.budget_s,
        criterion=request.criterion,
        profile=request.profile,
        units=request.units,
    )
    planned, result = find_plan(config, dataset, project.catalogue, question, progress)
    keep_plan(config, result, 0 if dataset is None else len({run.group for run in dataset.train}))
    if request.file is not None:
        protocols = list_protocols(planned.programme, planned.limits, result.units)
        result = write_plan(result, protocols, request.file)
    if request.picture is not None:
        page = render_page("The next experiment", [draw_programme(result)])
        write_whole(request.picture, page.encode())
    notes = (*(dataset.notes if dataset is not None else ()), *result.notes)
    return PlanOutcome(result, notes)


def has_logs(config: Config) -> bool:
    """Return whether there is any training log yet."""
    for pattern in config.train_logs:
        try:
            if expand_selectors(replace(config, train_logs=(pattern,)), "train"):
                return True
        except NoLogsError:
            continue
    return False


def read_within(config: Config, within: str) -> Config:
    """Return the project with other limits: a TOML file, or `KEY = VALUE; KEY = VALUE`.

    Limits that are not given there stay as in `[experiment]`.

    Raises:
        InputError: it is not TOML, or has a key that `[experiment]` does not have.
    """
    path = Path(within)
    is_file = path.suffix == ".toml"
    if is_file and not path.is_file():
        raise InputError(
            f"--within {within}: there is no such file; expected one with a table [experiment], or "
            "keys such as 'temperature_degC = [0, 50]; heating_K_per_min = 2'."
        )
    where = path if is_file else Path("--within")
    text = path.read_text(encoding="utf-8") if is_file else within.replace(";", "\n")
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            f"{where}: {error}; expected TOML such as 'temperature_degC = [0, 50]; "
            "heating_K_per_min = 2', or the name of a .toml file."
        ) from error
    table = values.get("experiment", values)
    if not isinstance(table, dict):
        raise InputError(f"{where}: [experiment] is no table; write [experiment] above its keys.")
    key = ("experiment",) if "experiment" in values else ()
    read = read_experiment(
        TomlTable(where, index_lines(text), key, table),
        tuple(output.name for output in config.outputs),
        tuple(config.inputs),
    )
    old = config.experiment
    merged = replace(
        old,
        **{name: getattr(read, name) for name in table},
        lines={**old.lines, **read.lines},
    )
    return replace(config, experiment=merged)


def find_plan(
    config: Config,
    dataset: Dataset | None,
    catalogue: Catalogue,
    question: Question,
    progress: Progress = SILENT,
) -> tuple[Planned | PlannedPrecisely, PlanResult]:
    """Return the programme and its record; no file is written.

    Raises:
        InputError: as `plan_experiment`.
    """
    units = {output.name: output.unit for output in config.outputs}
    if question.criterion != "discrimination" or question.units:
        precise = plan_precisely(config, dataset, catalogue, question, progress)
        return precise, PlanResult(**vars(summarise_precise(precise, units)))
    past = None if dataset is None else _compare_past(config, dataset, catalogue)
    planned = plan_experiment(config, dataset, catalogue, question, progress)
    if question.between:
        refuse_alike(planned)
    summary = summarise_plan(planned, units, past)
    return planned, PlanResult(**vars(summary))


def keep_plan(config: Config, plan: PlanResult, runs: int) -> None:
    """Keep what a plan predicts, for the next plan to compare with the result."""
    if plan.probability is None:
        return
    config.build_directory.mkdir(parents=True, exist_ok=True)
    kept = json.dumps(to_dict(KeptPlan(runs, plan)))
    write_whole(config.build_directory / KEPT, kept.encode())


def _compare_past(config: Config, dataset: Dataset, catalogue: Catalogue) -> PastPlan | None:
    """Return the last plan with its result; None where no log followed it."""
    path = config.build_directory / KEPT
    if not path.is_file():
        return None
    try:
        kept = from_json(KeptPlan, json.loads(path.read_text(encoding="utf-8")), str(path))
    except ValueError:
        # Written by another version: it cannot be compared.
        return None
    plan = kept.plan
    if plan.probability is None or len({run.group for run in dataset.train}) <= kept.runs:
        return None
    found = diagnose(config.effects, dataset, catalogue)
    kinds = tuple(outlook.effect for outlook in plan.outlooks)
    alone = found.effect in kinds and not set(found.lookalikes) & set(kinds)
    return PastPlan(kinds, plan.probability, found.verdict, found.effect, alone)
