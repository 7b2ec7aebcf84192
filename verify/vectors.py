"""The input sequences that a model is checked on: the logs themselves, and what logs never show."""

import numpy as np

from zerodrift.codegen.selftest import limits_of
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import CodeArray

RANDOM_SEED = 20250217
"""Only makes the sequences repeatable; any other would do."""
MISSING_SHARE = 0.1
"""Of the noise's codes, where a channel has one that means no reading."""
EDGE_SHARE = 0.04
"""Of the noise's codes, at either end of what is not flagged."""


def draw_sequences(model: IntegerModel, steps: int) -> dict[str, CodeArray]:
    """Return sequences [T, C] of raw codes by name, `steps` in all.

    Noise over everything that the input's type holds and within the calibrated range, with codes
    that mean no reading and those at which a flag changes; jumps, the rails, a slow walk through
    the calibrated range and beyond it, and a long dwell.

    Args:
        model: gives the channels and their calibrated range.
        steps: total number of steps, at least 50.
    """
    rng = np.random.default_rng(RANDOM_SEED)
    part, channels = steps // 5, len(model.channels)
    low, high = (np.array(x, dtype=np.float64) for x in limits_of(model))
    bits = np.array([channel.bits for channel in model.channels])
    first, last = -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    noise = rng.integers(first, last + 1, size=(part, channels))
    within = rng.integers(low.astype(np.int64), high.astype(np.int64) + 1, size=(part, channels))
    noise = np.where(rng.random((part, 1)) < 0.5, noise, within)
    none = np.array([channel.no_reading or 0 for channel in model.channels], dtype=np.int64)
    for channel in model.optional:
        lacks = rng.random(part) < MISSING_SHARE
        lacks[:2] = True  # nothing to start from
        noise[lacks, channel] = none[channel]
    guards = model.guards
    temperature = (guards.temperature_channel, guards.temperature_low, guards.temperature_high)
    for channel, lowest, highest in (temperature, *guards.ranges):
        at = rng.random(part) < EDGE_SHARE
        edges = (lowest - 1, lowest, highest, highest + 1)
        noise[at, channel] = rng.choice(edges, size=int(at.sum()))
    rails = np.where(rng.random((part, channels)) < 0.5, first, last)
    jumps = np.repeat(noise[:: max(part // 40, 1)], max(part // 40, 1), axis=0)[:part]
    span = high - low
    walk = np.cumsum(rng.normal(size=(part, channels)) * span / 50.0, axis=0)
    walk = low - 0.25 * span + np.abs((walk % (3.0 * span)) - 1.5 * span)
    dwell = np.repeat(((low + high) / 2.0)[None], steps - 4 * part, axis=0)
    named = {"noise": noise, "rails": rails, "jumps": jumps, "walk": walk, "constant": dwell}
    return {
        name: np.clip(np.round(codes), first, last).astype(model.code_type)
        for name, codes in named.items()
    }
