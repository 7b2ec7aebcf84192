"""`zerodrift init --upgrade`: codes that the logs decided so far are written into the project."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zerodrift.base.config import FILE_NAME, Config, load_config, parse_config
from zerodrift.base.errors import InputError
from zerodrift.base.fleet_config import PLACEHOLDER
from zerodrift.base.journal import write_text
from zerodrift.base.progress import SILENT, Progress
from zerodrift.base.toml_inputs import set_columns, set_format
from zerodrift.dataset.chip_codes import choose_input_codes, choose_temperature_codes
from zerodrift.dataset.design_codes import DESIGN_FORMAT, explain_stated, list_unstated
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Run
from zerodrift.fleet.sensors import configure_sensor, find_sensors, list_selectors

if TYPE_CHECKING:
    from zerodrift.report.results import UpgradeResult

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
