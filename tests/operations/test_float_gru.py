"""The float GRU is PyTorch's."""

import numpy as np
import pytest
import torch
from tests.train.one_at_a_time import Cell, step_gru

from zerodrift.operations.gru.cell import FloatGru


@pytest.mark.parametrize("reset", ["after", "before"])
def test_run_step_and_rest_are_those_of_the_equations(reset: str) -> None:
    rng = np.random.default_rng(4)
    parts = tuple(rng.normal(size=s) for s in ((3, 5, 2), (3, 5, 5), (4, 5)))
    gru = FloatGru(*parts, reset)
    cell = Cell(*map(torch.from_numpy, parts), reset)
    x, h = rng.normal(size=(3, 40, 2)), rng.uniform(-1.0, 1.0, (3, 5))
    found = gru.run(x, h)
    np.testing.assert_array_equal(gru.step(x[:, 0], h), gru.run(x[:, :1], h)[:, 0])
    expected = torch.from_numpy(h)
    for t in range(40):
        expected = step_gru(cell, torch.from_numpy(x[:, t]), expected)
        np.testing.assert_allclose(found[:, t], expected.numpy(), atol=1e-12)
    at_rest = torch.zeros(3, 5, dtype=torch.float64)
    for _ in range(64):
        at_rest = step_gru(cell, torch.from_numpy(x[:, 0]), at_rest, resting=True)
    np.testing.assert_allclose(gru.settle(x[:, 0]), at_rest.numpy(), atol=1e-12)
