"""Models of any shape for the proofs: a float compensator drawn from a seed, then quantized."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.float_network import Cell, FloatLayer, FloatNetwork
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations, Node
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.layer_norm import FloatLayerNorm
from zerodrift.operations.lstm.cell import FloatLstm

LINEAR = ("lowpass", "delay", "difference", "product", "power")
FRONT_ENDS = (*LINEAR, "exp2", "root", "play", "clip", "late", "mix", "warm_up", "load")
SAMPLE_PERIOD_S = 0.5
LOAD_LIMIT = 3_000_000


@dataclass(frozen=True)
class Shape:
    """What kind of model to draw."""

    name: str = "golden"
    inputs: int = 4
    hidden: int = 8
    """0: no network, the physical signals alone."""
    outputs: int = 3
    reset: str = "after"
    weights: str = "int16"
    window: int = 0
    front_end: tuple[str, ...] = ()
    """Operations between the inputs and the network, of `FRONT_ENDS`."""
    gain: float = 1.0
    """Size of the weights; beyond 10 every gate saturates."""
    update_bias: float = 0.0
    """Of the update gate: -6 is a unit that moves by 1/400 of its distance per step."""
    code_limit: int = 32768
    """Inputs are limited to +- this code."""
    drift_limit: float = 1e6
    warm_up_steps: int = 5
    no_reading: tuple[int | None, ...] = ()
    """Per channel the code that means none; left out: every code is a reading."""
    ranges: tuple[tuple[int, int, int], ...] = ()
    """(channel, lowest, highest code) of the inputs that are flagged beyond."""
    wide: tuple[int, ...] = ()
    """Inputs whose codes have 32 bits."""
    measured: tuple[int, ...] = ()
    """Outputs whose raw value is an input of 32 bits; "load" needs one."""
    channel_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    upper: tuple[int, ...] = ()
    """Hidden units of further recurrent layers on top of the first."""
    dense: tuple[tuple[int, str], ...] = ()
    """Rows and activation ("tanh", "relu", "relu6") of dense layers before the head."""
    layered: tuple[tuple[str, int, tuple[int, ...]], ...] = ()
    """Kind ("gru", "lstm", "tanh", "relu", "norm"), width, what it reads (0: the features, k: the
    k-th layer) of each layer; the head reads the last layer and the features."""
    forget_bias: float = 0.0
    """Of an LSTM: 6 is a unit that forgets 1/400 of its cell state per step."""


class Draw:
    """Uniform numbers from a linear congruential generator: the same on every machine for ever."""

    def __init__(self, seed: int) -> None:
        self._state = (seed * 2654435761 + 12345) & 0xFFFFFFFF

    def uniform(self, low: float, high: float, *shape: int) -> NDArray[np.float64]:
        """Return an array of numbers from low to high."""
        count = int(np.prod(shape, dtype=np.int64))
        values = np.empty(count)
        for i in range(count):
            self._state = (self._state * 1664525 + 1013904223) & 0xFFFFFFFF
            values[i] = low + (high - low) * (self._state >> 8) / 2**24
        return values.reshape(shape)

    def codes(self, low: int, high: int, *shape: int) -> NDArray[np.int16]:
        """Return an array of codes from low to high, both included."""
        return np.floor(self.uniform(low, high + 1, *shape)).astype(np.int16)


def draw_float_model(shape: Shape, seed: int) -> tuple[FloatModel, Calibration]:
    """Return a float compensator of a shape, and ranges as if it had been calibrated."""
    draw = Draw(seed)
    ops = GraphOperations(SAMPLE_PERIOD_S)
    names = shape.channel_names or tuple(f"in{i}" for i in range(shape.inputs))
    channels = tuple(
        Channel(name, "degC", 2.0**-7, 1.5 * i, bits=32 if i in shape.wide else 16)
        for i, name in enumerate(names)
    )
    sources = {f"source{i}": i for i in range(shape.inputs)}
    inputs = [ops.input(source) for source in sources]
    full = shape.code_limit / 128.0
    loads = [ops.input(f"load:out{k}") for k in shape.measured]
    for k in shape.measured:
        sources[f"load:out{k}"] = len(channels)
        lsb = 10.0 ** -(k % 4)
        channels = (*channels, Channel(f"measured{k}", "N", lsb, bits=32))
    none = (*shape.no_reading, *(None for _ in channels))[: len(channels)]
    channels = tuple(replace(c, no_reading=n) for c, n in zip(channels, none, strict=True))
    taps: list[tuple[Node, float]] = [(node, full) for node in inputs]
    taps += _draw_front_end(ops, inputs, loads, full, shape, draw)
    outputs = tuple(
        OutputFormat(
            shape.output_names[k] if shape.output_names and k not in shape.measured else f"out{k}",
            "N",
            10 ** (k % 4),
            2000.0,
        )
        for k in range(shape.outputs)
    )
    physical = taps[: 1 + len(shape.front_end)] if shape.hidden else taps
    coefficients = draw.uniform(-100.0, 100.0, len(physical), shape.outputs)
    coefficients /= np.array([[largest] for _, largest in physical])
    model = FloatModel(
        name=shape.name,
        sample_period_s=SAMPLE_PERIOD_S,
        channels=channels,
        sources=sources,
        outputs=outputs,
        features=tuple(node for node, _ in physical),
        coefficients=coefficients,
        offset=draw.uniform(-50.0, 50.0, shape.outputs),
        **(draw_network(taps, shape, draw) if shape.hidden else {}),
    )
    calibration = Calibration(
        code_limits=((max(-shape.code_limit, -32768), min(shape.code_limit, 32767)),) * shape.inputs
        + ((-LOAD_LIMIT, LOAD_LIMIT),) * len(shape.measured),
        feature_max=np.full(shape.inputs, 2.0),
        drift_low=np.full(shape.outputs, -shape.drift_limit),
        drift_high=np.full(shape.outputs, shape.drift_limit * 0.75),
        rate_max=1000,
        warm_up_steps=shape.warm_up_steps,
        input_ranges=shape.ranges,
        ranges={node: (-largest, largest) for node, largest in taps if node.op != "exp2"},
    )
    return model, calibration


def draw_model(shape: Shape, seed: int) -> IntegerModel:
    """Return a quantized model of a shape."""
    model, calibration = draw_float_model(shape, seed)
    return quantize(model, calibration, shape.weights)


def _draw_front_end(
    ops: GraphOperations,
    inputs: list[Node],
    loads: list[Node],
    full: float,
    shape: Shape,
    draw: Draw,
) -> list[tuple[Node, float]]:
    """Return nodes with their largest value; each kind acts on an input and the node before it."""
    nodes: list[tuple[Node, float]] = []
    for position, kind in enumerate(shape.front_end):
        x = inputs[position % len(inputs)]
        match kind:
            case "lowpass":
                tau_s = float(np.exp(draw.uniform(-1.0, 9.0, 1)[0]))
                nodes.append((ops.lowpass(x, tau_s), full))
            case "delay":
                steps = 1 + int(draw.uniform(0.0, 12.0, 1)[0])
                nodes.append((ops.delay(x, steps * SAMPLE_PERIOD_S), full))
            case "difference":
                nodes.append((ops.difference(x, ops.lowpass(x, 20.0)), 2.0 * full))
            case "product":
                other, largest = nodes[-1] if nodes else (inputs[-1], full)
                nodes.append((ops.product(ops.affine(x, 1.0, -3.0), other), full * largest))
            case "power":
                exponent = 2 + int(draw.uniform(0.0, 3.0, 1)[0])
                nodes.append((ops.power(x, float(exponent)), full**exponent))
            case "exp2":
                doubling, offset = full / draw.uniform(0.5, 12.0, 1)[0], draw.uniform(-9.0, 9.0, 1)
                argument = ops.affine(x, 1.0 / doubling, float(offset[0]))
                largest = 2.0 ** (full / doubling + float(offset[0]))
                nodes.append((ops.exp2(argument), largest))
            case "root":
                exponent = 0.1 + float(draw.uniform(0.0, 2.5, 1)[0])
                nodes.append((ops.power(ops.affine(x, -1.0, 2.0), exponent), full**exponent))
            case "play":
                width = full * float(draw.uniform(0.001, 0.5, 1)[0])
                nodes.append((ops.play(nodes[-1][0] if nodes else x, width), full))
            case "clip":
                low, high = full * np.sort(draw.uniform(-1.2, 1.2, 2))
                nodes.append((ops.clip(x, float(low), float(high)), full))
            case "late":
                nodes.append((ops.delay(x, float(draw.uniform(0.01, 6.0, 1)[0])), full))
            case "mix":
                other, largest = nodes[-1] if nodes else (inputs[-1], full)
                share = float(draw.uniform(-2.0, 2.0, 1)[0]) * full / largest
                mixed = ops.total(ops.affine(x, 0.3, 1.0), ops.affine(other, share, 0.0))
                nodes.append((mixed, 2.3 * full))
            case "warm_up":
                halvings = ops.affine(
                    ops.input("elapsed_s"), -float(draw.uniform(0.0, 0.3, 1)[0]), 0.0
                )
                nodes.append((ops.product(ops.exp2(halvings), x), full))
            case "load" if loads:
                span = ops.product(ops.affine(x, 0.002 / full, 0.0), loads[position % len(loads)])
                nodes.append((span, 1e-3 * LOAD_LIMIT))
    return nodes


def draw_network(taps: list[tuple[Node, float]], shape: Shape, draw: Draw) -> dict[str, Any]:
    """Return the fields of `FloatModel` that belong to the network."""
    inputs, hidden, gain = shape.inputs, shape.hidden, shape.gain
    if shape.layered:
        return {
            "taps": tuple(node for node, _ in taps),
            "tap_mean": draw.uniform(-5.0, 5.0, len(taps)),
            "whitening": draw.uniform(-1.0, 1.0, inputs, len(taps))
            / np.array([largest for _, largest in taps]),
            "network": _draw_layered(shape, draw),
            "window": shape.window,
        }
    mixing = draw.uniform(-0.3, 0.3, inputs, len(taps))
    mixing[:, :inputs] += 2.0 * np.eye(inputs)
    bias = draw.uniform(-0.5, 0.5, 4, hidden) * gain
    bias[1] += shape.update_bias
    if shape.reset == "before":
        bias[3] = 0.0
    gru = FloatGru(
        w_x=draw.uniform(-gain, gain, 3, hidden, inputs),
        w_h=draw.uniform(-gain, gain, 3, hidden, hidden) * np.sqrt(3.0 / hidden),
        bias=bias,
        reset=shape.reset,
    )
    top = shape.dense[-1][0] if shape.dense else shape.upper[-1] if shape.upper else hidden
    return {
        "taps": tuple(node for node, _ in taps),
        "tap_mean": draw.uniform(-5.0, 5.0, len(taps)),
        "whitening": mixing / np.array([largest for _, largest in taps]),
        "network": _draw_stack(gru, top, shape, draw),
        "window": shape.window,
    }


def _draw_stack(gru: FloatGru, top: int, shape: Shape, draw: Draw) -> FloatNetwork:
    """Return GRUs below dense layers; the head reads `top` numbers."""
    head = draw.uniform(-30.0, 30.0, shape.outputs, top)
    head_bias = draw.uniform(-5.0, 5.0, shape.outputs)
    cells = (gru, *_draw_upper(shape, draw), *_draw_dense(shape, draw))
    return FloatNetwork.stack(cells, head, head_bias)


def _draw_layered(shape: Shape, draw: Draw) -> FloatNetwork:
    """Return a network whose layers read several others."""
    layers, widths, gain = list[FloatLayer](), [shape.inputs], shape.gain
    for kind, width, reads in shape.layered:
        below = sum(widths[k] for k in reads)
        gates = {"gru": 3, "lstm": 4}.get(kind, 0)
        if kind == "norm":
            cell: Cell = FloatLayerNorm(
                draw.uniform(-gain, gain, width), draw.uniform(-0.5, 0.5, width), 1e-5
            )
        elif not gates:
            weight, bias = (draw.uniform(-gain, gain, width, n) for n in (below, 1))
            low = 0.0 if kind == "relu" else -np.inf
            activation = "tanh" if kind == "tanh" else "clip"
            cell = FloatDense(weight, bias[:, 0], activation, low)
        else:
            w_x = draw.uniform(-gain, gain, gates, width, below)
            w_h = draw.uniform(-gain, gain, gates, width, width) * np.sqrt(3.0 / width)
            bias = draw.uniform(-0.5, 0.5, 4, width) * gain
            bias[1] += shape.forget_bias if kind == "lstm" else shape.update_bias
            if kind == "lstm":
                cell = FloatLstm(w_x, w_h, bias)
            else:
                cell = FloatGru(w_x, w_h, bias, "after")
        layers.append(FloatLayer(cell, reads))
        widths.append(width)
    reads = (0, len(layers))
    head = draw.uniform(-30.0, 30.0, shape.outputs, widths[0] + widths[-1])
    return FloatNetwork(
        shape.inputs, tuple(layers), reads, head, draw.uniform(-5.0, 5.0, shape.outputs)
    )


def _draw_upper(shape: Shape, draw: Draw) -> tuple[FloatGru, ...]:
    """Return the further recurrent layers."""
    layers, below = [], shape.hidden
    for width in shape.upper:
        bias = draw.uniform(-0.5, 0.5, 4, width) * shape.gain
        bias[1] += shape.update_bias
        if shape.reset == "before":
            bias[3] = 0.0
        w_x = draw.uniform(-shape.gain, shape.gain, 3, width, below)
        w_h = draw.uniform(-shape.gain, shape.gain, 3, width, width) * np.sqrt(3.0 / width)
        layers.append(FloatGru(w_x, w_h, bias, shape.reset))
        below = width
    return tuple(layers)


def _draw_dense(shape: Shape, draw: Draw) -> tuple[FloatDense, ...]:
    """Return the dense layers before the head."""
    limits = {"tanh": (-np.inf, np.inf), "relu": (0.0, np.inf), "relu6": (0.0, 6.0)}
    layers, below = [], (shape.hidden, *shape.upper)[-1]
    for width, activation in shape.dense:
        gain = min(shape.gain, 4.0)  # what relu lets through multiplies from layer to layer
        weight = draw.uniform(-gain, gain, width, below)
        bias = draw.uniform(-gain, gain, width)
        kind = "tanh" if activation == "tanh" else "clip"
        layers.append(FloatDense(weight, bias, kind, *limits[activation]))
        below = width
    return tuple(layers)
