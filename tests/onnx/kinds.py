"""Kinds of recurrent networks that users bring, as files by PyTorch's exporter and by hand."""

import io
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import onnx
import torch
from tests.onnx.graphs import Graph
from torch import nn

MEAN, DEVIATION = [25.0, 3.3, 45.0], [10.0, 0.05, 8.0]
"""Of the columns that the networks read."""


@dataclass(frozen=True)
class Kind:
    """A kind of network: how its file is made, and what is to become of it."""

    make: Callable[[], bytes]
    refused: str = ""
    """Part of the message; "" where it is taken."""
    axes: str = "TB"
    """"TB" time first, "BT" batch first, of the input; "1" for one step, states handed in."""
    recurrent: int = 1
    """Recurrent layers in the network."""


def squeeze(g: Graph, y: str, axis: int = 1) -> str:
    """Take an axis of length 1 out."""
    if g.opset < 13:
        return str(g.op("Squeeze", y, axes=[axis]))
    return str(g.op("Squeeze", y, g.constant([axis], np.int64)))


def normalise(g: Graph) -> str:
    """Return the input, normalised."""
    return str(g.op("Div", g.op("Sub", "x", g.constant(MEAN)), g.constant(DEVIATION)))


def linear(g: Graph, x: str, rng: np.random.Generator, below: int, width: int) -> str:
    """Add a linear layer with a bias."""
    product = g.op("MatMul", x, g.constant(rng.normal(size=(below, width)) / np.sqrt(below)))
    return str(g.op("Add", product, g.constant(rng.normal(size=width) * 0.3)))


def add_lstm(
    g: Graph,
    x: str,
    rng: np.random.Generator,
    features: int,
    hidden: int,
    more: Sequence[str] = (),
    scale: float = 0.6,
    directions: int = 1,
    **attributes: object,
) -> list[str]:
    """Add an LSTM with random weights; `more` follows X, W, R, B. Return Y, Y_h, Y_c."""
    shapes = ((4 * hidden, features), (4 * hidden, hidden), (8 * hidden,))
    weights = [g.constant(rng.normal(scale=scale, size=(directions, *s))) for s in shapes]
    return list(g.op("LSTM", x, *weights, *more, outputs=3, hidden_size=hidden, **attributes))


def stack(*cells: str, window: int = 0, between: str = "", opset: int = 17) -> bytes:
    """Return recurrent layers ("gru", "before", "lstm") on top of each other, by hand."""
    g, rng = Graph(opset), np.random.default_rng(len(cells))
    value, width, last = normalise(g), 3, ""
    for index, cell in enumerate(cells):
        hidden = 6 - index
        if index and between:
            value = str(g.op(between, linear(g, value, rng, width, 7)))
            width = 7
        if cell == "lstm":
            y, last, _ = add_lstm(g, value, rng, width, hidden)
        else:
            after = int(cell == "gru")
            y, last = g.gru(value, rng, width, hidden, linear_before_reset=after)
        value, width = squeeze(g, y), hidden
    if window:
        value = squeeze(g, last, 0)
    answer = linear(g, value, rng, width, 2)
    return g.build({"x": (window or "T", 1, 3)}, [answer])


def branches(cell: str, way: str, window: int = 0) -> bytes:
    """Return a network with a skip connection: `way` is "add", "concat", "input" or "twice"."""
    g, rng = Graph(), np.random.default_rng(7)
    x = normalise(g)
    below = str(g.op("Tanh", linear(g, x, rng, 3, 6))) if way == "twice" else x
    width = 6 if way == "twice" else 3

    def end(value: str) -> str:
        """Return the last sample, where the network answers for that alone."""
        return str(g.op("Gather", value, g.constant(-1, np.int64), axis=0)) if window else value

    if cell == "lstm":
        y, last, _ = add_lstm(g, below, rng, width, 6)
    else:
        y, last = g.gru(below, rng, width, 6, linear_before_reset=1)
    states = squeeze(g, last, 0) if window else squeeze(g, y)
    if way == "add":
        value, width = str(g.op("Add", states, end(linear(g, x, rng, 3, 6)))), 6
    elif way == "twice":
        value, width = str(g.op("Add", states, end(below))), 6
    else:
        value, width = str(g.op("Concat", states, end(x), axis=1 if window else 2)), 9
    if way == "input":
        value, width = str(g.op("Relu", linear(g, value, rng, 9, 5))), 5
    return g.build({"x": (window or "T", 1, 3)}, [linear(g, value, rng, width, 2)])


