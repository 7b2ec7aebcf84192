"""A GRU in a block: its stream of numbers, the test of its rows, one format for many units.

The stream is that of the kernel for pairs (`operations/gru/layouts.py`), which every core can read;
the program's assembly takes it from the block as it takes it from its own constants. A block may
hold any numbers with which no sum leaves 32 bits, whatever the features and the state are:

    r, u:      |b| + 2^15 (L1 of both rows)           <= 2^31 - 1
    n inside:  |c| + 2^15 (L1 of the state's row)     <= 2^31 - 1
    n:         |b| + 2^15 (L1 of the features' row) + inside / 2 + 1 <= 2^31 - 1

A feature is an int16 and the copy of a state at most 32767; the reset gate is below 1/2 in Q0.32.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import INT16_MAX, INT32_MAX, round_shift
from zerodrift.operations.dense import COPY_BITS
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import GATES, IntegerGru, prove_state
from zerodrift.operations.gru.layouts import find_pairs, has_fast_kernels, lay_out_pairs
from zerodrift.operations.intervals import Bound, Interval, check_shift
from zerodrift.operations.node import ChannelNode, IntegerNode
from zerodrift.operations.recurrent import H_LIMIT_Q30

# A GRU's weights in a coarser format: rounded row by row together, for the states that occur.


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

    x: IntArray
    """[n, I] features."""
    h: IntArray
    """[n, H] the states' copies."""


def visit(model: IntegerModel, layer: IntegerGruLayer) -> Visits:
    """Return features and states of a unit under drawn inputs within what it was calibrated in."""
    bare = replace(model, channels=tuple(replace(c, conversion=None) for c in model.channels))
    steps, seen = max(STEPS, layer.window), list[IntArray]()
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


def draw_codes(model: IntegerModel, steps: int) -> IntArray:
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


def _draw_ramps(low: int, high: int, rate: float, steps: int, rng: np.random.Generator) -> IntArray:
    now, found = rng.uniform(low, high), list[float]()
    while len(found) < steps:
        to, slope = rng.uniform(low, high), rate * SLOWEST ** rng.random()
        found += np.linspace(now, to, max(int(abs(to - now) / slope), 1)).tolist()
        found += [to] * int(rng.integers(LONGEST_DWELL))
        now = to
    return np.asarray(np.clip(np.round(found[:steps]), low, high), dtype=np.int64)


def round_rows(rows: Array, inputs: IntArray) -> tuple[IntArray, IntArray]:
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


# A GRU in a block: its stream of numbers, the test of its rows, one format for many units.

STREAM = "stream"
"""The attribute under which a layer's numbers stand in a block."""
UNIT = 2**15
"""Largest feature, and more than the largest copy of a state."""
BIASES = 4
"""Words of a unit before its weights: r, u, n outside, n inside."""


def find_obstacle(node: IntegerNode) -> str:
    """Return why a recurrent layer cannot stand in a block; "" if it can."""
    if node.kind == "gru_stack":
        return "several layers on top of each other cannot stand in a block yet"
    if not isinstance(node, IntegerGruLayer):
        return "its weights cannot stand in a block yet: each kernel has an order of its own"
    if node.gru.multiplier is not None:
        return (
            "recurrent weights of 8 bits cannot stand in a block yet: no kernel in C reads the"
            ' order of the assembly. Use [quantization] weights = "int16"'
        )
    if not has_fast_kernels(node.gru):
        return "a reset before the product cannot stand in a block yet: no kernel in C reads it"
    return ""


