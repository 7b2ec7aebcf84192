"""The LSTM that is trained here: PyTorch's own equations and gradients, and the way to the chip."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from click.testing import CliRunner
from tests.onnx.test_firmware_onnx import TOML

from zerodrift.base.config import NetworkConfig
from zerodrift.cli.main import cli
from zerodrift.export.model_files import load_model
from zerodrift.export.onnx_reader import read_imported_bytes
from zerodrift.operations.lstm import IntegerLstmLayer
from zerodrift.train.networks import LstmNetwork, build_network
from zerodrift.train.onnx_export import OnnxNetwork, build_lstm_onnx

HIDDEN = 5


def draw_network(seed: int = 1) -> LstmNetwork:
    generator = torch.Generator().manual_seed(seed)
    network = build_network(NetworkConfig(kind="lstm", hidden=HIDDEN), 3, 2, generator)
    assert isinstance(network, LstmNetwork)
    with torch.no_grad():
        for p in network.parameters():
            p.add_(torch.randn(p.shape, generator=generator) * 0.3)
    return network


def test_recurrence_and_gradients_are_those_of_torch() -> None:
    network = draw_network().double()
    theirs = torch.nn.LSTM(3, HIDDEN).double()
    with torch.no_grad():
        theirs.weight_ih_l0.copy_(network.w_x.reshape(-1, 3))
        theirs.weight_hh_l0.copy_(network.w_h.reshape(-1, HIDDEN))
        theirs.bias_ih_l0.copy_(network.bias.ravel())
        theirs.bias_hh_l0.zero_()
    generator = torch.Generator().manual_seed(2)
    x = torch.randn(9, 3, 4, generator=generator, dtype=torch.float64)
    start = torch.randn(2 * HIDDEN, 4, generator=generator, dtype=torch.float64) * 0.3
    drift, states = network(x, start)
    halves = [part.T[None].contiguous() for part in start.chunk(2)]
    y, (_, c) = theirs(x.permute(0, 2, 1), tuple(halves))
    torch.testing.assert_close(states[:, :HIDDEN], y.permute(0, 2, 1))
    torch.testing.assert_close(states[-1, HIDDEN:], c[0].T)
    share = torch.randn(drift.shape, generator=generator, dtype=torch.float64)
    (drift * share).sum().backward()
    shown = torch.matmul(network.head.detach(), y.permute(0, 2, 1))
    ((shown + network.head_bias.detach()[:, None]) * share).sum().backward()
    for mine, other in (
        (network.w_x, theirs.weight_ih_l0),
        (network.w_h, theirs.weight_hh_l0),
        (network.bias, theirs.bias_ih_l0),
    ):
        assert mine.grad is not None and other.grad is not None
        torch.testing.assert_close(mine.grad.reshape(other.grad.shape), other.grad)


def test_state_at_rest_is_a_fixed_point_and_that_of_the_float_layer() -> None:
    network = draw_network(4)
    x = torch.randn(3, 6, generator=torch.Generator().manual_seed(5))
    rest = network.rest(x)
    cell = network.to_float()
    np.testing.assert_allclose(rest.T.numpy(), cell.settle(x.T.double().numpy()), atol=1e-6)
    _, after = network(x[None], rest)
    torch.testing.assert_close(after[0], rest, atol=1e-4, rtol=1e-4)


def test_slow_unit_is_at_rest_after_settle() -> None:
    """A unit that forgets 1/20000 of its cell state per step would take 10^5 steps by itself."""
    cell = draw_network().to_float()
    bias = cell.bias.copy()
    bias[0], bias[1] = -8.0, 9.9
    slow = replace(cell, w_h=0.01 * cell.w_h, bias=bias)
    x = np.array([[0.4, -0.3, 0.8]])
    settled = slow.settle(x)
    later = slow.run(np.repeat(x[:, None], 2000, axis=1), settled)[1]
    np.testing.assert_allclose(later, settled, atol=1e-6)


def test_file_answers_as_the_network_that_is_read_from_it() -> None:
    network = draw_network()
    cell, head = network.to_float(), network.head.detach().double().numpy()
    content = build_lstm_onnx(cell, head, np.array([0.3, -0.2]), ["Fz", "Mx"])
    features = np.random.default_rng(3).normal(size=(40, 3))
    imported = read_imported_bytes(content, "trained")
    assert [type(layer.cell) for layer in imported.network.layers] == [type(cell)]
    for window in (0, 7):
        found = OnnxNetwork(content).run(features, window)
        np.testing.assert_allclose(found, imported.network.answer(features, window), atol=1e-5)
    assert [i.name for i in onnxruntime.InferenceSession(content).get_inputs()] == [
        "features",
        "initial_h",
        "initial_c",
    ]


def write_lagging_logs(directory: Path) -> None:
    """Write three short simulated logs whose drifts bend with a temperature of some steps ago."""
    directory.mkdir(parents=True)
    rng = np.random.default_rng(6)
    for name in "abc":
        time = np.arange(400.0)
        temperature = 25.0 + 12.0 * np.sin(time / 40.0 + rng.uniform(0, 6)) + rng.normal(size=400)
        late = np.convolve(temperature - 25.0, np.exp(-np.arange(30) / 4.0), "full")[:400] / 4.5
        outputs = np.tanh(np.column_stack([late / 6.0, late / 4.0 - 0.5]))
        table = np.column_stack([time, temperature, 0 * time + 3.3, 0 * time + 45.0, outputs])
        header = "time_s,temperature_degC,supply_V,humidity_pct,Fz_N,Mx_Nm"
        np.savetxt(directory / f"{name}.csv", table, "%.6f", ",", header=header, comments="")


@pytest.mark.spread(0, "memory", ['"stream"', "6"])
def test_trained_lstm_becomes_equal_firmware(memory: str, tmp_path: Path) -> None:
    write_lagging_logs(tmp_path / "logs")
    network = (
        f'\n[network]\nkind = "lstm"\nhidden = 4\nepochs = 60\nstarts = 1\nmemory = {memory}\n'
    )
    (tmp_path / "zerodrift.toml").write_text(TOML + network)
    result = CliRunner().invoke(cli, ["firmware", "-C", str(tmp_path), "--json", "--force"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["bit_exact"] and told["backends"][:3] == ["reference", "host", "onnx"]
    nodes = load_model(tmp_path / "build" / "model.json").nodes
    layers = [node for node in nodes if isinstance(node, IntegerLstmLayer)]
    assert [layer.streams for layer in layers] == [memory == '"stream"']
    bound = told["error_bound"]["Fz"]
    assert bound["causes"]["range"] > 0.99 * bound["value"] > 0.0
    assert "no contraction" in bound["why"]
    assert CliRunner().invoke(cli, ["verify", "-C", str(tmp_path)]).exit_code == 0
