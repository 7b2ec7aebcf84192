"""One operation on its own, held against itself wherever it is computed."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tests.effects_on_chip.random_graphs import LSB_PER_UNIT, LSBS, describe_graph, draw_codes

from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.operations.backend import evaluate
from zerodrift.operations.graph import Node
from zerodrift.verify.certificate import certify
from zerodrift.verify.chip_check import check_chip
from zerodrift.verify.host_check import check_host
from zerodrift.verify.onnx_check import check_onnx
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_sequences
from zerodrift_proof import OPEN, list_shown, read_model
from zerodrift_proof.certificate.check import CertificateOutcome, compare

PERIOD_S, SEED = 0.5, 5


def quantize_nodes(nodes: Sequence[Node]) -> IntegerModel:
    """Return the integer model of at most four nodes over the inputs x0 and x1."""
    return quantize(*describe_graph(list(nodes), draw_codes(SEED)))


def derive_again(model: IntegerModel, code: GeneratedCode) -> CertificateOutcome:
    """Return what becomes of the claims of a model's certificate about some C of it."""
    return compare(json.loads(certify(model, code)), list_texts(code))


def list_texts(code: GeneratedCode) -> dict[str, str]:
    """Return a model's C with the runtime: file name -> content."""
    texts = {code.header_name: code.header, code.source_name: code.source}
    return texts | {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}


def list_unproven(model: IntegerModel, code: GeneratedCode) -> list[str]:
    """Return what of some C is not shown to be what the specification says of a model."""
    shown = list_shown(read_model(model.to_json()), list_texts(code))
    return [f"{one.what}: {one.why}" for one in shown if one.verdict == OPEN]


def check_everywhere(
    nodes: Sequence[Node], folder: Path, largest_error: float, cores: Sequence[str] = ()
) -> IntegerModel:
    """Return the integer model of at most four nodes over the inputs x0 and x1.

    Float and integers agree within `largest_error` beside the rounding of the outputs; reference,
    C, integer ONNX and emulated cores to the bit; the certificate is derived again from the C, and
    the C is proven to be what the proof knows of the operations.
    """
    codes, model = draw_codes(SEED), quantize_nodes(nodes)
    inputs = {f"x{i}": codes[:, i] * lsb for i, lsb in enumerate(LSBS)}
    drift = Reference(model).run(codes[None]).drift[0] / LSB_PER_UNIT
    wanted = np.stack(evaluate(nodes, inputs, PERIOD_S), axis=1)
    assert np.abs(drift - wanted).max() <= 0.5 / LSB_PER_UNIT + largest_error
    code = generate(model)
    host, onnx = HostModel(model, code, folder / "host", flags=("-O1",)), OnnxModel(model)
    sequences = draw_sequences(model, 400)
    for settled, (name, more) in enumerate(sequences.items()):
        for check in (
            check_host(host, more, settled=settled % 2 == 0),
            check_onnx(onnx, host, more, settled=settled % 2 == 0),
        ):
            assert check.mismatch is None, f"{name}: {check.mismatch}"
    outcome = derive_again(model, code)
    assert outcome.understood and not outcome.failures, outcome.failures
    assert not list_unproven(model, code)
    for core in cores:
        check_chip(core, code, host, {"noise": sequences["noise"]}, folder / core)
    return model
