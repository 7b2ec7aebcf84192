"""Graphs of any operations on any operations, in float and as integers, from a plan."""

import math

import numpy as np
from numpy.typing import NDArray

from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations, evaluate
from zerodrift.operations.operation import Node, list_nodes
from zerodrift.operations.registry import OPERATIONS as REGISTERED

Array = NDArray[np.float64]
Draw = tuple[str, int, int, float, float]
"""Operation, two earlier nodes to act on, two numbers within 0 .. 1."""

STEPS, PERIOD_S = 400, 0.5
LSBS = (2.0**-7, 2.0**-10)
LSB_PER_UNIT = 10**6
OWN_ARGUMENTS = (
    *("affine", "total", "product", "square", "cube", "root", "exp2", "lowpass", "delay"),
    *("play", "clip", "time"),
)
PLAIN = {
    name: len(operation.signals)
    for name, operation in REGISTERED.items()
    if name not in OWN_ARGUMENTS and not operation.constants
}
"""Operations that make sense of any signals, and how many they take."""
OPERATIONS = (*OWN_ARGUMENTS, *PLAIN)


def draw_codes(seed: int) -> NDArray[np.int16]:
    """Return codes [n, 2] of a slow signal and of steps."""
    rng = np.random.default_rng(seed)
    slow = 3000.0 + 2500.0 * np.sin(np.arange(STEPS) / rng.uniform(20.0, 90.0))
    steps = np.repeat(rng.integers(-9000, 9000, STEPS // 20), 20)
    return np.round(np.stack([slow + rng.normal(size=STEPS), steps], axis=1)).astype(np.int16)


def build(plan: list[Draw], inputs: dict[str, Array]) -> tuple[list[Node], dict[Node, Array]]:
    """Return the nodes of a plan and their values; each result is brought to a size of 1.

    An effect's author keeps arguments where an operation makes sense, and so does this.
    """
    ops = GraphOperations(PERIOD_S)
    nodes: list[Node] = [ops.input(name) for name in inputs]
    values: dict[Node, Array] = {}

    def settle(node: Node) -> Node:
        """Return the node scaled to a size of about 1, if it has another."""
        (found,) = evaluate([node], {**inputs, "elapsed_s": np.arange(STEPS) * PERIOD_S}, PERIOD_S)
        values[node] = found
        size = float(np.abs(found).max())
        if 0.5 <= size <= 2.0 or size == 0.0:
            return node
        return settle(ops.affine(node, 1.0 / size, 0.0))

    nodes = [settle(node) for node in nodes]
    for operation, i, j, p, q in plan:
        x, y = nodes[i % len(nodes)], nodes[j % len(nodes)]
        match operation:
            case "affine":
                made = ops.affine(x, 2.0 * p - 1.0, 2.0 * q - 1.0)
            case "total":
                made = ops.total(x, ops.affine(y, 2.0 * p - 1.0, q))
            case name if name in PLAIN:
                made = getattr(ops, name)(*(x, y)[: PLAIN[name]])
            case "product":
                made = ops.product(x, ops.affine(y, 1.0, q))
            case "square" | "cube":
                made = ops.power(ops.affine(x, 1.0, p), 2.0 if operation == "square" else 3.0)
            case "root":
                # Away from 0, where a root's slope has no bound and neither has its error.
                made = ops.power(ops.affine(ops.clip(x, -1.0, 1.0), 1.0, 1.5), 0.3 + 2.4 * p)
            case "exp2":
                made = ops.exp2(ops.affine(x, 8.0 * p - 4.0, 4.0 * q))
            case "lowpass":
                made = ops.lowpass(x, math.exp(-1.0 + 12.0 * p))
            case "delay":
                made = ops.delay(x, 8.0 * p)
            case "play":
                made = ops.play(x, 0.7 * p)
            case "clip":
                made = ops.clip(x, p - 1.2, q + 0.1)
            case _:
                halvings = ops.affine(ops.input("elapsed_s"), -0.002 - 0.03 * p, 0.0)
                made = ops.product(ops.exp2(halvings), x)
        nodes.append(settle(made))
    return nodes, values


def quantize_graph(nodes: list[Node], codes: NDArray[np.int16]) -> IntegerModel:
    """Return the model whose outputs are the last nodes, at most four."""
    return quantize(*describe_graph(nodes, codes))


def describe_graph(nodes: list[Node], codes: NDArray[np.int16]) -> tuple[FloatModel, Calibration]:
    """Return the float model whose outputs are the last nodes, and its ranges over codes."""
    wanted = nodes[-4:]
    inputs = {f"x{i}": codes[:, i] * lsb for i, lsb in enumerate(LSBS)}
    inputs["elapsed_s"] = np.arange(STEPS) * PERIOD_S
    every = list_nodes(wanted)
    found = evaluate(every, inputs, PERIOD_S)
    model = FloatModel(
        name="graph",
        sample_period_s=PERIOD_S,
        channels=tuple(Channel(f"x{i}", "", lsb) for i, lsb in enumerate(LSBS)),
        sources={f"x{i}": i for i in range(len(LSBS))},
        outputs=tuple(OutputFormat(f"y{k}", "1", LSB_PER_UNIT, 1.0) for k in range(len(wanted))),
        features=tuple(wanted),
        coefficients=np.eye(len(wanted)),
        offset=np.zeros(len(wanted)),
    )
    calibration = Calibration(
        code_limits=tuple((int(c.min()), int(c.max())) for c in codes.T),
        feature_max=np.zeros(0),
        drift_low=np.full(len(wanted), -100.0),
        drift_high=np.full(len(wanted), 100.0),
        rate_max=10_000,
        warm_up_steps=0,
        ranges={n: (float(v.min()), float(v.max())) for n, v in zip(every, found, strict=True)},
    )
    return model, calibration
