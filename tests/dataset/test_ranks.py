"""Medians and quantiles are NumPy's, to the bit."""

import numpy as np
import pytest

from zerodrift.base.arrays import find_median, find_quantile


@pytest.mark.parametrize("seed", range(40))
def test_ranks_have_the_bits_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=int(rng.integers(1, 3000))) * 10.0 ** rng.integers(-9, 9)
    if seed % 3 == 0:
        values = np.round(values, int(rng.integers(0, 3)))
    assert find_median(values) == np.median(values)
    for share in (0.0, 0.01, 0.25, 0.5, 0.95, 0.97, 0.99, 1.0, float(rng.random())):
        assert find_quantile(values, share) == np.quantile(values, share)


def test_ranks_of_what_is_no_number_are_none() -> None:
    values = np.array([1.0, np.nan, 3.0, 2.0])
    assert np.isnan(find_median(values)) and np.isnan(find_quantile(values, 0.1))
    assert np.isnan(find_median(np.zeros(0)))
