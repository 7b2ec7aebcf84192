"""`zerodrift firmware --onnx`: networks of other programs as C that is equal bit for bit."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from tests.onnx.graphs import Graph, keras
from tests.onnx.torch_networks import Form, export

from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.codegen.generate import generate
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.export.compose import (
    compose_integer_model,
    describe_imported,
    predict_integer,
    read_features,
)
from zerodrift.export.onnx_reader import read_imported_bytes
from zerodrift.tasks.firmware import OnnxRequest, open_import
from zerodrift.tasks.project import ProjectFolder
from zerodrift.verify.firmware_check import check_firmware
from zerodrift.verify.vectors import draw_sequences

TOML = """
[sensor]
name = "cell"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.Fz]
measured = "Fz_N"
unit = "N"
full_scale = 10

[outputs.Mx]
measured = "Mx_Nm"
unit = "Nm"
full_scale = 5

[inputs]
supply = "supply_V"
humidity = "humidity_pct"

[logs]
train = ["logs/a.csv", "logs/b.csv"]
test = ["logs/c.csv"]
"""
slow = pytest.mark.slow
FEATURES = ("temperature", "supply", "humidity")
MEAN, DEVIATION = [25.0, 3.3, 45.0], [10.0, 0.05, 8.0]
"""Of the logs, for the networks to normalise by."""


def write_logs(directory: Path) -> None:
    """Write three short logs; nothing in them needs to be like a sensor."""
    directory.mkdir(parents=True)
    rng = np.random.default_rng(6)
    for name in "abc":
        time = np.arange(400.0)
        temperature = 25.0 + 12.0 * np.sin(time / 70.0 + rng.uniform(0, 6)) + 0.01 * time
        supply = 3.3 + 0.05 * np.sin(time / 31.0)
        humidity = 45.0 + rng.normal(size=400).cumsum() * 0.3
        outputs = rng.normal(size=(400, 2)).cumsum(axis=0) * 0.02
        table = np.column_stack([time, temperature, supply, humidity, outputs])
        header = "time_s,temperature_degC,supply_V,humidity_pct,Fz_N,Mx_Nm"
        np.savetxt(directory / f"{name}.csv", table, "%.6f", ",", header=header, comments="")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    directory = tmp_path / "cell"
    write_logs(directory / "logs")
    (directory / "zerodrift.toml").write_text(TOML)
    return directory


def open_project(directory: Path) -> tuple[Config, Dataset]:
    config = load_config(directory)
    return config, load_dataset(config)


def scale_inputs(content: bytes) -> bytes:
    """Return a network whose first Sub and Div normalise the logs' columns."""
    import onnx
    from onnx import numpy_helper

    model = onnx.load_model_from_string(content)
    numbers = {"mean": MEAN, "deviation": DEVIATION}
    for tensor in model.graph.initializer:
        if tensor.name in numbers:
            array = np.array(numbers[tensor.name], dtype=np.float32)
            tensor.CopyFrom(numpy_helper.from_array(array, tensor.name))
    return bytes(model.SerializeToString())


NETWORKS = {
    "torch, window": export(Form(last="output"), steps=10, dynamic=False),
    "torch, window, two layers, relu": export(
        Form(layers=2, last="state", activation="relu", hidden=8), steps=5, dynamic=False
    ),
    "torch, stream with state": export(Form(state=True, batch_first=False, hidden=12)),
    "torch, three layers, sigmoid": export(Form(layers=3, activation="sigmoid")),
    "torch, leaky relu": export(Form(activation="leaky_relu")),
    "torch, hardtanh": export(Form(activation="hardtanh", layers=2)),
    "torch, tanh": export(Form(activation="tanh", last="output"), steps=3, dynamic=False),
    "keras, reset before": keras("sequence", False, mean=MEAN, gain=[1 / d for d in DEVIATION]),
    "keras, reset after": keras("reshaped", True, mean=MEAN, gain=[1 / d for d in DEVIATION]),
}
FAST = ("torch, window, two layers, relu", "torch, stream with state", "keras, reset before")
FORMS = [
    pytest.param(name, weights, marks=() if name in FAST and weights == "int16" else slow)
    for name in NETWORKS
    for weights in ("int16", "int8")
]


