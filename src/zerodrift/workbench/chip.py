"""The firmware's own C in the page: what there is to replay, and a live sensor's lines.

A child of the page writes the folder of a replay: the C as WebAssembly, `CHIP`, and a file for each
run with its inputs and the reference's answers, which the page's worker is compared with.
"""

import json
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.column_config import TIME_UNITS
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, to_dict
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.dataset.conversions import convert
from zerodrift.dataset.log_steps import find_column
from zerodrift.dataset.sampling import AVERAGED_BELOW
from zerodrift.dataset.units import read_time_unit
from zerodrift.export.encoding import encode_values
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import ModelState, Reference
from zerodrift.fleet.sensors import load_unit
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.recording.sources import LineError, LineReader, Values

# A live sensor's rows become steps at the model's sample period, without looking ahead.
#
# The convention is that of logs (dataset/sampling.py). Rows that come faster than the period are
# averaged: a row counts until the next one, and a step is the mean over the period that ends at it.
# Rows at the period are a step each, jitter or not. Slower ones are held until the next row, where
# a log would be interpolated, which nobody can before the next row is there.

SLOW_ABOVE = 1.1
"""Rows whose interval is a larger share of the period are said to be slow."""
LOOKED_AT = 5
"""Intervals between rows, after which the way to steps is chosen."""
MOST_HELD = 100
"""Steps for which one row is held at most; a longer silence is left out."""
REMEMBERED = 60
"""Intervals of which the median is told."""
ENDED = 1e-6
"""Of a period: ten rows of 0.1 s fill one of 1 s, although their times are rounded."""


class LiveSteps:
    """Makes steps of rows, in the order in which they come.

    Args:
        period_s: of the model.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._waiting: list[tuple[float, Array]] = []
        """Rows that came before the way was chosen."""
        self._intervals: list[float] = []
        self._averages: bool | None = None
        """Whether rows are averaged; None: not known yet."""
        self._start_s = 0.0
        self._steps = 0
        """Of the present stretch, which began at `start`."""
        self._last: tuple[float, Array] | None = None
        self._area = np.zeros(0)
        self._width_s = np.zeros(0)
        """Of the mean so far, for each column: values times seconds, and seconds with a value."""
        self._left_out = 0

    def add(self, at_s: float, values: Array) -> list[Array]:
        """Take a row [n] of values at a time in s; return the steps that it finishes.

        A time that does not rise begins anew: the device has begun again.
        """
        before = self._waiting[-1] if self._waiting else self._last
        if before is not None:
            if at_s <= before[0]:
                self._waiting, self._last = [], None
            else:
                self._intervals = [*self._intervals[1 - REMEMBERED :], at_s - before[0]]
        if self._averages is None:
            self._waiting.append((at_s, values))
            if len(self._intervals) < LOOKED_AT:
                return []
            self._averages = self.interval_s < AVERAGED_BELOW * self._period_s
            rows, self._waiting = self._waiting, []
        else:
            rows = [(at_s, values)]
        return [step for row in rows for step in self._take(*row)]

    @property
    def interval_s(self) -> float:
        """The usual interval between rows in s; NaN before the second."""
        return float(np.median(self._intervals)) if self._intervals else np.nan

    def explain(self) -> tuple[str, bool]:
        """Return how rows become steps, for people, and whether that is worth a warning."""
        share, period = self.interval_s / self._period_s, f"{self._period_s:.4g} s"
        parts = []
        if self._averages:
            parts.append(
                f"a row every {self.interval_s:.3g} s: each step is their mean over {period}"
            )
        elif share > SLOW_ABOVE:
            parts.append(
                f"a row every {self.interval_s:.3g} s, slower than the model's period of {period}: "
                "each is held until the next; send them faster"
            )
        if self._left_out:
            parts.append(f"{self._left_out} silences of more than {MOST_HELD} steps left out")
        return "; ".join(parts), bool(self._left_out) or share > SLOW_ABOVE

    def _take(self, at_s: float, values: Array) -> list[Array]:
        if self._last is None:
            self._begin(at_s, values)
            return [] if self._averages else self._give(values)
        if at_s - self._last[0] > MOST_HELD * self._period_s:
            self._left_out += 1
            self._begin(at_s, values)
            return [] if self._averages else self._give(values)
        found = self._average_until(at_s) if self._averages else self._hold_until(at_s, values)
        self._last = (at_s, values)
        return found

    def _begin(self, at_s: float, values: Array) -> None:
        self._start_s, self._steps, self._last = at_s, 0, (at_s, values)
        self._area, self._width_s = np.zeros(values.size), np.zeros(values.size)

    def _give(self, values: Array) -> list[Array]:
        self._steps += 1
        return [values]

    def _hold_until(self, at_s: float, values: Array) -> list[Array]:
        """Return the held steps before the one that is nearest to a row, and that one."""
        assert self._last is not None
        slot = round((at_s - self._start_s) / self._period_s)
        if slot < self._steps:  # this row's step has been given: two rows within half a period
            return []
        held = [self._last[1]] * (slot - self._steps)
        self._steps = slot + 1
        return [*held, values]

    def _average_until(self, at_s: float) -> list[Array]:
        """Return the means of the periods that end until a row, which the last row fills."""
        assert self._last is not None
        begin_s, values = self._last
        found: list[Array] = []
        while True:
            end_s = self._start_s + (self._steps + 1) * self._period_s
            is_whole = end_s <= at_s + ENDED * self._period_s
            width_s = max((min(end_s, at_s) if is_whole else at_s) - begin_s, 0.0)
            self._area = self._area + np.nan_to_num(values) * width_s
            self._width_s = self._width_s + np.isfinite(values) * width_s
            if not is_whole:
                return found
            with np.errstate(invalid="ignore", divide="ignore"):
                found.append(self._area / self._width_s)
            self._area, self._width_s = np.zeros(values.size), np.zeros(values.size)
            self._steps += 1
            begin_s = end_s


# The firmware's own C in the page: what there is to replay, and a live sensor's lines.

CHIP, WASM, MODEL = "chip.json", "chip.wasm", "model.json"
LONGEST_TEXT = 1_000_000
"""Bytes of lines in one request."""


@dataclass(frozen=True)
class ReplayOutput:
    """What drifts."""

    name: str
    unit: str
    lsb_per_unit: int


@dataclass(frozen=True)
class ReplayFlag:
    """One bit of the flags."""

    bit: int
    words: str


@dataclass(frozen=True)
class ReplayRun:
    """One run whose inputs and answers lie in the folder."""

    name: str
    held_out: bool
    steps: int
    whole: int
    """Steps of the log; more than `steps` where only its beginning is replayed."""
    elapsed: int
    """Steps since power-on at its first."""


@dataclass(frozen=True)
class PageReplay:
    """What the page's script needs to run the C beside the reference."""

    prefix: str
    model_hash: str
    columns: int
    """Numbers of a step's input."""
    code_bytes: int
    """Bytes of each."""
    period_s: float
    wasm_bytes: int
    outputs: tuple[ReplayOutput, ...]
    flags: tuple[ReplayFlag, ...]
    runs: tuple[ReplayRun, ...]
    reads: tuple[str, ...]
    """Columns that a live sensor's lines must have."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class LiveAnswers:
    """Steps that came of lines, with the reference's answers."""

    codes: tuple[tuple[int, ...], ...]
    drift: tuple[tuple[int, ...], ...]
    flags: tuple[int, ...]
    measured: tuple[tuple[float | None, ...], ...]
    """In each output's unit; null where the line has none."""
    strays: int
    """Lines so far that were no rows."""
    first_stray: str
    sampling: str
    """How rows become steps; empty where each is one."""
    warns: bool
    """Whether that is worth a warning."""


