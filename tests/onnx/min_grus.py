"""Single steps of minGRUs, as PyTorch writes what users have."""

import io
import warnings

import torch
from tests.onnx.kinds import DEVIATION, MEAN, Kind
from torch import nn


class MinGru(nn.Module):
    """h' = (1 - z) h + z c, z and c from the input alone."""

    def __init__(self, form: str, features: int, hidden: int) -> None:
        super().__init__()
        self.form = form
        self.both = nn.Linear(features, 2 * hidden)
        self.around = nn.Linear(features, hidden)

    def bound(self, c: torch.Tensor) -> torch.Tensor:
        """Return the candidate."""
        match self.form:
            case "linear":
                return c
            case "paper":
                return torch.where(c >= 0, c + 0.5, torch.sigmoid(c))
            case "sigmoid":
                return torch.sigmoid(c)
        return torch.tanh(c)

    def forward(self, x: torch.Tensor, h: torch.Tensor) -> torch.Tensor:
        """Return the state after a step."""
        c, a = self.both(x).chunk(2, dim=-1)
        if self.form == "own state":
            a = a + 0.1 * h
        c, z = self.bound(c), torch.sigmoid(a)
        match self.form:
            case "lerp":
                return torch.lerp(h, c, z)
            case "kept":
                return z * h + (1 - z) * c
            case "two gates":
                return torch.sigmoid(-a) * h + z * c
            case "independent gates":
                return torch.sigmoid(self.around(x)) * h + z * c
        return (1 - z) * h + z * c


class MinGrus(nn.Module):
    """One step of a network of minGRUs, with the states as inputs and outputs."""

    def __init__(self, form: str, hidden: int, layers: int) -> None:
        super().__init__()
        torch.manual_seed(hidden + layers)
        self.front, self.wide = nn.Linear(3, 5), form == "relu"
        below = [5 if self.wide else 3] + [hidden] * (layers - 1)
        self.cells = nn.ModuleList(MinGru(form, n, hidden) for n in below)
        self.head = nn.Linear(hidden, 2)
        self.register_buffer("mean", torch.tensor(MEAN))
        self.register_buffer("deviation", torch.tensor(DEVIATION))

    def forward(self, x: torch.Tensor, *states: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the answer, and the states after the step."""
        x = (x - self.mean) / self.deviation
        if self.wide:
            x = torch.tanh(self.front(x))
        after: list[torch.Tensor] = []
        for cell, state in zip(self.cells, states, strict=True):
            x = cell(x, state)
            after.append(x)
        return (self.head(x), *after)


def export(
    form: str, *, hidden: int = 5, layers: int = 1, rank: int = 2, opset: int | None = None
) -> bytes:
    """Return the file of a network of one step by PyTorch's older exporter."""
    lead = (1,) * (rank - 1)
    states = tuple(torch.zeros(*lead, hidden) for _ in range(layers))
    file = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            MinGrus(form, hidden, layers).eval(),
            (torch.zeros(*lead, 3), *states),
            file,
            dynamo=False,
            opset_version=opset,
            input_names=["x", *(f"s{k}" for k in range(layers))],
            output_names=["y", *(f"t{k}" for k in range(layers))],
        )
    return file.getvalue()


MIN_GRU_KINDS: dict[str, Kind] = {
    "a tanh over the candidate": Kind(lambda: export("tanh"), axes="1"),
    "a tanh, hidden 32": Kind(lambda: export("tanh", hidden=32), axes="1"),
    "a sigmoid over the candidate": Kind(lambda: export("sigmoid"), axes="1"),
    "two layers": Kind(lambda: export("tanh", layers=2), axes="1", recurrent=2),
    "two layers with a sigmoid": Kind(lambda: export("sigmoid", layers=2), axes="1", recurrent=2),
    "lerp": Kind(lambda: export("lerp"), axes="1"),
    "the gate keeps": Kind(lambda: export("kept"), axes="1"),
    "1 - z of its own": Kind(lambda: export("two gates"), axes="1"),
    "above Linear and tanh": Kind(lambda: export("relu"), axes="1"),
    "no batch": Kind(lambda: export("tanh", rank=1), axes="1"),
    "batch and time": Kind(lambda: export("lerp", rank=3), axes="1"),
    "opset 9": Kind(lambda: export("tanh", opset=9), axes="1"),
    "a linear candidate": Kind(lambda: export("linear"), "a tanh or a sigmoid over its candidate"),
    "the candidate of the paper": Kind(
        lambda: export("paper"), "a tanh or a sigmoid over its candidate"
    ),
    "gates that read the state": Kind(lambda: export("own state"), "a product of two signals"),
    "gates of their own": Kind(lambda: export("independent gates"), "a product of two signals"),
}
