"""Memory that `zerodrift compare` takes per row of long logs of three columns.

Writes simulated Parquet logs (time, temperature, one output; half of the rows for training, half
for testing) into a temporary directory and runs the command on them in fresh processes. A process's
peak is the largest resident memory that the kernel counted for it. The baseline is what the same
command takes on 1,000 rows; what a longer log takes beyond it is divided by its rows.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

BASE_ROWS = 1_000
ROWS = (200_000, 1_000_000, 5_000_000)
QUICK_ROWS = (200_000,)
LIMIT_BYTES_PER_ROW = 150
TOML = """\
[sensor]
name = "cell"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.Fz]
measured = "Fz_N"
unit = "N"
full_scale = 200

[logs]
train = ["train*.parquet"]
{test}
[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "thermal_lag"
"""


def main(quick: bool) -> None:
    """Print peak and bytes per row, and whether the longest logs keep to the limit."""
    base = measure_peak_bytes(BASE_ROWS)
    print("compare on simulated logs of 3 columns (time, temperature, one output)")
    print(f"{BASE_ROWS:>9} rows: peak {base / 1e6:6.0f} MB, the baseline")
    per_row = 0.0
    for rows in QUICK_ROWS if quick else ROWS:
        peak = measure_peak_bytes(rows)
        per_row = (peak - base) / rows
        print(f"{rows:>9} rows: peak {peak / 1e6:6.0f} MB, {per_row:4.0f} bytes per row beyond it")
    if not quick:
        verdict = "reached" if per_row <= LIMIT_BYTES_PER_ROW else "not reached"
        print(f"to reach at {ROWS[-1]} rows: {LIMIT_BYTES_PER_ROW} bytes per row: {verdict}")


def measure_peak_bytes(rows: int) -> int:
    """Return the peak resident memory of `zerodrift compare` on logs of so many rows in all."""
    with tempfile.TemporaryDirectory() as folder:
        # In a process of its own: a child's peak memory is never told as less than its parent's.
        subprocess.run([sys.executable, __file__, "write", folder, str(rows)], check=True)
        command = [sys.executable, "-m", "zerodrift", "compare", "--json", "-C", folder]
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise RuntimeError(f"zerodrift compare ended with {child.returncode}")
        return usage.ru_maxrss * 1024


def write_project(directory: Path, rows: int, *, test: bool = True) -> None:
    """Write two logs of half of the rows each, the second to test on or to learn from too."""
    stated = 'test = ["late.parquet"]\n' if test else ""
    (directory / "zerodrift.toml").write_text(TOML.format(test=stated))
    for seed, name in enumerate(("train", "late" if test else "train_2")):
        rng = np.random.default_rng(seed)
        time_s = np.arange(rows // 2, dtype=float)
        temperature = 20 + 15 * np.sin(time_s / (700 + 90 * seed)) + rng.normal(0, 0.02, rows // 2)
        force = 0.3 * (temperature - 20) + rng.normal(0, 0.2, rows // 2)
        columns = {"time_s": time_s, "temperature_degC": temperature.round(4)}
        frame = pl.DataFrame({**columns, "Fz_N": force.round(3)})
        frame.write_parquet(directory / f"{name}.parquet")


if __name__ == "__main__":
    write_project(Path(sys.argv[2]), int(sys.argv[3]))
