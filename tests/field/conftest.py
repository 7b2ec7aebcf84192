"""A unit in use, simulated: its project with firmware, built once, and what it logs afterwards."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from tests.projects import render_toml

from zerodrift.blocks.block import MAGIC, SERIAL_BYTES, seal
from zerodrift.blocks.design import FORMAT_OF_BLOCK
from zerodrift.cli.main import cli

DAY = 1440
NOISE = 0.05
OUTPUT = """
[outputs.y]
measured = "y_N"
reference = "true_N"
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
BEGIN_S = 1_767_225_600.0
"""2026-01-01."""


def make_bare_block(serial: str, sequence: int = 1, *, number: int = 0) -> bytes:
    """Return a sound block of no design: a header, and one number in place of the fields."""
    words = np.array([MAGIC, FORMAT_OF_BLOCK, 72, 1, 2, sequence, 20_000, 0], dtype="<u4")
    name = serial.encode().ljust(SERIAL_BYTES, b"\0")
    return seal(words.tobytes() + name + bytes(8) + number.to_bytes(4, "little"))


def write_log(
    path: Path,
    seed: int,
    days: float,
    *,
    begin_s: float = 0.0,
    slope: float = 0.3,
    zero: np.ndarray | float = 0.0,
    with_true: bool = True,
    swing: float = 1.0,
) -> Path:
    """Write a log of one row a minute: a linear zero drift, white noise, and a zero that moves."""
    rng = np.random.default_rng(seed)
    n = round(days * DAY)
    time_s = begin_s + 60.0 * np.arange(n)
    day = np.arange(n) / DAY
    warm = 7 * np.sin(2 * np.pi * day) + 3 * np.sin(2 * np.pi * day / 5.3 + seed)
    warm = 25 + swing * warm
    load = 10.0 * (np.arange(n) % 7 > 3)
    y = load + slope * (warm - 25) + zero + rng.normal(0, NOISE, n)
    frame = np.column_stack([time_s, warm, y, load] if with_true else [time_s, warm, y])
    header = "time_s,temperature_degC,y_N" + (",true_N" if with_true else "")
    np.savetxt(path, frame, fmt="%.10g", delimiter=",", header=header, comments="")
    return path


@pytest.fixture(scope="session")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project whose firmware was built; not to be changed."""
    folder = tmp_path_factory.mktemp("field") / "unit"
    (folder / "logs").mkdir(parents=True)
    for number in range(4):
        write_log(folder / f"logs/run{number}.csv", number, 2.0)
    text = render_toml(REST, name="small", period_s=60.0, outputs=(OUTPUT,))
    (folder / "zerodrift.toml").write_text(text, encoding="utf-8")
    result = CliRunner().invoke(cli, ["firmware", "-C", str(folder)])
    assert result.exit_code == 0, result.output
    return folder
