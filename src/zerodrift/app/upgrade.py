"""`zerodrift init --upgrade`: what a project's logs chose so far is written into its file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zerodrift.base.column_config import CodesConfig
from zerodrift.base.config import FILE_NAME, Config, load_config, parse_config
from zerodrift.base.errors import InputError
from zerodrift.base.fleet_config import PLACEHOLDER
from zerodrift.base.journal import write_text
from zerodrift.base.progress import print_progress
from zerodrift.base.toml_inputs import set_columns
from zerodrift.dataset.chip_codes import choose_input_codes
from zerodrift.dataset.code_format import CLOCK
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Run
from zerodrift.fleet.sensors import configure_sensor, find_sensors, list_selectors

if TYPE_CHECKING:
    from zerodrift.report.results import UpgradeResult


def upgrade(directory: Path) -> "UpgradeResult":
    """Write the codes of every input that states none into zerodrift.toml, and nothing else.

    They are those that the training logs chose so far, of a fleet those that hold the logs of all
    units; from then on they are the same for every unit and whatever else is logged.

    Raises:
        InputError: a log cannot be read, or the file's layout is not understood.
    """
    from zerodrift.report.results import UpgradedInput, UpgradeResult

    config = load_config(directory)
    units = _list_units(config)
    kept = {name: why for name in config.inputs if (why := _explain_kept(config, name))}
    wanted = find_unstated(config)
    changed = []
    if wanted:
        runs = []
        for number, unit in enumerate(units, 1):
            if len(units) > 1:
                print_progress(f"reading the logs of unit {number} of {len(units)}")
            runs += _read_extremes(unit, wanted)
        for name in wanted:
            codes = choose_input_codes(config, name, runs)
            column = UpgradedInput(config.inputs[name], f"int{codes.bits}", codes.lsb)
            changed.append((name, column))
        path = directory / FILE_NAME
        text = path.read_text(encoding="utf-8")
        edited = set_columns(text, {n: {"raw": c.raw, "lsb": c.lsb} for n, c in changed}, path)
        _confirm(parse_config(edited, path.absolute()), config, path)
        write_text(path, edited)
    return UpgradeResult(
        file=str(directory / FILE_NAME),
        units=len(units),
        changed=dict(changed),
        kept=kept,
    )


def find_unstated(config: Config) -> list[str]:
    """Return the inputs whose codes follow from the logs, so that units may differ."""
    return [name for name in config.inputs if not _explain_kept(config, name)]


def describe(result: "UpgradeResult") -> str:
    """Return what was done, line by line."""
    whose = "its logs" if result.units == 1 else f"the logs of {result.units} units"
    lines = [
        f'{name}: raw = "{one.raw}", lsb = {one.lsb:.10g}: what {whose} chose, now the same for'
        " every unit"
        for name, one in result.changed.items()
    ]
    lines += [f"{name}: left as it is: {why}" for name, why in result.kept.items()]
    lines.append("temperature: left as it is: its lsb does not follow from logs")
    if not result.changed:
        return "\n".join([*lines, f"{result.file}: nothing to upgrade, and nothing written"])
    return "\n".join([*lines, f"wrote {result.file}", "next: zerodrift firmware"])


def _list_units(config: Config) -> list[Config]:
    is_fleet = bool(config.fleet.folder) or any(
        PLACEHOLDER in text for text in list_selectors(config, "train")
    )
    if not is_fleet:
        return [config]
    return [configure_sensor(config, sensor) for sensor in find_sensors(config)]


def _explain_kept(config: Config, name: str) -> str:
    """Return why an input's codes do not follow from the logs; empty where they do."""
    stated = config.input_codes.get(name, CodesConfig())
    if name == CLOCK:
        return "whole seconds"
    if stated.by is not None or stated.raw:
        return "the hardware's own codes"
    if stated.lsb is not None and stated.bits is not None:
        return "it states raw and lsb"
    return ""


def _read_extremes(config: Config, names: Sequence[str]) -> list[Run]:
    """Return the training runs, of each input the lowest and the highest value alone."""
    runs = load_dataset(config).train
    ends = [{n: np.array([r.inputs[n].min(), r.inputs[n].max()]) for n in names} for r in runs]
    return [replace(run, inputs=own) for run, own in zip(runs, ends, strict=True)]


def _confirm(after: Config, before: Config, path: Path) -> None:
    """Raise where an edit changed more than codes."""
    codes = {n: replace(c, bits=None, lsb=None) for n, c in after.input_codes.items()}
    was = {n: replace(c, bits=None, lsb=None) for n, c in before.input_codes.items()}
    if codes != was or replace(after, input_codes={}, path=before.path) != replace(
        before, input_codes={}
    ):
        raise InputError(
            f"{path}: its layout is not understood well enough to edit it; expected [inputs] with "
            "one key to a line. Write raw and lsb by hand."
        )
