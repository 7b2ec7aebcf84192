"""The error budget of a network from elsewhere: node by node, and it adds up."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.onnx.graphs import keras
from tests.onnx.test_firmware_onnx import DEVIATION, FEATURES, MEAN, TOML, scale_inputs, write_logs
from tests.onnx.torch_networks import Form, export

from zerodrift.base.config import load_config
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import calibrate, describe_imported, predict_integer
from zerodrift.export.onnx_reader import read_imported_bytes
from zerodrift.export.quantize import quantize
from zerodrift.verify.chip_error import ErrorBudget, measure_budget

NETWORKS = {
    "one layer, stream": export(Form(state=True, batch_first=False, hidden=6)),
    "two layers, window, relu": export(
        Form(layers=2, last="state", activation="relu", hidden=8), steps=5, dynamic=False
    ),
    "three layers, stream, sigmoid": export(Form(layers=3, activation="sigmoid", hidden=6)),
    "keras, reset before": keras("sequence", False, mean=MEAN, gain=[1 / d for d in DEVIATION]),
}
Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("budget") / "cell"
    write_logs(directory / "logs")
    (directory / "zerodrift.toml").write_text(TOML)
    return directory


def measure(
    project: Path, name: str, folder: Path, *, weights: str = "int16", coarser: int = 1
) -> tuple[ErrorBudget, Array]:
    """Return the budget of a network and its measured total."""
    config = load_config(project)
    dataset = load_dataset(config)
    imported = read_imported_bytes(scale_inputs(NETWORKS[name]), "net.onnx")
    described, _ = describe_imported(imported, config, dataset.train, FEATURES)
    outputs = tuple(replace(o, lsb_per_unit=o.lsb_per_unit // coarser) for o in described.outputs)
    described = replace(described, outputs=outputs)
    calibration = calibrate(described, dataset.train)
    model = quantize(described, calibration, weights)
    host = HostModel(model, generate(model), folder, flags=("-O1",))
    budget = measure_budget(described, calibration, host, dataset.test, 1000)
    errors = [predict_integer(model, run) - described.predict(run) for run in dataset.test]
    return budget, np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


@pytest.mark.spread(2, "name", NETWORKS)
def test_budget_has_every_node_and_adds_up(name: str, project: Path, tmp_path: Path) -> None:
    budget, measured = measure(project, name, tmp_path)
    np.testing.assert_allclose(budget.total, measured, rtol=1e-6)
    assert (sum(node.rms for node in budget.nodes) >= budget.total * 0.999).all()
    names = [node.node for node in budget.nodes]
    assert {"in_0", "in_1", "in_2", "features", "gru", "head", "drift"} <= set(names)
    assert ("dense_0" in names) is (name in list(NETWORKS)[1:3])
    assert all((node.rms > 0).all() for node in budget.nodes if node.node in ("gru", "drift"))


@pytest.mark.long
def test_budget_names_the_node_that_is_made_coarse(project: Path, tmp_path: Path) -> None:
    name = "two layers, window, relu"
    coarse_weights, _ = measure(project, name, tmp_path / "a", weights="int8")
    assert coarse_weights.largest[0].node == "gru"
    coarse_output, _ = measure(project, name, tmp_path / "b", coarser=1000)
    assert coarse_output.largest[0].node == "drift"
