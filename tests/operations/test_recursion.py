"""The recursive filter that is loaded without the rest of SciPy's signal module."""

import subprocess
import sys

import numpy as np
import pytest

from zerodrift.operations import recursion


@pytest.mark.parametrize("shape", [(1,), (7,), (3, 400)])
@pytest.mark.parametrize("has_state", [False, True])
def test_filter_gives_the_bits_of_scipys_own(shape, has_state):
    from scipy.signal import lfilter

    rng = np.random.default_rng(5)
    x = rng.standard_normal(shape)
    state = rng.standard_normal((*shape[:-1], 1)) if has_state else None
    b, a = [0.3, -0.1], [1.0, -0.8]
    expected = lfilter(b, a, x) if state is None else lfilter(b, a, x, zi=state)[0]
    assert np.array_equal(recursion.filter_recursively(b, a, x, state), expected)


def test_filter_of_a_scipy_that_keeps_it_elsewhere_is_the_public_one(monkeypatch):
    from scipy.signal import lfilter

    monkeypatch.setattr(recursion, "FUNCTION", "_moved")
    recursion.load_filter.cache_clear()
    try:
        assert recursion.load_filter() is lfilter
        x, state = np.arange(9.0), np.array([0.5])
        expected = lfilter([0.5], [1.0, -0.5], x, zi=state)[0]
        told = recursion.filter_recursively([0.5], [1.0, -0.5], x, state)
        assert np.array_equal(told, expected)
    finally:
        recursion.load_filter.cache_clear()


def test_filter_loads_nothing_else_of_scipys_signal():
    code = (
        "import sys; from zerodrift.operations.recursion import load_filter; load_filter(); "
        "sys.exit('scipy.signal' in sys.modules or 'scipy.stats' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
