"""A whole run of the float GRU is its steps one after the other."""

import numpy as np
import pytest

from zerodrift.operations.gru.cell import FloatGru


@pytest.mark.parametrize("reset", ["after", "before"])
def test_run_is_the_steps_in_turn(reset: str) -> None:
    rng = np.random.default_rng(4)
    parts = (rng.normal(size=s) for s in ((3, 5, 2), (3, 5, 5), (4, 5)))
    gru = FloatGru(*parts, reset)
    x, h = rng.normal(size=(3, 40, 2)), rng.uniform(-1.0, 1.0, (3, 5))
    found = gru.run(x, h)
    for t in range(40):
        h = gru.step(x[:, t], h)
        np.testing.assert_allclose(found[:, t], h, atol=1e-12)
