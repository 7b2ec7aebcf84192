"""One small function per kind of node: its integer step, and its state at rest, as ONNX operators.

To add a kind: write its step (and its rest, if it has a state) and enter them below. Values and
states are int64 with the batch first, named and shaped as in the reference.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from zerodrift.export.onnx_writer import OnnxWriter, table
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.clock import IntegerCounter
from zerodrift.operations.exp2 import EXPONENT_BITS, MANTISSA_SHIFT, OCTAVE_Q29, IntegerExp2
from zerodrift.operations.gru import RELAX_STEPS, U_RELAX_Q31, IntegerGru
from zerodrift.operations.layers import (
    COPY_BITS,
    IntegerDense,
    IntegerFeatureDense,
    IntegerGruStack,
)
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.network import (
    IntegerDrift,
    IntegerFeatures,
    IntegerGruLayer,
    IntegerHead,
)
from zerodrift.operations.node import CODES, PREVIOUS_DRIFT, IntegerNode
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.polynomial import FRACTION_BITS
from zerodrift.operations.power import IntegerPower
from zerodrift.operations.signal import (
    LOWPASS_FRACTION,
    IntegerDelay,
    IntegerInput,
    IntegerLowpass,
    IntegerOffset,
    IntegerProduct,
)
from zerodrift.operations.tables import STEP_BITS, T_MAX, T_MIN, tanh_nodes
from zerodrift.operations.total import IntegerSum

Names = Mapping[str, str]
"""Node name -> name of its value, or state field -> name of its value."""
Step = Callable[[OnnxWriter, Any, Names, Names], tuple[dict[str, str], str]]
"""(writer, node, values, state) -> next state, output."""
Rest = Callable[[OnnxWriter, Any, Names], dict[str, str]]
"""(writer, node, values) -> state."""


def step_input(w: OnnxWriter, node: IntegerInput, values: Names, _: Names) -> Any:
    """Write (saturate(code, low, high) - origin) << shift."""
    code = w.saturate(w.column(values[CODES], node.channel), node.low, node.high)
    counted = w.sub(code, w.constant(node.origin)) if node.origin else code
    return {}, w.shift_left(counted, node.shift)


def step_load(w: OnnxWriter, node: IntegerLoad, values: Names, _: Names) -> Any:
    """Write saturate(code - drift of the step before, low, high) << shift."""
    code = w.column(values[CODES], node.channel)
    load = w.sub(code, w.column(values[PREVIOUS_DRIFT], node.output))
    return {}, w.shift_left(w.saturate(load, node.low, node.high), node.shift)


def step_counter(w: OnnxWriter, node: IntegerCounter, _: Names, state: Names) -> Any:
    """Write the count, and the next one up to the limit."""
    after = w.minimum(w.add(state["count"], w.constant(1)), w.constant(node.limit))
    return {"count": after}, state["count"]


def rest_counter(w: OnnxWriter, _: IntegerCounter, values: Names) -> dict[str, str]:
    """Write a count of 0."""
    return {"count": w.mul(w.column(values[CODES], 0), w.constant(0))}


def step_clip(w: OnnxWriter, node: IntegerClip, values: Names, _: Names) -> Any:
    """Write saturate(x, low, high)."""
    return {}, w.saturate(values[node.inputs[0]], node.low, node.high)


def step_play(w: OnnxWriter, node: IntegerPlay, values: Names, state: Names) -> Any:
    """Write saturate(y, x - half_width, x + half_width)."""
    x, r = values[node.inputs[0]], w.constant(node.half_width)
    y = w.minimum(w.maximum(state["y"], w.sub(x, r)), w.add(x, r))
    return {"y": y}, y


def rest_play(_: OnnxWriter, node: IntegerPlay, values: Names) -> dict[str, str]:
    """Write y in the middle of its slack."""
    return {"y": values[node.inputs[0]]}


def step_sum(w: OnnxWriter, node: IntegerSum, values: Names, _: Names) -> Any:
    """Write saturate((bias + coefficients . x) >> shift, low, high)."""
    total = w.constant(node.bias)
    for name, coefficient in zip(node.inputs, node.coefficients, strict=True):
        total = w.add(total, w.mul(values[name], w.constant(coefficient)))
    return {}, w.saturate(w.floor_shift(total, node.shift), node.low, node.high)


def write_polynomial(w: OnnxWriter, f_q31: str, coefficients: Sequence[int]) -> str:
    """Write sum c_i f**i by Horner's rule, rounded once per degree."""
    total = w.constant(coefficients[-1])
    for c in reversed(coefficients[:-1]):
        total = w.add(w.constant(c), w.round_shift(w.mul(total, f_q31), FRACTION_BITS))
    return total


