"""Data sets of an HDF5 file, by h5py: those of one length in a group are columns of one table."""

from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np
import polars as pl

from zerodrift.base.errors import InputError
from zerodrift.dataset.formats.tables import MOST_ELEMENTS, FormatTable

MOST_PACKED = 1032
"""Bytes that one byte of a file can stand for: the limit of deflate (zlib's technical notes)."""


def read(path: Path) -> Iterable[FormatTable]:
    """Yield a table for each compound data set, and for each group with columns of one length.

    Raises:
        InputError: the file takes numbers from other files, or claims more than it can hold.
    """
    groups: dict[tuple[str, int], dict[str, np.ndarray]] = {}
    units: dict[tuple[str, int], dict[str, str]] = {}
    tables: list[FormatTable] = []
    with h5py.File(path, "r") as file:
        _refuse_links(path, file)

        def visit(name: str, item: object) -> None:
            if isinstance(item, h5py.Group):
                _refuse_links(path, item)
            if isinstance(item, h5py.Dataset):
                _refuse_foreign(path, name, item)
            if not isinstance(item, h5py.Dataset) or item.ndim not in (1, 2) or item.shape[0] < 2:
                return
            _refuse_claims(path, name, item)
            group, _, column = name.rpartition("/")
            if item.dtype.names:
                values = item[()]
                columns = {each: _decode(values[each]) for each in item.dtype.names}
                kept = {each: array for each, array in columns.items() if array.ndim == 1}
                tables.append(FormatTable(name, pl.DataFrame(kept)))
                return
            key = (group, item.shape[0])
            unit = item.attrs.get("unit", item.attrs.get("units", ""))
            text = unit.decode() if isinstance(unit, bytes) else str(unit)
            own = groups.setdefault(key, {})
            if item.ndim == 1:
                own[column] = _decode(item[()])
                units.setdefault(key, {})[column] = text
            elif item.shape[1] <= MOST_ELEMENTS:
                values = item[()]
                for index in range(item.shape[1]):
                    own[f"{column}[{index}]"] = _decode(values[:, index])
                    units.setdefault(key, {})[f"{column}[{index}]"] = text

        file.visititems(visit)
    yield from tables
    for (group, _), columns in groups.items():
        frame = pl.DataFrame(columns)
        key = (group, frame.height)
        yield FormatTable(group or path.stem, frame, {k: v for k, v in units[key].items() if v})


def _refuse_links(path: Path, group: h5py.Group) -> None:
    """Refuse a group of which a member lies in another file."""
    for name in group:
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            _refuse(path, f"{group.name.rstrip('/')}/{name}", link.filename)


def _refuse_foreign(path: Path, name: str, item: h5py.Dataset) -> None:
    """Refuse a data set whose numbers lie in another file."""
    if item.external:
        _refuse(path, name, item.external[0][0])
    if item.is_virtual:
        for source in item.virtual_sources():
            if source.file_name != ".":
                _refuse(path, name, source.file_name)


def _refuse_claims(path: Path, name: str, item: h5py.Dataset) -> None:
    """Refuse a data set that is larger than the file can hold."""
    size = path.stat().st_size
    if item.nbytes > MOST_PACKED * size:
        raise InputError(
            f"{path}: '{name}' claims {item.nbytes:,} bytes in a file of {size:,}; expected"
            f" {MOST_PACKED * size:,} at most, which is as far as they can be compressed. The rest"
            " was never recorded: write the file with what was."
        )


def _refuse(path: Path, name: str, other: object) -> None:
    raise InputError(
        f"{path}: '{name}' takes its numbers from another file, {other}; expected a file that holds"
        " its own. Write it anew with the numbers in it (h5repack)."
    )


def _decode(values: np.ndarray) -> np.ndarray:
    """Return values [n] with bytes as text."""
    if values.dtype.kind in "SO":
        texts = (v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in values)
        return np.array(list(texts))
    return values
