"""A small project of physics alone, and the command line in a process of its own."""

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import Result
from tests.projects import render_toml

OUTPUT = """
[outputs.y]
measured = "y_N"
unit = "N"
full_scale = 100
"""
REST = """\
[logs]
train = ["logs/run[0-2].csv"]
test = ["logs/run3.csv"]

[[effect]]
kind = "zero_tempco"

[network]
kind = "none"
"""
Run = Callable[..., subprocess.CompletedProcess[str]]
Command = Callable[..., Result]


def write_project(folder: Path, rest: str = REST, output: str = OUTPUT) -> Path:
    """Write four short simulated logs and their zerodrift.toml."""
    (folder / "logs").mkdir(parents=True)
    time_s = np.arange(600.0)
    for number in range(4):
        rng = np.random.default_rng(number)
        temperature = 25 + 10 * np.sin(time_s / 90 + number) + rng.normal(0, 0.01, time_s.size)
        measured = 0.3 * (temperature - 25) + rng.normal(0, 0.02, time_s.size)
        rows = zip(time_s, temperature, measured, strict=True)
        text = "\n".join(f"{t:.0f},{degc:.4f},{y:.5f}" for t, degc, y in rows)
        (folder / f"logs/run{number}.csv").write_text(
            f"time_s,temperature_degC,y_N\n{text}\n", encoding="utf-8"
        )
    (folder / "zerodrift.toml").write_text(
        render_toml(rest, name="small", outputs=(output,)), encoding="utf-8"
    )
    return folder


@pytest.fixture
def project(tmp_path: Path) -> Path:
    return write_project(tmp_path / "project")


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Return a function that runs the command line with an environment of its own."""

    def call(
        *arguments: str | Path,
        without: tuple[str, ...] = (),
        environment: Mapping[str, str] | None = None,
        **options: object,
    ) -> subprocess.CompletedProcess[str]:
        inherited = {k: v for k, v in os.environ.items() if k not in without}
        inherited["XDG_CONFIG_HOME"] = str(tmp_path / "config")
        return subprocess.run(  # type: ignore[call-overload, no-any-return]
            [sys.executable, "-m", "zerodrift", *map(str, arguments)],
            env=inherited | dict(environment or {}),
            stdin=subprocess.DEVNULL,
            text=True,
            encoding="utf-8",
            errors="replace",
            check=False,
            **{"capture_output": True, **options},
        )

    return call


def assert_one_message(
    done: subprocess.CompletedProcess[str] | Result, code: int, *parts: str
) -> None:
    """Assert that a run ended with one message for a user, and no traceback."""
    found, told = (
        (done.code, done.err) if isinstance(done, Result) else (done.returncode, done.stderr)
    )
    assert found == code, told
    assert "Traceback" not in told
    errors = [line for line in told.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1, told
    for part in parts:
        assert part in told