def write_replay(
    folder: Path,
    replay: PageReplay,
    wasm: bytes,
    answers: list[tuple[CodeArray, NDArray[np.int32], NDArray[np.uint32], Array]],
) -> None:
    """Write a replay's folder.

    Args:
        folder: is there.
        replay: what the page is told.
        wasm: the module.
        answers: of each run: codes [n, C], the reference's drift [n, K] and flags [n], and the
            outputs [n, K] as measured.
    """
    (folder / WASM).write_bytes(wasm)
    for number, (codes, drift, flags, measured) in enumerate(answers):
        # The widest first, so that each begins at a multiple of its own size.
        parts = (measured.astype("<f8"), drift.astype("<i4"), flags.astype("<u4"), codes)
        content = b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
        (folder / name_answers(number)).write_bytes(content)
    (folder / CHIP).write_text(json.dumps(to_dict(replay)), encoding="utf-8")


def read_replay(folder: Path) -> PageReplay:
    """Return what a folder holds."""
    return from_json(PageReplay, json.loads((folder / CHIP).read_text(encoding="utf-8")))


def name_answers(number: int) -> str:
    """Return the file of a run's inputs and answers."""
    return f"run_{number}.bin"


def list_read(config: Config, model: IntegerModel) -> tuple[str, ...]:
    """Return the columns that a live sensor's lines must have: those of the model's channels."""
    columns = [find_column(config, c.source or c.name) for c in model.channels]
    return tuple(dict.fromkeys(columns))