def with_lengths(cell: str, lengths: Sequence[int], given: bool = False) -> bytes:
    """Return a network with `sequence_lens`, constant or as an input."""
    g, rng = Graph(), np.random.default_rng(5)
    x = normalise(g)
    name = "lengths" if given else g.constant(lengths, np.int32)
    if cell == "lstm":
        y = add_lstm(g, x, rng, 3, 5, (name,))[0]
    else:
        weights = [
            g.constant(rng.normal(scale=0.5, size=s)) for s in ((1, 15, 3), (1, 15, 5), (1, 30))
        ]
        y = g.op("GRU", x, *weights, name, outputs=2, hidden_size=5)[0]
    content = g.build({"x": (9, 1, 3)}, [linear(g, squeeze(g, y), rng, 5, 2)])
    if not given:
        return content
    model = onnx.load_model_from_string(content)
    model.graph.input.append(
        onnx.helper.make_tensor_value_info("lengths", onnx.TensorProto.INT32, [1])
    )
    return bytes(model.SerializeToString())


def without_shapes(content: bytes) -> bytes:
    """Return a file whose outputs have no shape, as some converters leave it."""
    model = onnx.load_model_from_string(content)
    for output in model.graph.output:
        output.type.tensor_type.ClearField("shape")
    return bytes(model.SerializeToString())


class Torch(nn.Module):
    """A network as a PyTorch user writes it."""

    def __init__(self, cell: str, form: str, features: int, hidden: int, layers: int) -> None:
        super().__init__()
        torch.manual_seed(features + 10 * hidden + layers)
        self.form = form
        below = hidden if form in ("relu", "tanh", "sigmoid") else features
        activations = {"relu": nn.ReLU(), "tanh": nn.Tanh(), "sigmoid": nn.Sigmoid()}
        self.front: nn.Module = nn.Identity()
        if form in activations:
            self.front = nn.Sequential(nn.Linear(features, hidden), activations[form])
        make = nn.LSTM if cell == "lstm" else nn.GRU
        self.cell = make(below, hidden, layers, batch_first=True, bias=form != "no bias")
        self.around = nn.Linear(below, hidden)
        self.head = nn.Linear(hidden, 2)
        mean = torch.tensor((MEAN * 4)[:features])
        deviation = torch.tensor((DEVIATION * 4)[:features])
        self.register_buffer("mean", mean)
        self.register_buffer("deviation", deviation)

    def forward(
        self, x: torch.Tensor, *state: torch.Tensor
    ) -> torch.Tensor | tuple[torch.Tensor, ...]:
        """Return the answers, and the states where they are handed in."""
        x = self.front((x - self.mean) / self.deviation)
        if len(state) == 2:
            y, after = self.cell(x, state)
            return self.head(y), *after
        y, _ = self.cell(x)
        if self.form == "skip":
            y = y + self.around(x)
        return self.head(y[:, -1]) if self.form == "last" else self.head(y)


