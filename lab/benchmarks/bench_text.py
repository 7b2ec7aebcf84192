"""Time and memory of reading ISO 8601 times and decimal commas, against Polars on plain numbers.

Writes one simulated log twice into a temporary directory: with dates, semicolons and decimal
commas, and with seconds, commas and points. Fresh processes take turns: Polars' own scan, select
and collect of the plain one; zerodrift reading the other (parsed, checked and passed through).
Times are the least of the repeats; peak memory is what a process holds at most beyond what it held
after its imports, over the columns' size as float64.
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

COLUMNS = ("temperature_degC", "Fx_N", "Fy_N", "Fz_N")
READERS = (POLARS, "zerodrift")
MODULE = "benchmarks.bench_text"
REPEATS = 3
LIMITS = Limits(time=4.0, memory=3.0)
START_US = 1_700_000_000_000_000
CHUNK = 500_000


def main(quick: bool) -> None:
    """Print rows, times and peak memory of each reader; `quick` reads a tenth of the rows."""
    rows = 1_000_000 if quick else 10_000_000
    with tempfile.TemporaryDirectory() as folder:
        run_here(MODULE, "write", Path(folder), str(rows))
        readings = take_turns(MODULE, READERS, REPEATS, Path(folder))
    print(f"{rows} simulated rows of {1 + len(COLUMNS)} columns")
    print_table(readings, LIMITS, judge=not quick)


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


def read_here(reader: str, directory: Path) -> str:
    """Read the log in this process; return what it took."""
    config = load_config(directory)
    columns = list(list_columns(config))

    def read() -> int:
        if reader == POLARS:
            return pl.scan_csv(directory / "plain.csv").select(columns).collect().height
        return sum(len(run) for run in load_dataset(config).train)

    return measure(reader, read, len(columns))


if __name__ == "__main__":
    if len(sys.argv) == 1:
        main(False)
    elif sys.argv[1] == "write":
        write_logs(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        print(read_here(sys.argv[1], Path(sys.argv[2])))
