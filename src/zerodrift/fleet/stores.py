"""Logs that are named by a URL: listed, and fetched whole, through fsspec."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.extras import FLEET_URL, require
from zerodrift.base.fleet_config import URL

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

SUMS = "SHA256SUMS"
"""Beside logs, as `sha256sum` writes it: the hashes that they must have."""
MAGIC = "*?["


def list_names(pattern: str, *, folders: bool) -> list[str]:
    """Return the URLs that match a pattern, sorted.

    Args:
        pattern: a URL with `*`, `?` or `[...]` in parts of its path.
        folders: whether folders or files are looked for.

    Raises:
        InputError: the store is unknown, its library is missing, or it does not answer.
    """
    with _telling_of(pattern):
        store, path = _open(pattern)
        found = store.glob(path, detail=True)
        kind = "directory" if folders else "file"
        names = (name for name, told in found.items() if told.get("type") == kind)
        return sorted(_name(store, pattern, name) for name in names)


def fetch(pattern: str, folder: Path) -> list[Path]:
    """Fetch the files that a pattern matches, or those in the folders that it matches.

    A file is complete: it has the size that the store states, before and after, and the hash that
    `SHA256SUMS` beside it states, if there is one. A local file is linked and not copied.

    Args:
        pattern: a URL, perhaps with `*`, `?` or `[...]`.
        folder: where to put them, `s3://bucket/log.csv` as `s3:/bucket/log.csv`.

    Returns:
        The files here; none where nothing matches.

    Raises:
        InputError: as `list_names`; or a file is incomplete, or changes while it is read.
    """
    with _telling_of(pattern):
        store, path = _open(pattern)
        is_plain = not any(sign in path for sign in MAGIC)
        found = [path] if is_plain and store.exists(path) else store.glob(path)
        files: list[str] = []
        for name in found:
            files += store.find(name, maxdepth=1) if store.isdir(name) else [name]
    sums: dict[str, dict[str, str]] = {}
    return [_fetch_file(store, pattern, name, folder, sums) for name in sorted(set(files))]


def _fetch_file(
    store: "AbstractFileSystem",
    pattern: str,
    name: str,
    folder: Path,
    sums: dict[str, dict[str, str]],
) -> Path:
    url = _name(store, pattern, name)
    scheme, rest = url.split(URL, 1)
    place = Path(os.path.normpath(folder / f"{scheme}:" / rest.lstrip("/")))
    if not place.is_relative_to(folder / f"{scheme}:"):
        raise InputError(f"{url}: leads out of its store; expected a plain path. Rename the log.")
    place.parent.mkdir(parents=True, exist_ok=True)
    if "file" in _list_protocols(store):
        place.unlink(missing_ok=True)
        place.symlink_to(name)
        return place
    with _telling_of(url):
        before = store.info(name)
        content = store.cat_file(name)
        store.invalidate_cache()
        after = store.info(name)
    size, then = before.get("size"), after.get("size")
    if size != then or (size is not None and size != len(content)):
        raise InputError(
            f"{url}: {len(content)} bytes came, the store states {size} before and {then} after;"
            " expected one size, of a log that is whole and no longer written. Run the command"
            " again."
        )
    parent, _, own = name.rpartition("/")
    if parent not in sums:
        sums[parent] = _read_sums(store, pattern, f"{parent}/{SUMS}")
    expected, actual = sums[parent].get(own), hashlib.sha256(content).hexdigest()
    if expected not in (None, actual):
        raise InputError(
            f"{url}: has the SHA-256 {actual}; expected {expected}, as {SUMS} beside it states."
            " Copy the log to the store again, or correct that file."
        )
    place.write_bytes(content)
    return place


def _read_sums(store: "AbstractFileSystem", pattern: str, name: str) -> dict[str, str]:
    """Return file -> SHA-256 as a file of `sha256sum` states them; empty where there is none."""
    with _telling_of(_name(store, pattern, name)):
        if not store.exists(name):
            return {}
        lines = store.cat_file(name).decode().splitlines()
    pairs = (line.split(maxsplit=1) for line in lines if line.strip())
    return {own.lstrip("*"): value.lower() for value, own in pairs}


def _open(url: str) -> "tuple[AbstractFileSystem, str]":
    require(FLEET_URL, f"'{url}'")
    from fsspec.core import url_to_fs

    store, path = url_to_fs(url)
    return store, str(path)


def _name(store: "AbstractFileSystem", pattern: str, name: str) -> str:
    """Return a file's URL, its scheme as the pattern writes it."""
    rest = str(store.unstrip_protocol(name)).split(URL, 1)[1].rstrip("/")
    scheme, given = pattern.split(URL, 1)
    return f"{scheme}{URL}{rest if given.startswith('/') else rest.lstrip('/')}"


def _list_protocols(store: "AbstractFileSystem") -> tuple[str, ...]:
    return (store.protocol,) if isinstance(store.protocol, str) else tuple(store.protocol)


@contextmanager
def _telling_of(url: str) -> Iterator[None]:
    """Put what a store's library raises into words; each has errors of its own."""
    try:
        yield
    except ZerodriftError:
        raise
    except Exception as error:  # stores' libraries raise many kinds
        raise InputError(
            f"{url}: cannot be read ({type(error).__name__}: {error}); expected a store that fsspec"
            " reaches from every machine that works on the fleet. Correct the URL, install what the"
            " store needs there, or see to its address and access."
        ) from error
