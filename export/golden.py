"""Golden vectors: raw inputs with the reference's answers, in one .npz file."""

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import pack_arrays
from zerodrift.base.errors import InputError
from zerodrift.base.files import write_whole
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
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

    def to_bytes(self) -> bytes:
        """Return the file's content; the same vectors give the same bytes."""
        arrays = {
            "codes": self.codes,
            "drift": self.drift,
            "flags": self.flags,
            "hidden": self.hidden,
            "hash": np.frombuffer(self.model_hash.encode(), dtype=np.uint8),
        }
        return pack_arrays(arrays, compressed=True)

    def save(self, path: Path) -> None:
        """Write the vectors, whole or not at all."""
        write_whole(path, self.to_bytes())


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
        _check_shapes(parts)
        return GoldenVectors(
            parts["codes"],
            parts["drift"],
            parts["flags"],
            parts["hidden"],
            parts["hash"].tobytes().decode("ascii"),
        )
    except FileNotFoundError as error:
        raise InputError(
            f"{path}: there are no golden vectors. Run `zerodrift firmware`."
        ) from error
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"{path}: cannot be read as golden vectors ({error}); the file is cut or damaged. Run"
            " `zerodrift firmware` again."
        ) from error


def _check_shapes(parts: dict[str, NDArray[np.generic]]) -> None:
    """Refuse arrays that are not [T, ...] of integers, with one T.

    Raises:
        ValueError: which.
    """
    steps = len(parts["codes"]) if parts["codes"].ndim == 2 else 0
    for name, dimensions in (("codes", 2), ("drift", 2), ("flags", 1), ("hidden", 2)):
        array = parts[name]
        if array.dtype.kind not in "iu" or array.ndim != dimensions or len(array) != steps:
            raise ValueError(f"'{name}' is {array.dtype} {list(array.shape)}")
    if not steps:
        raise ValueError("there is no step in them")
