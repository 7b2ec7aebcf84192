"""A project before its first log, and what its experiment may do."""

from pathlib import Path

from zerodrift.base.config import Config, parse_config

HEAD = """\
[sensor]
name = "ft40"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.Fz]
measured = "Fz_N"
reference = "ref_Fz_N"
unit = "N"
full_scale = 2000

[inputs]
supply = "supply_V"

[logs]
train = ["logs/*.csv"]

[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "dark_current"
"""
EXPERIMENT = """
[experiment]
temperature_degC = [-10, 50]
heating_K_per_min = 4
cooling_K_per_min = 2

[experiment.loads]
Fz = [-400, 400]

[experiment.inputs]
supply = { range = [4.75, 5.25], change_s = 2, hold_s = 30 }
"""


def write_blank(folder: Path, experiment: str = EXPERIMENT) -> Path:
    """Write a zerodrift.toml without logs."""
    (folder / "zerodrift.toml").write_text(HEAD + experiment, encoding="utf-8")
    return folder


def read(experiment: str = EXPERIMENT) -> Config:
    """Return the same without a file."""
    return parse_config(HEAD + experiment, Path("/nowhere/zerodrift.toml"))
