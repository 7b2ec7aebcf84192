"""The firmware as one file to download."""

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

EPOCH = (1980, 1, 1, 0, 0, 0)
"""The date of every member, so that the same firmware is the same bytes."""


def pack_files(directory: Path, files: Sequence[str]) -> bytes:
    """Return files of a project as a zip, those that are there and lie inside of it.

    Args:
        directory: of the project.
        files: relative to it, as `firmware` tells them.
    """
    packed = io.BytesIO()
    root = directory.resolve()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            path = (root / name).resolve()
            if path.is_file() and path.is_relative_to(root):
                info = zipfile.ZipInfo(path.relative_to(root).as_posix(), EPOCH)
                info.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(info, path.read_bytes())
    return packed.getvalue()
