"""The rows of a log with the model's answers, and the file they are written to."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray
from polars.exceptions import PolarsError
from polars.io.plugins import register_io_source

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.csv_text import mark_frame
from zerodrift.base.errors import InputError
from zerodrift.base.files import explain_write, name_beside
from zerodrift.dataset.code_format import MEASURED
from zerodrift.dataset.log_steps import LogSteps, find_column
from zerodrift.dataset.selectors import PARQUET_SUFFIXES
from zerodrift.dataset.text_format import TextFormat
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_DAMAGED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TARED,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    IntegerModel,
)
from zerodrift.report.results import AppliedLog, OutputApplied
from zerodrift.verify.uncertainty import Uncertainty

FLAGS = "flags"
FLAG_NAMES = {
    FLAG_WARMING_UP: "warming up",
    FLAG_TEMPERATURE_RANGE: "temperature outside the calibrated range",
    FLAG_RATE_RANGE: "temperature moves faster than calibrated",
    FLAG_CLAMPED: "correction at its limit",
    FLAG_DAMAGED: "state or model damaged",
    FLAG_INPUT_RANGE: "an input outside its calibrated range",
    FLAG_NO_READING: "no reading",
    FLAG_TARED: "tared",
}
UNSTATED = FLAG_CLAMPED | FLAG_DAMAGED | FLAG_NO_READING
"""Rows with one of these flags have no uncertainty: nothing says how far off they are."""
BLOCK = 65_536
"""Steps, and rows, that are worked on at once."""


@dataclass(frozen=True)
class StepAnswers:
    """The model's answers for each step of a log."""

    drift: NDArray[np.float32] | NDArray[np.int32]
    """[steps, K]: int32 output codes, or float32 values of the float model in output units."""
    flags: NDArray[np.uint32]
    """[steps]."""
    beyond: NDArray[np.float32] | None
    """[steps] how far outside its range an input is, as a share of it; None: nowhere."""
    notes: tuple[str, ...]


class AppliedRows:
    """The log's rows with the model's answers, in batches."""

    def __init__(
        self,
        config: Config,
        model: IntegerModel,
        steps: LogSteps,
        answers: StepAnswers,
        uncertainty: Uncertainty | None,
    ) -> None:
        self.model, self.steps, self.answers = model, steps, answers
        self.measured = [find_column(config, f"{MEASURED}{o.name}") for o in model.outputs]
        self._known = uncertainty.outputs if uncertainty is not None else {}
        self.scales = [
            float(o.lsb_per_unit) if answers.drift.dtype == np.int32 else 1.0 for o in model.outputs
        ]

    def stream(self, as_text: bool) -> Iterator[pl.DataFrame]:
        """Yield the rows.

        Args:
            as_text: keep a CSV's fields as they were written; else columns
                whose first rows are numbers are read as numbers.
        """
        source = self.steps.source
        numeric = set[str]() if as_text else set(self.measured) - set(self.steps.quantities)
        if source.is_csv and not as_text:
            numeric |= _find_numeric(source.scan().head(1000).collect())
        frame = source.scan(sorted(numeric))
        names = [name for name in source.names if not name.startswith("\0")]
        row = 0
        for batch in frame.select(names).collect_batches(chunk_size=BLOCK):
            at = self.steps.step_of_row[row : row + len(batch)].astype(np.int64)
            lacking = len(batch) - at.size  # rows after the last that was kept
            if lacking:
                at = np.concatenate([at, np.full(lacking, -1, dtype=np.int64)])
            yield batch.with_columns(self._compute(batch, at, row))
            row += len(batch)

    def _compute(self, batch: pl.DataFrame, at: NDArray[np.int64], row: int) -> list[pl.Series]:
        none = at < 0
        step = np.where(none, 0, at)
        flags = self.answers.flags[step]
        columns = []
        for k, (output, column) in enumerate(zip(self.model.outputs, self.measured, strict=True)):
            drift = self.answers.drift[step, k] / self.scales[k]
            measured = self._read_measured(batch, column, row)
            expanded = self.expand(output.name, step)
            columns += [
                _fill(f"{output.name}_drift", drift, none),
                _fill(f"{output.name}_compensated", measured - drift, none),
                _fill(f"{output.name}_uncertainty", expanded, none),
            ]
        told = pl.Series(FLAGS, flags.astype(np.uint32))
        return [*columns, told.zip_with(pl.Series(~none), pl.Series([None], dtype=pl.UInt32))]

    def _read_measured(self, batch: pl.DataFrame, column: str, row: int) -> Array:
        """Return a measured column [n] of a batch that begins at a row, in the output's unit."""
        converted = self.steps.quantities.get(column)
        if converted is None:
            return _read_numbers(batch[column], self.steps.source.text)
        values = np.full(len(batch), np.nan)
        own = converted[row : row + len(batch)]
        values[: own.size] = own
        return values

    def expand(self, output: str, step: NDArray[np.int64]) -> Array:
        """Return the expanded uncertainty (k = 2) [n] at some steps, in the output's unit.

        NaN where none is known.
        """
        known = self._known.get(output)
        if known is None or self.answers.beyond is None:
            return np.full(step.size, np.nan)
        expanded = known.expand(self.answers.beyond[step].astype(np.float64))
        return np.where(self.answers.flags[step] & UNSTATED != 0, np.nan, expanded)


