"""A finished model over a log, as the chip would: drift, compensated value, uncertainty, flags."""

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray
from polars.io.plugins import register_io_source

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.files import explain_write
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.dataset.log_steps import (
    LogSteps,
    StepStretch,
    find_column,
    lay_bridge,
    name_columns,
    read_log_steps,
)
from zerodrift.dataset.runs import Run
from zerodrift.dataset.selectors import CSV_SUFFIXES, PARQUET_SUFFIXES
from zerodrift.export.compose import count_elapsed
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_DAMAGED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    Channel,
    IntegerModel,
)
from zerodrift.export.reference import ModelState, Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.report.results import AppliedLog, OutputApplied
from zerodrift.verify.uncertainty import Uncertainty

Array = NDArray[np.float64]
PredictFloat = Callable[[Run], Array]

FLAGS = "flags"
FLAG_NAMES = {
    FLAG_WARMING_UP: "warming up",
    FLAG_TEMPERATURE_RANGE: "temperature outside the calibrated range",
    FLAG_RATE_RANGE: "temperature moves faster than calibrated",
    FLAG_CLAMPED: "correction at its limit",
    FLAG_DAMAGED: "state or model damaged",
    FLAG_INPUT_RANGE: "an input outside its calibrated range",
    FLAG_NO_READING: "no reading",
}
UNSTATED = FLAG_CLAMPED | FLAG_DAMAGED | FLAG_NO_READING
"""Rows with one of these flags have no uncertainty: nothing says how far off they are."""
BLOCK = 65_536
"""Steps, and rows, that are worked on at once."""


@dataclass(frozen=True)
class StepAnswers:
    """What the model gives for each step of a log."""

    drift: NDArray[np.float32] | NDArray[np.int32]
    """[steps, K]: int32 codes, or float32 values of the float model."""
    flags: NDArray[np.uint32]
    """[steps]."""
    beyond: NDArray[np.float32] | None
    """[steps] how far outside its range an input is, as a share of it; None: nowhere."""
    notes: tuple[str, ...]


class Chip:
    """The integer model: its C on this host, or the reference where there is no compiler."""

    def __init__(self, model: IntegerModel) -> None:
        self.model = model
        self.note = ""
        self._host: HostModel | None = None
        self._reference = Reference(model)
        self._state: ModelState | None = None
        try:
            with tempfile.TemporaryDirectory(prefix="zerodrift-") as scratch:
                self._host = HostModel(model, generate(model), Path(scratch), observe=False)
        except (CheckError, OSError) as error:
            self.note = f"no C could be built ({error}); computed by the reference, which is slow"

    def run(
        self, codes: CodeArray, elapsed: int | None
    ) -> tuple[NDArray[np.int32], NDArray[np.uint32]]:
        """Return drift [n, K] and flags [n] of codes [n, C].

        Args:
            codes: raw codes.
            elapsed: begin at rest so many steps after power-on; None goes on from the last call.
        """
        if self._host is not None:
            restart = elapsed is not None
            trace = self._host.run(codes, restart=restart, elapsed=elapsed or 0)
            return trace.drift, trace.flags
        state = None if elapsed is not None else self._state
        told = self._reference.run(codes[None], state=state, elapsed=elapsed or 0)
        self._state = told.state
        return told.drift[0], told.flags[0]


