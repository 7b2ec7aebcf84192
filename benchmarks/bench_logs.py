"""Time and memory of reading a long log, against Polars reading the same columns.

Writes a simulated CSV (time, temperature, 6 outputs, 6 references) into a temporary directory,
then reads it in fresh processes, the readers taking turns: Polars' own scan, select and collect;
zerodrift at the log's period (checked and passed through); zerodrift at ten times that period
(checked and averaged). Times are the least of the repeats. Peak memory is what a process holds at
most beyond what it held after its imports, over the columns' size as float64.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl

from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.open_log import list_columns

AXES = ("Fx_N", "Fy_N", "Fz_N", "Mx_Nm", "My_Nm", "Mz_Nm")
LOG_PERIOD_S = 0.1
READERS = ("polars", "passed", "averaged")
REPEATS = 3
TIME_LIMIT = 2.0
MEMORY_LIMIT = 2.0


def main(quick: bool) -> None:
    """Print rows, times and peak memory of each reader; `quick` reads a twentieth of the rows."""
    rows = 500_000 if quick else 10_000_000
    with tempfile.TemporaryDirectory() as folder:
        # In a process of its own: a child's peak memory is never told as less than its parent's.
        run_here("write", Path(folder), str(rows))
        size = (Path(folder) / "log.csv").stat().st_size
        print(f"{rows} simulated rows of {2 + 2 * len(AXES)} columns, {size / 1e6:.0f} MB of CSV")
        runs = [run_reader(name, Path(folder)) for name in READERS * REPEATS]
    print_table(runs, judge=not quick)


def run_here(*arguments: str | Path) -> str:
    """Run this file in a fresh process and return what it printed."""
    command = [sys.executable, __file__, *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


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


def run_reader(reader: str, directory: Path) -> dict[str, float | str]:
    """Run one reader in a fresh process and return what it measured."""
    measured: dict[str, float | str] = json.loads(run_here(reader, directory))
    return measured


def measure(reader: str, directory: Path) -> dict[str, float | str]:
    """Read the log in this process; return seconds, steps and peak memory over the data's size."""
    config = load_config(directory / f"{'passed' if reader == 'polars' else reader}.toml")
    columns = list(list_columns(config))

    def read_by_polars() -> int:
        return pl.scan_csv(directory / "log.csv").select(columns).collect().height

    def read_by_zerodrift() -> int:
        return sum(len(run) for run in load_dataset(config).train)

    read: Callable[[], int] = read_by_polars if reader == "polars" else read_by_zerodrift
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start_s = time.perf_counter()
    steps = read()
    seconds = time.perf_counter() - start_s
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - held
    rows = round(steps * config.sample_period_s / LOG_PERIOD_S)
    share = peak * 1024 / (8 * rows * len(columns))
    return {"reader": reader, "steps": steps, "seconds": seconds, "memory": share}


def print_table(runs: list[dict[str, float | str]], judge: bool) -> None:
    """Print one line per reader, and whether the limits, which are for long logs, are kept."""
    best = {
        reader: (
            min(float(run["seconds"]) for run in runs if run["reader"] == reader),
            max(float(run["memory"]) for run in runs if run["reader"] == reader),
            next(int(run["steps"]) for run in runs if run["reader"] == reader),
        )
        for reader in READERS
    }
    print(f"{'reader':<10}{'steps':>10}{'seconds':>10}{'x Polars':>10}{'peak x data':>13}")
    good = True
    for reader, (seconds, memory, steps) in best.items():
        ratio = seconds / best["polars"][0]
        print(f"{reader:<10}{steps:>10}{seconds:>10.2f}{ratio:>10.2f}{memory:>13.2f}")
        good &= ratio <= TIME_LIMIT and (memory <= MEMORY_LIMIT or reader == "polars")
    if judge:
        verdict = "met" if good else "MISSED"
        print(f"limits: {TIME_LIMIT:g} x Polars, {MEMORY_LIMIT:g} x data: {verdict}")


if __name__ == "__main__":
    if len(sys.argv) == 1:
        main(False)
    elif sys.argv[1] == "write":
        write_project(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        print(json.dumps(measure(sys.argv[1], Path(sys.argv[2]))))