def export(
    cell: str,
    form: str = "",
    *,
    features: int = 3,
    hidden: int = 6,
    layers: int = 1,
    opset: int | None = None,
    steps: int = 8,
) -> bytes:
    """Return the file of a network by PyTorch's older exporter."""
    network = Torch(cell, form, features, hidden, layers).eval()
    arguments: tuple[torch.Tensor, ...] = (torch.randn(1, steps, features),)
    names, results = ["x"], ["y"]
    if form == "state":
        arguments += tuple(torch.zeros(layers, 1, hidden) for _ in range(2))
        names, results = ["x", "h0", "c0"], ["y", "hn", "cn"]
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
            dynamic_axes=None if form == "last" else {"x": {1: "T"}},
        )
    return file.getvalue()


class TorchCells(nn.Module):
    """One step of a GRU or an LSTM, with the states as inputs and outputs."""

    def __init__(self, cell: str, form: str, hidden: int, layers: int) -> None:
        super().__init__()
        torch.manual_seed(hidden + layers)
        make = nn.LSTMCell if cell == "lstm" else nn.GRUCell
        self.lstm, self.form, features = cell == "lstm", form, 5 if form == "relu" else 3
        self.front = nn.Linear(3, 5)
        below = [features] + [hidden] * (layers - 1)
        self.cells = nn.ModuleList(make(n, hidden, bias=form != "no bias") for n in below)
        self.head = nn.Linear(hidden, 2)
        self.register_buffer("mean", torch.tensor(MEAN))
        self.register_buffer("deviation", torch.tensor(DEVIATION))

    def forward(self, x: torch.Tensor, *states: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the answer, and the states after the step."""
        x = (x - self.mean) / self.deviation
        if self.form == "relu":
            x = torch.relu(self.front(x))
        after: list[torch.Tensor] = []
        for k, cell in enumerate(self.cells):
            if self.lstm:
                x, c = cell(x, (states[2 * k], states[2 * k + 1]))
                after += [x, c]
            else:
                x = cell(x, states[k])
                after.append(x)
        return (self.head(x), *after)


def export_cells(
    cell: str,
    form: str = "",
    *,
    hidden: int = 5,
    layers: int = 1,
    rank: int = 2,
    opset: int | None = None,
) -> bytes:
    """Return the file of a network of one step by PyTorch's older exporter."""
    network = TorchCells(cell, form, hidden, layers).eval()
    count = layers * (2 if cell == "lstm" else 1)
    lead = (1,) * (rank - 1)
    arguments = (torch.zeros(*lead, 3), *(torch.zeros(*lead, hidden) for _ in range(count)))
    file = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            arguments,
            file,
            dynamo=False,
            opset_version=opset,
            input_names=["x", *(f"s{k}" for k in range(count))],
            output_names=["y", *(f"t{k}" for k in range(count))],
        )
    return file.getvalue()


def almost_a_cell() -> bytes:
    """Return a step whose update gate also multiplies the candidate's argument: no GRU."""
    g, rng = Graph(), np.random.default_rng(4)
    x = normalise(g)

    def gate() -> str:
        below = linear(g, x, rng, 3, 4)
        return str(g.op("Add", below, g.op("MatMul", "h", g.constant(rng.normal(size=(4, 4))))))

    r, u = g.op("Sigmoid", gate()), g.op("Sigmoid", gate())
    n = g.op("Tanh", g.op("Mul", gate(), g.op("Mul", r, u)))
    after = g.op("Add", "h", g.op("Mul", u, g.op("Sub", n, "h")))
    answer = linear(g, after, rng, 4, 2)
    return g.build({"x": (1, 3), "h": (1, 4)}, [answer, after])