def apply_model(
    config: Config,
    model: IntegerModel,
    logs: Sequence[tuple[Path, Path]],
    *,
    uncertainty: Uncertainty | None = None,
    predict_float: PredictFloat | None = None,
    skip_invalid: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> list[AppliedLog]:
    """Write each log with what the model gives for its rows; return what was given.

    Each output gains `NAME_drift`, `NAME_compensated` and `NAME_uncertainty` (k = 2), in its unit,
    and the log `flags`, the chip's. A row's drift is that of the last step of the firmware that is
    complete by then; before a run's first step, that of the first.

    Args:
        config: the project; says how the logs are read.
        model: the integer model.
        logs: (log, file to be written), .csv or .parquet.
        uncertainty: of the model; None leaves the columns empty.
        predict_float: run -> [n, K] drift of the float model, which then stands for the chip's.
        skip_invalid: drop rows whose time is no number or does not rise.
        say: is told what is being done.

    Raises:
        InputError: a log cannot be read or lacks a channel, or a file cannot be written.
    """
    chip = Chip(model)
    applied = []
    for number, (log, out) in enumerate(logs, start=1):
        say(f"reading {log.name} ({number} of {len(logs)})")
        wanted = [c.source or c.name for c in model.channels]
        wanted += [f"{MEASURED}{output.name}" for output in model.outputs]
        columns = name_columns(config, wanted)
        steps = read_log_steps(config, log, columns, skip_invalid)
        _refuse_names(steps, config, model)
        say(f"computing {log.name} ({number} of {len(logs)})")
        answers = answer(chip, config, steps, with_range=uncertainty is not None)
        if predict_float is not None:
            drift = _predict_float(predict_float, config, model, steps)
            answers = replace(answers, drift=drift)
        say(f"writing {out.name} ({number} of {len(logs)})")
        frames = _Frames(config, model, steps, answers, uncertainty)
        write_frames(frames, out)
        notes = (*steps.notes, *answers.notes, *([chip.note] if chip.note else []))
        applied.append(_summarise(log, out, frames, notes))
    return applied


def answer(chip: Chip, config: Config, steps: LogSteps, *, with_range: bool = True) -> StepAnswers:
    """Return what the chip gives for each step of a log, each run begun at rest.

    Args:
        chip: the model.
        config: names the columns of its channels.
        steps: the log.
        with_range: whether to measure how far outside their ranges the inputs are.
    """
    model = chip.model
    drift = np.zeros((steps.steps, len(model.outputs)), dtype=np.int32)
    flags = np.zeros(steps.steps, dtype=np.uint32)
    beyond = np.zeros(steps.steps, dtype=np.float32) if with_range else None
    before: Array | None = None
    clipped = dict.fromkeys((channel.name for channel in model.channels), 0)
    held = dict.fromkeys(clipped, 0)
    for one in steps.stretches:
        values = _read_channels(config, model, steps, one)
        elapsed: int | None = None
        if one.part == 0 or before is None:
            elapsed = _count_elapsed(config, model, one)
        elif one.bridge:
            _, codes = encode_values(model, lay_bridge(before, values, one.bridge))
            for start in range(0, one.bridge, BLOCK):
                chip.run(codes[start : start + BLOCK], None)
        for start in range(0, one.stretch.steps, BLOCK):
            part = values[start : start + BLOCK]
            counts, codes = encode_values(model, part)
            for channel, (out, lacking) in zip(model.channels, counts, strict=True):
                clipped[channel.name] += out
                held[channel.name] += lacking if channel.no_reading is None else 0
            at = slice(one.first_step + start, one.first_step + start + len(part))
            drift[at], flags[at] = chip.run(codes, elapsed)
            if beyond is not None:
                beyond[at] = measure_beyond(model, codes)
            elapsed = None
        before = values[-1:]
    notes = [
        f"{steps.source.label}: '{name}' leaves its codes at {count} steps; the nearest was taken"
        for name, count in clipped.items()
        if count
    ]
    notes += [
        f"{steps.source.label}: '{name}' has no reading at {count} steps, and no code that says "
        "so; the last one was held"
        for name, count in held.items()
        if count
    ]
    return StepAnswers(drift, flags, beyond, tuple(notes))


def _read_channels(config: Config, model: IntegerModel, steps: LogSteps, one: StepStretch) -> Array:
    """Return the channels' values [n, C] over a stretch; NaN where a channel may lack them."""
    values = np.empty((one.stretch.steps, len(model.channels)))
    for index, channel in enumerate(model.channels):
        column = find_column(config, channel.source or channel.name)
        values[:, index] = steps.resample(column, one)
        if channel.no_reading is None and np.isnan(values[:, index]).all():
            raise InputError(
                f"{steps.source.label}: '{column}' has no reading in a whole stretch, and the "
                f"firmware has no code for none of '{channel.name}'; expected numbers. Leave the "
                "stretch out of the log."
            )
    return values


def encode_values(model: IntegerModel, values: Array) -> tuple[list[tuple[int, int]], CodeArray]:
    """Return per channel the values beyond its codes and those that lack, and codes [n, C]."""
    counts, columns = [], []
    for channel, column in zip(model.channels, values.T, strict=True):
        codes, out, lacking = _encode_channel(channel, column)
        counts.append((out, lacking))
        columns.append(codes)
    return counts, np.stack(columns, axis=1).astype(model.code_type)


def _encode_channel(channel: Channel, values: Array) -> tuple[Array, int, int]:
    """Return codes [n], how many values lie beyond them, and how many are lacking."""
    codes = np.round((values - channel.offset) / channel.lsb)
    lacks = np.isnan(codes)
    limited = np.clip(codes, channel.least, channel.most)
    if lacks.any():
        known = np.flatnonzero(~lacks)
        first = int(known[0]) if known.size else 0
        last = np.maximum.accumulate(np.where(lacks, first, np.arange(codes.size)))
        none = limited[last] if channel.no_reading is None else float(channel.no_reading)
        limited = np.where(lacks, none, limited)
    return limited, int(np.sum(limited[~lacks] != codes[~lacks])), int(lacks.sum())


def _count_elapsed(config: Config, model: IntegerModel, one: StepStretch) -> int:
    """Return the steps since power-on at a stretch's first step."""
    empty = np.zeros((1, len(model.outputs)))
    time_s, period_s = one.stretch.time_s[:1], config.sample_period_s
    run = Run("", "", 0, Path(), period_s, time_s, time_s, empty, empty, start_s=one.start_s)
    return count_elapsed(model, run)


def measure_beyond(model: IntegerModel, codes: CodeArray) -> NDArray[np.float32]:
    """Return how far outside its calibrated range an input is [n], as a share; 0 inside."""
    guards = model.guards
    temperature = (guards.temperature_channel, guards.temperature_low, guards.temperature_high)
    squares = np.zeros(len(codes))
    for index, low, high in (temperature, *guards.ranges):
        own = codes[:, index].astype(np.float64)
        none = model.channels[index].no_reading
        outside = np.maximum(np.maximum(low - own, own - high), 0.0) / max(high - low, 1)
        if none is not None:
            outside[own == none] = 0.0
        squares += outside**2
    return np.sqrt(squares).astype(np.float32)


def _predict_float(
    predict: PredictFloat, config: Config, model: IntegerModel, steps: LogSteps
) -> NDArray[np.float32]:
    """Return the float model's drift [steps, K]; what lacks readings holds the last ones."""
    drift = np.zeros((steps.steps, len(model.outputs)), dtype=np.float32)
    before: Run | None = None
    for one in steps.stretches:

        def read(column: str, one: StepStretch = one) -> Array:
            values = steps.resample(column, one)
            lacks = np.isnan(values)
            known = np.flatnonzero(~lacks)
            if known.size and lacks.any():
                held = np.where(lacks, known[0], np.arange(values.size))
                values = values[np.maximum.accumulate(held)]
            return values

        inputs = {}
        for channel in model.channels[1:]:
            source = channel.source or channel.name
            if not source.startswith(MEASURED):
                inputs[source] = read(find_column(config, source))
        columns = [find_column(config, f"{MEASURED}{o.name}") for o in model.outputs]
        measured = np.nan_to_num(np.stack([read(column) for column in columns], axis=1))
        run = Run(
            f"{one.run}#{one.part}",
            one.run,
            one.part,
            steps.source.path,
            config.sample_period_s,
            one.stretch.time_s,
            read(config.temperature_column),
            measured,
            np.zeros_like(measured),
            inputs,
            one.start_s,
            before if one.part else None,
        )
        drift[one.first_step : one.first_step + len(run)] = predict(run)
        before = run
    return drift


class _Frames:
    """The log's rows with what the model gives for them, in batches."""

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
        self._scales = [
            float(o.lsb_per_unit) if answers.drift.dtype == np.int32 else 1.0 for o in model.outputs
        ]

    def list_added(self) -> list[str]:
        """Return the names of the columns that are added."""
        return list_added(self.model)

    def stream(self, as_text: bool) -> Iterator[pl.DataFrame]:
        """Yield the rows.

        Args:
            as_text: keep a CSV's fields as they were written, but for the outputs; else what is
                numbers in its first rows is read as numbers.
        """
        source = self.steps.source
        numeric = set(self.measured)
        if source.is_csv and not as_text:
            numeric |= _find_numeric(source.scan().head(1000).collect())
        frame = source.scan(sorted(numeric))
        names = [name for name in source.names if not name.startswith("\0")]
        row = 0
        for batch in frame.select(names).collect_batches(chunk_size=BLOCK):
            at = self.steps.step_of_row[row : row + len(batch)]
            lacking = len(batch) - at.size  # rows after the last that was kept
            if lacking:
                at = np.concatenate([at, np.full(lacking, -1, dtype=np.int64)])
            yield batch.with_columns(self._compute(batch, at))
            row += len(batch)

    def _compute(self, batch: pl.DataFrame, at: NDArray[np.int64]) -> list[pl.Series]:
        none = at < 0
        step = np.where(none, 0, at)
        flags = self.answers.flags[step]
        columns = []
        for k, (output, column) in enumerate(zip(self.model.outputs, self.measured, strict=True)):
            drift = self.answers.drift[step, k] / self._scales[k]
            measured = batch[column].cast(pl.Float64).to_numpy()
            expanded = self.expand(output.name, step)
            columns += [
                _fill(f"{output.name}_drift", drift, none),
                _fill(f"{output.name}_compensated", measured - drift, none),
                _fill(f"{output.name}_uncertainty", expanded, none),
            ]
        told = pl.Series(FLAGS, flags.astype(np.uint32))
        return [*columns, told.zip_with(pl.Series(~none), pl.Series([None], dtype=pl.UInt32))]

    def expand(self, output: str, step: NDArray[np.int64]) -> Array:
        """Return the expanded uncertainty [n] at some steps; NaN where none is known."""
        known = self._known.get(output)
        if known is None or self.answers.beyond is None:
            return np.full(step.size, np.nan)
        expanded = known.expand(self.answers.beyond[step].astype(np.float64))
        return np.where(self.answers.flags[step] & UNSTATED != 0, np.nan, expanded)


def list_added(model: IntegerModel) -> list[str]:
    """Return the names of the columns that a log gains."""
    kinds = ("drift", "compensated", "uncertainty")
    return [*(f"{o.name}_{kind}" for o in model.outputs for kind in kinds), FLAGS]


def _fill(name: str, values: Array, none: NDArray[np.bool_]) -> pl.Series:
    """Return a column whose missing numbers are null."""
    return pl.Series(name, np.where(none, np.nan, values)).fill_nan(None)


def _find_numeric(head: pl.DataFrame) -> set[str]:
    """Return the columns of text that hold nothing but numbers."""
    found = set()
    for name in head.columns:
        column = head[name].drop_nulls()
        if len(column) and column.cast(pl.Float64, strict=False).null_count() == 0:
            found.add(name)
    return found


def _refuse_names(steps: LogSteps, config: Config, model: IntegerModel) -> None:
    """Refuse a log that has a column which is to be added."""
    taken = [name for name in list_added(model) if name in steps.source.names]
    if taken:
        raise InputError(
            f"{steps.source.label}: has a column '{taken[0]}' already; expected a log as it was "
            f"recorded. Apply the model of {config.path} to the original."
        )


def write_frames(frames: _Frames, out: Path) -> None:
    """Write a log's rows, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    beside = out.with_name(f".{out.name}.{os.getpid()}.part")
    try:
        if out.suffix.lower() in PARQUET_SUFFIXES:
            _write_parquet(frames, beside)
        else:
            _write_csv(frames, beside, "\t" if out.suffix.lower() == ".tsv" else ",")
        beside.replace(out)
    except OSError as error:
        raise InputError(explain_write(out, error)) from error
    finally:
        beside.unlink(missing_ok=True)


def _write_csv(frames: _Frames, path: Path, separator: str) -> None:
    with path.open("wb") as file:
        for number, batch in enumerate(frames.stream(as_text=True)):
            batch.write_csv(file, include_header=number == 0, separator=separator)


def _write_parquet(frames: _Frames, path: Path) -> None:
    stream = frames.stream(as_text=False)
    first = next(stream)

    def read(
        columns: list[str] | None,
        predicate: pl.Expr | None,
        most: int | None,
        size: int | None,
    ) -> Iterator[pl.DataFrame]:
        del columns, predicate, most, size  # a sink asks for everything
        yield first
        yield from stream

    register_io_source(read, schema=first.schema).sink_parquet(path)


def _summarise(log: Path, out: Path, frames: _Frames, notes: tuple[str, ...]) -> AppliedLog:
    outputs = {}
    answers, scales = frames.answers, frames._scales
    every = np.arange(frames.steps.steps)
    for k, output in enumerate(frames.model.outputs):
        squares, largest = 0.0, 0.0
        for start in range(0, every.size, BLOCK):
            part = answers.drift[start : start + BLOCK, k] / scales[k]
            squares += float(part @ part)
            largest = max(largest, float(np.abs(part).max()))
        expanded = frames.expand(output.name, every[:: max(1, every.size // BLOCK)])
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
        rows=frames.steps.rows,
        steps=frames.steps.steps,
        outputs=outputs,
        flags={text: count for text, count in counts.items() if count},
        notes=notes,
    )


def choose_file(log: Path, out: Path | None, several: bool) -> Path:
    """Return the file that a log's answer is written to.

    Args:
        log: the log.
        out: what the user named: a file, or a directory.
        several: whether there are more logs.

    Raises:
        InputError: a file is named for several logs, or its suffix stands for no format.
    """
    name = f"{log.stem}_compensated{log.suffix or '.csv'}"
    if out is None:
        return Path(name)
    if out.is_dir():
        return out / name
    if several:
        raise InputError(
            f"--out {out}: is no directory; expected one, as there are several logs. Make it first."
        )
    if out.suffix.lower() not in (*CSV_SUFFIXES, *PARQUET_SUFFIXES):
        raise InputError(
            f"--out {out}: '{out.suffix}' stands for no format; expected .csv, .tsv or .parquet."
        )
    return out