def step_exp2(w: OnnxWriter, node: IntegerExp2, values: Names, _: Names) -> Any:
    """Write round_shift(octave(t mod 2**24), min(top + 2 - (t >> 24), 31))."""
    total = w.add(
        w.mul(values[node.inputs[0]], w.constant(node.coefficient)), w.constant(node.bias)
    )
    t = w.saturate(w.floor_shift(total, node.shift), node.low, node.high)
    octave = w.floor_shift(t, EXPONENT_BITS)
    fraction = w.op("Mod", t, w.constant(1 << EXPONENT_BITS))
    mantissa = write_polynomial(w, w.shift_left(fraction, 31 - EXPONENT_BITS), OCTAVE_Q29)
    shift = w.minimum(w.sub(w.constant(node.top + MANTISSA_SHIFT), octave), w.constant(31))
    divisor = w.op("Gather", w.constant([1 << s for s in range(32)]), shift)
    half = w.op("Gather", w.constant([1 << s >> 1 for s in range(32)]), shift)
    return {}, w.op("Div", w.add(mantissa, half), divisor)  # the mantissa is positive


def step_power(w: OnnxWriter, node: IntegerPower, values: Names, _: Names) -> Any:
    """Write round_shift(saturate(octave(f), low, high) gains[n], shift) for x = 2**n (1 + f)."""
    x = values[node.inputs[0]]
    positive = w.maximum(x, w.constant(1))
    powers = w.constant([1 << n for n in range(1, 31)])
    reached = w.flag(w.op("GreaterOrEqual", w.op("Unsqueeze", positive, w.constant([1])), powers))
    n = w.op("ReduceSum", reached, w.constant([1]), keepdims=0)
    scale = w.op("Gather", w.constant([1 << (31 - n) for n in range(31)]), n)
    f_q31 = w.sub(w.mul(positive, scale), w.constant(1 << 31))
    mantissa = w.saturate(write_polynomial(w, f_q31, node.octave), node.low, node.high)
    product = w.mul(mantissa, w.op("Gather", w.constant(list(node.gains)), n))
    power = w.round_shift(product, node.shift)
    return {}, w.op("Where", w.op("Greater", x, w.constant(0)), power, w.constant(0))


def step_offset(w: OnnxWriter, node: IntegerOffset, values: Names, _: Names) -> Any:
    """Write x - offset."""
    return {}, w.sub(values[node.inputs[0]], w.constant(node.offset))


def step_difference(w: OnnxWriter, node: IntegerNode, values: Names, _: Names) -> Any:
    """Write a - b."""
    return {}, w.sub(values[node.inputs[0]], values[node.inputs[1]])


def step_product(w: OnnxWriter, node: IntegerProduct, values: Names, _: Names) -> Any:
    """Write saturate(round_shift(a * b, shift), low, high)."""
    a, b = (values[name] for name in node.inputs)
    return {}, w.saturate(w.round_shift(w.mul(a, b), node.shift), node.low, node.high)


def step_lowpass(w: OnnxWriter, node: IntegerLowpass, values: Names, state: Names) -> Any:
    """Write y = v + c x and v' = v + a (x - y)."""
    x = values[node.inputs[0]]
    y = w.add(state["v"], w.mul(x, w.constant(node.c_q24)))
    gap = w.round_shift(w.sub(w.shift_left(x, LOWPASS_FRACTION), y), 22)
    v = w.add(state["v"], w.round_shift(w.mul(gap, w.constant(node.m_q31)), node.shift))
    return {"v": v}, w.round_shift(y, LOWPASS_FRACTION)


def rest_lowpass(w: OnnxWriter, node: IntegerLowpass, values: Names) -> dict[str, str]:
    """Write the v at which y equals x."""
    share = (1 << LOWPASS_FRACTION) - node.c_q24
    return {"v": w.mul(values[node.inputs[0]], w.constant(share))}


