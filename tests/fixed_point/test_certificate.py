"""Nothing that a model computes ever leaves what its certificate proves, rails included."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fixed_point.strategies import shapes
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.errors import CheckError
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.clock import IntegerCounter
from zerodrift.operations.exp2 import OCTAVE_Q29, IntegerExp2
from zerodrift.operations.gru import H_LIMIT_Q30, IntegerGru
from zerodrift.operations.intervals import Interval
from zerodrift.operations.network import IntegerDrift, IntegerFeatures, IntegerGruLayer
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.power import IntegerPower
from zerodrift.operations.signal import IntegerDelay, IntegerLowpass, IntegerProduct
from zerodrift.operations.tables import sigmoid_q31
from zerodrift.operations.total import IntegerSum
from zerodrift.verify.vectors import draw_sequences

Array = np.ndarray[tuple[int, ...], np.dtype[np.int64]]


def observe(model: IntegerModel, steps: int) -> list[tuple[dict[str, Array], dict[str, Array]]]:
    """Return every node's value and state-before at each step of noise, rails, jumps and a walk."""
    sequences = draw_sequences(model, steps)
    length = min(map(len, sequences.values()))
    codes = np.stack([codes[:length] for codes in sequences.values()]).astype(np.int64)
    reference = Reference(model)
    state = reference.start(codes[:, 0], settled=False)
    seen = []
    for t in range(length):
        before = {f"{n}.{k}": v for n, s in state.nodes.items() for k, v in s.items()}
        state, values, _, _ = reference.step(state, codes[:, t])
        seen.append((dict(values), before))
    return seen


def recompute_gru(gru: IntegerGru, name: str, x: Array, h_q30: Array) -> dict[str, Array]:
    """Return every accumulator of a GRU step, in plain int64 arithmetic, by its certificate name.

    Written from the specification, apart from the code that it watches.
    """
    out: dict[str, Array] = {}
    h_q15 = (h_q30 + 2**14) >> 15
    assert np.abs(h_q15).max() <= 32767
    bias = gru.bias.astype(np.int64)

    def recurrent(gate: int, letter: str, vector: Array) -> Array:
        product = vector @ gru.w_h[gate].astype(np.int64).T
        if gru.multiplier is None:
            return product
        shift = gru.multiplier_shift[gate]
        scaled = product * gru.multiplier[gate] + (1 << shift >> 1)
        for j in range(gru.hidden):
            out[f"{name}.{letter}[{j}].product"] = product[:, j]
            out[f"{name}.{letter}[{j}].scaled"] = scaled[:, j]
        return scaled >> shift

    def from_x(gate: int) -> Array:
        return x @ gru.w_x[gate].astype(np.int64).T

    a_r = bias[0] + from_x(0) + recurrent(0, "r", h_q15)
    a_u = bias[1] + from_x(1) + recurrent(1, "u", h_q15)
    r_q31 = sigmoid_q31(a_r >> gru.shift[0]).astype(np.int64)
    if gru.reset == "after":
        inside = bias[3] + recurrent(2, "n", h_q15)
        a_n = bias[2] + from_x(2) + ((inside * r_q31 + 2**31) >> 32)
        for j in range(gru.hidden):
            out[f"{name}.n[{j}].inside"] = inside[:, j]
    else:
        a_n = bias[2] + from_x(2) + recurrent(2, "n", (h_q30 * r_q31 + 2**45) >> 46)
    for letter, accumulator in (("r", a_r), ("u", a_u), ("n", a_n)):
        for j in range(gru.hidden):
            out[f"{name}.{letter}[{j}]"] = accumulator[:, j]
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