def refuse_names(steps: LogSteps, config: Config, model: IntegerModel) -> None:
    """Refuse a log that has a column which is to be added."""
    taken = [name for name in list_added(model) if name in steps.source.names]
    if taken:
        raise InputError(
            f"{steps.source.label}: has a column '{taken[0]}' already; expected a log as it was "
            f"recorded. Apply the model of {config.path} to the original."
        )


def list_added(model: IntegerModel) -> list[str]:
    """Return the names of the columns that a log gains."""
    kinds = ("drift", "compensated", "uncertainty")
    return [*(f"{o.name}_{kind}" for o in model.outputs for kind in kinds), FLAGS]


def _fill(name: str, values: Array, none: NDArray[np.bool_]) -> pl.Series:
    """Return a column whose missing numbers are null."""
    return pl.Series(name, np.where(none, np.nan, values)).fill_nan(None)


def _read_numbers(column: pl.Series, text: TextFormat | None) -> Array:
    """Return the numbers [n] of a column, of fields of text too; NaN where there is none."""
    if column.dtype == pl.String:
        if text is not None and text.decimal_comma:
            column = column.str.replace(",", ".", literal=True)
        column = column.str.strip_chars()
    return np.asarray(column.cast(pl.Float64, strict=False).to_numpy())


def _find_numeric(head: pl.DataFrame) -> set[str]:
    """Return the columns of text that hold nothing but numbers."""
    found = set()
    for name in head.columns:
        column = head[name].drop_nulls()
        if len(column) and column.cast(pl.Float64, strict=False).null_count() == 0:
            found.add(name)
    return found


def write_rows(rows: AppliedRows, out: Path) -> None:
    """Write a log's rows, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    beside = name_beside(out)
    try:
        if out.suffix.lower() in PARQUET_SUFFIXES:
            _write_parquet(rows, beside)
        else:
            _write_csv(rows, beside, tabs=out.suffix.lower() == ".tsv")
        beside.replace(out)
    except OSError as error:
        raise InputError(explain_write(out, error)) from error
    except PolarsError as error:  # its text contains the disk's error
        answer = re.search(r"(.*)\(os error (\d+)\)", str(error))
        if answer is None:
            raise
        cause = OSError(int(answer[2]), answer[1].strip())
        raise InputError(explain_write(out, cause)) from error
    finally:
        beside.unlink(missing_ok=True)


def _write_csv(rows: AppliedRows, path: Path, *, tabs: bool) -> None:
    """Write the rows as text; where the log has decimal commas, the answers have them too."""
    text = rows.steps.source.text
    comma = text is not None and text.decimal_comma
    separator = "\t" if tabs else ";" if comma else ","
    with path.open("wb") as file:
        for number, batch in enumerate(rows.stream(as_text=True)):
            mark_frame(batch).write_csv(
                file, include_header=number == 0, separator=separator, decimal_comma=comma
            )


def _write_parquet(rows: AppliedRows, path: Path) -> None:
    stream = rows.stream(as_text=False)
    first = next(stream)

    def read(
        columns: list[str] | None,
        predicate: pl.Expr | None,
        most: int | None,
        size: int | None,
    ) -> Iterator[pl.DataFrame]:
        del columns, predicate, most, size  # a sink requires all of these methods
        yield first
        yield from stream

    register_io_source(read, schema=first.schema).sink_parquet(path)


def summarise(log: Path, out: Path, rows: AppliedRows, notes: tuple[str, ...]) -> AppliedLog:
    """Return the answers to a log as figures: drift per output, steps per flag, notes."""
    outputs = {}
    answers, scales = rows.answers, rows.scales
    every = np.arange(rows.steps.steps)
    for k, output in enumerate(rows.model.outputs):
        squares, largest = 0.0, 0.0
        for start in range(0, every.size, BLOCK):
            part = answers.drift[start : start + BLOCK, k] / scales[k]
            squares += float(part @ part)
            largest = max(largest, float(np.abs(part).max()))
        expanded = rows.expand(output.name, every[:: max(1, every.size // BLOCK)])
        known = expanded[np.isfinite(expanded)]
        outputs[output.name] = OutputApplied(
            unit=output.unit,
            rms_drift=float(np.sqrt(squares / every.size)),
            largest_drift=largest,
            uncertainty=float(np.median(known)) if known.size else None,
        )
    counts = {text: int(np.count_nonzero(answers.flags & bit)) for bit, text in FLAG_NAMES.items()}
    return AppliedLog(
        log=str(log),
        file=str(out),
        rows=rows.steps.rows,
        steps=rows.steps.steps,
        outputs=outputs,
        flags={text: count for text, count in counts.items() if count},
        notes=notes,
    )