def step_delay(w: OnnxWriter, node: IntegerDelay, values: Names, state: Names) -> Any:
    """Write older + (newer - older) newer_q31, and the line moved on by one."""
    x = w.op("Unsqueeze", values[node.inputs[0]], w.constant([1]))
    line = w.op("Concat", state["line"], x, axis=1)
    older, newer = w.column(line, 0), w.column(line, 1)
    rise = w.round_shift(w.mul(w.sub(newer, older), w.constant(node.newer_q31)), 31)
    moved = w.split(line, (1, node.steps))[1]
    return {"line": moved}, w.add(older, rise) if node.newer_q31 else older


def rest_delay(w: OnnxWriter, node: IntegerDelay, values: Names) -> dict[str, str]:
    """Write a line filled with the present input."""
    x = w.op("Unsqueeze", values[node.inputs[0]], w.constant([1]))
    return {"line": w.op("Tile", x, w.constant([1, node.steps]))}


def step_features(w: OnnxWriter, node: IntegerFeatures, values: Names, _: Names) -> Any:
    """Write saturate((bias + matrix . signals) >> shift) to int16."""
    signals = w.stack([values[name] for name in node.inputs])
    total = w.op("MatMul", signals, w.constant(table(node.matrix.T)))
    total = w.add(total, w.constant(table(node.bias)))
    return {}, w.saturate(w.floor_shift(total, node.shift), INT16_MIN, INT16_MAX)


def write_tanh(w: OnnxWriter, t_q16: str) -> str:
    """Write tanh in Q0.30 of t in Q3.16, from the one table."""
    nodes = tanh_nodes().astype(np.int64)
    position = w.sub(w.saturate(t_q16, T_MIN, T_MAX), w.constant(T_MIN))
    width = w.constant(1 << STEP_BITS)
    index = w.op("Div", position, width)  # position >= 0
    fraction = w.op("Mod", position, width)
    start = w.op("Gather", w.constant(nodes[:-1] << STEP_BITS), index)
    slope = w.op("Gather", w.constant(np.diff(nodes)), index)
    return w.add(start, w.mul(slope, fraction))


def write_sigmoid(w: OnnxWriter, half_t_q16: str) -> str:
    """Write the sigmoid in Q0.31 of twice t in Q3.16."""
    return w.add(write_tanh(w, half_t_q16), w.constant(1 << 30))


def _write_recurrent(w: OnnxWriter, gru: IntegerGru, h_q15: str, gates: slice) -> str:
    """Write w_h . h of some gates, [B, gates * H], in their accumulators' formats."""
    rows = gru.w_h[gates].reshape(-1, gru.hidden)
    product = w.op("MatMul", h_q15, w.constant(table(rows.T)))
    if gru.multiplier is None:
        return product
    scaled = w.mul(product, w.constant(table(gru.multiplier[gates].ravel())))
    return w.round_shift(scaled, np.repeat(gru.multiplier_shift[gates], gru.hidden))


def write_gru_step(
    w: OnnxWriter, gru: IntegerGru, x: str, h_q30: str, u_q31: str | None = None
) -> str:
    """Write one step of a GRU.

    Args:
        w: where to.
        gru: the layer.
        x: [B, I] features.
        h_q30: [B, H] state.
        u_q31: what to move by instead of the update gate.
    """
    hidden, after = gru.hidden, gru.reset == "after"
    halves = (2 * hidden, hidden)
    from_x = w.op("MatMul", x, w.constant(table(gru.w_x.reshape(3 * hidden, -1).T)))
    from_x = w.add(from_x, w.constant(table(gru.bias[:3].ravel())))
    x_ru, x_n = w.split(from_x, halves)
    h_q15 = w.round_shift(h_q30, 15)
    if after:
        h_ru, h_n = w.split(_write_recurrent(w, gru, h_q15, slice(0, 3)), halves)
    else:
        h_ru = _write_recurrent(w, gru, h_q15, slice(0, 2))
    shifts = np.repeat(gru.shift[:2], hidden)
    ru_q31 = write_sigmoid(w, w.floor_shift(w.add(x_ru, h_ru), shifts))
    r_q31, update_q31 = w.split(ru_q31, (hidden, hidden))
    if after:
        inside = w.add(h_n, w.constant(table(gru.bias[3])))
        a_n = w.add(x_n, w.round_shift(w.mul(inside, r_q31), 32))
    else:
        rh_q15 = w.round_shift(w.mul(h_q30, r_q31), 46)
        a_n = w.add(x_n, _write_recurrent(w, gru, rh_q15, slice(2, 3)))
    n_q30 = write_tanh(w, w.floor_shift(a_n, gru.shift[2]))
    move = w.round_shift(w.mul(w.sub(n_q30, h_q30), u_q31 or update_q31), 32)
    return w.add(h_q30, w.shift_left(move, 1))