def by_hand(form: str) -> bytes:
    """Return an LSTM of which one thing is unusual."""
    g, rng = Graph(), np.random.default_rng(11)
    x = normalise(g)
    attributes: dict[str, object] = {}
    more: list[str] = []
    directions = 1
    match form:
        case "reverse":
            attributes["direction"] = "reverse"
        case "bidirectional":
            attributes["direction"], directions = "bidirectional", 2
        case "clip":
            attributes["clip"] = 3.0
        case "coupled":
            attributes["input_forget"] = 1
        case "relu gates":
            attributes["activations"] = ["Relu", "Tanh", "Tanh"]
        case "peepholes":
            more = ["", "", "", g.constant(rng.normal(size=(1, 15)))]
        case "no peepholes":
            more = ["", "", "", g.constant(np.zeros((1, 15)))]
        case "constant start":
            more = ["", *(g.constant(rng.normal(size=(1, 1, 5))) for _ in range(2))]
        case "zero start":
            more = ["", *(g.constant(np.zeros((1, 1, 5))) for _ in range(2))]
        case "saturating":
            attributes["scale"] = 8.0
        case "tiny":
            attributes["scale"] = 1e-3
        case "huge":
            attributes["scale"] = 1e5
    scale = float(str(attributes.pop("scale", 0.6)))
    y, _, c = add_lstm(g, x, rng, 3, 5, more, scale, directions, **attributes)
    if form == "cell as answer":
        return g.build({"x": ("T", 1, 3)}, [linear(g, squeeze(g, c, 0), rng, 5, 2)])
    if directions == 2:
        y = g.op("Gather", y, g.constant([0], np.int64), axis=1)
    answer = linear(g, squeeze(g, y), rng, 5, 2)
    if form == "not finite":
        answer = g.op("Add", answer, g.constant([np.nan, 0.0]))
    return g.build({"x": ("T", 1, 3)}, [answer])


