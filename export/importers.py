"""Networks of other programs' formats, as the ONNX that installed packages make of their files."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.plugins import IMPORTERS, load_parts


@dataclass(frozen=True)
class Importer:
    """What an installed package adds: files of these names become ONNX."""

    suffixes: tuple[str, ...]
    """Small letters, with the dot."""
    name: str
    """Of the format, for messages."""
    to_onnx: Callable[[Path], bytes]
    """A file -> the same network as an ONNX file's content, with all weights in it."""


def import_onnx(path: Path) -> bytes | None:
    """Return a file of another format as ONNX; None where no importer takes its suffix.

    Raises:
        InputError: its importer fails.
    """
    suffix = path.suffix.lower()
    found = (part for part in load_parts(IMPORTERS, Importer) if suffix in part.suffixes)
    part = next(found, None)
    if part is None:
        return None
    try:
        return bytes(part.to_onnx(path))
    except Exception as error:  # whatever a stranger's code raises
        raise InputError(
            f"{path}: cannot be read as {part.name} ({type(error).__name__}: {error}); expected a"
            " whole file of that format. Export the network as ONNX."
        ) from error
