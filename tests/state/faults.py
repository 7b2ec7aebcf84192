"""A kill, or a refusal, at each call that changes the disk."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from zerodrift.base.journal import settle_project

CALLS = ("open", "replace", "rename", "link", "unlink", "remove", "mkdir", "rmdir", "fsync")
"""Of module os; each also stands for the bytes written before it."""
Tree = dict[str, bytes]


def read_tree(folder: Path) -> Tree:
    """Return every file by its name below the folder; hidden ones too."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in ("lock", "holder.json")
    }


@contextmanager
def before_each_call(act: Callable[[int, str], None]) -> Iterator[None]:
    """Call `act(n, name)` before the n-th call (from 0) of those in CALLS that changes a disk."""
    originals = {name: getattr(os, name) for name in CALLS}
    count = [0]
    is_busy = [False]

    def wrap(name: str) -> Callable[..., object]:
        def call(*arguments: object, **options: object) -> object:
            reads = name == "open" and not int(arguments[1]) & (os.O_WRONLY | os.O_RDWR)  # type: ignore[call-overload]
            # What lies in a scratch folder belongs to no set, and is removed with it.
            scratch = "dir_fd" in options or "/scratch-" in str(arguments[0])
            if not is_busy[0] and not reads and not scratch:
                is_busy[0] = True
                try:
                    act(count[0], name)
                finally:
                    is_busy[0] = False
                    count[0] += 1
            return originals[name](*arguments, **options)

        return call

    for name in CALLS:
        setattr(os, name, wrap(name))
    try:
        yield
    finally:
        for name, original in originals.items():
            setattr(os, name, original)


def list_crashes(project: Path, command: Callable[[], object], copies: Path) -> list[Path]:
    """Run a command; return a copy of the project as a kill before each call would leave it."""
    found = []

    def copy(number: int, name: str) -> None:
        place = copies / f"{number:04}_{name}"
        shutil.copytree(project, place, symlinks=True)
        found.append(place)

    with before_each_call(copy):
        command()
    return found


def find_mixed(
    crashes: list[Path], old: Tree, new: Tree, sets: tuple[str, ...] = ("",)
) -> list[str]:
    """Return the crashes after which the next command finds neither the old files nor the new.

    Args:
        crashes: copies of a project.
        old: its files before the command.
        new: its files after it.
        sets: beginnings of names; files of one set belong together.
    """
    mixed = []
    for place in crashes:
        settle_project(place)
        found = read_tree(place)
        found = {name: content for name, content in found.items() if ".zerodrift" not in name}
        for start in sets:
            parts = [
                {name: content for name, content in tree.items() if name.startswith(start)}
                for tree in (found, old, new)
            ]
            if parts[0] not in parts[1:]:
                mixed.append(f"{place.name} {start}")
    return mixed
