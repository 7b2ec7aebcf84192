"""Data sets of an HDF5 file, by h5py: those of one length in a group are columns of one table."""

from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np
import polars as pl

from zerodrift.dataset.formats.tables import MOST_ELEMENTS, FormatTable


def read(path: Path) -> Iterable[FormatTable]:
    """Yield a table for each compound data set, and for each group with columns of one length."""
    groups: dict[tuple[str, int], dict[str, np.ndarray]] = {}
    units: dict[tuple[str, int], dict[str, str]] = {}
    tables: list[FormatTable] = []
    with h5py.File(path, "r") as file:

        def visit(name: str, item: object) -> None:
            if not isinstance(item, h5py.Dataset) or item.ndim not in (1, 2) or item.shape[0] < 2:
                return
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


def _decode(values: np.ndarray) -> np.ndarray:
    """Return values [n] with bytes as text."""
    if values.dtype.kind in "SO":
        texts = (v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in values)
        return np.array(list(texts))
    return values
