"""A simulated sensor with its logs, and how they are written as a user's project."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = Mapping[str, Array]
"""Column of a log -> shape (rows,)."""
Effect = Mapping[str, str | int | float]
"""One [[effect]] table."""

TIME = "time_s"
TEMPERATURE = "temperature_degC"


@dataclass(frozen=True)
class Output:
    """One quantity that drifts, by the names of its columns; `reference` is None for zero."""

    name: str
    measured: str
    reference: str | None
    unit: str
    full_scale: float


@dataclass(frozen=True, eq=False)
class Log:
    """One run. `name` is its file's stem; `use` is train, test, dwell or spare (not told)."""

    name: str
    use: str
    columns: Columns


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor, the model that its user begins with, and all its runs.

    Attributes:
        simulator: twin, foreign or third.
        outputs: 1 to 6.
        inputs: name in [inputs] -> column.
        period_s: of rows.
        effects: the told model.
        logs: the runs.
        tare_rows: rows at a log's begin over which it was zeroed; 0 = not tared.
        basis: columns of a log and number of an output -> the told model's columns in the
            simulator's own form, shape (rows, terms), without a constant.
        lacks: the effect that the told model lacks, or "".
    """

    simulator: str
    outputs: tuple[Output, ...]
    inputs: Mapping[str, str]
    period_s: float
    effects: tuple[Effect, ...]
    logs: tuple[Log, ...]
    tare_rows: int
    basis: Callable[[Columns, int], Array]
    lacks: str = ""

    def select(self, *uses: str) -> tuple[Log, ...]:
        """Return the runs of these uses."""
        return tuple(log for log in self.logs if log.use in uses)

    def with_log(self, changed: Log) -> "Sensor":
        """Return the sensor with one log in the place of that of its name."""
        logs = tuple(changed if log.name == changed.name else log for log in self.logs)
        return replace(self, logs=logs)

    def drift(self, columns: Columns, output: int) -> Array:
        """Return measured less reference of a log, shape (rows,)."""
        told = self.outputs[output]
        measured = columns[told.measured]
        return measured - columns[told.reference] if told.reference else measured

    def render_toml(self) -> str:
        """Return zerodrift.toml; physics only, no network."""
        lines = ["# Simulated.", "[sensor]", 'name = "judged"', f'time = "{TIME}"']
        lines += [f'temperature = "{TEMPERATURE}"', f"sample_period_s = {self.period_s:g}"]
        for output in self.outputs:
            lines += ["", f"[outputs.{output.name}]", f'measured = "{output.measured}"']
            lines += [f'reference = "{output.reference}"'] if output.reference else []
            lines += [f'unit = "{output.unit}"', f"full_scale = {output.full_scale:.6g}"]
        if self.inputs:
            lines += ["", "[inputs]"]
            lines += [f'{name} = "{column}"' for name, column in self.inputs.items()]
        lines += ["", "[logs]"]
        for use in ("train", "test", "dwell"):
            files = [f"logs/{log.name}.csv" for log in self.select(use)]
            lines += [f"{use} = {json.dumps(files)}"] if files else []
        for effect in self.effects:
            lines += ["", "[[effect]]"]
            lines += [f"{key} = {json.dumps(value)}" for key, value in effect.items()]
        return "\n".join([*lines, "", "[network]", 'kind = "none"', ""])

    def write(self, folder: Path) -> None:
        """Write zerodrift.toml and logs/RUN.csv; spare runs are not written."""
        (folder / "logs").mkdir(parents=True, exist_ok=True)
        (folder / "zerodrift.toml").write_text(self.render_toml(), encoding="utf-8")
        for log in self.select("train", "test", "dwell"):
            write_csv(log.columns, folder / "logs" / f"{log.name}.csv")


def write_csv(columns: Columns, path: Path) -> None:
    """Write one log with nine significant digits, and times with a microsecond."""
    table = {
        name: np.round(values, 6) if name == TIME else _round(values)
        for name, values in columns.items()
    }
    pl.DataFrame(table).write_csv(path)


def _round(values: Array) -> Array:
    largest = float(np.max(np.abs(values), initial=0.0))
    digits = 9 - int(np.ceil(np.log10(largest))) if largest > 0.0 else 9
    return np.round(values, digits)
