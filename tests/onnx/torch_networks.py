"""Networks as PyTorch users write them, and their ONNX files by PyTorch's own exporter."""

import io
import warnings
from dataclasses import dataclass

import torch
from torch import nn

ACTIVATIONS = {
    "relu": nn.ReLU(),
    "leaky_relu": nn.LeakyReLU(0.1),
    "prelu": nn.PReLU(1),
    "tanh": nn.Tanh(),
    "sigmoid": nn.Sigmoid(),
    "relu6": nn.ReLU6(),
    "hardtanh": nn.Hardtanh(-0.4, 0.3),
    "hardsigmoid": nn.Hardsigmoid(),
    "none": nn.Identity(),
}


@dataclass(frozen=True)
class Form:
    """How a network is built and called."""

    layers: int = 1
    batch_first: bool = True
    last: str = ""
    """"" for the whole sequence, "output" for output[:, -1], "state" for h_n[-1]."""
    state: bool = False
    """Takes and gives the state."""
    activation: str = ""
    """Of a hidden dense layer; "" for a plain linear head."""
    normalised: bool = True
    features: int = 3
    hidden: int = 5
    outputs: int = 2


class Network(nn.Module):
    """A GRU with a head."""

    def __init__(self, form: Form, seed: int = 0) -> None:
        super().__init__()
        torch.manual_seed(seed)
        self.form = form
        self.gru = nn.GRU(form.features, form.hidden, form.layers, batch_first=form.batch_first)
        self.head: nn.Module = nn.Linear(form.hidden, form.outputs)
        if form.activation:
            first = nn.Linear(form.hidden, 4)
            self.head = nn.Sequential(
                first, ACTIVATIONS[form.activation], nn.Linear(4, form.outputs)
            )
        self.register_buffer("mean", torch.randn(form.features))
        self.register_buffer("deviation", torch.rand(form.features) + 0.5)
        with torch.no_grad():
            for parameter in self.parameters():
                parameter.mul_(1.5)

    def forward(
        self, x: torch.Tensor, state: torch.Tensor | None = None
    ) -> torch.Tensor | tuple[torch.Tensor, torch.Tensor]:
        """Return the outputs, and the state where the form says so."""
        if self.form.normalised:
            x = (x - self.mean) / self.deviation
        y, after = self.gru(x, state)
        if self.form.last == "output":
            y = y[:, -1] if self.form.batch_first else y[-1]
        elif self.form.last == "state":
            y = after[-1]
        y = self.head(y)
        return (y, after) if self.form.state else y


def export(
    form: Form, steps: int = 10, *, dynamic: bool = True, seed: int = 0, opset: int | None = None
) -> bytes:
    """Return the ONNX file of a network of this form."""
    network = Network(form, seed).eval()
    shape = (1, steps, form.features) if form.batch_first else (steps, 1, form.features)
    arguments: tuple[torch.Tensor, ...] = (torch.randn(shape),)
    names, results = ["x"], ["y"]
    if form.state:
        arguments += (torch.zeros(form.layers, 1, form.hidden),)
        names, results = ["x", "h0"], ["y", "hn"]
    file = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            arguments,
            file,
            dynamo=False,
            opset_version=opset,
            input_names=names,
            output_names=results,
            dynamic_axes={"x": {1 if form.batch_first else 0: "T"}} if dynamic else None,
        )
    return file.getvalue()
