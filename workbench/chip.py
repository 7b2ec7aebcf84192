"""The firmware's own C in the page: what there is to replay, and a live sensor's lines.

A child of the page writes the folder of a replay: the C as WebAssembly, `CHIP`, and a file for each
run with its inputs and the reference's answers, which the page's worker is compared with.
"""

import json
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, to_dict
from zerodrift.dataset.code_format import MEASURED
from zerodrift.dataset.conversions import convert
from zerodrift.dataset.log_steps import find_column
from zerodrift.export.encoding import encode_values
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import ModelState, Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.recording.lines import LineError, LineReader, Values

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


def write_replay(
    folder: Path,
    replay: PageReplay,
    wasm: bytes,
    answers: list[tuple[CodeArray, NDArray[np.int32], NDArray[np.uint32], NDArray[np.float64]]],
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
    """Turns a live sensor's lines into the chip's inputs, a step for each row, and answers them."""

    def __init__(self, directory: Path, folder: Path) -> None:
        """Begin before the first line.

        Args:
            directory: of the project; its zerodrift.toml says what the columns are.
            folder: of a replay, with its model.

        Raises:
            InputError: a file of the project is gone or damaged.
        """
        self._config = load_config(directory)
        self._model = load_model(folder / MODEL)
        self._reference = Reference(self._model)
        self._state: ModelState | None = None
        self._reader = LineReader()
        self._last: NDArray[np.float64] | None = None
        self._strays, self._first_stray = 0, ""
        self._lock = threading.Lock()

    def take(self, text: str) -> LiveAnswers:
        """Return the steps of some whole lines, which go on from the last call's.

        Raises:
            InputError: a row lacks a column that the model reads.
        """
        with self._lock:
            rows = [row for row in map(self._read, text.splitlines()) if row]
            codes = [self._encode(row) for row in rows]
            drift, flags = list[tuple[int, ...]](), list[int]()
            for given in codes:
                d, f = self._step(given)
                drift.append(d)
                flags.append(f)
            told = tuple(tuple(int(x) for x in given[0]) for given in codes)
            measured = tuple(self._measure(row) for row in rows)
            strays, first = self._strays, self._first_stray
            return LiveAnswers(told, tuple(drift), tuple(flags), measured, strays, first)

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

    def _encode(self, row: Values) -> CodeArray:
        """Return the codes [1, C] of a row; what has no reading and no code for it holds."""
        lacking = [c for c in list_read(self._config, self._model) if c not in row]
        if lacking:
            raise InputError(
                f"the sensor's lines have {', '.join(row)}; the model reads {', '.join(lacking)},"
                " too. Expected the columns of the logs."
            )
        channels = self._model.channels
        columns = [find_column(self._config, c.source or c.name) for c in channels]
        values = np.array([self._find(row, column) for column in columns])
        holds = np.isnan(values) & np.array([c.no_reading is None for c in channels])
        if holds.any():
            if self._last is None or np.isnan(self._last[holds]).any():
                raise InputError(
                    f"'{columns[int(holds.argmax())]}' has no reading in the first line; expected"
                    " a number. Begin again."
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

    def _measure(self, row: Values) -> tuple[float | None, ...]:
        found = []
        for output in self._model.outputs:
            value = self._find(row, find_column(self._config, f"{MEASURED}{output.name}"))
            found.append(value if np.isfinite(value) else None)
        return tuple(found)