@pytest.mark.spread(0, ("name", "weights"), FORMS)
def test_network_becomes_equal_firmware(name: str, weights: str, project: Path) -> None:
    """Reference, C and integer ONNX agree at 0 LSB, and all of them with the float network."""
    config, dataset = open_project(project)
    config = replace(config, weights=weights)
    content = NETWORKS[name]
    imported = read_imported_bytes(scale_inputs(content), "net.onnx")
    described, _ = describe_imported(imported, config, dataset.train, FEATURES)
    model = compose_integer_model(described, config, dataset)
    sequences = draw_sequences(model, 300)
    check_firmware(model, generate(model), sequences, project / "scratch").require()

    run = dataset.train[0]  # within the calibrated ranges, so that nothing is limited
    float_drift, drift = described.predict(run), predict_integer(model, run)
    error = np.sqrt(np.mean((drift - float_drift) ** 2, axis=0))
    size = np.sqrt(np.mean(float_drift**2, axis=0))
    limit = 2e-3 if weights == "int16" else 3e-2
    assert (error < limit * size).all(), f"{error / size}"


@pytest.mark.parametrize("name", ["torch, window", "torch, window, two layers, relu"])
def test_window_is_that_of_the_file(name: str, project: Path) -> None:
    """The compensator's answer is the file's own, in onnxruntime, for the window before it."""
    import onnxruntime

    config, dataset = open_project(project)
    content = scale_inputs(NETWORKS[name])
    imported = read_imported_bytes(content, "net.onnx")
    described, notes = describe_imported(imported, config, dataset.train, FEATURES)
    run = dataset.test[0]
    raw = read_features(run, FEATURES).astype(np.float32)
    session = onnxruntime.InferenceSession(content)
    at = np.arange(described.window, 400, 37)
    expected = [session.run(None, {"x": raw[None, t + 1 - described.window : t + 1]}) for t in at]
    found = described.predict(run)[at]
    np.testing.assert_allclose(found, np.reshape(expected, found.shape), atol=2e-5)
    assert notes == []


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


@pytest.mark.long
def test_command_writes_checked_firmware(project: Path) -> None:
    network = project.parent / "net.onnx"
    network.write_bytes(scale_inputs(NETWORKS["torch, window, two layers, relu"]))
    result = invoke("firmware", "-C", project, "--json", "--force", "--onnx", network)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["bit_exact"] and told["vectors"] >= 100_000
    assert told["backends"][:3] == ["reference", "host", "onnx"]
    assert told["held_out"] and told["runs"] == ["c"]
    for name in ("Fz", "Mx"):
        assert told["rmse"]["float"][name] == pytest.approx(told["rmse"]["integer"][name], rel=0.01)
    files = {path.name for path in (project / "firmware").iterdir()}
    assert files == {
        "cell.h",
        "cell.c",
        "zd_runtime.h",
        "zd_runtime.c",
        "zd_gru_pairs.h",
        "zd_gru_rows.h",
        "zd_gru_columns.h",
        "zd_gru_columns_sse2.h",
        "zd_gru_columns_avx2.h",
        "zd_gru_portable.h",
        "zd_signals.h",
        "zd_network.h",
        "zd_tanh_table.h",
        "certificate.json",
        "manifest.json",
        "model.json",
        "cell.dbc",
    }
    assert (project / "build" / "integer.onnx").is_file()
    assert invoke("verify", "-C", project).exit_code == 0


def test_project_is_guessed_from_the_logs(tmp_path: Path) -> None:
    write_logs(tmp_path / "logs")
    (tmp_path / "net.onnx").write_bytes(NETWORKS["keras, reset before"])
    request = OnnxRequest(tmp_path / "net.onnx", (tmp_path / "logs",), FEATURES)
    config, dataset, described, notes = open_import(request, ProjectFolder(tmp_path))
    assert [o.name for o in config.outputs] == ["Fz", "Mx"]
    assert {"supply", "humidity"} <= set(config.inputs)
    assert len(dataset.train) == 3 and len(described.taps) == len(FEATURES)
    assert "guessed from the logs" in notes[0]


@slow
def test_command_guesses_the_project_from_the_logs(tmp_path: Path) -> None:
    write_logs(tmp_path / "logs")
    (tmp_path / "net.onnx").write_bytes(scale_inputs(NETWORKS["keras, reset before"]))
    logs = [tmp_path / "logs" / f"{name}.csv" for name in "abc"]
    options = ("--features", "temperature,supply,humidity", "--calibrate", *logs)
    result = invoke("firmware", "-C", tmp_path, "--json", "--onnx", tmp_path / "net.onnx", *options)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert set(told["units"]) == {"Fz", "Mx"} and not told["held_out"]
    assert "guessed from the logs" in result.stderr
    files = {tmp_path / name for name in told["files"]}
    assert {*(tmp_path / "firmware").iterdir()} == files
    assert {"zd_runtime.h", "zd_runtime.c", "manifest.json"} <= {path.name for path in files}


