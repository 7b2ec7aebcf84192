"""Imported networks with 8-bit weights are fine-tuned in the chip's arithmetic, all layers."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.onnx.test_firmware_onnx import (
    FEATURES,
    TOML,
    invoke,
    open_project,
    scale_inputs,
    write_logs,
)
from tests.onnx.torch_networks import Form, export

from zerodrift.export.compose import compose_integer_model, describe_imported, predict_integer
from zerodrift.export.fine_tune import FOLDER, LAYERS, load_or_tune
from zerodrift.export.float_model import FloatModel
from zerodrift.export.onnx_reader import read_imported_bytes
from zerodrift.operations.gru.cell import FloatGru

pytestmark = pytest.mark.long

CASES = {
    "two layers and tanh, stream": export(Form(layers=2, activation="tanh", hidden=6)),
    "one layer and relu, window": export(
        Form(last="state", activation="relu", hidden=6), steps=5, dynamic=False
    ),
}


@pytest.fixture
def project(tmp_path: Path) -> Path:
    directory = tmp_path / "cell"
    write_logs(directory / "logs")
    (directory / "zerodrift.toml").write_text(TOML)
    return directory


def list_layers(model: FloatModel) -> tuple[FloatGru, ...]:
    assert model.network is not None
    return model.network.grus


@pytest.mark.parametrize("name", CASES)
def test_fine_tuning_brings_an_imported_network_nearer(name: str, project: Path) -> None:
    config, dataset = open_project(project)
    config = replace(config, weights="int8")
    imported = read_imported_bytes(scale_inputs(CASES[name]), "net.onnx")
    described, _ = describe_imported(imported, config, dataset.train, FEATURES)
    tuned = load_or_tune(described, config, dataset.train)
    layers = list_layers(tuned)
    assert tuned is not described and len(layers) == len(imported.network.grus)
    off = []
    for form in (described, tuned):
        model = compose_integer_model(form, config, dataset)
        run = dataset.train[0]
        error = predict_integer(model, run) - described.predict(run)
        off.append(float(np.sqrt(np.mean((error / described.predict(run).std(axis=0)) ** 2))))
    assert off[1] < 0.9 * off[0], off
    told: list[str] = []
    again = load_or_tune(described, config, dataset.train, told.append)
    assert again is not described and told == []  # from build/
    for mine, kept in zip(layers, list_layers(again), strict=True):
        assert np.array_equal(mine.w_h, kept.w_h) and mine.reset == kept.reset
    path = config.build_directory / FOLDER / LAYERS
    path.write_bytes(path.read_bytes()[:-100])
    assert load_or_tune(described, config, dataset.train, told.append) is not described
    assert told  # a damaged file is replaced


def test_16_bit_weights_are_taken_as_they_came(project: Path) -> None:
    config, dataset = open_project(project)
    imported = read_imported_bytes(scale_inputs(next(iter(CASES.values()))), "net.onnx")
    described, _ = describe_imported(imported, config, dataset.train, FEATURES)
    assert load_or_tune(described, config, dataset.train) is described
    assert not (config.build_directory / FOLDER).exists()


@pytest.mark.slow
def test_command_tells_what_fine_tuning_gained(project: Path) -> None:
    toml = project / "zerodrift.toml"
    toml.write_text(toml.read_text() + '\n[quantization]\nweights = "int8"\n')
    network = project.parent / "net.onnx"
    network.write_bytes(scale_inputs(next(iter(CASES.values()))))
    result = invoke("firmware", "-C", project, "--json", "--onnx", network)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["bit_exact"] and set(told["rmse"]["integer_not_fine_tuned"]) == {"Fz", "Mx"}
    assert {"features", "gru", "dense_0", "head", "drift"} <= {
        node["node"] for node in told["error_budget"]["nodes"]
    }
