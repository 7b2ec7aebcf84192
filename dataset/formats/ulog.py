"""Topics of a PX4 log (ULog), by pyulog."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import polars as pl
from pyulog import ULog

from zerodrift.dataset.formats.tables import TIME, FormatTable


def read(path: Path) -> Iterable[FormatTable]:
    """Yield a table for each topic and instance; its times are seconds since power-on."""
    for topic in ULog(str(path)).data_list:
        name = f"{topic.name}_{topic.multi_id}" if topic.multi_id else topic.name
        columns = {TIME: 1e-6 * np.asarray(topic.data["timestamp"], dtype=np.float64)}
        columns |= {
            key: np.asarray(values) for key, values in topic.data.items() if key != "timestamp"
        }
        yield FormatTable(name, pl.DataFrame(columns))
