"""Time and memory of reading a long log, against Polars reading the same columns.

Writes a simulated CSV (time, temperature, 6 outputs, 6 references) into a temporary directory,
then reads it in fresh processes, the readers taking turns: Polars' own scan, select and collect;
zerodrift at the log's period (checked and passed through); zerodrift at ten times that period
(checked and averaged). Times are the least of the repeats. Peak memory is what a process holds at
most beyond what it held after its imports, over the columns' size as float64.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.readers import POLARS, Limits, measure, print_table, run_here, take_turns
from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.open_log import list_columns

AXES = ("Fx_N", "Fy_N", "Fz_N", "Mx_Nm", "My_Nm", "Mz_Nm")
LOG_PERIOD_S = 0.1
READERS = (POLARS, "passed", "averaged")
MODULE = "benchmarks.bench_logs"
REPEATS = 3
LIMITS = Limits(time=2.0, memory=2.0)


def main(quick: bool) -> None:
    """Print rows, times and peak memory of each reader; `quick` reads a twentieth of the rows."""
    rows = 500_000 if quick else 10_000_000
    with tempfile.TemporaryDirectory() as folder:
        run_here(MODULE, "write", Path(folder), str(rows))
        size = (Path(folder) / "log.csv").stat().st_size
        print(f"{rows} simulated rows of {2 + 2 * len(AXES)} columns, {size / 1e6:.0f} MB of CSV")
        readings = take_turns(MODULE, READERS, REPEATS, Path(folder))
    print_table(readings, LIMITS, judge=not quick)


def write_project(directory: Path, rows: int) -> None:
    """Write a simulated log and a zerodrift.toml for each way of reading it."""
    rng = np.random.default_rng(0)
    time_s = np.arange(rows) * LOG_PERIOD_S
    temperature = 20 + 40 * np.sin(time_s / 3000)
    columns = {"time_s": time_s.round(3), "temperature_degC": (temperature * 128).round() / 128}
    for axis in AXES:
        columns[axis] = rng.normal(0, 100, rows).round(4)
        columns[f"ref_{axis}"] = rng.normal(0, 100, rows).round(4)
    log = directory / "log.csv"
    pl.DataFrame(columns).write_csv(log)
    outputs = "".join(
        f'[outputs.{axis.split("_")[0]}]\nmeasured = "{axis}"\nreference = "ref_{axis}"\n'
        f'unit = "{axis.split("_")[1]}"\nfull_scale = 1000\n'
        for axis in AXES
    )
    for reader, period_s in (("passed", LOG_PERIOD_S), ("averaged", 10 * LOG_PERIOD_S)):
        (directory / f"{reader}.toml").write_text(
            '[sensor]\nname = "bench"\ntime = "time_s"\ntemperature = "temperature_degC"\n'
            f'sample_period_s = {period_s}\n{outputs}[logs]\ntrain = ["log.csv"]\n'
        )


def read_here(reader: str, directory: Path) -> str:
    """Read the log in this process; return what it took."""
    config = load_config(directory / f"{'passed' if reader == POLARS else reader}.toml")
    columns = list(list_columns(config))

    def read() -> int:
        if reader == POLARS:
            return pl.scan_csv(directory / "log.csv").select(columns).collect().height
        return sum(len(run) for run in load_dataset(config).train)

    return measure(reader, read, len(columns) * config.sample_period_s / LOG_PERIOD_S)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        main(False)
    elif sys.argv[1] == "write":
        write_project(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        print(read_here(sys.argv[1], Path(sys.argv[2])))
