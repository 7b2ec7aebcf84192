"""Training in the chip's arithmetic: the same bits as the reference, and gradients that help."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fixed_point.strategies import shapes
from tests.golden.model_factory import Draw, Shape, draw_float_model
from tests.train.one_at_a_time import Cell, step_gru
from torch import Tensor

from zerodrift.base.arrays import IntArray
from zerodrift.export.fine_tune import build_integer_network
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.onnx_reader import read_imported_bytes
from zerodrift.export.quantize import choose_feature_exponents, quantize_graph
from zerodrift.export.quantize_layers import quantize_gru, quantize_grus
from zerodrift.export.reference import Reference
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.train.integer_network import IntegerGruNetwork, Tuning, fine_tune
from zerodrift.train.onnx_export import build_onnx
from zerodrift.train.recurrence import GruWeights, run_gru
from zerodrift.train.sequences import Sequence32

EXPONENTS = np.array([13, 13, 14, 12])


def as_stored(gru: FloatGru) -> FloatGru:
    """Return weights as a network's file holds them, in 32 bits."""
    parts = {name: getattr(gru, name).astype(np.float32) for name in ("w_x", "w_h", "bias")}
    return FloatGru(**{k: v.astype(np.float64) for k, v in parts.items()}, reset=gru.reset)


def make_network(shape: Shape, seed: int, exponents: IntArray) -> IntegerGruNetwork:
    model, calibration = draw_float_model(shape, seed)
    assert model.network is not None
    rounded = quantize_graph(model, calibration)
    return build_integer_network(model.network, rounded, exponents, np.ones(shape.outputs))


@pytest.mark.long
@settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(shape=shapes(most_hidden=12, most_outputs=4), seed=st.integers(0, 2**31))
def test_forward_pass_is_the_reference_bit_for_bit(shape: Shape, seed: int) -> None:
    """Every state and every output sum, from the state at rest (or of each window) on."""
    shape = replace(shape, hidden=max(shape.hidden, 1))
    float_model, calibration = draw_float_model(shape, seed)
    assert float_model.network is not None
    network = float_model.network
    stored = network.replace_grus(list(map(as_stored, network.grus)))
    rounded = quantize_graph(replace(float_model, network=stored), calibration, "int8")
    model, exponents = rounded.model, choose_feature_exponents(calibration)
    network = build_integer_network(stored, rounded, exponents, np.ones(shape.outputs))
    codes = Draw(seed + 1).codes(-32768, 32767, 2, 40, len(model.channels))
    seen: list[dict[str, IntArray]] = []
    Reference(model).run(codes, observe=lambda _, values: seen.append(dict(values)))
    x = np.stack([v["features"] for v in seen]).astype(np.float32)  # [T, B, I]
    features = torch.from_numpy(np.ascontiguousarray(x.transpose(0, 2, 1)))
    with torch.no_grad():
        if shape.window:
            padded = torch.cat([features[:1].expand(shape.window - 1, -1, -1), features])
            parts = [padded[t : t + shape.window] for t in range(len(features))]
            runs = [network(part, network.cold(2)) for part in parts]
            drift = torch.stack([d[-1] for d, _ in runs])
            states = torch.stack([h[-1] for _, h in runs])
        else:
            drift, states = network(features, network.rest(features[0]))
    h_q30 = (states.numpy() * 2.0**30).transpose(0, 2, 1)
    top = np.stack([v["gru"] for v in seen])
    assert np.array_equal(h_q30[:, :, -top.shape[2] :], top)
    sums = drift.numpy().transpose(0, 2, 1) / network.head.scale
    assert np.array_equal(np.round(sums), np.stack([v["head"] for v in seen]))
    assert np.abs(sums - np.round(sums)).max() < 1e-3


@pytest.mark.parametrize("reset", ["after", "before"])
def test_gradient_is_that_of_the_float_cell(reset: str) -> None:
    """With weights that lose little to rounding both gradients agree; both are checked by hand."""
    shape = Shape(inputs=4, hidden=5, outputs=2, reset=reset)
    network = make_network(shape, 5, EXPONENTS)
    network._quantize = lambda layers: quantize_grus(layers, EXPONENTS, "int16")
    counts = Draw(6).codes(-9000, 9000, 20, 4, 3).astype(np.float32)
    x = torch.from_numpy(counts)
    drift, _ = network(x, network.cold(3))
    drift.square().mean().backward()
    floats = [
        w.detach().clone().requires_grad_()
        for w in (network.w_x[0], network.w_h[0], network.bias[0])
    ]
    w_x, w_h, bias = (w[None] for w in floats)
    real = x * torch.from_numpy(2.0**-EXPONENTS).float()[:, None]
    weights = GruWeights(w_x.flatten(1, 2), w_h.flatten(1, 2), bias, reset)
    states = run_gru(real[:, None], torch.zeros(1, 5, 3), weights)[:, 0]
    head = torch.from_numpy(network.head.rows * network.head.scale[:, None] * 2**15).float()
    torch.matmul(head, states).square().mean().backward()
    for mine, other in zip((network.w_x[0], network.w_h[0], network.bias[0]), floats, strict=True):
        assert mine.grad is not None and other.grad is not None
        scale = other.grad.abs().max()
        assert (mine.grad - other.grad).abs().max() < 0.01 * scale


def run_floats(network: FloatNetwork, layers: list[list[Tensor]], x: Tensor) -> Tensor:
    """Return the answers [T, K, B] of stacked layers, reset after, from zero, by autograd."""
    for w_x, w_h, bias in layers:
        h = torch.zeros(x.shape[2], w_h.shape[1], dtype=torch.float64)
        states = []
        for now in x:
            h = step_gru(Cell(w_x, w_h, bias, "after"), now.T, h)
            states.append(h.T)
        x = torch.stack(states)
    for layer in (n.cell for n in network.layers[len(network.grus) :]):
        total = torch.from_numpy(layer.weight) @ x + torch.from_numpy(layer.bias)[:, None]
        x = torch.tanh(total) if layer.activation == "tanh" else total.clamp(layer.low, layer.high)
    return torch.from_numpy(network.head) @ x