class LiveChip:
    """Turns a live sensor's lines into the chip's inputs at its sample period, and answers them.

    Where a step is variable, each row is a step.
    """

    def __init__(self, directory: Path, folder: Path, sensor: str | None = None) -> None:
        """Begin before the first line.

        Args:
            directory: of the project; its zerodrift.toml says what the columns are.
            folder: of a replay, with its model.
            sensor: a unit of a fleet.

        Raises:
            InputError: a file of the project is gone or damaged.
        """
        self._config = load_unit(directory, sensor)
        self._model = load_model(folder / MODEL)
        self._reference = Reference(self._model)
        self._state: ModelState | None = None
        self._reader = LineReader()
        self._steps: LiveSteps | None = None
        self._has_times = False
        """Whether rows have times of their own."""
        self._came_s = -np.inf
        """When the last lines arrived."""
        self._last: Array | None = None
        self._strays, self._first_stray = 0, ""
        self._lock = threading.Lock()

    def take(self, text: str, now_s: float | None = None) -> LiveAnswers:
        """Return the steps of some whole lines, which go on from the last call's.

        Args:
            text: the lines.
            now_s: when they arrived, by any clock in s; None: now.

        Raises:
            InputError: a row lacks a column that the model reads.
        """
        with self._lock:
            rows = [row for row in map(self._read, text.splitlines()) if row]
            steps = self._resample(rows, time.monotonic() if now_s is None else now_s)
            inputs = len(self._model.channels)
            codes = [self._encode(step[:inputs]) for step in steps]
            drift, flags = list[tuple[int, ...]](), list[int]()
            for given in codes:
                d, f = self._step(given)
                drift.append(d)
                flags.append(f)
            told = tuple(tuple(int(x) for x in given[0]) for given in codes)
            measured = tuple(
                tuple(float(x) if np.isfinite(x) else None for x in step[inputs:]) for step in steps
            )
            sampling, warns = self._steps.explain() if self._steps is not None else ("", False)
            return LiveAnswers(
                codes=told,
                drift=tuple(drift),
                flags=tuple(flags),
                measured=measured,
                strays=self._strays,
                first_stray=self._first_stray,
                sampling=sampling,
                warns=warns,
            )

    def _resample(self, rows: list[Values], now_s: float) -> list[Array]:
        """Return steps [C + K], inputs and measured outputs, that rows finish.

        Rows without times of their own are taken as evenly spread since the last lines arrived.
        """
        values = [np.concatenate([self._read_inputs(row), self._measure(row)]) for row in rows]
        if self._config.variable_step or not rows:
            return values
        column, period_s = self._config.time_column, self._model.sample_period_s
        if self._steps is None:
            self._has_times = column in rows[0]
            self._steps = LiveSteps(period_s)
        if self._has_times:
            unit = self._config.time.unit or read_time_unit(column) or "s"
            times_s = [TIME_UNITS[unit] * row.get(column, np.nan) for row in rows]
        else:
            if not np.isfinite(self._came_s):  # when those before the last were made, nobody knows
                values, self._came_s = values[-1:], now_s - period_s
            each_s = (now_s - self._came_s) / len(values)
            times_s = [self._came_s + each_s * (number + 1) for number in range(len(values))]
            self._came_s = now_s
        found = []
        for at_s, row in zip(times_s, values, strict=True):
            if np.isfinite(at_s):
                found += self._steps.add(at_s, row)
            else:
                self._strays += 1
                self._first_stray = self._first_stray or f"a row has no time in '{column}'"
        return found

    def _read(self, line: str) -> Values | None:
        try:
            return self._reader.read(line)
        except LineError as error:
            self._strays += 1
            self._first_stray = self._first_stray or str(error)
            return None

    def _find(self, row: Values, column: str) -> float:
        """Return a column's value as the project converts it."""
        value = np.array([row.get(column, np.nan)])
        by = self._config.conversions.get(column)
        if by is None:
            return float(value[0])
        cold = None
        if by.junction is not None:
            cold = np.array([self._find(row, find_column(self._config, by.junction))])
        return float(convert(value, by, cold)[0])

    def _read_inputs(self, row: Values) -> Array:
        """Return the model's inputs [C] of a row, in their physical units."""
        lacking = [c for c in list_read(self._config, self._model) if c not in row]
        if lacking:
            raise InputError(
                f"the sensor's lines have {', '.join(row)}; the model reads {', '.join(lacking)},"
                " too. Expected the columns of the logs."
            )
        return np.array([self._find(row, column) for column in self._list_columns()])

    def _list_columns(self) -> list[str]:
        """Return the column of each of the model's channels."""
        return [find_column(self._config, c.source or c.name) for c in self._model.channels]

    def _encode(self, inputs: Array) -> CodeArray:
        """Return the codes [1, C] of a step; what has no reading and no code for it holds."""
        channels, values = self._model.channels, inputs.copy()
        holds = np.isnan(values) & np.array([c.no_reading is None for c in channels])
        if holds.any():
            if self._last is None or np.isnan(self._last[holds]).any():
                lacking = self._list_columns()[int(holds.argmax())]
                raise InputError(
                    f"'{lacking}' has no reading in the first line; expected a number. Begin again."
                )
            values[holds] = self._last[holds]
        self._last = values
        return encode_values(self._model, values[None])[1]

    def _step(self, codes: CodeArray) -> tuple[tuple[int, ...], int]:
        wide = codes.astype(np.int64)
        if self._state is None:
            self._state = self._reference.start(wide, settled=True)
        self._state, _, drift, flags = self._reference.step(self._state, wide)
        return tuple(int(x) for x in drift[0]), int(flags[0])

    def _measure(self, row: Values) -> Array:
        names = (f"{MEASURED}{output.name}" for output in self._model.outputs)
        return np.array([self._find(row, find_column(self._config, name)) for name in names])
