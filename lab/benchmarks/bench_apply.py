"""`zerodrift apply` on a long log: time and memory beyond the numbers."""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.bench_main_job import copy_example

ROWS = 10_000_000
COLUMNS_READ = 8
"""Time, temperature and six outputs of the bundled example, as float64: the log's numbers."""


def main(quick: bool) -> None:
    """Print time and memory of `apply` on a Parquet log of the bundled example's columns.

    Targets: 20 s for 10 million rows, 200 MB beyond the numbers. `quick`: a million rows.
    """
    rows = ROWS // 10 if quick else ROWS
    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch) / "ft40"
        copy_example(project)
        command = [sys.executable, "-m", "zerodrift"]
        subprocess.run([*command, "firmware", "-C", project], check=True, capture_output=True)
        log = Path(scratch) / "long.parquet"
        write_long(next((project / "logs").glob("test_*")), log, rows)
        probe = (
            "import sys; from zerodrift.cli.main import main; sys.argv[0] = 'zerodrift'\n"
            "try: main()\n"
            "finally:\n"
            "  peak = next(s for s in open('/proc/self/status') if s.startswith('VmHWM'))\n"
            "  print(peak.split()[1], file=sys.stderr)"  # ru_maxrss would begin at this process's
        )
        arguments = ["apply", "-C", project, log, "--out", Path(scratch) / "out.parquet"]
        start = time.perf_counter()
        begin = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [sys.executable, "-c", probe, *arguments], check=True, capture_output=True, text=True
        )
        seconds = time.perf_counter() - start
        end = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = end.ru_utime + end.ru_stime - begin.ru_utime - begin.ru_stime
        peak = int(done.stderr.split()[-1]) / 1024.0
    numbers = rows * COLUMNS_READ * 8 / 2**20
    print(
        f"{rows:,} rows: {seconds:.1f} s, {cpu:.1f} CPU s; {peak:.0f} MB, of which the numbers are"
        f" {numbers:.0f} MB (targets at 10 million: 20 s, 200 MB beyond the numbers)"
    )


def write_long(log: Path, out: Path, rows: int) -> None:
    """Write a log over and over, its time going on, until it has so many rows."""
    frame = pl.read_csv(log)
    time_column = frame.columns[0]
    times = -(-rows // len(frame))
    long = pl.concat([frame] * times).head(rows)
    step = float(frame[time_column][1] - frame[time_column][0])
    long.with_columns(pl.Series(time_column, np.arange(rows) * step)).write_parquet(out)
