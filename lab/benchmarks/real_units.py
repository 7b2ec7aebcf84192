"""Real sensors with several runs each, to be left out in turn: third-party logs, where they are.

Resistors in ovens: cellularmitosis/logs, commit 31b39708, MIT licence, (c) 2018 Jason Pepas.
Load cell: hmd83/tanen, commit 6ae504e2, CC BY 4.0.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.config import FILE_NAME, Config, load_config

DATA = Path(__file__).parents[3] / "shared" / "data"

_OVEN = """[sensor]
name = "r"
time = "time_s"
temperature = "oven_temperature_degC"
sample_period_s = {period:g}
[outputs.R]
measured = "drift_ppm"
unit = "ppm"
full_scale = 100
"""
_FOIL = """[sensor]
name = "r"
temperature = {{ column = "temp_c", unit = "degC" }}
sample_period_s = {period:g}
[outputs.R]
measured = "ppm"
unit = "ppm"
full_scale = 100
"""
_CELL = """[sensor]
name = "cell"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = {period:g}
[outputs.weight]
measured = "weight_kg"
reference = "static_load_nominal_kg"
unit = "kg"
full_scale = 150
"""
_MODEL = """
[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "thermal_lag"

[network]
kind = "none"
"""


_BENCH = """[sensor]
name = "r"
time = {{{{ column = "timestamp", unit = "s" }}}}
temperature = {{{{ column = "temp_c", unit = "degC" }}}}
sample_period_s = {{period:g}}
[outputs.R]
measured = "{column}"
unit = "{unit}"
full_scale = 1e7
"""


@dataclass(frozen=True)
class RealUnit:
    """One device and its runs."""

    name: str
    columns: str
    period_s: float
    runs: tuple[str, ...]
    """Selectors, relative to DATA."""
    timed: bool = True
    """Whether the logs have a column of times."""


_GENRAD, _DIVIDER = "resistor_genrad2k_oven_ramps.csv", "resistor_vhd200_oven_ramps.csv"
_FOILS = "as_logged/20180115-vhp202z/run{}-{}/tempco.csv"
UNITS = (
    RealUnit("GenRad 2k", _OVEN, 5.0, tuple(f"{_GENRAD}#run{i}" for i in (1, 2))),
    RealUnit("VHD200 1k", _OVEN, 10.0, tuple(f"{_DIVIDER}#run{i}" for i in (9, 10))),
    RealUnit("VHD200 12.5k", _OVEN, 10.0, tuple(f"{_DIVIDER}#run{i}" for i in (11, 12, 13))),
    *(
        RealUnit(f"VHP202Z {name}", _FOIL, 1.0, tuple(_FOILS.format(i, name) for i in runs), False)
        for name, runs in (("9k9850-1", (1, 2)), ("9k9850-3", (4, 5)), ("19k970-2", (7, 8, 9)))
    ),
    RealUnit(
        "load cell",
        _CELL,
        256.0,
        tuple(f"loadcell_h40a_22kg.csv@{at}%:{at + 20}%" for at in range(0, 100, 20)),
    ),
)
"""All devices of these sources that have more than one run, or one that makes five fifths."""

_REFERENCES = "as_logged/20171208-svrt-logging"
_METER = "as_logged/20180117-hp34401a-tempco/run2-balcony/out.csv"
UNSEEN = tuple(
    RealUnit(
        name,
        _BENCH.format(column=column, unit=unit),
        period_s,
        tuple(f"{log}@{at}%:{at + 20}%" for at in range(0, 100, 20)),
    )
    for name, log, column, unit, period_s in (
        ("meter 34401A", _METER, "lm399", "uV", 5.0),
        ("reference, as found", f"{_REFERENCES}/1512730462-svrt", "svrt", "LSB", 10.0),
        ("LM399", f"{_REFERENCES}/1512747712-lm399-p15", "lm399-p15", "LSB", 10.0),
        (
            "reference, reseated",
            f"{_REFERENCES}/1512782821-svrt-reseat",
            "svrt-reseat",
            "LSB",
            10.0,
        ),
        ("AD587", f"{_REFERENCES}/1512853381-AD587-bare", "AD587-bare", "LSB", 10.0),
        (
            "reference, bare",
            f"{_REFERENCES}/1512886351-svrt-no-tempco",
            "svrt-no-tempco",
            "LSB",
            10.0,
        ),
    )
)
"""Logs long enough to make five fifths, on which nothing about the uncertainty was ever chosen.

Four devices, one of them three times, altered in between. Fifths of one log resemble each other
more than runs do.
"""


def leave_out_each(unit: RealUnit, scratch: Path) -> Iterator[Config]:
    """Yield a project for each run of a unit: that run tests, the others teach."""
    for left_out in unit.runs:
        train = [str(DATA / run) for run in unit.runs if run != left_out]
        logs = f"[logs]\ntrain = {json.dumps(train)}\ntest = {json.dumps([str(DATA / left_out)])}\n"
        logs += "" if unit.timed else f"period_s = {unit.period_s:g}\n"
        text = unit.columns.format(period=unit.period_s) + logs + _MODEL
        (scratch / FILE_NAME).write_text(text, encoding="utf-8")
        yield load_config(scratch)