def write_zeros(w: OnnxWriter, x: str, width: int) -> str:
    """Write [B, width] zeros for the batch of x [B, n]."""
    zero = w.mul(w.op("Gather", x, w.constant([0]), axis=1), w.constant(0))
    return w.op("Tile", zero, w.constant([1, width]))


def step_gru(w: OnnxWriter, node: IntegerGruLayer, values: Names, state: Names) -> Any:
    """Write a step in time, or the whole window from h = 0."""
    x, gru = values[node.inputs[0]], node.gru
    if not node.window:
        h_q30 = write_gru_step(w, gru, x, state["h_q30"])
        return {"h_q30": h_q30}, h_q30
    window = move_window(w, node.window, x, state["window"])
    h_q30 = w.scan(
        lambda carried, slices: ([write_gru_step(w, gru, slices[0], carried[0])], []),
        [(write_zeros(w, x, gru.hidden), ("B", gru.hidden))],
        [(w.op("Transpose", window, perm=[1, 0, 2]), ("B", gru.inputs))],
        [],
    )[0]
    return {"window": window}, h_q30


def move_window(w: OnnxWriter, length: int, x: str, window: str) -> str:
    """Write a window [B, N, I] with x [B, I] appended and the oldest left out."""
    newest = w.op("Unsqueeze", x, w.constant([1]))
    if length == 1:
        return newest
    newer = w.op("Slice", window, w.constant([1]), w.constant([length]), w.constant([1]))
    return w.op("Concat", newer, newest, axis=1)


def rest_window(w: OnnxWriter, length: int, x: str) -> str:
    """Write a window [B, N, I] filled with x [B, I]."""
    newest = w.op("Unsqueeze", x, w.constant([1]))
    return w.op("Tile", newest, w.constant([1, length, 1]))


def rest_gru(w: OnnxWriter, node: IntegerGruLayer, values: Names) -> dict[str, str]:
    """Write h = 0, or a window filled with the present features."""
    x = values[node.inputs[0]]
    if node.window:
        return {"window": rest_window(w, node.window, x)}
    return {"h_q30": write_zeros(w, x, node.gru.hidden)}


def settle_gru(w: OnnxWriter, node: IntegerGruLayer, values: Names) -> dict[str, str]:
    """Write the state at rest under the present features."""
    if node.window:
        return rest_gru(w, node, values)
    return {"h_q30": write_relaxed(w, node.gru, values[node.inputs[0]])}


def write_relaxed(w: OnnxWriter, gru: IntegerGru, x: str) -> str:
    """Write the state of a GRU at rest under constant features x [B, I]."""
    half = w.constant(U_RELAX_Q31)
    return w.repeat(
        RELAX_STEPS,
        lambda carried: [write_gru_step(w, gru, x, carried[0], half)],
        [(write_zeros(w, x, gru.hidden), ("B", gru.hidden))],
    )[0]


def write_stack_step(
    w: OnnxWriter, layers: Sequence[IntegerGru], x: str, states: Sequence[str]
) -> list[str]:
    """Write a step of every layer, each on the state of the one below."""
    after = []
    for layer, h_q30 in zip(layers, states, strict=True):
        after.append(write_gru_step(w, layer, x, h_q30))
        x = w.round_shift(after[-1], COPY_BITS)
    return after


def _join_lower(w: OnnxWriter, states: Sequence[str]) -> dict[str, str]:
    """Write the state of a stack from its layers' states."""
    *lower, top = states
    return {"h_q30": top, "lower_q30": w.op("Concat", *lower, axis=1)}


