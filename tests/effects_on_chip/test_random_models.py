"""Random models of all three sorts on all back ends, and one that once did not compile."""

from pathlib import Path

import pytest
from benchmarks.bench_random import compare, read_journal

pytestmark = pytest.mark.long


def test_network_that_sees_nothing_but_time_compiles(tmp_path: Path) -> None:
    assert compare(1, 1, tmp_path / "journal.jsonl", first=503)


def test_a_few_random_models_are_equal_everywhere_and_within_their_bounds(tmp_path: Path) -> None:
    journal = tmp_path / "journal.jsonl"
    assert compare(4, 2, journal)
    first = journal.read_text()
    assert compare(4, 2, journal) and journal.read_text() == first  # nothing is run again
    assert {r["sort"] for r in read_journal(journal, 2).values()} <= {
        "effects",
        "operations",
        "shapes",
    }