def recompute(
    model: IntegerModel, values: dict[str, Array], before: dict[str, Array]
) -> dict[str, Array]:
    """Return the accumulators of one step by their names in the certificate."""
    out: dict[str, Array] = {}
    for node in model.nodes:
        inputs = [values[name] for name in node.inputs]
        match node:
            case IntegerProduct():
                out[f"{node.name}.product"] = inputs[0] * inputs[1] + (1 << node.shift >> 1)
            case IntegerLowpass():
                v = before[f"{node.name}.v"]
                y = v + inputs[0] * node.c_q24
                gap = (inputs[0] * 2**24 - y + 2**21) >> 22
                out |= {
                    f"{node.name}.v": v,
                    f"{node.name}.y": y,
                    f"{node.name}.gap": gap,
                    f"{node.name}.scaled": gap * node.m_q31 + (1 << node.shift >> 1),
                }
            case IntegerSum():
                row = np.array(node.coefficients)
                out[f"{node.name}.sum"] = np.stack(inputs, 1) @ row + node.bias
            case IntegerExp2():
                total = inputs[0] * node.coefficient + node.bias
                t = np.clip(total >> node.shift, node.low, node.high)
                out |= {f"{node.name}.sum": total, f"{node.name}.exponent": t}
                out |= recompute_polynomial(node.name, (t % 2**24) * 2**7, OCTAVE_Q29)
            case IntegerPower():
                x = np.maximum(inputs[0], 1)
                n = np.array([int(v).bit_length() - 1 for v in x])
                terms = recompute_polynomial(node.name, (x << (31 - n)) - 2**31, node.octave)
                m = np.clip(terms[f"{node.name}.degree_0"], node.low, node.high)
                gain = np.array(node.gains)[n]
                out |= terms
                out |= {
                    f"{node.name}.octaves": n,
                    f"{node.name}.mantissa": m,
                    f"{node.name}.gain": gain,
                    f"{node.name}.product": m * gain + (1 << node.shift >> 1),
                }
            case IntegerPlay():
                out |= {
                    f"{node.name}.slack": np.concatenate(
                        [inputs[0] - node.half_width, inputs[0] + node.half_width]
                    ),
                    f"{node.name}.y": before[f"{node.name}.y"],
                }
            case IntegerDelay():
                line = np.concatenate([before[f"{node.name}.line"], inputs[0][:, None]], axis=1)
                rise = (line[:, 1] - line[:, 0]) * node.newer_q31 + 2**30
                out |= {f"{node.name}.line": line.ravel(), f"{node.name}.rise": rise}
            case IntegerCounter():
                out[f"{node.name}.count"] = before[f"{node.name}.count"] + 1
            case IntegerFeatures():
                sums = np.stack(inputs, 1) @ node.matrix.astype(np.int64).T + node.bias
                out |= {f"{node.name}[{i}]": sums[:, i] for i in range(node.width)}
            case IntegerGruLayer() if not node.window:
                h_q30 = before[f"{node.name}.h_q30"]
                out |= recompute_gru(node.gru, node.name, inputs[0], h_q30)
            case IntegerDrift():
                sums = node.bias + np.zeros((len(inputs[0]), 1), dtype=np.int64)
                for j in range(len(node.signals)):
                    sums = sums + inputs[j][:, None] * node.coefficients[:, j]
                if node.head:
                    sums = sums + inputs[-1] * node.head_coefficients
                out |= {f"{node.name}[{k}]": sums[:, k] for k in range(node.width)}
            case _:
                pass
    return out


def prove_values(model: IntegerModel) -> dict[str, list[Interval]]:
    """Return each node's proven output intervals."""
    known: dict[str, list[Interval]] = {}
    for node in model.nodes:
        known[node.name], _ = node.prove([known[name] for name in node.inputs])
    return known


