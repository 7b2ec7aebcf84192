"""Thinned lines keep what the eye would see."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zerodrift.report.window import pick_rows, pick_spread


@given(st.integers(1, 5000), st.integers(4, 400), st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_thin_lines_keep_ends_and_extremes_and_the_limit(count, most, seed, place):
    y = np.random.default_rng(seed).standard_normal(count)
    start = int(place * (count - 1))
    rows = pick_rows(y, start, count, most)
    assert rows.size <= max(most, 4)
    assert np.all(np.diff(rows) > 0)
    assert rows[0] == start
    assert rows[-1] == count - 1
    assert y[rows].max() == y[start:].max()
    assert y[rows].min() == y[start:].min()


def test_every_spike_of_a_long_line_is_kept():
    y = np.zeros(1_000_000)
    spikes = np.arange(1000, 1_000_000, 10_007)
    y[spikes] = np.where(np.arange(spikes.size) % 2, 1.0, -1.0)
    kept = pick_rows(y, 0, y.size, 1200)
    assert set(spikes) <= set(kept.tolist())


@pytest.mark.parametrize(("count", "most"), [(5, 10), (10, 5), (100_000, 900)])
def test_spread_rows_reach_from_end_to_end(count, most):
    rows = pick_spread(count, most)
    assert rows.size == min(count, most)
    assert (rows[0], rows[-1]) == (0, count - 1)
