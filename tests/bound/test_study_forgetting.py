"""The study of what free GRUs forget: its Jacobians; it tells what forgets from what does not."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.study_forgetting import Forgetting, find_jacobians, measure

from tests.bound.recurrent import Forgetful, draw_gru
from zerodrift.export.float_network import FloatNetwork
from zerodrift.operations.gru.cell import FloatGru

FULL_SCALE = np.array([4.0])


@pytest.mark.parametrize("reset", ["after", "before"])
def test_jacobians_are_what_a_small_change_makes(reset: str) -> None:
    rng = np.random.default_rng(3)
    gru = draw_gru(Forgetful(hidden=5, reset=reset, coupling=0.9))
    gru = replace(gru, w_h=5.0 * gru.w_h)
    x, h, by = rng.normal(size=(4, 2)), rng.uniform(-1, 1, (4, 5)), 1e-6
    found, _ = find_jacobians(gru, x, h)
    for j, aside in enumerate(by * np.eye(5)):
        change = (gru.step(x, h + aside) - gru.step(x, h - aside)) / (2.0 * by)
        np.testing.assert_allclose(found[:, :, j], change, atol=1e-8)


def test_a_gru_that_forgets_meets_every_criterion() -> None:
    found = _measure(draw_gru(Forgetful(hidden=4, coupling=0.5)))
    assert found.step < 1.0
    assert max(found.products) < 1e-3
    assert max(found.left) < 1e-3
    assert found.range_percent == pytest.approx(100.0 * 2.0 * 4 / 4.0)


def test_a_unit_that_keeps_its_sign_is_seen_to_forget_nothing() -> None:
    """h' = h + (tanh(4 h) - h) / 2 has two states of rest, on either side of 0."""
    zeros = np.zeros((3, 1, 2))
    w_h = np.zeros((3, 1, 1))
    w_h[2] = 8.0
    found = _measure(FloatGru(zeros, w_h, np.zeros((4, 1)), "after"))
    assert found.left[-1] > 1.9
    assert found.left_percent[-1] == pytest.approx(50.0 * found.left[-1] / 2.0)


def _measure(gru: FloatGru) -> Forgetting:
    hidden = gru.w_h.shape[1]
    network = FloatNetwork.stack((gru,), np.ones((1, hidden)), np.zeros(1))
    x = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 3100, 2))
    return measure(network, x, FULL_SCALE, 1)
