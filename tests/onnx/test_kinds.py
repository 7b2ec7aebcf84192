"""Every kind of recurrent network that users bring: taken to the bit, or refused by name."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from tests.golden.model_factory import SAMPLE_PERIOD_S
from tests.onnx.kinds import (
    DEVIATION,
    GRU_KINDS,
    LSTM_KINDS,
    LSTM_REFUSED,
    MEAN,
    Kind,
    export_cells,
)
from tests.onnx.layer_norms import NORM_KINDS, NORM_REFUSED
from tests.onnx.min_grus import MIN_GRU_KINDS
from tests.onnx.test_reader import run_onnxruntime
from tests.onnx.write_exported import PLAIN
from tests.operations.everywhere import derive_again

from zerodrift.base.errors import InputError
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.onnx_reader import ImportedNetwork, read_imported, read_imported_bytes
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations
from zerodrift.verify.chip_check import check_chip
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.host_check import check_host
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_sequences

ALL = {f"GRU: {k}": v for k, v in GRU_KINDS.items()} | {
    f"LSTM: {k}": v for k, v in LSTM_KINDS.items()
}
ALL |= {f"minGRU: {k}": v for k, v in MIN_GRU_KINDS.items()}
ALL |= {f"LayerNorm: {k}": v for k, v in NORM_KINDS.items()}
TAKEN = {name: kind for name, kind in ALL.items() if not kind.refused}
REFUSED = {name: kind for name, kind in ALL.items() if kind.refused}
REFUSED |= {f"LSTM: {k}": v for k, v in LSTM_REFUSED.items()}
REFUSED |= {f"LayerNorm: {k}": v for k, v in NORM_REFUSED.items()}
ON_CORES = (
    "GRU: Tanh between two GRUs",
    "LSTM: PyTorch, two layers, window",
    "LSTM: GRU on an LSTM",
    "minGRU: a tanh over the candidate",
    "LayerNorm: between two LSTMs, opset 14",
)


def read(kind: Kind) -> tuple[bytes, ImportedNetwork]:
    content = kind.make()
    return content, read_imported_bytes(content, "net.onnx")


def run_step_by_step(content: bytes, x: np.ndarray, start: float = 0.0) -> np.ndarray:
    """Return the answers [T, K] of a network of one step, which hands its states on in order."""
    session = onnxruntime.InferenceSession(content)
    first, *states = session.get_inputs()
    carried = [np.full(state.shape, start, dtype=np.float32) for state in states]
    answers = []
    for row in x:
        feed = dict(zip([s.name for s in states], carried, strict=True))
        answer, *carried = session.run(None, {first.name: row.reshape(first.shape), **feed})
        answers.append(np.ravel(answer))
    return np.array(answers)


def draw_inputs(count: int, steps: int = 12) -> np.ndarray:
    """Return [1, T, I] like the logged columns that the networks normalise."""
    rng = np.random.default_rng(3)
    mean, deviation = ((column * 4)[:count] for column in (MEAN, DEVIATION))
    return (rng.normal(size=(1, steps, count)) * deviation + mean).astype(np.float32)


def make_integer_model(imported: ImportedNetwork, weights: str = "int16") -> IntegerModel:
    """Return the integer model of a network over int16 channels, one per feature."""
    count = imported.network.inputs
    ops = GraphOperations(SAMPLE_PERIOD_S)
    names = tuple(f"x{i}" for i in range(count))
    mean, deviation = (np.array((column * 4)[:count]) for column in (MEAN, DEVIATION))
    taps = tuple(ops.input(name) for name in names)
    outputs = imported.network.head.shape[0]
    model = FloatModel(
        name="kind",
        sample_period_s=SAMPLE_PERIOD_S,
        channels=tuple(
            Channel(name=n, unit="", lsb=float(d) / 4096, bits=16, source=n)
            for n, d in zip(names, deviation, strict=True)
        ),
        sources={name: i for i, name in enumerate(names)},
        outputs=tuple(OutputFormat(f"y{k}", "N", 100000, 10.0) for k in range(outputs)),
        features=(),
        coefficients=np.zeros((0, outputs)),
        offset=np.zeros(outputs),
        taps=taps,
        tap_mean=np.zeros(count),
        whitening=np.diag(1.0 / deviation),
        network=imported.network.rescale_inputs(np.zeros(count), deviation),
        window=imported.window,
    )
    calibration = Calibration(
        code_limits=((-32768, 32767),) * count,
        feature_max=np.abs(mean) / deviation + 3.0,
        drift_low=np.full(outputs, -1e3),
        drift_high=np.full(outputs, 1e3),
        rate_max=1000,
        warm_up_steps=0,
    )
    return quantize(model, calibration, weights)


@pytest.mark.spread(20, "name", TAKEN)
def test_kind_is_read_as_onnxruntime_computes_it(name: str) -> None:
    kind = TAKEN[name]
    content, imported = read(kind)
    arrays = [n for n, _ in imported.network.list_arrays() if n.endswith("w_h")]
    assert len(arrays) == kind.recurrent
    steps = 12 if kind.axes == "1" else imported.steps or 12
    x = draw_inputs(imported.network.inputs, steps)
    if "constant start" in name:
        assert imported.initial_state == "constant"
        return
    if kind.axes == "1":
        assert (imported.initial_state, imported.window) == ("input", 0)
        found = imported.network.run(x.astype(np.float64))[0]
        start = 0.5 if "a sigmoid" in name else 0.0  # the middle of what the state can be
        np.testing.assert_allclose(found, run_step_by_step(content, x[0], start), atol=1e-5)
        return
    expected = run_onnxruntime(content, x if kind.axes == "BT" else x.swapaxes(0, 1))
    answer = imported.network.run(x.astype(np.float64))
    found = answer[:, -1] if imported.last_only else answer
    found = found.reshape(expected.shape) if kind.axes == "BT" else found.swapaxes(0, 1)
    found = found.reshape(expected.shape)
    np.testing.assert_allclose(found, expected, atol=2e-4 * max(1.0, np.abs(expected).max()))


def test_cells_are_read_beside_an_operator_that_onnx_cannot_evaluate() -> None:
    model = onnx.load_model_from_string(export_cells("lstm", layers=2))
    beside = onnx.helper.make_node("MaxRoiPool", ["x", "x"], ["pooled"], pooled_shape=[1, 1])
    model.graph.node.append(beside)
    model.graph.output.append(onnx.helper.make_tensor_value_info("pooled", 1, None))
    imported = read_imported_bytes(model.SerializeToString(), "net.onnx", "y")
    assert (imported.initial_state, len(imported.network.layers)) == ("input", 2)


@pytest.mark.parametrize("weights", ["int16", "int8"])
@pytest.mark.spread(6, "name", TAKEN)
def test_kind_is_the_same_everywhere(name: str, weights: str, tmp_path: Path) -> None:
    """Reference, C of this host, integer ONNX and cores agree at 0 LSB, under the certificate."""
    _, imported = read(TAKEN[name])
    if weights == "int8" and name not in ON_CORES:
        pytest.skip("8-bit weights of the kinds that run on cores")
    model = make_integer_model(imported, weights)
    code = generate(model)
    host, onnx = HostModel(model, code, tmp_path, flags=("-O1",)), OnnxModel(model)
    sequences = draw_sequences(model, 120)
    for settled, (sequence, codes) in enumerate(sequences.items()):
        for check in (
            check_host(host, codes, settled=settled % 2 == 0),
            check_onnx(onnx, host, codes, settled=settled % 2 == 0),
        ):
            assert check.mismatch is None, f"{sequence}: {check.mismatch}"
    outcome = derive_again(model, code)
    assert outcome.understood and not outcome.failures, outcome.failures
    if name in ON_CORES:
        for core in ("cortex-m0plus", "cortex-m4", "rv32imc"):
            check_chip(core, code, host, {"noise": sequences["noise"][:40]}, tmp_path / core)


@pytest.mark.parametrize("name", PLAIN)
def test_plain_export_of_torch_is_read_with_the_file_beside_it(name: str, tmp_path: Path) -> None:
    path = Path(__file__).parent / "exported" / f"{name}.onnx"
    assert path.with_suffix(".onnx.data").stat().st_size > 0
    imported = read_imported(path)
    steps = imported.steps if imported.window else 12
    x = draw_inputs(3, steps)
    whole = onnx.load(path).SerializeToString()
    if "cell" in name:
        expected, found = run_step_by_step(whole, x[0]), imported.network.run(x.astype(float))[0]
    else:
        expected = run_onnxruntime(whole, x)
        found = imported.network.run(x.astype(float))[:, -1].reshape(expected.shape)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert imported.initial_state == ("input" if "cell" in name else "zero")
    (tmp_path / path.name).write_bytes(path.read_bytes())
    with pytest.raises(InputError, match=r"which cannot be read .* Copy it there, or export again"):
        read_imported(tmp_path / path.name)


@pytest.mark.parametrize("name", REFUSED)
def test_kind_is_refused_by_name(name: str) -> None:
    kind = REFUSED[name]
    with pytest.raises(InputError, match=r"net\.onnx") as caught:
        read(kind)
    assert kind.refused in str(caught.value), str(caught.value)
