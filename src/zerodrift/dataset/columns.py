"""Float64 columns that grow batch by batch and are never copied as a whole."""

from collections.abc import Sequence

import numpy as np
import polars as pl

from zerodrift.base.arrays import Array


class GrowingColumns:
    """Equally long columns with room reserved ahead; unused room takes address space, not
    memory."""

    def __init__(self, names: Sequence[str], capacity: int) -> None:
        self._arrays: dict[str, Array] = {name: np.empty(capacity) for name in names}
        self._capacity = capacity
        self._rows = 0

    def __len__(self) -> int:
        """Return the number of rows so far."""
        return self._rows

    def append(self, batch: pl.DataFrame) -> None:
        """Add the rows of a batch that has these columns, as float64; null becomes NaN."""
        rows = self._rows + batch.height
        if rows > self._capacity:
            self._capacity = rows + rows // 4
            for name, old in self._arrays.items():
                self._arrays[name] = np.empty(self._capacity)
                self._arrays[name][: self._rows] = old[: self._rows]
        for name, array in self._arrays.items():
            array[self._rows : rows] = batch[name].to_numpy()
        self._rows = rows

    def finish(self) -> dict[str, Array]:
        """Return name -> [n]."""
        return {name: array[: self._rows] for name, array in self._arrays.items()}
