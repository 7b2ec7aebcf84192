"""A project's address on this machine: the same port and token each time, so that a tab finds it.

They lie in the user's own state directory, readable by that user alone, and never in the project,
which may be shared. Another user's file, or one that others may read, is ignored.
"""

import hashlib
import json
import os
import secrets
import stat
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.records import from_json, to_dict

FOLDER = Path("zerodrift") / "workbench"
FEWEST_LETTERS = 24
"""Of a token that is believed."""


@dataclass(frozen=True)
class PageAddress:
    """Where a project's page is."""

    port: int
    """0: any that is free."""
    token: str


def make_token() -> str:
    """Return a random token that cannot be guessed."""
    return secrets.token_urlsafe(24)


def find_address(directory: Path) -> PageAddress:
    """Return the address that the project had last, or a new one.

    Args:
        directory: of the project.
    """
    path = _name_file(directory)
    try:
        told = path.lstat()
        is_own = stat.S_ISREG(told.st_mode) and told.st_uid == _find_user(told.st_uid)
        if is_own and (os.name == "nt" or not told.st_mode & 0o077):
            kept = from_json(PageAddress, json.loads(path.read_text(encoding="utf-8")))
            if len(kept.token) >= FEWEST_LETTERS and 1024 <= kept.port < 65536:
                return kept
    except (OSError, ValueError, RecursionError):
        pass
    return PageAddress(0, make_token())


def keep_address(directory: Path, address: PageAddress) -> None:
    """Keep an address for the next time; where that cannot be, the next one is another."""
    path = _name_file(directory)
    part = path.with_suffix(f".{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        part.unlink(missing_ok=True)
        handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(to_dict(address), file)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)


def _find_user(fallback: int) -> int:
    return os.getuid() if hasattr(os, "getuid") else fallback


def _name_file(directory: Path) -> Path:
    """Return the file of a project's address: named by a hash of where the project lies."""
    if os.name == "nt":
        state = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    name = hashlib.sha256(os.fsencode(directory.resolve())).hexdigest()[:32]
    return state / FOLDER / f"{name}.json"
