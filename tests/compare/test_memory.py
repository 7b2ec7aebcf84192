"""Memory of `compare` per row: what is held of a long log is little more than the log itself."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from benchmarks.bench_memory import LIMIT_BYTES_PER_ROW, write_project
from click.testing import CliRunner

from zerodrift.cli.main import cli
from zerodrift.diagnosis import memory
from zerodrift.diagnosis.memory import average

ROWS = (100_000, 260_000)
"""More than the rows at which block means stand for samples, so that only what grows counts."""


def measure_peak_bytes(directory: Path, rows: int, *, test: bool) -> int:
    """Return the most that NumPy and Python held at once during a `compare`."""
    directory.mkdir()
    write_project(directory, rows, test=test)
    tracemalloc.start()
    try:
        result = CliRunner().invoke(cli, ["compare", "--json", "-C", str(directory)])
        assert result.exit_code == 0, result.output
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.spread(0, "test", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_row_of_three_columns_takes_no_more_than_the_limit(test: bool, tmp_path: Path) -> None:
    measure_peak_bytes(tmp_path / "first", 1_000, test=test)  # what is imported counts no row
    few, many = (measure_peak_bytes(tmp_path / str(rows), rows, test=test) for rows in ROWS)
    assert (many - few) / (ROWS[1] - ROWS[0]) <= LIMIT_BYTES_PER_ROW


@pytest.mark.parametrize("block", [1, 2, 7, 60])
@pytest.mark.parametrize("samples", [1, 59, 60, 1000, 4001])
def test_means_of_blocks_are_the_same_bits_however_many_rows_are_made_at_once(
    monkeypatch: pytest.MonkeyPatch, block: int, samples: int
) -> None:
    columns = np.random.default_rng(samples).normal(20, 5, (3, samples))
    whole = samples // block * block
    at_once = columns.T[:whole].copy().reshape(-1, block, 3).mean(axis=1)
    for rows in (1, 100, 1 << 14):
        monkeypatch.setattr(memory, "ROWS_AT_ONCE", rows)
        means = average(lambda rows: list(columns[:, rows]), samples, block)
        np.testing.assert_array_equal(means, at_once)
