"""The step of a coarse converter, read from the values that recur."""

import numpy as np
import pytest

from zerodrift.dataset.resolution import measure_resolution


def make_codes(step: float, rows: int = 2000) -> np.ndarray:
    rng = np.random.default_rng(7)
    load = np.repeat(rng.uniform(-300, 300, 10), rows // 10)
    return step * np.rint((load + rng.normal(0, 0.33 * step, rows)) / step)


@pytest.mark.parametrize("step", [0.0179221, 1 / 128, 3.0])
def test_rows_between_two_samples_hide_no_step(step: float) -> None:
    codes = make_codes(step)
    share = np.random.default_rng(8).uniform(size=codes.size)
    mixed = np.where(share < 0.5, codes, (1 - share) * codes + share * np.roll(codes, 1))
    assert measure_resolution(codes) == pytest.approx(step, rel=1e-4)
    assert measure_resolution(mixed) == pytest.approx(step, rel=1e-4)


def test_noise_and_a_constant_show_no_step() -> None:
    noise = np.random.default_rng(9).normal(size=2000)
    assert measure_resolution(noise) == 0.0
    assert measure_resolution(np.round(noise, 4)) == 0.0  # hardly a value recurs
    assert measure_resolution(np.full(500, 3.0)) == 0.0
    assert measure_resolution(np.clip(noise, -1.0, 1.0)) == 0.0
