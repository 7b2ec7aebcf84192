"""A finished model over a log, as the chip would: drift, compensated value, uncertainty, flags."""

import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray
from polars.exceptions import PolarsError
from polars.io.plugins import register_io_source

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.base.config import Config
from zerodrift.base.csv_text import mark_frame
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.files import explain_write, name_beside
from zerodrift.base.progress import SILENT, Progress
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
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.dataset.selectors import CSV_SUFFIXES, PARQUET_SUFFIXES
from zerodrift.dataset.text_format import TextFormat
from zerodrift.export.compose import count_elapsed, describe_compensator
from zerodrift.export.encoding import encode_values
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
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import ModelState, Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.report.results import AppliedLog, ApplyResult, OutputApplied
from zerodrift.tasks.built import read_uncertainty
from zerodrift.tasks.deployed_block import find_deployed_block
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.tasks.trust import require_trust
from zerodrift.train.compensator import DESCRIPTION, Compensator
from zerodrift.train.prepare import mark_inputs
from zerodrift.verify.manifest import check_manifest
from zerodrift.verify.uncertainty import Uncertainty

# The rows of a log with the model's answers, and the file they are written to.

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

    def _compute(self, batch: pl.DataFrame, at: IntArray, row: int) -> list[pl.Series]:
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

    def expand(self, output: str, step: IntArray) -> Array:
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


def _fill(name: str, values: Array, none: Mask) -> pl.Series:
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


# A finished model over a log, as the chip would: drift, compensated value, uncertainty, flags.

PredictFloat = Callable[[Run], Array]


class Chip:
    """The integer model: its C on this host, or the reference where there is no compiler.

    Args:
        model: the integer model.
        host: its C, where it is built already.
    """

    def __init__(self, model: IntegerModel, host: HostModel | None = None) -> None:
        self.model = model
        self.note = ""
        self._host = host
        self._reference = Reference(model)
        self._state: ModelState | None = None
        if host is not None:
            return
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
        if self.model.variable_step and elapsed is not None:
            codes = codes.copy()
            codes[0, -1] = 0  # it begins with this row
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
    """Write each log with the model's answers for its rows; return a summary of each.

    Each output gains `NAME_drift`, `NAME_compensated` and `NAME_uncertainty` (k = 2), in its unit,
    and the log `flags`, the chip's. A row's drift is that of the last step of the firmware that is
    complete by then; before a run's first step, that of the first.

    Args:
        config: the project; says how the logs are read.
        model: the integer model.
        logs: (log, file to be written), .csv or .parquet.
        uncertainty: of the model; None leaves the columns empty.
        predict_float: run -> [n, K] drift of the float model in output units, used instead of the
            chip's.
        skip_invalid: drop rows whose time is no number or does not rise.
        say: called with a description of each stage of the work.

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
        streamed = frozenset[str]() if predict_float is not None else _find_streamed(config, model)
        steps = read_log_steps(config, log, columns, skip_invalid, streamed)
        refuse_names(steps, config, model)
        say(f"computing {log.name} ({number} of {len(logs)})")
        answers = answer(chip, config, steps, with_range=uncertainty is not None)
        if predict_float is not None:
            drift = _predict_float(predict_float, config, model, steps)
            answers = replace(answers, drift=drift)
        say(f"writing {out.name} ({number} of {len(logs)})")
        steps = steps.drop_values()
        rows = AppliedRows(config, model, steps, answers, uncertainty)
        write_rows(rows, out)
        notes = (*steps.notes, *answers.notes, *([chip.note] if chip.note else []))
        applied.append(summarise(log, out, rows, notes))
    return applied


def _find_streamed(config: Config, model: IntegerModel) -> frozenset[str]:
    """Return the columns that no channel takes: they are only copied, row by row."""
    measured = {find_column(config, f"{MEASURED}{output.name}") for output in model.outputs}
    taken = {find_column(config, c.source or c.name) for c in model.channels}
    return frozenset(measured - taken)


def answer(chip: Chip, config: Config, steps: LogSteps, *, with_range: bool = True) -> StepAnswers:
    """Return the chip's answers for each step of a log, each run begun at rest.

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
        values = _read_channels(config, model, steps, one, held)
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
            for channel, out in zip(model.channels, counts, strict=True):
                clipped[channel.name] += out
            at = slice(one.first_step + start, one.first_step + start + len(part))
            drift[at], raised = chip.run(codes, elapsed)
            if raised.any():  # pages of zeros that are never written take no memory
                flags[at] = raised
            if beyond is not None and (outside := measure_beyond(model, codes)).any():
                beyond[at] = outside
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


