"""Files that survive an interruption: written whole or not at all, and never pickled."""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from zerodrift import files
from zerodrift.errors import InputError

VALUES = "values"
"""Entry of the npz that holds everything but arrays, as JSON."""


@dataclass(frozen=True)
class Checkpoint:
    """Where a training stands: arrays by name, and JSON values beside them."""

    arrays: Mapping[str, NDArray[Any]]
    values: Mapping[str, Any]


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is there entirely or not at all, whenever the process ends.

    Raises:
        InputError: the folder cannot be made or written.
    """
    files.make_directory(path.parent)
    files.write_whole(path, content)


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint as one npz file."""
    text = json.dumps(checkpoint.values, sort_keys=True).encode()
    buffer = io.BytesIO()
    entries: dict[str, Any] = {VALUES: np.frombuffer(text, np.uint8), **checkpoint.arrays}
    np.savez(buffer, **entries)
    write_whole(path, buffer.getvalue())


def load_checkpoint(path: Path) -> Checkpoint | None:
    """Return the checkpoint of an interrupted training, or None where there is none.

    Raises:
        InputError: the file is damaged.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            values = json.loads(stored[VALUES].tobytes())
            arrays = {name: stored[name] for name in stored.files if name != VALUES}
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise InputError(
            f"{path}: this is no checkpoint ({error}). Delete it, or train with --fresh."
        ) from error
    return Checkpoint(arrays, values)
