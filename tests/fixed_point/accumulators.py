"""What every accumulator of a model holds while it runs, by the names of its certificate.

Written from the specification, in plain int64 arithmetic, apart from the code that it watches.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.export.integer_model import FLAG_NO_READING, IntegerModel
from zerodrift.export.reference import ModelState, Reference
from zerodrift.operations.arithmetic import CodeArray, round_shift, saturate
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.counter import IntegerCounter
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.dense import IntegerDense
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.exp2 import OCTAVE_Q29, IntegerExp2
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import GATES, IntegerGru
from zerodrift.operations.gru_stack import IntegerGruStack
from zerodrift.operations.head import IntegerHead
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.intervals import Interval
from zerodrift.operations.layer_norm import IntegerLayerNorm, invert_root, list_constants
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.power import IntegerPower
from zerodrift.operations.product import IntegerProduct
from zerodrift.operations.sum import IntegerSum
from zerodrift.verify.vectors import draw_sequences

Array = np.ndarray[tuple[int, ...], np.dtype[np.int64]]
Found = Iterator[tuple[str, Array]]
"""Name in the certificate, and all that was found there."""

CODES, DRIFT, STEPS = "codes", "drift before", "steps before"
"""Names of the raw codes, the drift and the count of the step before in `Record.before`."""


@dataclass(frozen=True)
class Record:
    """A run of the reference over B sequences of T steps; every array leads with T B rows."""

    drift: Array  # [B, T, K]
    flags: Array  # [B, T]
    values: dict[str, Array]
    """Every node's value."""
    before: dict[str, Array]
    """What each step found: NODE.FIELD of the state, the codes, the drift of the step before."""
    end: ModelState


def record(model: IntegerModel, codes: CodeArray, *, settled: bool) -> Record:
    """Run the reference over codes [B, T, C] and keep everything."""
    reference = Reference(model)
    wide = np.ascontiguousarray(codes.swapaxes(0, 1), dtype=np.int64)
    state = reference.start(wide[0], settled=settled)
    drifts, flags, values, before = [], [], [], []
    for now in wide:
        found = {f"{n}.{k}": v for n, s in state.nodes.items() for k, v in s.items()}
        before.append({**found, CODES: now, DRIFT: state.drift, STEPS: state.steps})
        state, value, drift, flag = reference.step(state, now)
        values.append({name: value[name] for name in state.nodes})
        drifts.append(drift)
        flags.append(flag)
    return Record(
        drift=np.stack(drifts, axis=1),
        flags=np.stack(flags, axis=1),
        values={k: np.concatenate([v[k] for v in values]) for k in values[0]},
        before={k: np.concatenate([b[k] for b in before]) for k in before[0]},
        end=state,
    )


def record_sequences(model: IntegerModel, steps: int) -> Record:
    """Run the reference, from cold, over noise, rails, jumps, a walk and a dwell."""
    sequences = draw_sequences(model, steps)
    length = min(map(len, sequences.values()))
    codes = np.stack([codes[:length] for codes in sequences.values()])
    return record(model, codes, settled=False)


def recompute_gru(gru: IntegerGru, name: str, x: Array, h_q30: Array) -> dict[str, Array]:
    """Return every accumulator of a GRU step from features x [B, I] and state h_q30 [B, H].

    What the gates are is the reference's; the sums that lead to them are added up here.
    """
    out: dict[str, Array] = {}
    gates = gru.gates(x, h_q30)
    after = gru.reset == "after"
    h_q15 = (h_q30 + 2**14) >> 15
    assert np.abs(h_q15).max() <= 32767
    for gate, letter in enumerate(GATES):
        vector = gates.product if letter == "n" and not after else h_q15
        total = vector @ gru.w_h[gate].astype(np.int64).T
        if gru.multiplier is not None:
            shift = gru.multiplier_shift[gate]
            scaled = total * gru.multiplier[gate] + (1 << shift >> 1)
            for j in range(gru.hidden):
                out[f"{name}.{letter}[{j}].product"] = total[:, j]
                out[f"{name}.{letter}[{j}].scaled"] = scaled[:, j]
            total = scaled >> shift
        if letter == "n" and after:
            inside = total + gru.bias[3]
            for j in range(gru.hidden):
                out[f"{name}.n[{j}].inside"] = inside[:, j]
            total = (inside * gates.r_q31.astype(np.int64) + 2**31) >> 32
        total = total + x @ gru.w_x[gate].astype(np.int64).T + gru.bias[gate]
        for j in range(gru.hidden):
            out[f"{name}.{letter}[{j}]"] = total[:, j]
    return out


