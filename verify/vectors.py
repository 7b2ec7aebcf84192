"""The input sequences that a model is checked on: the logs themselves, and what logs never show."""

import numpy as np
from numpy.typing import NDArray

from zerodrift.codegen.selftest import limits_of
from zerodrift.export.integer_model import IntegerModel

RANDOM_SEED = 20250217
"""Only makes the sequences repeatable; any other would do."""


def draw_sequences(model: IntegerModel, steps: int) -> dict[str, NDArray[np.int16]]:
    """Return sequences [T, C] of raw codes by name, `steps` in all.

    Noise and jumps over the whole int16 range, the rails, a slow walk through the calibrated range
    and beyond it, and a long dwell.

    Args:
        model: gives the channels and their calibrated range.
        steps: total number of steps, at least 50.
    """
    rng = np.random.default_rng(RANDOM_SEED)
    part, channels = steps // 5, len(model.channels)
    low, high = (np.array(x, dtype=np.float64) for x in limits_of(model))
    noise = rng.integers(-32768, 32768, size=(part, channels))
    rails = np.where(rng.random((part, channels)) < 0.5, -32768, 32767)
    jumps = np.repeat(noise[:: max(part // 40, 1)], max(part // 40, 1), axis=0)[:part]
    span = high - low
    walk = np.cumsum(rng.normal(size=(part, channels)) * span / 50.0, axis=0)
    walk = low - 0.25 * span + np.abs((walk % (3.0 * span)) - 1.5 * span)
    dwell = np.repeat(((low + high) / 2.0)[None], steps - 4 * part, axis=0)
    named = {"noise": noise, "rails": rails, "jumps": jumps, "walk": walk, "constant": dwell}
    return {
        name: np.clip(np.round(codes), -32768, 32767).astype(np.int16)
        for name, codes in named.items()
    }
