"""Writes tests/onnx/exported again: networks by the newer exporter of PyTorch (dynamo).

It needs the package onnxscript, which zerodrift itself does without:
`python -m tests.onnx.write_exported`.
"""

from pathlib import Path

import onnx
import torch
from tests.onnx.kinds import Torch, TorchCells
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
PLAIN = {
    "plain_gru": lambda: (Torch("gru", "last", 3, 6, 1), (torch.randn(1, 8, 3),)),
    "plain_lstm_two_layers": lambda: (Torch("lstm", "last", 3, 6, 2), (torch.randn(1, 8, 3),)),
    "plain_gru_cell": lambda: (TorchCells("gru", "", 5, 1), make_step(1)),
    "plain_lstm_cells": lambda: (TorchCells("lstm", "relu", 5, 2), make_step(4)),
}
"""What torch.onnx.export(network, arguments, "net.onnx") writes with nothing else said: the weights
lie in a file beside."""


def make_step(states: int) -> tuple[torch.Tensor, ...]:
    """Return a row of features and states of their own; equal objects would be one input."""
    return torch.zeros(1, 3), *(torch.zeros(1, 5) for _ in range(states))


def export(form: Form) -> bytes:
    """Return the file, without what it tells of the machine that it was exported on."""
    shape = (1, STEPS, form.features) if form.batch_first else (STEPS, 1, form.features)
    arguments: tuple[torch.Tensor, ...] = (torch.randn(shape),)
    if form.state:
        arguments += (torch.zeros(form.layers, 1, form.hidden),)
    program = torch.onnx.export(Network(form).eval(), arguments, dynamo=True, verbose=False)
    model = onnx.load_model_from_string(program.model_proto.SerializeToString())
    return bytes(strip(model).SerializeToString(deterministic=True))


def strip(model: onnx.ModelProto) -> onnx.ModelProto:
    """Take off what a file tells of the machine."""
    graph = model.graph
    for part in (model, *graph.node, *graph.value_info, *graph.input, *graph.output):
        del part.metadata_props[:]
        part.doc_string = ""
    for tensor in graph.initializer:
        tensor.doc_string = ""
    return model


def write_plain(name: str) -> None:
    """Write a file and the weights beside it, as PyTorch does."""
    network, arguments = PLAIN[name]()
    path = FOLDER / f"{name}.onnx"
    torch.onnx.export(network.eval(), arguments, str(path), verbose=False)
    model = strip(onnx.load(path))
    (FOLDER / f"{name}.onnx.data").unlink()
    onnx.save(
        model, path, save_as_external_data=True, location=f"{name}.onnx.data", size_threshold=0
    )


if __name__ == "__main__":
    for name, form in FORMS.items():
        (FOLDER / f"{name}.onnx").write_bytes(export(form))
    for name in PLAIN:
        write_plain(name)
