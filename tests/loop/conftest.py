"""A project whose sensor lags its thermometer, and a way to run commands on it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from zerodrift.operations.lowpass import lowpass

TAU_S = 60.0

TOML = """\
# A sensor with a lag that its model does not know of yet.
[sensor]
name = "cell"                       # prefix of the C names
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.Fz]
measured = "Fz_N"
reference = "ref_Fz_N"
unit = "N"
full_scale = 200

[outputs.Mx]                        # has no reference
measured = "Mx_Nm"
unit = "Nm"
full_scale = 10

[logs]
train = ["logs/run_*.csv"]
{more_logs}
# What the model is told; more is to be found out.
[[effect]]
kind = "zero_tempco"   # to first order

[network]
kind = "none"
"""


@dataclass(frozen=True)
class Project:
    """A directory with logs and zerodrift.toml."""

    directory: Path

    @property
    def toml(self) -> Path:
        return self.directory / "zerodrift.toml"

    @property
    def history(self) -> Path:
        return self.directory / "build" / "history.json"

    def read_all(self) -> dict[str, bytes]:
        """Return the content of every file, to see that none changed."""
        files = sorted(p for p in self.directory.rglob("*") if p.is_file())
        return {str(p.relative_to(self.directory)): p.read_bytes() for p in files}


def write_log(
    path: Path, seed: int, *, seconds: int = 900, dwell: bool = False, tau_s: float = TAU_S
) -> None:
    """Write a log of two ramps of the temperature with loads hung on now and then."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(seconds, dtype=np.float64)
    levels = 25.0 + 20.0 * rng.uniform(-1.0, 1.0, 6)
    temperature = np.interp(time_s / seconds, (0.0, 0.1, 0.35, 0.5, 0.8, 1.0), levels)
    temperature += 0.004 * rng.standard_normal(seconds)
    load = np.repeat(20.0 * rng.integers(0, 4, size=-(-seconds // 100)), 100)[:seconds]
    if dwell:
        temperature, load = np.full(seconds, 25.0), np.zeros(seconds)
    late = lowpass(temperature, 1.0, tau_s)
    fz = 0.2 * (late - 25.0) + 3.0 + 0.05 * rng.standard_normal(seconds)
    mx = -0.01 * (late - 25.0) + 0.004 * rng.standard_normal(seconds)
    columns = [time_s, temperature, load + fz, mx, load]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(
        path,
        np.stack(columns, axis=1),
        delimiter=",",
        fmt="%.5f",
        header="time_s,temperature_degC,Fz_N,Mx_Nm,ref_Fz_N",
        comments="",
    )


def write_project(
    directory: Path, *, runs: int = 5, dwell: bool = True, tau_s: float = TAU_S
) -> Project:
    """Write a project of so many training runs; without test logs, runs are left out in turn."""
    for number in range(runs):
        write_log(directory / "logs" / f"run_{number}.csv", 50 + number, tau_s=tau_s)
    more = ""
    if dwell:
        write_log(directory / "logs" / "dwell.csv", 99, dwell=True)
        more = 'dwell = ["logs/dwell.csv"]\n'
    project = Project(directory)
    project.toml.write_text(TOML.format(more_logs=more), encoding="utf-8")
    return project


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """Return a project of five runs and a dwell."""
    return write_project(tmp_path)


@pytest.fixture
def make_project(tmp_path: Path) -> Callable[..., Project]:
    """Return a function that writes a project in the test's own directory."""
    return lambda **options: write_project(tmp_path, **options)
