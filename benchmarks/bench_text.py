"""Time and memory of reading ISO 8601 times and decimal commas, against Polars on plain numbers.

Writes one simulated log twice into a temporary directory: with dates, semicolons and decimal
commas, and with seconds, commas and points. Fresh processes take turns: Polars' own scan, select
and collect of the plain one; zerodrift reading the other (parsed, checked and passed through).
Times are the least of the repeats; peak memory is what a process holds at most beyond what it held
after its imports, over the columns' size as float64.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.open_log import list_columns

COLUMNS = ("temperature_degC", "Fx_N", "Fy_N", "Fz_N")
READERS = ("polars", "zerodrift")
REPEATS = 3
TIME_LIMIT = 4.0
MEMORY_LIMIT = 3.0
START_US = 1_700_000_000_000_000
CHUNK = 500_000


def main(quick: bool) -> None:
    """Print rows, times and peak memory of each reader; `quick` reads a tenth of the rows."""
    rows = 1_000_000 if quick else 10_000_000
    with tempfile.TemporaryDirectory() as folder:
        run_here("write", Path(folder), str(rows))
        runs = [json.loads(run_here(name, Path(folder))) for name in READERS * REPEATS]
    print(f"{rows} simulated rows of {1 + len(COLUMNS)} columns")
    print(f"{'reader':<10}{'seconds':>10}{'x Polars':>10}{'peak x data':>13}")
    seconds = {name: min(r["seconds"] for r in runs if r["reader"] == name) for name in READERS}
    memory = {name: max(r["memory"] for r in runs if r["reader"] == name) for name in READERS}
    for name in READERS:
        ratio = seconds[name] / seconds["polars"]
        print(f"{name:<10}{seconds[name]:>10.2f}{ratio:>10.2f}{memory[name]:>13.2f}")
    if quick:  # the limits are for long logs, beside which what a process holds anyway is little
        return
    good = seconds["zerodrift"] <= TIME_LIMIT * seconds["polars"]
    good &= memory["zerodrift"] <= MEMORY_LIMIT
    verdict = "met" if good else "MISSED"
    print(f"limits: {TIME_LIMIT:g} x Polars, {MEMORY_LIMIT:g} x data: {verdict}")


def run_here(*arguments: str | Path) -> str:
    """Run this file in a fresh process and return what it printed."""
    command = [sys.executable, __file__, *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def write_logs(directory: Path, rows: int) -> None:
    """Write the log in both forms, and a project for each."""
    rng = np.random.default_rng(0)
    for name in ("plain", "iso"):
        (directory / f"{name}.csv").unlink(missing_ok=True)
    for begin in range(0, rows, CHUNK):
        k = np.arange(begin, min(begin + CHUNK, rows))
        frame = pl.DataFrame({"time": k * 0.1}).with_columns(pl.col("time").round(1))
        values = {"temperature_degC": (20 + 40 * np.sin(k / 30_000)).round(4)}
        values |= {column: rng.normal(0, 100, k.size).round(4) for column in COLUMNS[1:]}
        plain = frame.with_columns(**{n: pl.Series(v) for n, v in values.items()})
        at = pl.Series(START_US + k * 100_000).cast(pl.Datetime("us"))
        iso = plain.with_columns(
            at.dt.strftime("%Y-%m-%dT%H:%M:%S%.3f").alias("time"),
            *(pl.col(n).cast(pl.String).str.replace(".", ",", literal=True) for n in COLUMNS),
        )
        for name, table, separator in (("plain", plain, ","), ("iso", iso, ";")):
            with (directory / f"{name}.csv").open("ab") as file:
                table.write_csv(file, separator=separator, include_header=begin == 0)
    outputs = "".join(
        f'[outputs.{column[:2]}]\nmeasured = "{column}"\nunit = "N"\nfull_scale = 1000\n'
        for column in COLUMNS[1:]
    )
    (directory / "zerodrift.toml").write_text(
        '[sensor]\nname = "bench"\ntime = "time"\ntemperature = "temperature_degC"\n'
        f'sample_period_s = 0.1\n{outputs}[logs]\ntrain = ["iso.csv"]\n'
    )


def measure(reader: str, directory: Path) -> dict[str, float | str]:
    """Read the log in this process; return seconds and peak memory over the data's size."""
    config = load_config(directory)
    columns = list(list_columns(config))
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start_s = time.perf_counter()
    if reader == "polars":
        rows = pl.scan_csv(directory / "plain.csv").select(columns).collect().height
    else:
        rows = sum(len(run) for run in load_dataset(config).train)
    seconds = time.perf_counter() - start_s
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - held
    share = peak * 1024 / (8 * rows * len(columns))
    return {"reader": reader, "seconds": seconds, "memory": share}


if __name__ == "__main__":
    if len(sys.argv) == 1:
        main(False)
    elif sys.argv[1] == "write":
        write_logs(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        print(json.dumps(measure(sys.argv[1], Path(sys.argv[2]))))