def _read_channels(
    config: Config,
    model: IntegerModel,
    steps: LogSteps,
    one: StepStretch,
    held: dict[str, int],
) -> Array:
    """Return the channels' values [n, C] over a stretch; count steps at which one was held.

    A channel with a code for "no reading" has NaN where the log has no value; one without holds its
    last reading, and before its first reading, that one.

    Args:
        config: names the columns.
        model: has the channels.
        steps: the log.
        one: the stretch.
        held: channel -> steps at which it was held; incremented here.
    """
    values = np.empty((one.stretch.steps, len(model.channels)))
    for index, channel in enumerate(model.channels):
        column = find_column(config, channel.source or channel.name)
        values[:, index] = steps.resample(column, one)
        if channel.no_reading is not None:
            continue
        lacking = int(np.isnan(values[:, index]).sum())
        if lacking == one.stretch.steps:
            raise InputError(
                f"{steps.source.label}: '{column}' has no reading in a whole stretch, and the "
                f"firmware has no code for none of '{channel.name}'; expected numbers. Leave the "
                "stretch out of the log."
            )
        if lacking:
            values[:, index] = hold_last(values[:, index])
            held[channel.name] += lacking
    return values


def hold_last(values: Array) -> Array:
    """Return values [n] with gaps (NaN) filled by the last known value, or at the start the first.

    Without any known value they stay NaN.
    """
    lacks = np.isnan(values)
    known = np.flatnonzero(~lacks)
    if not known.size or not lacks.any():
        return values
    return values[np.maximum.accumulate(np.where(lacks, known[0], np.arange(values.size)))]


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
    squares, own_codes = np.zeros(len(codes)), model.convert(codes)
    for index, low, high in (temperature, *guards.ranges):
        own = own_codes[:, index].astype(np.float64)
        none = model.channels[index].no_reading
        outside = np.maximum(np.maximum(low - own, own - high), 0.0) / max(high - low, 1)
        if none is not None:
            outside[own == none] = 0.0
        squares += outside**2
    return np.sqrt(squares).astype(np.float32)


def _predict_float(
    predict: PredictFloat, config: Config, model: IntegerModel, steps: LogSteps
) -> NDArray[np.float32]:
    """Return the float model's drift [steps, K] in output units; missing readings hold the last."""
    drift = np.zeros((steps.steps, len(model.outputs)), dtype=np.float32)
    before: Run | None = None
    for one in steps.stretches:

        def read(column: str, one: StepStretch = one) -> Array:
            return hold_last(steps.resample(column, one))

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


# What `apply` needs: a project's finished model, and the files that it may write.

KINDS = INTEGER, FLOAT = ("integer", "float")


@dataclass(frozen=True)
class ApplyRequest:
    """Which logs the model is applied to."""

    project: ProjectFolder
    logs: tuple[Path, ...]
    out: Path | None = None
    """File, or a directory for several logs; None: LOG_compensated in the current directory."""
    kind: str = INTEGER
    """integer | float."""
    block: Path | None = None
    """The block on the unit; None: as the registry says, else the one written last."""


@dataclass(frozen=True)
class AppliedModel:
    """The model of the last `firmware`, or what the unit's chip computes with its block."""

    model: IntegerModel
    uncertainty: Uncertainty | None
    predict_float: PredictFloat | None
    """The float model's prediction, where it was asked for."""
    notes: tuple[str, ...]
    """Why there is no uncertainty, what has changed since the firmware was built, which block."""


def apply_to_logs(request: ApplyRequest, progress: Progress = SILENT) -> ApplyResult:
    """Run the model of the last `firmware` over logs, and write what it gives for every row.

    Raises:
        InputError: no firmware was built, a log cannot be read, or a file would be overwritten.
    """
    project = request.project
    config = project.config
    several = len(request.logs) > 1
    pairs = [(log, choose_file(log, request.out, several)) for log in request.logs]
    refuse_taken(pairs)
    whole = ProjectFolder(project.directory, project.sensor)  # no row of its own logs is left out
    opened = open_applied(
        config,
        request.kind,
        load_logs=lambda: open_project(whole, progress)[1],
        block=request.block,
        progress=progress,
    )
    progress("applying")
    applied = apply_model(
        config,
        opened.model,
        pairs,
        uncertainty=opened.uncertainty,
        predict_float=opened.predict_float,
        skip_invalid=project.skip_invalid,
        say=progress,
    )
    stated = opened.uncertainty.state() if opened.uncertainty is not None else None
    return ApplyResult(request.kind, opened.model.hash, tuple(applied), opened.notes, stated)


