"""A log of a unit in use, read once: steps, true values, and what a model leaves of them."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.dataset.log_steps import LogSteps, find_column, name_columns, read_log_steps
from zerodrift.dataset.selectors import list_files
from zerodrift.export.integer_model import IntegerModel
from zerodrift.tasks.apply import Chip, answer
from zerodrift.verify.manifest import hash_file
from zerodrift.verify.uncertainty import Uncertainty


@dataclass(frozen=True)
class Deployed:
    """A unit in use, and how it is monitored."""

    sensor: str
    serial: str
    """Under which the registry knows it."""
    config: Config
    model: IntegerModel
    uncertainty: Uncertainty | None
    loads: Mapping[str, float]
    """Output -> its true value in the logs, in its unit, where it is known without a column."""
    when: tuple[str, float] | None = None
    """(column, value) of the rows at which the load is known; None: all."""


@dataclass(frozen=True)
class MonitoredLog:
    """The content of one log, step by step."""

    steps: LogSteps
    time_s: Array
    channels: Array
    """[n, C]"""
    temperature: Array
    """[n] as a share of the calibrated range: -1 .. 1 inside."""
    excess: Mapping[str, Array]
    """Output -> [n] measured less true value, in its unit; NaN where that is unknown."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Left:
    """What a model leaves of a log."""

    residuals: Mapping[str, Array]
    """Output -> [n] measured less drift less true value, in its unit; NaN where that is unknown."""
    flags: NDArray[np.uint32]
    notes: tuple[str, ...]


def open_log(deployed: Deployed, log: Path, skip_invalid: bool) -> MonitoredLog:
    """Return a log with what is known of its true values.

    Raises:
        InputError: it cannot be read, or lacks what the model takes.
    """
    config, model = deployed.config, deployed.model
    wanted = [c.source or c.name for c in model.channels]
    wanted += [f"{MEASURED}{output.name}" for output in model.outputs]
    columns = name_columns(config, wanted)
    if deployed.when is not None:
        columns.setdefault(deployed.when[0], "--when")
    known = dict.fromkeys(
        o.reference
        for o in config.outputs
        if isinstance(o.reference, str) and o.name not in deployed.loads
    )
    notes: list[str] = []
    try:
        asked = {**columns, **dict.fromkeys(known, "[outputs] reference")}
        steps = read_log_steps(config, log, asked, skip_invalid)
    except InputError as error:
        if not known or isinstance(error.__cause__, OSError):
            raise
        steps = read_log_steps(config, log, columns, skip_invalid)
        notes.append(f"{log}: no true value is read ({str(error).split(';')[0]})")
        known = {}
    here = np.ones(steps.steps, dtype=np.bool_)
    if deployed.when is not None:
        column, value = deployed.when
        here = _resample(steps, column) == value
    excess = {}
    for output in model.outputs:
        stated = next(o for o in config.outputs if o.name == output.name)
        if output.name in deployed.loads:
            true: Array | float = deployed.loads[output.name]
        elif stated.reference in known:
            true = _resample(steps, str(stated.reference))
        else:
            continue
        excess[output.name] = np.where(here, _resample(steps, stated.measured) - true, np.nan)
    channels = np.column_stack(
        [_resample(steps, find_column(config, c.source or c.name)) for c in model.channels]
    )
    guards = model.guards
    thermometer = model.channels[guards.temperature_channel]
    low, high = (
        thermometer.offset + code * thermometer.lsb
        for code in (guards.temperature_low, guards.temperature_high)
    )
    warm = channels[:, guards.temperature_channel]
    share = (warm - 0.5 * (low + high)) / max(0.5 * (high - low), 1e-9)
    time_s = np.concatenate([one.stretch.time_s for one in steps.stretches])
    return MonitoredLog(steps, time_s, channels, share, excess, (*notes, *steps.notes))


def apply_to(chip: Chip, config: Config, log: MonitoredLog) -> Left:
    """Return what a model leaves of a log."""
    answers = answer(chip, config, log.steps, with_range=False)
    residuals = {
        output.name: log.excess[output.name] - answers.drift[:, k] / float(output.lsb_per_unit)
        for k, output in enumerate(chip.model.outputs)
        if output.name in log.excess
    }
    return Left(residuals, answers.flags, answers.notes)


def hash_log(log: Path) -> str:
    """Return the SHA-256 of a log's files.

    Raises:
        InputError: one cannot be read.
    """
    digest = hashlib.sha256()
    for path in list_files(log):
        digest.update(hash_file(path).encode())
    return digest.hexdigest()


def _resample(steps: LogSteps, column: str) -> Array:
    """Return a column [n] at all steps of a log."""
    return np.concatenate([steps.resample(column, one) for one in steps.stretches])