def make_bidirectional() -> bytes:
    g, rng = Graph(), np.random.default_rng(1)
    weights = [g.constant(rng.normal(size=s)) for s in ((2, 12, 3), (2, 12, 4), (2, 24))]
    y = g.op("GRU", "x", *weights, hidden_size=4, direction="bidirectional")
    return g.build({"x": ("T", "B", 3)}, [y])


def make_wide() -> bytes:
    return export(Form(features=5, outputs=2, normalised=False))


REFUSALS = {
    "another number of outputs": (
        lambda: export(Form(outputs=3, normalised=False)),
        (),
        "expected one table per column",
    ),
    "more features than signals": (make_wide, (), "has 5 features"),
    "a feature that is none": (
        make_wide,
        ("--features", "temprature"),
        "did you mean 'temperature'",
    ),
    "a feature twice": (
        lambda: NETWORKS["torch, window"],
        ("--features", "supply,supply,humidity"),
        "3 different ones",
    ),
    "a window of no length": (lambda: NETWORKS["torch, window"], ("--memory", "0"), "samples"),
    "a window that is too long": (
        lambda: NETWORKS["torch, window"],
        ("--memory", "1000000"),
        "expected 1 to 4096",
    ),
    "both directions": (make_bidirectional, (), "it is bidirectional"),
    "no network": (lambda: b"not one", (), "cannot be read as ONNX"),
    "logs that are not there": (
        lambda: NETWORKS["torch, window"],
        ("--calibrate", "gone.csv"),
        "there is no such log",
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_command_refuses_and_writes_nothing(name: str, project: Path) -> None:
    make, options, told = REFUSALS[name]
    network = project.parent / "net.onnx"
    network.write_bytes(make())
    before = sorted(str(p) for p in project.rglob("*"))
    result = invoke("firmware", "-C", project, "--onnx", network, *options)
    message = str(result.exception) + result.output
    assert result.exit_code != 0 and told in message, message
    assert result.exit_code == 2 or getattr(result.exception, "exit_code", 0) == 2
    assert sorted(str(p) for p in project.rglob("*")) == before


@pytest.mark.parametrize(
    "options", [("--features", "temperature"), ("--calibrate", "logs"), ("logs/a.csv",)]
)
def test_options_of_onnx_need_it(options: tuple[str, ...], project: Path) -> None:
    result = invoke("firmware", "-C", project, *options)
    assert result.exit_code == 2
    told = "logs follow --calibrate" if options == ("logs/a.csv",) else "go with --onnx"
    assert told in result.output


def test_missing_project_and_logs_is_told(tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(NETWORKS["torch, window"])
    result = invoke("firmware", "-C", tmp_path, "--onnx", tmp_path / "net.onnx")
    assert isinstance(result.exception, InputError)
    assert "no logs by --calibrate" in str(result.exception)


def test_file_decides_on_the_memory_unless_told_otherwise(project: Path) -> None:
    config, dataset = open_project(project)
    cases = (
        ("torch, window", None, 10, ""),
        ("torch, window", "stream", 0, ""),
        ("torch, stream with state", None, 0, ""),
        ("torch, stream with state", 7, 7, ""),
        ("keras, reset before", None, 0, ""),
    )
    for name, memory, window, told in cases:
        imported = read_imported_bytes(NETWORKS[name], "net.onnx")
        described, notes = describe_imported(imported, config, dataset.train, FEATURES, memory)
        assert described.window == window
        assert (told in " ".join(notes)) and bool(notes) == bool(told)
    imported = read_imported_bytes(export(Form(last="output")), "net.onnx")
    _, notes = describe_imported(imported, config, dataset.train, FEATURES)
    assert "give --memory N" in notes[0]


def test_initial_state_other_than_zero_needs_a_stream(project: Path) -> None:
    g, rng = Graph(), np.random.default_rng(1)
    y, _ = g.gru("x", rng, 3, 4, g.constant(rng.normal(size=(1, 1, 4))))
    last = g.op("Gather", y, g.constant(-1, np.int64), axis=0)
    answer = g.op("MatMul", last, g.constant(rng.normal(size=(4, 2))))
    imported = read_imported_bytes(g.build({"x": (9, 1, 3)}, [answer]), "net.onnx")
    config, dataset = open_project(project)
    with pytest.raises(InputError, match="a state other than zero"):
        describe_imported(imported, config, dataset.train, FEATURES)
    _, notes = describe_imported(imported, config, dataset.train, FEATURES, "stream")
    assert "initial state in the file is not used" in notes[0]