def open_applied(
    config: Config,
    kind: str = INTEGER,
    *,
    load_logs: Callable[[], Dataset],
    block: Path | None = None,
    progress: Progress = SILENT,
) -> AppliedModel:
    """Return the model of a project's last `firmware`; of a block design, with the unit's block.

    Args:
        config: the project.
        kind: integer | float.
        load_logs: returns the project's logs, which the float model needs.
        block: the block on the unit; None: as the registry says, else the one written last.
        progress: asks whether the project's effects may be run, which the float model needs.

    Raises:
        InputError: no firmware was built yet, it or the float model has other outputs, there is no
            such block, or `kind` is neither.
    """
    if kind not in KINDS:
        raise InputError(f"model = {kind!r}: expected one of {', '.join(KINDS)}.")
    if kind == FLOAT and block is not None:
        raise InputError(
            f"{block}: the float model takes no block; expected --model {INTEGER}, or no --block."
        )
    model = load_model(config.build_directory / "model.json")
    refuse_other(config, model, str(config.build_directory / "model.json"))
    uncertainty, why = read_uncertainty(config, model.hash)
    notes = [*([why] if why else []), *(f.text for f in check_manifest(config).findings)]
    predict = None
    if kind == FLOAT:
        require_trust(config.plugin_files, config.directory, progress)
        dataset = load_logs()
        catalogue = load_catalogue(config.plugin_files)
        trained = Compensator.load(config.build_directory, catalogue)
        if trained.physics.outputs != tuple(output.name for output in config.outputs):
            raise InputError(
                f"{config.build_directory / DESCRIPTION}: has the outputs"
                f" {', '.join(trained.physics.outputs)}; {config.path} has"
                f" {', '.join(output.name for output in config.outputs)}: it is another project's."
                " Run `zerodrift train`."
            )
        if trained.trained_from != mark_inputs(config, dataset):
            notes.append(
                f"{config.build_directory / DESCRIPTION}: was not trained from these logs and this"
                f" {config.path.name}, but from others; the float model may be another than the"
                " firmware's. `zerodrift train` trains it anew"
            )
        predict = describe_compensator(trained, config, dataset.train).predict_on_chip
    else:
        on_chip = find_deployed_block(config, block)
        if on_chip is not None:
            model = on_chip.model
            refuse_other(config, model, str(block or on_chip.note))
            notes.append(on_chip.note)
    return AppliedModel(model, uncertainty, predict, tuple(notes))


def load_nothing() -> Dataset:
    """Take the place of a project's logs, which the integer model does not need."""
    raise AssertionError("the integer model needs no logs")


def refuse_other(config: Config, model: IntegerModel, where: str) -> None:
    """Refuse a model of other outputs than the project's.

    Raises:
        InputError: names where it comes from.
    """
    names = tuple(output.name for output in model.outputs)
    wanted = tuple(output.name for output in config.outputs)
    if names != wanted:
        raise InputError(
            f"{where}: has the outputs {', '.join(names)}; {config.path} has {', '.join(wanted)}."
            " Run `zerodrift firmware`, or name the block of this sensor."
        )


def choose_file(log: Path, out: Path | None, several: bool) -> Path:
    """Return the file that a log's answer is written to.

    Args:
        log: the log.
        out: what the user named: a file, or a directory.
        several: whether there are more logs.

    Raises:
        InputError: one file is named for several logs, or its suffix belongs to no known format.
    """
    written = (*CSV_SUFFIXES, *PARQUET_SUFFIXES)
    suffix = log.suffix if log.suffix.lower() in written else ".csv"
    name = f"{log.stem}_compensated{suffix}"
    if out is None:
        return Path(name)
    if out.is_dir():
        return out / name
    if several:
        raise InputError(
            f"--out {out}: is no directory; expected one, as there are several logs. Make it first."
        )
    if out.suffix.lower() not in written:
        raise InputError(
            f"--out {out}: '{out.suffix}' stands for no format; expected .csv, .tsv or .parquet."
        )
    return out


def refuse_taken(pairs: Sequence[tuple[Path, Path]]) -> None:
    """Refuse to overwrite a log, another log's answer, or a file that `apply` did not write.

    Args:
        pairs: (log, file to be written).

    Raises:
        InputError: a file would be overwritten.
    """
    taken: dict[Path, Path] = {}
    logs = {log.resolve() for log, _ in pairs}
    for log, out in pairs:
        place = out.resolve()
        if place in logs:
            raise InputError(f"{out}: is a log itself; expected another file. Name it by --out.")
        if place in taken:
            raise InputError(
                f"{out}: would hold {taken[place]} and {log}; expected a file for each. Apply the "
                "model to one at a time, with --out."
            )
        taken[place] = log
        if out.exists() and FLAGS not in _name_columns(out):
            raise InputError(
                f"{out}: is there and was not written by `zerodrift apply`; expected a new file. "
                "Move it, or name another by --out."
            )


def _name_columns(path: Path) -> list[str]:
    """Return the columns of a file as `apply` writes them; none where it is no such file."""
    try:
        if path.suffix.lower() in PARQUET_SUFFIXES:
            return list(pl.read_parquet_schema(path))
        separator = "\t" if path.suffix.lower() == ".tsv" else ","
        head = pl.read_csv(path, separator=separator, n_rows=0, infer_schema=False)
        return head.columns
    except (PolarsError, OSError, UnicodeDecodeError):
        return []
