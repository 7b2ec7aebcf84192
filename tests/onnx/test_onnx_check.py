"""The comparison of onnxruntime with the host: it passes equal bits and finds a wrong one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.golden.model_factory import Shape, draw_model

from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_sequences

SHAPE = Shape(front_end=("lowpass", "delay"), hidden=5)


def exchange(model: IntegerModel, kind: type, **changes: object) -> IntegerModel:
    nodes = tuple(replace(n, **changes) if isinstance(n, kind) else n for n in model.nodes)
    return replace(model, nodes=nodes)


def test_check_passes_equal_bits_and_finds_a_wrong_one(tmp_path: Path) -> None:
    model = draw_model(SHAPE, 21)
    host = HostModel(model, generate(model), tmp_path)
    runtime = OnnxModel(model)
    for settled, codes in enumerate(draw_sequences(model, 3000).values()):
        check = check_onnx(runtime, host, codes, settled=bool(settled % 2))
        assert check.mismatch is None, str(check.mismatch)
        assert check.values_compared > check.steps * len(model.nodes)
    codes = draw_sequences(model, 3000)["walk"]
    bias = model.recurrent.gru.bias.copy()
    bias[2, 4] += 1 << model.recurrent.gru.shift[2]  # one LSB of the table's argument
    gru = replace(model.recurrent.gru, bias=bias)
    lowpass = next(n for n in model.nodes if isinstance(n, IntegerLowpass))
    for wrong, place in (
        (exchange(model, IntegerGruLayer, gru=gru), "gru[4]"),
        (exchange(model, IntegerLowpass, m_q31=lowpass.m_q31 - 1), "state["),
    ):
        found = check_onnx(OnnxModel(wrong), host, codes)
        assert found.mismatch is not None and found.mismatch.where.startswith(place)


def test_check_finds_a_wrong_start(tmp_path: Path) -> None:
    model = draw_model(SHAPE, 21)
    host = HostModel(model, generate(model), tmp_path)
    runtime = OnnxModel(model)
    start = runtime.run

    def run(codes: np.ndarray, *, settled: bool = True, state: np.ndarray | None = None):
        return start(codes, settled=True, state=state)

    runtime.run = run  # a cold start that is a settled one
    codes = draw_sequences(model, 500)["constant"]
    assert check_onnx(runtime, host, codes, settled=True).mismatch is None
    assert check_onnx(runtime, host, codes, settled=False).mismatch is not None