def step_gru_stack(w: OnnxWriter, node: IntegerGruStack, values: Names, state: Names) -> Any:
    """Write a step in time of all layers, or the whole window from h = 0."""
    x = values[node.inputs[0]]
    if not node.window:
        lower = w.split(state["lower_q30"], [layer.hidden for layer in node.lower])
        states = write_stack_step(w, node.layers, x, [*lower, state["h_q30"]])
        return _join_lower(w, states), states[-1]
    window = move_window(w, node.window, x, state["window"])
    widths = [layer.hidden for layer in node.layers]
    states = w.scan(
        lambda carried, slices: (write_stack_step(w, node.layers, slices[0], carried), []),
        [(write_zeros(w, x, width), ("B", width)) for width in widths],
        [(w.op("Transpose", window, perm=[1, 0, 2]), ("B", node.lower[0].inputs))],
        [],
    )
    return {"window": window}, states[-1]


def rest_gru_stack(w: OnnxWriter, node: IntegerGruStack, values: Names) -> dict[str, str]:
    """Write all h = 0, or a window filled with the present features."""
    x = values[node.inputs[0]]
    if node.window:
        return {"window": rest_window(w, node.window, x)}
    return _join_lower(w, [write_zeros(w, x, layer.hidden) for layer in node.layers])


def settle_gru_stack(w: OnnxWriter, node: IntegerGruStack, values: Names) -> dict[str, str]:
    """Write the states at rest under the present features, from the bottom up."""
    if node.window:
        return rest_gru_stack(w, node, values)
    x, states = values[node.inputs[0]], []
    for layer in node.layers:
        states.append(write_relaxed(w, layer, x))
        x = w.round_shift(states[-1], COPY_BITS)
    return _join_lower(w, states)


def step_dense(w: OnnxWriter, node: IntegerDense, values: Names, _: Names) -> Any:
    """Write activation((bias + weights . x) >> shift), 15 fractional bits added."""
    x = values[node.inputs[0]]
    if not isinstance(node, IntegerFeatureDense):
        x = w.round_shift(x, COPY_BITS)
    total = w.op("MatMul", x, w.constant(table(node.weights.T)))
    scaled = w.floor_shift(w.add(total, w.constant(table(node.bias))), node.shift)
    if node.activation == "tanh":
        return {}, write_tanh(w, scaled)
    return {}, w.shift_left(w.saturate(scaled, node.low, node.high), COPY_BITS)


def step_head(w: OnnxWriter, node: IntegerHead, values: Names, _: Names) -> Any:
    """Write weights . round_shift(h_q30, 15)."""
    h_q15 = w.round_shift(values[node.inputs[0]], 15)
    return {}, w.op("MatMul", h_q15, w.constant(table(node.weights.T)))


def write_drift_sum(w: OnnxWriter, node: IntegerDrift, values: Names) -> str:
    """Write the drift [B, K] before it is limited."""
    terms = []
    if node.signals:
        signals = w.stack([values[name] for name in node.signals])
        terms.append(w.op("MatMul", signals, w.constant(table(node.coefficients.T))))
    if node.head:
        terms.append(w.mul(values[node.inputs[-1]], w.constant(table(node.head_coefficients))))
    total = w.constant(table(node.bias))
    for term in terms:
        total = w.add(total, term)
    return w.floor_shift(total, node.shift)


def step_drift(w: OnnxWriter, node: IntegerDrift, values: Names, _: Names) -> Any:
    """Write the drift, limited."""
    return {}, w.saturate(write_drift_sum(w, node, values), node.low, node.high)


STEPS: dict[str, Step] = {
    "input": step_input,
    "load": step_load,
    "counter": step_counter,
    "sum": step_sum,
    "power": step_power,
    "exp2": step_exp2,
    "play": step_play,
    "clip": step_clip,
    "offset": step_offset,
    "difference": step_difference,
    "product": step_product,
    "lowpass": step_lowpass,
    "delay": step_delay,
    "features": step_features,
    "gru": step_gru,
    "gru_stack": step_gru_stack,
    "dense": step_dense,
    "feature_dense": step_dense,
    "head": step_head,
    "drift": step_drift,
}
RESTS: dict[str, Rest] = {
    "lowpass": rest_lowpass,
    "delay": rest_delay,
    "play": rest_play,
    "counter": rest_counter,
    "gru": rest_gru,
    "gru_stack": rest_gru_stack,
}
"""State after `init` and the first input; kinds without an entry have no state."""
SETTLES: dict[str, Rest] = {"gru": settle_gru, "gru_stack": settle_gru_stack}
"""State after `settle`, where it is another."""
