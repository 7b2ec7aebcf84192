"""The frozen list of real records, and how one is read: by the product's own reader of logs."""

import hashlib
import json
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.config import FILE_NAME, load_config
from zerodrift.dataset.load import load_dataset

LIST = Path(__file__).with_name("records.toml")


@dataclass(frozen=True)
class Entry:
    """One record as the list has it."""

    name: str
    log: str
    """Selector below the folder of data."""
    settings: Mapping[str, Any]
    """Of zerodrift.toml: time or log_period_s, temperature, inputs, measured, reference, unit."""
    short: bool
    """Whether it is in the reduced form, for CI."""

    def find(self, data: Path) -> Path:
        """Return where its file or folder is, or would be."""
        return data / self.log.partition("#")[0]


@dataclass(frozen=True)
class Record:
    """One log at one sample period: a thermometer and what may drift with it."""

    name: str
    unit: str
    period_s: float
    place: NDArray[np.int64]
    """[n] rising: which step of the period each row is; a number left out is a gap in the log."""
    temperature_degC: Array
    """[n]"""
    drift: Array
    """[n] measured minus reference, in `unit`."""
    inputs: Mapping[str, Array] = field(default_factory=dict)
    """Further thermometers and humidity [n]."""


def list_entries(path: Path = LIST) -> tuple[Entry, ...]:
    """Return the records of a list."""
    entries = []
    for series in tomllib.loads(path.read_text(encoding="utf-8"))["series"]:
        for record in series.pop("record"):
            settings = {**series, **record}
            name, log, short = (settings.pop(key, False) for key in ("name", "log", "short"))
            entries.append(Entry(name, log, settings, bool(short)))
    return tuple(entries)


def mark_entry(entry: Entry) -> str:
    """Return a digest of what a record is, by which results that were kept are known."""
    text = json.dumps([entry.name, entry.log, dict(entry.settings)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def read_record(entry: Entry, data: Path) -> Record:
    """Return a record's rows at its sample period.

    Raises:
        InputError: the log is not what the list says.
    """
    settings = entry.settings
    lines = ["[sensor]", 'name = "record"', f"sample_period_s = {settings['period_s']}"]
    lines += [f"{k} = {_write(settings[k])}" for k in ("time", "temperature") if k in settings]
    lines += ["[outputs.y]", "full_scale = 1e9"]
    lines += [
        f"{k} = {_write(settings[k])}" for k in ("measured", "reference", "unit") if k in settings
    ]
    lines += ["[inputs]", *(f"{k} = {_write(v)}" for k, v in settings.get("inputs", {}).items())]
    lines += ["[logs]", f"train = [{_write(str(data / entry.log))}]"]
    if "log_period_s" in settings:
        lines.append(f"period_s = {settings['log_period_s']}")
    lines += ["[[effect]]", 'kind = "zero_tempco"', "[network]", 'kind = "none"', ""]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / FILE_NAME).write_text("\n".join(lines), encoding="utf-8")
        runs = load_dataset(load_config(Path(folder)), skip_invalid=True).train
    period_s = float(settings["period_s"])
    time_s = np.concatenate([run.time_s for run in runs])
    return Record(
        entry.name,
        str(settings["unit"]),
        period_s,
        np.rint((time_s - time_s[0]) / period_s).astype(np.int64),
        np.concatenate([run.temperature_degC for run in runs]),
        np.concatenate([run.drift[:, 0] for run in runs]),
        {name: np.concatenate([run.inputs[name] for run in runs]) for name in runs[0].inputs},
    )


def _write(value: object) -> str:
    """Return a value in TOML: text, a number, or a table of these."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_write(v)}" for k, v in value.items()) + " }"
    return json.dumps(value)
