"""Golden vectors as text: inputs run-length coded, expected values in hexadecimal, row by row."""

import json
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.c_runtime.host import HostModel
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.verify.mismatch import label_columns

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Golden:
    """A model, an input sequence, and what every back end must make of it."""

    model: IntegerModel
    codes: CodeArray  # [T, C]
    settled: bool
    """Starts from `settle`; else from `init`, which leaves a streaming network cold."""
    every: int
    """Every how many steps a row is written; the CRC covers all of them."""
    rows: NDArray[np.int32]  # [T // every, K + 1 + H] drift, flags, hidden state in Q1.30
    crc: int
    """CRC-32 of all T rows, int32, least significant byte first."""

    def to_text(self) -> str:
        """Return the JSON text."""
        body = {
            "model_hash": self.model.hash,
            "settled": self.settled,
            "every": self.every,
            "codes": _encode_runs(self.codes),
            "columns": f"{len(self.model.outputs)} drift, 1 flags, the rest hidden Q1.30",
            "rows": [_encode_row(row, 8) for row in self.rows],
            "crc": f"{self.crc:08x}",
        }
        return json.dumps(body, indent=0) + "\n"


def compute(model: IntegerModel, codes: CodeArray, settled: bool, every: int = 1) -> Golden:
    """Return the golden vectors that the reference gives."""
    trace = run_reference(model, codes, settled)
    return Golden(model, codes, settled, every, trace[every - 1 :: every], crc_of(trace))


def run_reference(model: IntegerModel, codes: CodeArray, settled: bool) -> NDArray[np.int32]:
    """Return all rows [T, K + 1 + H] as the reference computes them."""
    hidden: list[NDArray[np.int64]] = []
    names = [layer.name for layer in model.recurrents]
    trace = Reference(model).run(
        codes[None],
        settled=settled,
        observe=lambda _, values: hidden.append(np.concatenate([values[n][0] for n in names])),
    )
    return _join(trace.drift[0], trace.flags[0], np.stack(hidden))


def run_host(host: HostModel, codes: CodeArray, settled: bool) -> NDArray[np.int32]:
    """Return all rows [T, K + 1 + H] as the compiled C computes them."""
    trace = host.run(codes, settled=settled)
    return _join(trace.drift, trace.flags, trace.nodes[:, find_hidden(host.model)])


def find_hidden(model: IntegerModel) -> list[bool]:
    """Return which of the observed columns are what recurrent layers give."""
    names = [layer.name for layer in model.recurrents]
    return [label.split("[")[0] in names for label in label_columns(model)]


def crc_of(rows: NDArray[np.int32]) -> int:
    """Return the CRC-32 of the rows."""
    return zlib.crc32(np.ascontiguousarray(rows, dtype="<i4").tobytes())


def load(name: str) -> Golden:
    """Read `NAME.model.json` and `NAME.vectors.json` of this folder."""
    body = json.loads((FOLDER / f"{name}.vectors.json").read_text(encoding="utf-8"))
    model = load_model(FOLDER / f"{name}.model.json")
    assert model.hash == body["model_hash"], f"{name}: vectors and model do not belong together"
    rows = [[_signed(word, 32) for word in row.split()] for row in body["rows"]]
    return Golden(
        model=model,
        codes=_decode_runs(body["codes"], model),
        settled=body["settled"],
        every=body["every"],
        rows=np.array(rows, dtype=np.int32),
        crc=int(body["crc"], 16),
    )


def _join(
    drift: NDArray[np.int32], flags: NDArray[np.uint32], hidden: NDArray[np.int64]
) -> NDArray[np.int32]:
    return np.column_stack([drift, flags.astype(np.int32), hidden.astype(np.int32)])


def _encode_row(row: NDArray[np.integer], digits: int) -> str:
    return " ".join(f"{int(v) & (16**digits - 1):0{digits}x}" for v in row)


def _encode_runs(codes: CodeArray) -> list[str]:
    """Return "COUNT: codes" for every stretch of equal rows."""
    starts = np.flatnonzero(np.append(True, (codes[1:] != codes[:-1]).any(axis=1)))
    counts = np.diff(np.append(starts, len(codes)))
    digits = 2 * codes.dtype.itemsize
    return [f"{n}: {_encode_row(codes[i], digits)}" for i, n in zip(starts, counts, strict=True)]


def _decode_runs(runs: list[str], model: IntegerModel) -> CodeArray:
    bits = 8 * np.dtype(model.code_type).itemsize
    rows = []
    for run in runs:
        count, words = run.split(":")
        rows += [[_signed(word, bits) for word in words.split()]] * int(count)
    return np.array(rows, dtype=model.code_type)


def _signed(word: str, bits: int) -> int:
    value = int(word, 16)
    return value - (1 << bits) if value >> (bits - 1) else value
