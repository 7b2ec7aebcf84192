"""Files that survive an interruption: written whole or not at all, and never pickled."""

import hashlib
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from zerodrift.base import files
from zerodrift.base.arrays import pack_arrays
from zerodrift.base.errors import InputError
from zerodrift.base.records import Json, read_sealed, render_sealed

FORMAT = 1
VALUES = "values"
"""Entry of the npz that holds everything but arrays, as JSON."""


@dataclass(frozen=True)
class Checkpoint:
    """The state of a training: arrays by name, and further JSON values."""

    arrays: Mapping[str, NDArray[np.generic]]
    values: Mapping[str, Json]


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is there entirely or not at all, whenever the process ends.

    Raises:
        InputError: the folder cannot be made or written.
    """
    files.make_directory(path.parent)
    files.write_whole(path, content)


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint as one npz file."""
    values: dict[str, Json] = {"format": FORMAT, "arrays": _hash(checkpoint.arrays)}
    values |= checkpoint.values
    text = render_sealed(values)
    arrays = {VALUES: np.frombuffer(text, np.uint8), **checkpoint.arrays}
    write_whole(path, pack_arrays(arrays, compressed=False))


def load_checkpoint(path: Path) -> Checkpoint | None:
    """Return the checkpoint of an interrupted training, or None where there is none.

    Raises:
        InputError: the file is damaged.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            values = read_sealed(stored[VALUES].tobytes())
            arrays = {name: stored[name] for name in stored.files if name != VALUES}
        if values.get("format") != FORMAT:
            raise ValueError(f"format {values.get('format')}, expected {FORMAT}")
        if values.get("arrays") != _hash(arrays):
            raise ValueError("its numbers are not those that were written")
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: this is no checkpoint ({error}).") from error
    return Checkpoint(arrays, values)


def _hash(arrays: Mapping[str, NDArray[np.generic]]) -> str:
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