def recompute_polynomial(
    name: str, f_q31: Array, coefficients: tuple[int, ...]
) -> dict[str, Array]:
    """Return every partial result of Horner's rule by its certificate name."""
    out: dict[str, Array] = {}
    total = np.zeros_like(f_q31)
    for degree in range(len(coefficients) - 1, -1, -1):
        total = coefficients[degree] + ((total * f_q31 + 2**30) >> 31)
        out[f"{name}.degree_{degree}"] = total
    return out


def drop_missing(seen: Record) -> Record:
    """Return a run without the steps that do not go on from the state and the codes they found.

    A step that lacks a reading works on the reading before; the first one of a cold state begins
    at rest under its own codes.
    """
    flags = seen.flags.swapaxes(0, 1).ravel()
    read = ((flags & FLAG_NO_READING) == 0) & (seen.before[STEPS] > 0)
    return replace(
        seen,
        flags=flags[read][None],
        values={name: found[read] for name, found in seen.values.items()},
        before={name: found[read] for name, found in seen.before.items()},
    )


def recompute(model: IntegerModel, seen: Record) -> Found:
    """Yield every accumulator of all steps by its name in the certificate; some more than once."""
    seen = drop_missing(seen)
    for node in model.nodes:
        inputs = [seen.values[name] for name in node.inputs]
        if not node.width and not isinstance(node, IntegerDelay | IntegerPlay | IntegerCounter):
            yield node.name, seen.values[node.name]
        match node:
            case IntegerInput():
                code = saturate(seen.before[CODES][:, node.channel], node.low, node.high)
                yield f"{node.name}.code", code - node.origin
            case IntegerLoad():
                found = seen.before[CODES][:, node.channel] - seen.before[DRIFT][:, node.output]
                yield f"{node.name}.difference", found
                yield f"{node.name}.limits", saturate(found, node.low, node.high)
            case IntegerClip():
                yield f"{node.name}.limits", seen.values[node.name]
            case IntegerProduct():
                yield f"{node.name}.product", inputs[0] * inputs[1] + (1 << node.shift >> 1)
            case IntegerLowpass():
                v = seen.before[f"{node.name}.v"]
                y = v + inputs[0] * node.c_q24
                gap = (inputs[0] * 2**24 - y + 2**21) >> 22
                yield f"{node.name}.v", v
                yield f"{node.name}.y", y
                yield f"{node.name}.gap", gap
                yield f"{node.name}.scaled", gap * node.m_q31 + (1 << node.shift >> 1)
            case IntegerSum():
                yield (
                    f"{node.name}.sum",
                    np.stack(inputs, 1) @ np.array(node.coefficients) + (node.bias),
                )
            case IntegerExp2():
                total = inputs[0] * node.coefficient + node.bias
                t = np.clip(total >> node.shift, node.low, node.high)
                yield f"{node.name}.sum", total
                yield f"{node.name}.exponent", t
                yield from recompute_polynomial(node.name, (t % 2**24) * 2**7, OCTAVE_Q29).items()
            case IntegerPower():
                yield from _recompute_power(node, inputs[0])
            case IntegerPlay():
                yield f"{node.name}.slack", inputs[0] - node.half_width
                yield f"{node.name}.slack", inputs[0] + node.half_width
                yield f"{node.name}.y", seen.before[f"{node.name}.y"]
            case IntegerDelay():
                line = np.concatenate([seen.before[f"{node.name}.line"], inputs[0][:, None]], 1)
                yield f"{node.name}.line", line
                yield f"{node.name}.rise", (line[:, 1] - line[:, 0]) * node.newer_q31 + 2**30
            case IntegerCounter():
                yield f"{node.name}.count", seen.before[f"{node.name}.count"] + 1
            case IntegerFeatures():
                sums = np.stack(inputs, 1) @ node.matrix.astype(np.int64).T + node.bias
                for i in range(node.width):
                    yield f"{node.name}[{i}]", sums[:, i]
            case IntegerGruLayer():
                yield from _recompute_layers(node, inputs[0], seen)
            case IntegerDense():
                copies = (inputs[0] + 2**14) >> 15
                sums = copies @ node.weights.astype(np.int64).T + node.bias
                for i in range(node.width):
                    yield f"{node.name}[{i}]", sums[:, i]
                    if node.activation == "clip":
                        yield f"{node.name}[{i}].limit", seen.values[node.name][:, i] >> 15
            case IntegerLayerNorm():
                yield from _recompute_norm(node, inputs[0])
            case IntegerHead():
                for k in range(node.width):
                    yield f"{node.name}[{k}]", seen.values[node.name][:, k]
            case IntegerDrift():
                sums = node.bias + np.zeros((len(seen.values[node.name]), 1), dtype=np.int64)
                for j in range(len(node.signals)):
                    sums = sums + inputs[j][:, None] * node.coefficients[:, j]
                if node.head:
                    sums = sums + inputs[-1] * node.head_coefficients
                for k in range(node.width):
                    yield f"{node.name}[{k}]", sums[:, k]
            case _:
                pass


