"""Golden vectors: raw inputs and what the reference makes of them, in one .npz file."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.errors import InputError
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.files import write_whole
from zerodrift.operations.arithmetic import CodeArray

FIELDS = ("codes", "drift", "flags", "hidden", "hash")


@dataclass(frozen=True)
class GoldenVectors:
    """One sequence from rest, step by step."""

    codes: CodeArray  # [T, C]
    drift: NDArray[np.int32]  # [T, K]
    flags: NDArray[np.uint32]  # [T]
    hidden: NDArray[np.int32]
    """[T, H] streaming state in Q1.30; H = 0 without a streaming GRU."""
    model_hash: str

    def save(self, path: Path) -> None:
        """Write the vectors atomically; the same vectors give the same bytes."""
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            codes=self.codes,
            drift=self.drift,
            flags=self.flags,
            hidden=self.hidden,
            hash=np.frombuffer(self.model_hash.encode(), dtype=np.uint8),
        )
        write_whole(path, buffer.getvalue())


def compute_golden(model: IntegerModel, codes: CodeArray) -> GoldenVectors:
    """Return what the reference computes for codes [T, C], from rest at the first."""
    trace = Reference(model).run(codes[None])
    return GoldenVectors(codes, trace.drift[0], trace.flags[0], trace.hidden[0], model.hash)


def load_golden(path: Path) -> GoldenVectors:
    """Read golden vectors.

    Raises:
        InputError: missing, damaged or not golden vectors.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            parts = {name: file[name] for name in FIELDS}
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(
            f"{path}: cannot be read as golden vectors ({error}). Run `zerodrift export`."
        ) from error
    return GoldenVectors(
        parts["codes"],
        parts["drift"],
        parts["flags"],
        parts["hidden"],
        parts["hash"].tobytes().decode(),
    )