GRU_KINDS: dict[str, Kind] = {
    f"Linear and {form} before the GRU": Kind(
        lambda form=form: export("gru", form),  # type: ignore[misc]
        axes="BT",
    )
    for form in ("relu", "tanh", "sigmoid")
} | {
    "a linear map before the GRU": Kind(lambda: stack("gru")),
    "Relu between two GRUs": Kind(lambda: stack("gru", "gru", between="Relu"), recurrent=2),
    "Tanh between two GRUs": Kind(lambda: stack("gru", "before", between="Tanh"), recurrent=2),
    "Sigmoid between three GRUs": Kind(
        lambda: stack("gru", "gru", "before", between="Sigmoid"), recurrent=3
    ),
    "Add around the GRU": Kind(lambda: branches("gru", "add")),
    "Concat of the GRU and its input": Kind(lambda: branches("gru", "concat")),
    "Concat below a dense layer": Kind(lambda: branches("gru", "input")),
    "Add around the GRU above a dense layer": Kind(lambda: branches("gru", "twice")),
    "a skip connection by PyTorch": Kind(lambda: export("gru", "skip"), axes="BT"),
    "Add around the GRU, window": Kind(lambda: branches("gru", "add", window=6)),
    "Concat, window": Kind(lambda: branches("gru", "input", window=6)),
    "full sequence_lens": Kind(lambda: with_lengths("gru", [9])),
    "outputs without shapes": Kind(lambda: without_shapes(stack("gru", "gru")), recurrent=2),
    "GRUCell": Kind(lambda: export_cells("gru"), axes="1"),
    "GRUCell without a batch": Kind(lambda: export_cells("gru", rank=1), axes="1"),
    "GRUCell, opset 11": Kind(lambda: export_cells("gru", opset=11), axes="1"),
    "GRUCell, hidden 32": Kind(lambda: export_cells("gru", hidden=32), axes="1"),
    "GRUCell, no bias": Kind(lambda: export_cells("gru", "no bias"), axes="1"),
    "two GRUCells": Kind(lambda: export_cells("gru", layers=2), axes="1", recurrent=2),
    "GRUCell above Linear and ReLU": Kind(lambda: export_cells("gru", "relu"), axes="1"),
    "nearly a GRUCell": Kind(almost_a_cell, "a product of two signals"),
    "short sequence_lens": Kind(lambda: with_lengths("gru", [4]), "GRU 'GRU_2': it is given"),
    "sequence_lens as an input": Kind(
        lambda: with_lengths("gru", [9], given=True), "sequence_lens) that are computed"
    ),
}
LSTM_KINDS: dict[str, Kind] = (
    {
        f"PyTorch, hidden {hidden}, {features} inputs": Kind(
            lambda h=hidden, f=features: export("lstm", features=f, hidden=h),  # type: ignore[misc]
            axes="BT",
        )
        for hidden, features in ((1, 1), (2, 3), (5, 2), (17, 3), (32, 1), (64, 3), (128, 3))
    }
    | {
        f"PyTorch, opset {opset}": Kind(
            lambda o=opset: export("lstm", opset=o, layers=2),  # type: ignore[misc]
            axes="BT",
            recurrent=2,
        )
        for opset in (9, 11, 13, 17, 20)
    }
    | {
        "PyTorch, 12 inputs": Kind(lambda: export("lstm", features=12, hidden=8), axes="BT"),
        "PyTorch, no bias": Kind(lambda: export("lstm", "no bias"), axes="BT"),
        "PyTorch, window": Kind(lambda: export("lstm", "last"), axes="BT"),
        "PyTorch, two layers, window": Kind(
            lambda: export("lstm", "last", layers=2), axes="BT", recurrent=2
        ),
        "PyTorch, states handed in": Kind(lambda: export("lstm", "state"), axes="BT"),
        "PyTorch, two layers, states handed in": Kind(
            lambda: export("lstm", "state", layers=2), axes="BT", recurrent=2
        ),
        "PyTorch, Linear and ReLU before": Kind(lambda: export("lstm", "relu"), axes="BT"),
        "PyTorch, Linear and Tanh before": Kind(lambda: export("lstm", "tanh"), axes="BT"),
        "PyTorch, skip connection": Kind(lambda: export("lstm", "skip"), axes="BT"),
        "LSTMCell": Kind(lambda: export_cells("lstm"), axes="1"),
        "LSTMCell without a batch": Kind(lambda: export_cells("lstm", rank=1), axes="1"),
        "two LSTMCells": Kind(lambda: export_cells("lstm", layers=2), axes="1", recurrent=2),
        "by hand, opset 7": Kind(lambda: stack("lstm", opset=7)),
        "by hand, opset 22": Kind(lambda: stack("lstm", opset=22)),
        "LSTM on a GRU": Kind(lambda: stack("gru", "lstm"), recurrent=2),
        "GRU on an LSTM": Kind(lambda: stack("lstm", "before"), recurrent=2),
        "LSTM, GRU, LSTM": Kind(lambda: stack("lstm", "gru", "lstm"), recurrent=3),
        "Tanh between two LSTMs": Kind(lambda: stack("lstm", "lstm", between="Tanh"), recurrent=2),
        "two LSTMs, window, by hand": Kind(lambda: stack("lstm", "lstm", window=7), recurrent=2),
        "Add around the LSTM": Kind(lambda: branches("lstm", "add")),
        "Concat of the LSTM and its input": Kind(lambda: branches("lstm", "concat")),
        "Concat, window": Kind(lambda: branches("lstm", "input", window=5)),
        "full sequence_lens": Kind(lambda: with_lengths("lstm", [9])),
        "peepholes of zero": Kind(lambda: by_hand("no peepholes")),
        "constant start": Kind(lambda: by_hand("constant start")),
        "zero start": Kind(lambda: by_hand("zero start")),
        "tiny weights": Kind(lambda: by_hand("tiny")),
        "saturating weights": Kind(lambda: by_hand("saturating")),
    }
)
LSTM_REFUSED: dict[str, Kind] = {
    form: Kind(lambda f=form: by_hand(f), told)  # type: ignore[misc]
    for form, told in {
        "reverse": "LSTM 'LSTM_2': it is reverse",
        "bidirectional": "it is bidirectional",
        "clip": "it clips its cells",
        "coupled": "input_forget",
        "relu gates": "it has the activations",
        "peepholes": "peepholes",
        "cell as answer": "its cell state Y_c",
        "not finite": "nan",
    }.items()
}
