"""Which code of a project this user has agreed to run: files of effects (Python) and generated C.

Both can do anything, and come with a project that somebody else may have sent. Commands that change
a project (`add`, `train`, `firmware`, ...) are its author's: they run its files of effects, and the
project counts as this user's own from then on. In any other project, a command that only looks
(`compare`, `diagnose`, `plan`, `effects`, `diff`, `report`, the page, ...) asks before it runs a
file that was never run here; a file is known by its content, so a changed one is asked about again.

`verify` runs no file of effects. It builds and runs C, without a question if that is, to the
byte, what this version of zerodrift writes for the model beside it, or what `firmware` once wrote
for this user; any other C is asked about, once for each content.
"""

import contextlib
import hashlib
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.progress import SILENT, Progress

STORE = "trusted.txt"

_agreed: set[str] = set()
"""What was agreed to in this process; the store may not be writable."""


def locate_store() -> Path:
    """Return the file in the user's configuration folder that holds the hashes."""
    home = Path("~").expanduser()
    if sys.platform == "win32":
        folder = Path(os.environ.get("APPDATA", home))
    elif sys.platform == "darwin":
        folder = home / "Library/Application Support"
    else:
        folder = Path(os.environ.get("XDG_CONFIG_HOME", home / ".config"))
    return folder / "zerodrift" / STORE


def list_unknown(files: Sequence[Path]) -> list[Path]:
    """Return the files whose content was not agreed to yet."""
    known = _read_store()
    return [file for file in files if _hash(file) not in known]


def remember(files: Sequence[Path]) -> None:
    """Note that these files were agreed to; one that cannot be noted is asked for again."""
    _note({_hash(file): file.name for file in files})


def claim(directory: Path) -> None:
    """Note that a project is this user's own: a command of its author's is run on it."""
    _note({_mark_folder(directory): "a project of one's own"})


def remember_code(texts: Mapping[str, str]) -> None:
    """Note that C was written by this user's own zerodrift.

    Args:
        texts: name -> content, of the model's header and source and of the runtime.
    """
    _note({hash_code(texts): ", ".join(n for n in sorted(texts) if not n.startswith("zd_"))})


def require_trust(files: Sequence[Path], directory: Path, progress: Progress = SILENT) -> None:
    """Ask once before files of effects are run, unless the project is this user's own.

    Args:
        files: the project's `[plugins] files`.
        directory: of the project.
        progress: asks the user.

    Raises:
        InputError: the user says no, or there is nobody to ask.
    """
    unknown = list_unknown(files)
    if unknown and _mark_folder(directory) not in _read_store():
        names = ", ".join(str(file) for file in unknown)
        _ask(
            f"{names}: Python that this project brings and that was never run here",
            "files that you have read",
            progress,
        )
    remember(files)


def require_code(texts: Mapping[str, str], folder: Path, progress: Progress = SILENT) -> None:
    """Ask once before C is built and run that this user's own zerodrift did not write.

    Args:
        texts: name -> content, of the model's header and source and of the runtime.
        folder: where it lies.
        progress: asks the user.

    Raises:
        InputError: the user says no, or there is nobody to ask.
    """
    if hash_code(texts) not in _read_store():
        _ask(
            f"{folder}: C that differs from what this zerodrift writes for the model, and that was"
            " never run here; to verify it is to run it",
            "C that you have read, or have from somebody whom you trust",
            progress,
        )
        remember_code(texts)


def require_place(out: Path, directory: Path, named: Path | None = None) -> None:
    """Refuse a firmware folder outside the project that no user named on the command line.

    Args:
        out: where the firmware goes, by `[firmware] out` or the command line; links are followed.
        directory: of the project.
        named: the folder that `--out` names; where it is this one it is known from now on.

    Raises:
        InputError: it is outside, and was never named.
    """
    place, home = (Path(os.path.realpath(path)) for path in (out, directory))
    if place.is_relative_to(home):
        return
    mark = hashlib.sha256(b"place\0" + os.fsencode(home) + b"\0" + os.fsencode(place)).hexdigest()
    if named is None and mark not in _read_store():
        raise InputError(
            f"{out}: the firmware folder of [firmware] out lies outside the project {directory};"
            " expected one inside, or one that you name yourself. Run once: zerodrift firmware"
            f" --out {out}. Nothing was written."
        )
    _note({mark: str(place)})


def hash_code(texts: Mapping[str, str]) -> str:
    """Return one hash of all files of a model's C."""
    digest = hashlib.sha256()
    for name, text in sorted(texts.items()):
        digest.update(f"{name}\0{len(text.encode())}\0{text}\0".encode())
    return digest.hexdigest()


def _ask(found: str, expected: str, progress: Progress) -> None:
    """Return if the user agrees.

    Raises:
        InputError: the user says no, or there is nobody to ask.
    """
    agreed = progress.confirm(f"{found}. Run it?")
    if agreed is None:
        raise InputError(
            f"{found}; expected {expected}. Look at it, then run the command again with --trust."
        )
    if not agreed:
        raise InputError(f"{found}: not run, as you asked. Nothing was done.")


def _note(hashes: Mapping[str, str]) -> None:
    known = _read_store()
    fresh = {digest: name for digest, name in hashes.items() if digest not in known}
    if not fresh:
        return
    _agreed.update(fresh)
    with contextlib.suppress(OSError):
        store = locate_store()
        store.parent.mkdir(parents=True, exist_ok=True)
        with store.open("a", encoding="utf-8") as lines:
            lines.writelines(f"{digest}  {name!r}\n" for digest, name in fresh.items())


def _mark_folder(directory: Path) -> str:
    """Return the hash that stands for a project's folder."""
    return hashlib.sha256(b"folder\0" + os.fsencode(os.path.realpath(directory))).hexdigest()


def _hash(file: Path) -> str:
    """Return a file's hash; a file that cannot be read is reported by whoever runs it."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


def _read_store() -> set[str]:
    try:
        lines = locate_store().read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        lines = []
    return {line.split()[0] for line in lines if line.strip()} | _agreed | {""}
