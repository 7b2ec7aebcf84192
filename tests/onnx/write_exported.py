"""Writes tests/onnx/exported again: networks by the newer exporter of PyTorch (dynamo).

It needs the package onnxscript, which zerodrift itself does without:
`python -m tests.onnx.write_exported`.
"""

from pathlib import Path

import onnx
import torch
from tests.onnx.torch_networks import Form, Network

FOLDER = Path(__file__).parent / "exported"
FORMS = {
    "torch_dynamo_window": Form(last="output", activation="relu"),
    "torch_dynamo_stream_two_layers": Form(
        layers=2, batch_first=False, state=True, activation="sigmoid"
    ),
    "torch_dynamo_sequence": Form(layers=2, activation="leaky_relu"),
}
STEPS = 10


def export(form: Form) -> bytes:
    """Return the file, without what it tells of the machine that it was exported on."""
    shape = (1, STEPS, form.features) if form.batch_first else (STEPS, 1, form.features)
    arguments: tuple[torch.Tensor, ...] = (torch.randn(shape),)
    if form.state:
        arguments += (torch.zeros(form.layers, 1, form.hidden),)
    program = torch.onnx.export(Network(form).eval(), arguments, dynamo=True, verbose=False)
    model = onnx.load_model_from_string(program.model_proto.SerializeToString())
    graph = model.graph
    for part in (model, *graph.node, *graph.value_info, *graph.input, *graph.output):
        del part.metadata_props[:]
        part.doc_string = ""
    return bytes(model.SerializeToString(deterministic=True))


if __name__ == "__main__":
    for name, form in FORMS.items():
        (FOLDER / f"{name}.onnx").write_bytes(export(form))
