"""Memory that `zerodrift compare` takes per row of long logs of three columns.

Writes two simulated Parquet logs (time, temperature, one output) into a temporary directory, the
second to test on or, as the first, to learn from and be left out in turn, and runs the command on
them in fresh processes. A process's peak is the largest resident memory that the kernel counted for
it. The baseline is what the same command takes on 1,000 rows; what longer logs take beyond it is
divided by their rows.
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
    """Print peaks and bytes per row, and whether the longest logs keep to the limit."""
    print("compare on two simulated logs of 3 columns (time, temperature, one output)")
    most = 0.0
    for test, held_out in ((True, "one log to test on"), (False, "leave one run out")):
        base = measure_peak_bytes(BASE_ROWS, test=test)
        print(f"{held_out}: {BASE_ROWS:>9} rows: peak {base / 1e6:5.0f} MB, the baseline")
        for rows in QUICK_ROWS if quick else ROWS:
            peak = measure_peak_bytes(rows, test=test)
            per_row = (peak - base) / rows
            print(f"{held_out}: {rows:>9} rows: peak {peak / 1e6:5.0f} MB, {per_row:.0f} B per row")
        most = max(most, per_row)
    if not quick:
        verdict = "reached" if most <= LIMIT_BYTES_PER_ROW else "not reached"
        print(f"to reach at {ROWS[-1]} rows: {LIMIT_BYTES_PER_ROW} bytes per row: {verdict}")


def measure_peak_bytes(rows: int, *, test: bool) -> int:
    """Return the peak resident memory of `zerodrift compare` on logs of so many rows in all."""
    with tempfile.TemporaryDirectory() as folder:
        # In a process of its own: a child's peak memory is never told as less than its parent's.
        use = "test" if test else "train"
        subprocess.run([sys.executable, __file__, use, folder, str(rows)], check=True)
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
    write_project(Path(sys.argv[2]), int(sys.argv[3]), test=sys.argv[1] == "test")
