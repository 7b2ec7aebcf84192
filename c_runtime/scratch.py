"""Scratch folders that every compiler can work in, wherever the project lies."""

import os
import re
import tempfile
from pathlib import Path

_PLAIN = re.compile(r"[^%\\\"'`$\x00-\x1f\x7f]*" if os.sep == "/" else r"[^%\"'`$\x00-\x1f\x7f]*")
"""Without what a compiler's command line or its list of dependencies gives a meaning to."""


def open_scratch(beside: Path, prefix: str) -> tempfile.TemporaryDirectory[str]:
    """Return a scratch folder, removed with its context.

    It lies in `beside` where that can be written and compilers can work with its name, since
    libraries that are built there are loaded from there and the system's folder for temporary
    files may forbid that; else in the system's.

    Args:
        beside: a folder on the project's disk.
        prefix: of the new folder's name.
    """
    place = beside.absolute()
    if _PLAIN.fullmatch(str(place)) and os.access(place, os.W_OK):
        return tempfile.TemporaryDirectory(prefix=prefix, dir=place)
    return tempfile.TemporaryDirectory(prefix=f"zerodrift{prefix}")
