"""Topics of a PX4 log (ULog), by pyulog."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import polars as pl
from pyulog import ULog

from zerodrift.dataset.formats.tables import TIME, FormatTable

CLOCK_US = "timestamp"
"""The field in which every topic has its time."""


def read(path: Path) -> Iterable[FormatTable]:
    """Yield a table for each topic and instance; its times are seconds since power-on."""
    for topic in ULog(str(path)).data_list:
        name = f"{topic.name}_{topic.multi_id}" if topic.multi_id else topic.name
        fields = {key: np.asarray(values) for key, values in topic.data.items()}
        columns = {TIME: 1e-6 * fields.pop(CLOCK_US).astype(np.float64), **fields}
        yield FormatTable(name, pl.DataFrame(columns))
