"""What training promises: the same weights for the same seed, and an ONNX file that holds them."""

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray

from zerodrift.base.config import NetworkConfig
from zerodrift.export.onnx_reader import read_imported_bytes
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.train.attempts import Problem
from zerodrift.train.engine import Result, train_networks
from zerodrift.train.networks import build_network
from zerodrift.train.onnx_export import build_onnx
from zerodrift.train.sequences import Sequence32
from zerodrift.train.settings import Settings

FEATURES, OUTPUTS = 2, 3


def make_sequences(count: int, seed: int) -> list[Sequence32]:
    """Runs whose target is a saturating function of a slow memory of the first feature."""
    rng = np.random.default_rng(seed)
    sequences = []
    for i in range(count):
        x = np.cumsum(rng.normal(size=(300, FEATURES)), axis=0) / 10.0
        memory = np.zeros(300)
        for t in range(1, 300):
            memory[t] = memory[t - 1] + 0.05 * (x[t, 0] - memory[t - 1])
        target = np.tanh(np.outer(memory, [1.0, -0.5, 2.0]))
        sequences.append(Sequence32(f"run{i}", x.astype(np.float32), target.astype(np.float32), 0))
    return sequences


def train(memory: str | int, form: str) -> Result:
    config = NetworkConfig(kind="gru", hidden=4, memory=memory, options={"form": form})
    settings = Settings(memory=memory, seed=7, starts=(0, 1), epochs=6, chunk=50, batch=4)
    problem = Problem(
        lambda generator: build_network(config, FEATURES, OUTPUTS, generator),
        make_sequences(3, 1),
        make_sequences(1, 2),
        settings,
    )
    (result,) = train_networks([problem])
    assert isinstance(result, Result)
    return result


def assert_same_weights(a: Result, b: Result) -> None:
    assert (a.start, a.epoch) == (b.start, b.epoch)
    assert a.weights.keys() == b.weights.keys()
    for name, value in a.weights.items():
        assert np.array_equal(value, b.weights[name]), name


@pytest.mark.parametrize("form", ["reset_after", "reset_before"])
@pytest.mark.spread(1, "memory", ["stream", 5])
def test_same_seed_gives_the_same_weights_to_the_bit(memory: str | int, form: str) -> None:
    first, second = train(memory, form), train(memory, form)
    assert_same_weights(first, second)
    assert first.rmse < first.rmse_without


def random_gru(reset: str, seed: int) -> FloatGru:
    rng = np.random.default_rng(seed)
    bias = rng.normal(size=(4, 6)).astype(np.float32).astype(np.float64)
    if reset == "before":
        bias[3] = 0.0
    return FloatGru(
        w_x=rng.normal(size=(3, 6, FEATURES)).astype(np.float32).astype(np.float64),
        w_h=(rng.normal(size=(3, 6, 6)) / 2.0).astype(np.float32).astype(np.float64),
        bias=bias,
        reset=reset,
    )


def run_torch(gru: FloatGru, x: NDArray[np.float64], h: NDArray[np.float64]) -> NDArray[np.float64]:
    """PyTorch's own GRU (reset after) with these weights; its gates stand in the order r, z, n."""
    module = torch.nn.GRU(x.shape[2], h.shape[1]).double()
    sign = np.array([1.0, -1.0, 1.0])[:, None]  # PyTorch keeps z = 1 - u
    with torch.no_grad():
        module.weight_ih_l0.copy_(torch.from_numpy((sign[..., None] * gru.w_x).reshape(18, -1)))
        module.weight_hh_l0.copy_(torch.from_numpy((sign[..., None] * gru.w_h).reshape(18, -1)))
        module.bias_ih_l0.copy_(torch.from_numpy((sign * gru.bias[:3]).ravel()))
        inside = np.concatenate([np.zeros(12), gru.bias[3]])
        module.bias_hh_l0.copy_(torch.from_numpy(inside))
        states, _ = module(torch.from_numpy(x), torch.from_numpy(h)[None])
    return np.asarray(states.numpy())


@pytest.mark.parametrize("reset", ["after", "before"])
def test_float_onnx_equals_pytorch_within_1e_5(reset: str) -> None:
    gru = random_gru(reset, 3)
    rng = np.random.default_rng(4)
    head, head_bias = rng.normal(size=(OUTPUTS, 6)) * 100.0, rng.normal(size=OUTPUTS)
    content = build_onnx(gru, head, head_bias, ["a", "b", "c"])
    x, h = rng.normal(size=(80, 5, FEATURES)), rng.normal(size=(5, 6)) / 3.0
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    feed = {"features": x.astype(np.float32), "initial_h": h[None].astype(np.float32)}
    drift, hidden = session.run(["drift", "hidden"], feed)
    if reset == "after":
        expected = run_torch(gru, x, h)
    else:  # PyTorch has no GRU with the reset before the product; the paper's equations stand in
        states, now = [], h
        for t in range(len(x)):
            now = gru.step(x[t], now)
            states.append(now)
        expected = np.stack(states)
    assert np.abs(hidden - expected).max() < 1e-5
    wanted = expected @ head.T + head_bias
    assert np.abs(drift - wanted).max() < 1e-5 * np.abs(wanted).max()


@pytest.mark.parametrize("reset", ["after", "before"])
def test_onnx_written_and_read_again_is_the_same_network(reset: str) -> None:
    gru = random_gru(reset, 5)
    head, head_bias = np.ones((OUTPUTS, 6)), np.arange(3.0)
    content = build_onnx(gru, head, head_bias, ["a", "b", "c"])
    assert content == build_onnx(gru, head, head_bias, ["a", "b", "c"])
    network = read_imported_bytes(content, "test").network
    (read,) = network.grus
    assert read.reset == reset
    for name in ("w_x", "w_h", "bias"):
        assert np.array_equal(getattr(read, name), getattr(gru, name)), name
    assert np.array_equal(network.head, head)
    assert np.array_equal(network.head_bias, head_bias)
