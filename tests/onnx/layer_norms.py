"""Networks with a layer normalisation, by PyTorch's exporter and by hand; and ones with others."""

import io
import warnings

import numpy as np
import torch
from tests.onnx.graphs import Graph
from tests.onnx.kinds import DEVIATION, MEAN, Kind, linear, normalise, squeeze
from torch import nn


class TorchNorms(nn.Module):
    """A recurrent network with normalisations where a PyTorch user puts them."""

    def __init__(self, form: str, cell: str, hidden: int) -> None:
        super().__init__()
        torch.manual_seed(hidden + len(form))
        make = nn.LSTM if cell == "lstm" else nn.GRU
        affine = form != "plain"
        below = 6 if form == "before" else 3
        self.form = form
        self.front = nn.Sequential(nn.Linear(3, 6), nn.LayerNorm(6), nn.ReLU())
        self.lower = make(below, hidden, batch_first=True)
        self.norm = nn.LayerNorm(hidden, elementwise_affine=affine)
        self.upper = make(hidden, hidden, batch_first=True)
        self.around = nn.Linear(3, hidden)
        self.head = nn.Linear(hidden, 2)
        self.register_buffer("mean", torch.tensor(MEAN))
        self.register_buffer("deviation", torch.tensor(DEVIATION))
        with torch.no_grad():
            if affine:
                self.norm.weight.copy_(torch.rand(hidden) + 0.5)
                self.norm.bias.copy_(torch.randn(hidden) * 0.2)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the answers."""
        x = (x - self.mean) / self.deviation
        if self.form == "before":
            x = self.front(x)
        y, _ = self.lower(x)
        if self.form == "skip":
            y = y + self.around(x)
        y = self.norm(y)
        if self.form == "between":
            y, _ = self.upper(y)
        return self.head(y[:, -1] if self.form == "last" else y)


def export_norms(
    form: str, cell: str = "gru", hidden: int = 6, opset: int = 17, steps: int = 8
) -> bytes:
    """Return the file of a network by PyTorch's older exporter."""
    network = TorchNorms(form, cell, hidden).eval()
    file = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (torch.randn(1, steps, 3),),
            file,
            dynamo=False,
            opset_version=opset,
            input_names=["x"],
            output_names=["y"],
            dynamic_axes=None if form == "last" else {"x": {1: "T"}},
        )
    return file.getvalue()


def by_hand(form: str) -> bytes:
    """Return a GRU and what looks like a normalisation, in one of its ways."""
    g, rng = Graph(), np.random.default_rng(12)
    x = normalise(g)
    y, _ = g.gru(x, rng, 3, 5)
    given = squeeze(g, y)
    y, eps = given, g.constant(1e-3)
    match form:
        case "halved":
            y = g.op("Add", g.op("Mul", y, g.constant(-0.5)), g.constant(0.25))
        case "on the input":
            y = x
    mean = g.op("ReduceMean", y, axes=[-1])
    centered = g.op("Sub", y, mean)
    square = g.op("Mul", centered, centered)
    axes = {"over time": [0], "over time and features": [0, 2]}.get(form, [-1])
    variance = g.op("ReduceMean", square, axes=axes)
    match form:
        case "reciprocal":
            deviation = g.op("Sqrt", g.op("Add", eps, variance))
            y = g.op("Mul", g.op("Reciprocal", deviation), centered)
        case "power":
            y = g.op("Mul", centered, g.op("Pow", g.op("Add", variance, eps), g.constant(-0.5)))
        case "one operator, -0.5 x":
            rows = (g.constant(rng.uniform(0.5, 2.0, 5)), g.constant(rng.normal(size=5)))
            y = g.op("LayerNormalization", g.op("Neg", given), *rows, epsilon=1e-2)
        case "scale alone":
            y = g.op("LayerNormalization", given, g.constant(np.full(5, 0.7)))
        case "two operators":
            for _ in range(2):
                rows = (g.constant(rng.uniform(0.5, 2.0, 5)), g.constant(rng.normal(size=5)))
                y = g.op("LayerNormalization", g.op("Tanh", y), *rows)
        case "no epsilon":
            y = g.op("Div", centered, g.op("Sqrt", variance))
        case "another's deviation":
            y = g.op(
                "Div", g.op("Sub", x, g.op("ReduceMean", x, axes=[-1])), g.op("Sqrt", variance)
            )
        case "over all axes":
            y = g.op("LayerNormalization", given, g.constant(np.ones((1, 5))), axis=1)
        case "root mean square":
            y = g.op("Div", y, g.op("Sqrt", g.op("ReduceMean", g.op("Mul", y, y), axes=[-1])))
        case "its mean too":
            row = g.constant(np.ones(5))
            y, mean = g.op("LayerNormalization", given, row, outputs=2)
        case "mean as answer":
            return g.build({"x": ("T", 1, 3)}, [mean])
        case "centred":
            y = centered
        case _:
            y = g.op("Div", centered, g.op("Sqrt", g.op("Add", variance, eps)))
    if form == "on the input":
        y = squeeze(g, g.gru(y, rng, 3, 5)[0])
    return g.build({"x": ("T", 1, 3)}, [linear(g, y, rng, 5, 2)])


NORM_KINDS: dict[str, Kind] = (
    {
        f"after a {cell.upper()}, opset {opset}": Kind(
            lambda c=cell, o=opset: export_norms("after", c, opset=o),  # type: ignore[misc]
            axes="BT",
        )
        for cell in ("gru", "lstm")
        for opset in (11, 16, 17, 18, 20)
    }
    | {
        "between two GRUs": Kind(lambda: export_norms("between"), axes="BT", recurrent=2),
        "between two LSTMs, opset 14": Kind(
            lambda: export_norms("between", "lstm", opset=14), axes="BT", recurrent=2
        ),
        "below the GRU": Kind(lambda: export_norms("before"), axes="BT"),
        "without gain": Kind(lambda: export_norms("plain"), axes="BT"),
        "around a skip connection": Kind(lambda: export_norms("skip"), axes="BT"),
        "64 units": Kind(lambda: export_norms("after", hidden=64), axes="BT"),
        "window": Kind(lambda: export_norms("last"), axes="BT"),
    }
    | {
        f"by hand: {form}": Kind(lambda f=form: by_hand(f))  # type: ignore[misc]
        for form in (
            "taken apart",
            "halved",
            "reciprocal",
            "power",
            "one operator, -0.5 x",
            "scale alone",
            "two operators",
        )
    }
    | {"by hand: on the input": Kind(lambda: by_hand("on the input"))}
)
NORM_REFUSED: dict[str, Kind] = {
    form: Kind(lambda f=form: by_hand(f), told)  # type: ignore[misc]
    for form, told in {
        "over time": "ReduceMean 'ReduceMean_7': it normalises over the axes [0]",
        "over time and features": "it normalises over the axes [0, 2]",
        "over all axes": "it normalises over the axes [1, 2]",
        "no epsilon": "its epsilon is 0; expected one above 0",
        "another's deviation": "Div 'Div_11': it uses a mean or a deviation",
        "root mean square": "a product of two signals",
        "its mean too": "its mean or deviation is used too",
        "mean as answer": "it uses a mean or a deviation over the features of a sample outside",
        "centred": "it uses a mean or a deviation over the features of a sample outside",
    }.items()
}
