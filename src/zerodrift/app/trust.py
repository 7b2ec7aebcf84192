"""Which files of effects this user has agreed to run: they are Python and can do anything.

The user's own commands (`compare`, `add`, `train`, `firmware`, ...) run the files that their
project names, and remember them. `report` and `workbench`, with which one looks at a project that
somebody else has sent, ask before they run a file that was never run here. A file is known by its
content, so a changed one is asked about again. `verify` runs no file of effects at all.
"""

import contextlib
import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from zerodrift.base.errors import InputError

STORE = "trusted_effects.txt"


def locate_store() -> Path:
    """Return the file in the user's configuration folder that holds the hashes."""
    return Path(click.get_app_dir("zerodrift")) / STORE


def list_unknown(files: Sequence[Path]) -> list[Path]:
    """Return the files whose content was not agreed to yet."""
    known = _read_store()
    return [file for file in files if _hash(file) not in known]


def remember(files: Sequence[Path]) -> None:
    """Note that these files were agreed to; one that cannot be noted is asked for again."""
    fresh = list_unknown(files)
    if not fresh:
        return
    with contextlib.suppress(OSError):
        store = locate_store()
        store.parent.mkdir(parents=True, exist_ok=True)
        with store.open("a", encoding="utf-8") as lines:
            lines.writelines(f"{_hash(file)}  {file.name}\n" for file in fresh)


def require_trust(files: Sequence[Path], *, trusted: bool) -> None:
    """Ask once before files of effects are run that this user has not run before.

    Args:
        files: the project's `[plugins] files`.
        trusted: `--trust` was given: do not ask.

    Raises:
        InputError: the user says no, or there is nobody to ask.
    """
    unknown = list_unknown(files)
    if unknown and not trusted:
        names = ", ".join(str(file) for file in unknown)
        if not (sys.stdin and sys.stdin.isatty() and sys.stderr.isatty()):
            raise InputError(
                f"{names}: Python that this project brings and that was never run here; expected"
                " files that you have read. Look at them, then run the command again with --trust."
            )
        question = f"This project brings Python that was never run here: {names}. Run it?"
        if not click.confirm(question, default=False, err=True):
            raise InputError(f"{names}: not run, as you asked. Nothing was done.")
    remember(unknown)


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
        return set()
    return {line.split()[0] for line in lines if line.strip()} | {""}