def _recompute_norm(node: IntegerLayerNorm, given: Array) -> Found:
    reciprocal, mean_shift, root = list_constants(node.width)
    align, shift, name = np.array(node.align), np.array(node.shift), node.name
    raised = round_shift(given, 15) << 12
    v = (raised + (np.left_shift(1, align) >> 1)) >> align
    yield f"{name}.sum", np.cumsum(v, axis=1)
    scaled = v.sum(axis=1, keepdims=True) * reciprocal + (1 << mean_shift >> 1)
    yield f"{name}.mean", scaled
    d = v - (scaled >> mean_shift)
    yield f"{name}.difference", d
    squares = node.epsilon + (d * d).sum(axis=1, keepdims=True)
    yield f"{name}.squares", squares
    doublings = np.array([[(62 - int(w).bit_length()) // 2 * 2] for w in squares[:, 0]])
    scale = invert_root((squares << doublings) >> 32) * root >> 29
    yield f"{name}.scale", scale
    half = np.left_shift(1, 31 - doublings // 2) >> 1
    yield f"{name}.part", d * scale + half
    part = (d * scale + half) >> (31 - doublings // 2)
    product = part * node.gain.astype(np.int64) + (np.left_shift(1, shift) >> 1)
    y = (product >> shift) + node.bias
    for i in range(node.width):
        yield f"{name}[{i}].product", product[:, i]
        yield f"{name}[{i}]", y[:, i]
        yield f"{name}[{i}].copy", (y[:, i] + 2**14) >> 15


def _recompute_power(node: IntegerPower, given: Array) -> Found:
    x = np.maximum(given, 1)
    n = np.array([int(v).bit_length() - 1 for v in x])
    terms = recompute_polynomial(node.name, (x << (31 - n)) - 2**31, node.octave)
    m = np.clip(terms[f"{node.name}.degree_0"], node.low, node.high)
    gain = np.array(node.gains)[n]
    yield from terms.items()
    yield f"{node.name}.octaves", n
    yield f"{node.name}.mantissa", m
    yield f"{node.name}.gain", gain
    yield f"{node.name}.product", m * gain + (1 << node.shift >> 1)


def _recompute_layers(node: IntegerGruLayer, x: Array, seen: Record) -> Found:
    """Yield the accumulators of all layers, and of all steps of a window."""
    layers: tuple[IntegerGru, ...] = (node.gru,)
    names = [node.name]
    if isinstance(node, IntegerGruStack):
        layers = node.layers
        names = [f"{node.name}.{level}" for level in range(len(layers))]
    if node.window:
        window = np.concatenate([seen.before[f"{node.name}.window"][:, 1:], x[:, None]], axis=1)
        states = [np.zeros((len(x), layer.hidden), dtype=np.int64) for layer in layers]
        steps = [window[:, k] for k in range(node.window)]
    else:
        states, steps = [seen.before[f"{node.name}.h_q30"]], [x]
        if isinstance(node, IntegerGruStack):
            ends = np.cumsum([layer.hidden for layer in node.lower])
            states = [*np.split(seen.before[f"{node.name}.lower_q30"], ends[:-1], 1), *states]
    for features in steps:
        below = features
        for level, (layer, name) in enumerate(zip(layers, names, strict=True)):
            h_q30 = states[level]
            yield from recompute_gru(layer, name, below, h_q30).items()
            n_q30 = layer.gates(below, h_q30).n_q30.astype(np.int64)
            yield f"{name}.state_step", n_q30 - h_q30
            states[level] = layer.step(below, h_q30)
            below = (states[level] + 2**14) >> 15
    assert np.array_equal(states[-1], seen.values[node.name])


def prove_values(model: IntegerModel) -> dict[str, list[Interval]]:
    """Return each node's proven output intervals."""
    known: dict[str, list[Interval]] = {}
    for node in model.nodes:
        known[node.name], _ = node.prove([known[name] for name in node.inputs])
    return known
