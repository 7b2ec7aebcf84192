"""Plans the next experiment of a project; used by the command and by the Python face."""

import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.experiment_config import read_experiment
from zerodrift.base.files import write_whole
from zerodrift.base.records import from_json, to_dict
from zerodrift.base.toml_lines import index_lines
from zerodrift.base.toml_table import TomlTable
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.selectors import NoLogsError, expand_selectors
from zerodrift.discovery.plan import Planned, Question, plan_experiment, refuse_alike
from zerodrift.discovery.precise import PlannedPrecisely, plan_precisely
from zerodrift.discovery.summary import PastPlan, summarise_plan, summarise_precise
from zerodrift.physics.catalogue import Catalogue
from zerodrift.report.results import PlanResult

KEPT = "plan.json"
"""In build/: the last plan, to be compared with what came of it."""


@dataclass(frozen=True)
class KeptPlan:
    """A plan, and how many runs there were when it was made."""

    runs: int
    plan: PlanResult


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
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Planned | PlannedPrecisely, PlanResult]:
    """Return the programme and its record; no file is written.

    Raises:
        InputError: as `plan_experiment`.
    """
    units = {output.name: output.unit for output in config.outputs}
    if question.criterion != "discrimination" or question.units:
        precise = plan_precisely(config, dataset, catalogue, question, say)
        return precise, PlanResult(**vars(summarise_precise(precise, units)))
    past = None if dataset is None else _compare_past(config, dataset, catalogue)
    planned = plan_experiment(config, dataset, catalogue, question, say)
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
    from zerodrift.diagnosis.diagnose import diagnose

    found = diagnose(config.effects, dataset, catalogue)
    kinds = tuple(outlook.effect for outlook in plan.outlooks)
    alone = found.effect in kinds and not set(found.lookalikes) & set(kinds)
    return PastPlan(kinds, plan.probability, found.verdict, found.effect, alone)


def load_limits(config: Config, within: str | None) -> Config:
    """Return a project's configuration with the limits that are asked for."""
    return read_within(config, within) if within is not None else config
