"""A finished model over a log, as the chip would: drift, compensated value, uncertainty, flags."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.code_format import MEASURED
from zerodrift.dataset.log_steps import (
    LogSteps,
    StepStretch,
    find_column,
    lay_bridge,
    name_columns,
    read_log_steps,
)
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import count_elapsed
from zerodrift.export.encoding import encode_values
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import ModelState, Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.report.results import AppliedLog
from zerodrift.tasks.applied_rows import (
    BLOCK,
    AppliedRows,
    StepAnswers,
    refuse_names,
    summarise,
    write_rows,
)
from zerodrift.verify.uncertainty import Uncertainty

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
