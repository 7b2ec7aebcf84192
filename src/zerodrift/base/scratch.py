"""Folders for the work of one command, which the next command removes if a kill left them.

They are in the project, since libraries that are built there are also loaded from there, which the
system's folder for temporary files may forbid.
"""

import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from zerodrift.base.files import REMAINDER, explain_write, is_refused_write
from zerodrift.base.lock import find_state, try_lock

_PLAIN = re.compile(r"[^%\\\"'`$\x00-\x1f\x7f]*" if os.sep == "/" else r"[^%\"'`$\x00-\x1f\x7f]*")
"""Without what a compiler's command line or its list of dependencies gives a meaning to."""
IN_USE = ".in-use"
SCRATCH = "scratch-"
FORSAKEN_S = 3600.0
"""Age at which folders of earlier versions are removed, which do not say if they are in use."""
EARLIER_FOLDERS = {
    "": re.compile(r"\.(report|twin)-[a-z0-9_]{8}"),
    "build": re.compile(r"\.(firmware|verify)-[a-z0-9_]{8}"),
    "firmware/packages": re.compile(r"\.staging-[a-z0-9_]{8}"),
}
"""Folder -> names of scratch folders that earlier versions made there."""
EARLIER_FILES = {
    "": re.compile(r"\.zerodrift\.toml\.[a-z0-9_]{8}"),
    "build": re.compile(r"\.[\w.-]+\.(json|npz|onnx)\.[a-z0-9_]{8}|\.history\.json\.kept"),
    "firmware": re.compile(r"\.[\w.-]+\.(h|c|json|dbc)\.(?=[a-z]*[0-9_])[a-z0-9_]{8}"),
}
"""Folder -> names that earlier versions gave to files which were not in their places yet."""


@contextmanager
def make_scratch(project: Path) -> Iterator[Path]:
    """Make a temporary folder that every compiler can work in.

    It is in the project where that can be written and compilers accept its path, else in the
    system's folder for temporary files.

    Args:
        project: the folder of zerodrift.toml.

    Raises:
        InputError: within this context a file was written, and the disk has no room for it.
    """
    state = find_state(project)
    try:
        if not _PLAIN.fullmatch(str(state)):
            raise OSError
        state.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(prefix=SCRATCH, dir=state, ignore_cleanup_errors=True)
    except OSError:
        folder = tempfile.TemporaryDirectory(prefix="zerodrift-", ignore_cleanup_errors=True)
    try:
        with folder as name:
            release = try_lock(Path(name) / IN_USE)
            try:
                yield Path(name)
            except OSError as error:
                if (
                    is_refused_write(error) and not error.filename
                ):  # of a write the system tells none
                    raise explain_write(name, error) from error
                raise
            finally:
                if release is not None:
                    release()
    finally:
        with suppress(OSError):
            state.rmdir()
            state.parent.rmdir()


def clean_scratch(state: Path) -> None:
    """Remove what killed commands have left in a project's build/; its lock is held."""
    build = state.parent
    with suppress(OSError):
        for folder in state.glob(f"{SCRATCH}*"):
            release = try_lock(folder / IN_USE)
            if release is not None:
                release()
                shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        for folder in (build.parent, build):
            for path in folder.glob(f".*{REMAINDER}"):
                path.unlink(missing_ok=True)
    for name, pattern in EARLIER_FOLDERS.items():
        with suppress(OSError):
            for path in (build.parent / name).glob(".*-*"):
                is_old = path.lstat().st_mtime < time.time() - FORSAKEN_S
                if pattern.fullmatch(path.name) and path.is_dir() and is_old:
                    shutil.rmtree(path, ignore_errors=True)
    for name, pattern in EARLIER_FILES.items():
        with suppress(OSError):
            for path in (build.parent / name).glob(".*"):
                if pattern.fullmatch(path.name) and path.is_file():
                    path.unlink(missing_ok=True)