@settings(
    max_examples=30,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(shape=shapes(most_hidden=12, most_outputs=4), seed=st.integers(0, 2**31))
def test_nothing_leaves_its_proven_interval(shape: Shape, seed: int) -> None:
    model = draw_model(replace(shape, upper=(), dense=()), seed)  # those: tests/certificate
    bounds = {bound.where: bound.interval for bound in model.prove()}
    intervals = prove_values(model)
    for values, before in observe(model, steps=300):
        for node in model.nodes:
            columns = values[node.name].reshape(len(values[node.name]), -1)
            for column, interval in zip(columns.T, intervals[node.name], strict=True):
                assert interval.low <= column.min() and column.max() <= interval.high, node.name
        for where, accumulator in recompute(model, values, before).items():
            bound = bounds[where]
            assert bound.low <= accumulator.min() and accumulator.max() <= bound.high, where


def test_feature_bounds_are_reached() -> None:
    """A bound that is never near would be no proof of anything but caution."""
    model = draw_model(Shape(inputs=4, hidden=3), 3)
    features = next(n for n in model.nodes if isinstance(n, IntegerFeatures))
    bounds = {bound.where: bound.interval for bound in model.prove()}
    for i in range(features.width):
        toward_high = features.matrix[i].astype(np.int64) > 0
        codes = np.where(toward_high, 32767, -32768)[None] << 12
        reached = int((codes @ features.matrix[i].astype(np.int64))[0] + features.bias[i])
        assert reached <= bounds[f"features[{i}]"].high
        assert reached > 0.9 * bounds[f"features[{i}]"].high


@pytest.mark.parametrize("reset", ["after", "before"])
def test_state_reaches_its_limit_and_stays_there(reset: str) -> None:
    model = draw_model(Shape(reset=reset, hidden=6, gain=60.0), 4)
    layer = model.recurrent
    assert layer is not None
    largest = 0
    h_q30 = np.zeros((64, 6), dtype=np.int64)
    draw = Draw(9)
    for _ in range(400):
        x = np.where(draw.uniform(0.0, 1.0, 64, 4) < 0.5, -32768, 32767)
        h_q30 = layer.gru.step(x, h_q30)
        largest = max(largest, int(np.abs(h_q30).max()))
    assert H_LIMIT_Q30 - 2 <= largest <= H_LIMIT_Q30


def test_every_state_within_the_invariant_stays_within() -> None:
    """The induction step itself, from states that no run would visit."""
    rng = np.random.default_rng(5)
    for weights in ("int16", "int8"):
        layer = draw_model(Shape(weights=weights, hidden=8, gain=60.0), 6).recurrent
        assert layer is not None
        h_q30 = rng.choice([-H_LIMIT_Q30, -H_LIMIT_Q30 + 1, -1, 0, 1, H_LIMIT_Q30], size=(5000, 8))
        x = rng.choice([-32768, 0, 32767], size=(5000, 4))
        assert np.abs(layer.gru.step(x, h_q30)).max() <= H_LIMIT_Q30


def test_damaged_lowpass_within_its_invariant_stays_within() -> None:
    """Any v that the soundness check admits keeps v and y where the certificate says."""
    model = draw_model(Shape(inputs=1, hidden=0, outputs=1, front_end=("lowpass",)), 2)
    node = next(n for n in model.nodes if isinstance(n, IntegerLowpass))
    bounds = {bound.where: bound.interval for bound in model.prove()}
    allowed, out = bounds[f"{node.name}.v"], bounds[node.name]
    for v in (allowed.low, allowed.high, 0):
        for x in (-32768 << 12, 32767 << 12):
            state, y = node.step({"v": np.array([v])}, {node.inputs[0]: np.array([x])})
            assert out.low <= y[0] <= out.high
            assert allowed.low <= state["v"][0] <= allowed.high


@pytest.mark.parametrize(
    "fields", [{"c_q24": -1}, {"c_q24": 2**24 + 1}, {"m_q31": 0}, {"m_q31": -5}, {"shift": 8}]
)
def test_lowpass_that_is_none_is_refused(fields: dict[str, int]) -> None:
    node = IntegerLowpass("f", ("x",), c_q24=1000, m_q31=2**30 + 2**29, shift=9)
    node.prove([[Interval(-1000, 1000)]])
    with pytest.raises(CheckError, match=r"f: c = .*refused"):
        replace(node, **fields).prove([[Interval(-1000, 1000)]])


@pytest.mark.parametrize("shift", [-1, 32])
def test_shift_that_c_leaves_undefined_is_refused(shift: int) -> None:
    layer = draw_model(Shape(hidden=2), 9).recurrent
    assert layer is not None
    bad = replace(layer.gru, shift=(layer.gru.shift[0], shift, layer.gru.shift[2]))
    with pytest.raises(CheckError, match=rf"gru\.u: a shift by {shift} bits"):
        bad.prove("gru", [Interval(-1, 1)] * 4)
    with pytest.raises(CheckError, match="p: a shift by 63 bits"):
        IntegerProduct("p", ("a", "b"), shift=63).prove([[Interval(0, 1)], [Interval(0, 1)]])


def test_delay_longer_than_its_ring_is_refused() -> None:
    IntegerDelay("d", ("x",), steps=32767).prove([[Interval(0, 1)]])
    with pytest.raises(CheckError, match=r"d\.steps"):
        IntegerDelay("d", ("x",), steps=70_000).prove([[Interval(0, 1)]])


@pytest.mark.parametrize("weights", ["int16", "int8"])
@pytest.mark.parametrize("reset", ["after", "before"])
def test_weights_scaled_beyond_the_proof_are_refused(weights: str, reset: str) -> None:
    """The certificate looks at the integers: doubling a row that fits must be noticed."""
    layer = draw_model(Shape(weights=weights, reset=reset, hidden=64, inputs=8), 8).recurrent
    assert layer is not None
    loud = replace(layer.gru, w_x=np.full_like(layer.gru.w_x, 32767))
    with pytest.raises(CheckError, match=r"does not fit 32 bits"):
        loud.prove("gru", [Interval(-32768, 32767)] * 8)
