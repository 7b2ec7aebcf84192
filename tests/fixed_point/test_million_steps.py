"""Long runs: a GRU's million steps at 0 LSB, and an LSTM's integers beside float64."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.bench_recurrent import LSTM_MARK_PCT, measure_lstm
from tests.golden.model_factory import Shape, draw_model

from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.verify.host_check import check_host

pytestmark = pytest.mark.long

STEPS = 1_000_000
HIDDEN = 16


def walk_slowly(steps: int, channels: int) -> np.ndarray[tuple[int, int], np.dtype[np.int16]]:
    """Return a simulated day of temperatures: a walk, an hourly cycle, and visits to the rails."""
    rng = np.random.default_rng(7)
    walk = np.cumsum(rng.normal(scale=3.0, size=(steps, channels)), axis=0)
    codes = walk + 6000.0 * np.sin(np.arange(steps)[:, None] * (2.0 * np.pi / 3600.0))
    codes[steps // 3 : steps // 3 + 500] = 40_000.0
    codes[steps // 2 : steps // 2 + 500] = -40_000.0
    return np.clip(np.round(codes), -32768, 32767).astype(np.int16)


@pytest.mark.parametrize("weights", ["int16", "int8"])
def test_a_million_steps_of_a_slow_memory_are_exact(weights: str, tmp_path: Path) -> None:
    """Units that move by 0.001 to 0.05 of their distance per step, the memory of a warm sensor."""
    shape = Shape(hidden=HIDDEN, inputs=4, outputs=1, weights=weights, update_bias=-5.0)
    model = draw_model(shape, 11)
    host = HostModel(model, generate(model), tmp_path)
    check = check_host(host, walk_slowly(STEPS, shape.inputs), settled=False)
    assert check.mismatch is None
    assert check.steps == STEPS
    assert check.values_compared >= STEPS * (HIDDEN + len(model.outputs) + 1)


def test_16_bit_lstm_stays_with_float_over_thousands_of_steps() -> None:
    assert max(measure_lstm(300, 4000, "int16")) <= LSTM_MARK_PCT


def test_8_bits_cost_more_than_16() -> None:
    wide, narrow = (sum(measure_lstm(301, 2000, weights)) for weights in ("int16", "int8"))
    assert wide < narrow