def test_gradient_goes_through_stacked_and_dense_layers() -> None:
    """It is that of PyTorch on the float network, down to the weights of the lowest layer."""
    shape = Shape(inputs=4, hidden=5, outputs=2, upper=(4,), dense=((6, "tanh"), (5, "relu6")))
    model, calibration = draw_float_model(shape, 5)
    assert model.network is not None
    rounded = quantize_graph(model, calibration)
    network = build_integer_network(model.network, rounded, EXPONENTS, np.ones(2))
    network._quantize = lambda layers: quantize_grus(layers, EXPONENTS, "int16")
    x = torch.from_numpy(Draw(6).codes(-9000, 9000, 20, 4, 3).astype(np.float32))
    drift, _ = network(x, network.cold(3))
    drift.square().mean().backward()
    mine = [list(layer) for layer in zip(network.w_x, network.w_h, network.bias, strict=True)]
    floats = [[w.detach().double().requires_grad_() for w in layer] for layer in mine]
    answers = run_floats(
        model.network, floats, x.double() * torch.from_numpy(2.0**-EXPONENTS)[:, None]
    )
    answers.square().mean().backward()
    assert (answers - drift).abs().max() < 2e-3 * answers.abs().max()
    for layer, other in zip(mine, floats, strict=True):
        for weight, wanted in zip(layer, other, strict=True):
            assert weight.grad is not None and wanted.grad is not None
            scale = wanted.grad.abs().max()
            assert scale > 0 and (weight.grad - wanted.grad).abs().max() < 0.01 * scale


def make_problem(reset: str, memory: str | int) -> tuple[IntegerGruNetwork, list[Sequence32]]:
    """Return an 8-bit network and, as targets, what its float form answers."""
    shape = Shape(inputs=4, hidden=6, outputs=2, reset=reset, update_bias=-1.0)
    model, calibration = draw_float_model(shape, 11)
    assert model.network is not None
    (gru,) = model.network.grus
    rounded = quantize_graph(model, calibration)
    walk = Draw(3).uniform(-600.0, 600.0, 3, 200, 4).cumsum(axis=1)
    sequences = []
    for counts in np.clip(np.round(walk), -30000, 30000):
        x = counts * 2.0**-EXPONENTS
        if memory == "stream":
            h, states = gru.settle(x[:1]), []
            for row in x:
                h = gru.step(row[None], h)
                states.append(h[0])
            found = np.stack(states)
        else:
            padded = np.concatenate([np.repeat(x[:1], int(memory) - 1, axis=0), x])
            found = np.zeros((len(x), 6))
            for k in range(int(memory)):
                found = gru.step(padded[k : k + len(x)], found)
        target = found @ model.network.head.T
        sequences.append(Sequence32("a", counts.astype(np.float32), target.astype(np.float32)))
    size = np.sqrt(np.mean(np.concatenate([s.target for s in sequences]) ** 2, axis=0))
    scaled = [Sequence32("a", s.features, (s.target / size).astype(np.float32)) for s in sequences]
    size = size.astype(np.float64)
    return build_integer_network(model.network, rounded, EXPONENTS, size), scaled


@pytest.mark.spread(0, ("reset", "memory"), [("after", "stream"), ("before", 6)])
def test_fine_tuning_brings_8_bit_weights_nearer_to_the_float_network(
    reset: str, memory: str | int
) -> None:
    short = Tuning(epochs=12, batch=8, evaluations=6)
    results = []
    for _ in range(2):
        network, sequences = make_problem(reset, memory)
        results.append(fine_tune(network, sequences, memory, short))
    first, second = results
    assert first.epoch > 0 and first.after < 0.8 * first.before
    for name in ("w_x", "w_h", "bias"):  # and the same again to the bit
        assert np.array_equal(getattr(first.layers[0], name), getattr(second.layers[0], name))


def test_weights_kept_are_those_that_the_chip_gets() -> None:
    """Through the network's file and the quantizer: the answers measured in training come back."""
    network, sequences = make_problem("after", "stream")
    tuned = fine_tune(network, sequences, "stream", Tuning(epochs=2, evaluations=1))
    content = build_onnx(tuned.layers[0], np.ones((2, 6)), np.zeros(2), ["a", "b"])
    (read,) = read_imported_bytes(content, "test").network.grus
    again = quantize_gru(read, EXPONENTS, "int8")
    expected = quantize_gru(tuned.layers[0], EXPONENTS, "int8")
    for name in ("w_x", "w_h", "bias", "multiplier"):
        assert np.array_equal(getattr(again, name), getattr(expected, name)), name
    assert (again.shift, again.multiplier_shift) == (expected.shift, expected.multiplier_shift)


def test_nothing_is_changed_where_nothing_can_be_gained() -> None:
    network, sequences = make_problem("after", "stream")
    own = []
    for s in sequences:
        x = torch.from_numpy(s.features)[:, :, None]
        with torch.no_grad():
            drift, _ = network(x, network.rest(x[0]))
        own.append(Sequence32(s.group, s.features, drift[..., 0].numpy().astype(np.float32)))
    (first,) = network.to_float()
    tuned = fine_tune(network, own, "stream", Tuning(epochs=2, evaluations=2))
    assert tuned.before < 1e-6 and tuned.epoch == 0
    assert np.array_equal(tuned.layers[0].w_h, first.w_h)