def count_pairs(gru: IntegerGru) -> tuple[int, int]:
    """Return the words that hold a row of features and a row of the state, two weights in each."""
    return -(-gru.inputs // 2), -(-gru.hidden // 2)


def read_stream(gru: IntegerGru) -> IntArray:
    """Return the numbers of a layer as they lie in a block, unit by unit: [H, 4 + 3 (X + R)]."""
    return np.array(lay_out_pairs(gru), dtype=np.int64).reshape(gru.hidden, -1)


def put_stream(gru: IntegerGru, stream: IntArray) -> IntegerGru:
    """Return a layer with the numbers of a block."""
    bias, *parts = _split(stream, count_pairs(gru))
    w_x, w_h = (np.moveaxis(part, 0, 1).astype(np.int16) for part in parts)
    return replace(
        gru,
        w_x=np.ascontiguousarray(w_x[..., : gru.inputs]),
        w_h=np.ascontiguousarray(w_h[..., : gru.hidden]),
        bias=bias.T.astype(np.int32),
    )


def _split(stream: IntArray, pairs: tuple[int, int]) -> tuple[IntArray, IntArray, IntArray]:
    """Return biases [H, 4] and the weights of features and state, [H, 3, 2 X] and [H, 3, 2 R]."""
    words = stream.reshape(-1, BIASES + 3 * sum(pairs))
    parts, at = [], BIASES
    for count in pairs:
        found = words[:, at : at + 3 * count][:, find_pairs(count)]
        halves = np.stack([((found & 0xFFFF) ^ 0x8000) - 0x8000, found >> 16], axis=-1)
        parts.append(halves.reshape(*found.shape[:2], 2 * count))
        at += 3 * count
    return words[:, :BIASES], parts[0], parts[1]


def find_overflow(stream: IntArray, pairs: tuple[int, int]) -> str:
    """Return which sum of a stream could leave 32 bits; "" if none can.

    Args:
        stream: the numbers of a block.
        pairs: words of a row of features and of the state.
    """
    bias, w_x, w_h = _split(stream, pairs)
    for gate, reach in zip(GATES, _bound_rows(bias, w_x, w_h), strict=True):
        if int(reach.max()) > INT32_MAX:
            return f"the sum of gate {gate}, unit {int(reach.argmax())}, could reach {reach.max()}"
    return ""


def _bound_rows(bias: IntArray, w_x: IntArray, w_h: IntArray) -> list[IntArray]:
    """Return the largest sums of r, u and n (there the larger of both), [H] each."""
    x, h = (UNIT * np.abs(w).sum(axis=2) for w in (w_x, w_h))
    size = np.abs(bias)
    inside = size[:, 3] + h[:, 2]
    outside = size[:, 2] + x[:, 2] + inside // 2 + 1
    r, u = (size[:, gate] + x[:, gate] + h[:, gate] for gate in (0, 1))
    return [r, u, np.maximum(inside, outside)]


def align_layers(
    grus: Sequence[IntegerGru], name: str, design: IntegerGru | None, margin: float
) -> list[IntegerGru]:
    """Return layers with the same shifts, each weight rounded to its new scale by itself.

    Args:
        grus: of the units; all of one shape.
        name: names the layer in messages.
        design: a layer of the format that they are to have; None: the finest in which all fit with
            a margin.
        margin: by how much a later unit's numbers may be larger, as a share.

    Raises:
        CheckError: they have no format in common, or do not fit the design's.
    """
    shapes = {(g.w_x.shape, g.w_h.shape) for g in [*grus, *([] if design is None else [design])]}
    if len(shapes) > 1:
        raise CheckError(
            f"operation '{name}': units of one design need layers of one size. Make `hidden` and"
            " the effects the same in all, and train again."
        )
    if design is not None:
        shifts = list(design.shift)
    else:
        least = [min(gru.shift[gate] for gru in grus) for gate in range(3)]
        shifts = [_choose_shift(grus, gate, most, margin) for gate, most in enumerate(least)]
    for gru in grus:
        if any(own < to for own, to in zip(gru.shift, shifts, strict=True)):
            raise CheckError(
                f"operation '{name}': the unit needs a coarser format than its design has (shifts"
                f" of {list(gru.shift)}; {shifts} are fixed). Make a new design from all units."
            )
    aligned = [_rescale(gru, (shifts[0], shifts[1], shifts[2])) for gru in grus]
    for gru in aligned:
        why = find_overflow(read_stream(gru), count_pairs(gru))
        if why:
            raise CheckError(
                f"operation '{name}': the unit does not fit its design's format ({why} of"
                f" {INT32_MAX}). Make a new design from all units."
            )
    return aligned


def _choose_shift(grus: Sequence[IntegerGru], gate: int, most: int, margin: float) -> int:
    """Return the largest shift of a gate at which all units fit, enlarged by the margin."""
    for shift in range(most, -1, -1):
        shifts = [gru.shift[gate] - shift for gru in grus]
        if all(_fits(gru, gate, by, margin) for gru, by in zip(grus, shifts, strict=True)):
            return shift
    raise CheckError(f"GRU gate {GATES[gate]}: these units have no safe 32-bit format in common")


def _fits(gru: IntegerGru, gate: int, coarser: int, margin: float) -> bool:
    """Tell whether a gate fits 2^coarser times as coarse, with weights so much larger."""
    scale = Fraction(1 + margin) / 2**coarser
    reach = _bound_rows(
        gru.bias.T.astype(np.int64),
        np.moveaxis(gru.w_x, 0, 1).astype(np.int64),
        np.moveaxis(gru.w_h, 0, 1).astype(np.int64),
    )[gate]
    largest = max(int(np.abs(w[gate].astype(np.int64)).max()) for w in (gru.w_x, gru.w_h))
    # each weight may be rounded up by a half
    rounding = UNIT * (gru.inputs + gru.hidden) + UNIT if coarser else 0
    return bool(int(reach.max()) * scale + rounding <= INT32_MAX and largest * scale <= INT16_MAX)


def _rescale(gru: IntegerGru, shifts: tuple[int, int, int]) -> IntegerGru:
    """Return a layer whose gates have other, smaller shifts."""
    by = [own - to for own, to in zip(gru.shift, shifts, strict=True)]
    halves = [(1 << own >> 1, 1 << to >> 1) for own, to in zip(gru.shift, shifts, strict=True)]
    bias = gru.bias.astype(np.int64)
    outside = [_coarsen(bias[g] - halves[g][0], by[g]) + halves[g][1] for g in range(3)]
    w_x, w_h = (
        np.stack([_coarsen(w[g].astype(np.int64), by[g]) for g in range(3)]).astype(np.int16)
        for w in (gru.w_x, gru.w_h)
    )
    inside = _coarsen(bias[3], by[2])
    return replace(
        gru, w_x=w_x, w_h=w_h, bias=np.stack([*outside, inside]).astype(np.int32), shift=shifts
    )


def refine(own: IntegerGru, aligned: IntegerGru, visits: Visits) -> IntegerGru:
    """Return a layer in a design's format whose sums are nearer to its own than `aligned` gives.

    Args:
        own: in the format of its own.
        aligned: each weight rounded by itself; returned where rounding rows together would leave
            the set of blocks.
        visits: the features and states for which sums are to be near.
    """
    bias = aligned.bias.astype(np.int64)
    w_x, w_h = aligned.w_x.astype(np.int64), aligned.w_h.astype(np.int64)
    both, inputs = np.concatenate([visits.x, visits.h], axis=1), own.inputs
    for gate, (before, after) in enumerate(zip(own.shift, aligned.shift, strict=True)):
        if before == after:
            continue
        rows_x, rows_h = (w[gate] / 2.0 ** (before - after) for w in (own.w_x, own.w_h))
        if gate < GATES.index("n"):
            rows, change = round_rows(np.concatenate([rows_x, rows_h], axis=1), both)
            w_x[gate], w_h[gate] = rows[:, :inputs], rows[:, inputs:]
            bias[gate] += change
            continue
        w_x[gate], outside = round_rows(rows_x, visits.x)
        w_h[gate], inside = round_rows(rows_h, visits.h)
        bias[gate] += outside
        bias[3] += inside
    largest = max(int(np.abs(w).max()) for w in (w_x, w_h))
    reach = _bound_rows(bias.T, np.moveaxis(w_x, 0, 1), np.moveaxis(w_h, 0, 1))
    if largest > INT16_MAX or max(int(sums.max()) for sums in reach) > INT32_MAX:
        return aligned
    return replace(
        aligned, w_x=w_x.astype(np.int16), w_h=w_h.astype(np.int16), bias=bias.astype(np.int32)
    )


def _coarsen(numbers: IntArray, bits: int) -> IntArray:
    """Return numbers / 2^bits, to the nearest integers, halves upwards."""
    return np.asarray((numbers + (1 << bits >> 1)) >> bits)


def prove_layer(node: IntegerGruLayer) -> tuple[list[Interval], list[Bound]]:
    """Return the bounds of every accumulator for any block that passes `find_overflow`."""
    bounds = [prove_state(node.name)]
    if node.window:
        bounds.append(Bound(f"{node.name}.window", Interval(1, node.window), 16).check())
    for gate, name in enumerate(GATES):
        check_shift(f"{node.name}.{name}", node.gru.shift[gate], 31)
        for unit in range(node.width):
            row = f"{node.name}.{name}[{unit}]"
            any_sum = Interval(-INT32_MAX, INT32_MAX)
            wheres = [f"{row}.inside", row] if name == "n" else [row]
            bounds += [Bound(where, any_sum, 32).check() for where in wheres]
    return [Interval(-H_LIMIT_Q30, H_LIMIT_Q30)] * node.width, bounds
