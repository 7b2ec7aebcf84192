"""A GRU's weights in a coarser format: rounded row by row together, for the states that occur.

Features and states of a layer go up and down together, so that what rounding one weight costs a sum
can be made good by the others of its row. Weights are rounded one after the other; what is left of
each is spread over those that are not rounded yet so that the sum changes least, in the mean square
over what the unit's own model goes through under drawn inputs. What is left in the mean goes into
the bias. Source: Frantar et al., GPTQ, arXiv:2210.17323, algorithm 1.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.dense import COPY_BITS
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.node import ChannelNode

Numbers = NDArray[np.int64]
RUNS, STEPS = 32, 600
SLOWEST = 1e-2
"""Of the calibrated rate: the slowest ramp that is drawn."""
LONGEST_DWELL = 300
"""Steps."""
OTHER_RATE = 0.1
"""Largest change per step of other inputs, as a share of their range."""
DAMPING = 1e-3
"""Of the mean variance, added to each: how far states are trusted to be those that were seen."""


@dataclass(frozen=True)
class Visits:
    """What a layer's sums are made of, from step to step."""

    x: Numbers
    """[n, I] features."""
    h: Numbers
    """[n, H] the states' copies."""


def visit(model: IntegerModel, layer: IntegerGruLayer) -> Visits:
    """Return features and states of a unit under drawn inputs within what it was calibrated in."""
    bare = replace(model, channels=tuple(replace(c, conversion=None) for c in model.channels))
    steps, seen = max(STEPS, layer.window), list[Numbers]()
    Reference(bare).run(
        draw_codes(bare, steps), observe=lambda _, values: seen.append(values[layer.inputs[0]])
    )
    x = np.stack(seen, axis=1)
    if layer.window:
        x = x[:, : steps // layer.window * layer.window].reshape(-1, layer.window, x.shape[2])
        h = np.zeros((x.shape[0], layer.width), dtype=np.int64)
    else:
        h = layer.gru.settle(x[:, 0])
    copies = []
    for t in range(x.shape[1]):
        copies.append(round_shift(h, COPY_BITS))
        h = layer.gru.step(x[:, t], h)
    return Visits(x.reshape(-1, x.shape[2]), np.stack(copies, axis=1).reshape(-1, layer.width))


def draw_codes(model: IntegerModel, steps: int) -> Numbers:
    """Return ramps and dwells of every input [RUNS, steps, C], always the same."""
    rng = np.random.default_rng(0)
    codes = np.empty((RUNS, steps, len(model.channels)), dtype=np.int64)
    for channel in range(codes.shape[2]):
        low, high, rate = _find_range(model, channel)
        for run in range(RUNS):
            codes[run, :, channel] = _draw_ramps(low, high, rate, steps, rng)
        missing = model.channels[channel].no_reading
        if missing is not None:
            codes[..., channel] += codes[..., channel] == missing
    return codes


def _find_range(model: IntegerModel, channel: int) -> tuple[int, int, float]:
    """Return the ends of an input's calibrated range, and the largest change per step."""
    guards = model.guards
    if channel == guards.temperature_channel:
        return guards.temperature_low, guards.temperature_high, max(guards.rate_max, 1)
    limits = [(low, high) for own, low, high in guards.ranges if own == channel]
    limits += [
        (n.low, n.high) for n in model.nodes if isinstance(n, ChannelNode) and n.channel == channel
    ]
    low, high = limits[0] if limits else (0, 0)
    return low, high, max(OTHER_RATE * (high - low), 1)


def _draw_ramps(low: int, high: int, rate: float, steps: int, rng: np.random.Generator) -> Numbers:
    now, found = rng.uniform(low, high), list[float]()
    while len(found) < steps:
        to, slope = rng.uniform(low, high), rate * SLOWEST ** rng.random()
        found += np.linspace(now, to, max(int(abs(to - now) / slope), 1)).tolist()
        found += [to] * int(rng.integers(LONGEST_DWELL))
        now = to
    return np.asarray(np.clip(np.round(found[:steps]), low, high), dtype=np.int64)


def round_rows(rows: Array, inputs: Numbers) -> tuple[Numbers, Numbers]:
    """Return rows in whole numbers, and what is to be added to their biases.

    Args:
        rows: [R, n] in units of the format.
        inputs: [m, n] what they are multiplied with.

    Returns:
        [R, n] and [R].
    """
    moments = np.cov(inputs.T.astype(np.float64)).reshape(rows.shape[1], -1)
    variances = np.diag(moments)
    moments = moments + np.eye(len(moments)) * max(DAMPING * variances.mean(), 1.0)
    order = np.argsort(-variances, kind="stable")
    spread = np.linalg.cholesky(np.linalg.inv(moments[np.ix_(order, order)])).T
    left = rows[:, order]
    rounded = np.empty_like(left)
    for i in range(len(order)):
        rounded[:, i] = np.round(left[:, i])
        lost = (left[:, i] - rounded[:, i]) / spread[i, i]
        left[:, i:] -= np.outer(lost, spread[i, i:])
    found = np.empty_like(rounded)
    found[:, order] = rounded
    bias = (rows - found) @ inputs.mean(axis=0)
    return found.astype(np.int64), np.round(bias).astype(np.int64)
