"""The sequential test itself: what the noise is told to be, what long histories take, gaps."""

import time

import numpy as np
import pytest
from benchmarks.bench_monitor import draw_unit

from zerodrift.field.noise import MEMORIES, correlate, fit_noise
from zerodrift.field.watch import STEP, BlockMeans, Rules, follow, join_blocks, make_blocks

BLOCK_S = 14_400.0
RULES = Rules(0.01, BLOCK_S, 0.02)


def draw_blocks(seed: int, n: int, noise: float = 0.1, first: int = 100_000) -> BlockMeans:
    rng = np.random.default_rng(seed)
    place = first + np.arange(n)
    warm = 0.4 * np.sin(place * 2 * np.pi / 6) + 0.3 * np.sin(place / 40)
    return BlockMeans(place, np.full(n, 240.0), rng.normal(0, noise, n), warm)


@pytest.mark.parametrize("memory", MEMORIES)
def test_the_covariance_of_block_means_is_that_of_a_simulated_process(memory: float) -> None:
    rng = np.random.default_rng(1)
    per, blocks = 200, 40_000
    keep = np.exp(-1.0 / (memory * per))
    from scipy.signal import lfilter

    drawn = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=per * blocks))
    means = drawn.reshape(blocks, per).mean(axis=1)
    told = correlate(np.arange(4.0), memory)
    for lag in range(4):
        seen = np.mean(means[: blocks - lag] * means[lag:])
        assert seen == pytest.approx(told[lag], abs=0.02)


def test_white_noise_is_told_by_its_size() -> None:
    blocks = draw_blocks(2, 200)
    noise = fit_noise(blocks.residual, blocks, np.ones((200, 1)), BLOCK_S)[0]
    whole = np.sqrt(np.mean(np.diag(noise.covariance(blocks))) - np.mean(noise.covariance(blocks)))
    assert whole == pytest.approx(0.1, rel=0.15)


@pytest.mark.long
def test_three_years_are_tested_in_seconds_and_a_late_step_is_found() -> None:
    blocks = draw_blocks(3, 6500)
    blocks.residual[6400:] += 1.0
    start = time.process_time()
    found = follow(blocks, RULES, None).finding
    assert time.process_time() - start < 30
    assert found is not None
    assert found.cause == STEP
    assert 6398 <= found.since <= 6401
    assert found.alarm >= 6400
    assert found.size == pytest.approx(1.0, abs=0.1)


@pytest.mark.spread(0, "noise", ["white", "flicker"])
def test_a_step_does_not_pass_for_another_unit(noise: str) -> None:
    """Of five times the noise: between the sizes that the test averages over."""
    told = [draw_unit(700_000 + i, noise, STEP) for i in range(8)]
    assert [one.cause for one in told] == [STEP] * 8


def test_a_gap_of_months_is_no_change() -> None:
    before, after = draw_blocks(4, 120), draw_blocks(5, 120, first=101_000)
    assert follow(join_blocks(before, after), RULES, None).finding is None


def test_blocks_that_arrive_in_parts_are_those_that_arrive_at_once() -> None:
    rng = np.random.default_rng(6)
    time_s = 1.7e9 + 60.0 * np.arange(2000)
    residual, warm = rng.normal(size=2000), rng.normal(size=2000)
    whole = make_blocks(time_s, residual, warm, 600.0)
    cut = int(np.flatnonzero(time_s % 600.0 < 60.0)[50])
    parts = [
        make_blocks(time_s[s], residual[s], warm[s], 600.0) for s in (slice(cut), slice(cut, None))
    ]
    joined = join_blocks(*parts)
    assert (joined.place == whole.place).all()
    assert joined.residual == pytest.approx(whole.residual, abs=1e-12)


def test_a_spike_counts_as_four_deviations_at_most() -> None:
    rng = np.random.default_rng(7)
    residual = rng.normal(size=240)
    spiked = residual.copy()
    spiked[100] = 1e6
    time_s = 60.0 * np.arange(240)
    means = [make_blocks(time_s, r, residual, BLOCK_S).residual[0] for r in (residual, spiked)]
    assert abs(means[1] - means[0]) < 8 / 240
