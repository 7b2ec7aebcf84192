"""Unsound error rules, and models on which each of them shows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache

import numpy as np

from tests.bound.cases import Case
from tests.effects_on_chip.random_graphs import LSBS, describe_graph, draw_codes
from zerodrift.export.float_network import FloatNetwork
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.errors import NONE, Error, Known
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.operation import Node
from zerodrift.operations.signals import Real

PERIOD_S, FINE, BATCH = 0.5, 10**9, 24
Rule = Callable[[IntegerNode, Real, Known, Sequence[Known]], Error]


@dataclass(frozen=True)
class PlantedRule:
    """A rule that leaves something out."""

    kind: str
    """Of node."""
    lacks: str
    """A cause that it takes for nothing, "inputs": their errors, or "half": half of everything."""
    model: str
    """Of `MODELS`, where it shows."""

    def replace(self, rule: Rule) -> Rule:
        """Return the unsound rule in the place of the right one."""

        def unsound(node: IntegerNode, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
            if self.lacks == "inputs":
                return rule(node, real, out, [replace(x, error=NONE) for x in inputs])
            error = rule(node, real, out, inputs)
            if self.lacks == "half":
                return error.scale(Fraction(1, 2))
            return replace(error, **{self.lacks: Fraction(0)})

        return unsound


def _list_models() -> dict[str, Callable[[GraphOperations], list[Node]]]:
    def x(ops: GraphOperations) -> Node:
        return ops.affine(ops.input("x0"), 1.0 / 47.0, 0.0)

    def y(ops: GraphOperations) -> Node:
        return ops.affine(ops.input("x1"), 1.0 / 9.0, 0.13)

    return {
        "sum": lambda o: [o.total(x(o), o.affine(y(o), 0.371, 0.0))],
        "product": lambda o: [o.product(x(o), y(o))],
        "square": lambda o: [o.power(o.affine(x(o), 1.0, -0.371), 2.0)],
        "cube": lambda o: [o.power(o.affine(x(o), 1.0, 0.2), 3.0)],
        "root": lambda o: [o.power(o.affine(x(o), 1.0, 0.7), 0.41)],
        "root of a low-pass": lambda o: [o.power(o.affine(o.lowpass(x(o), 7.0), 1.0, 0.7), 0.41)],
        "exp2": lambda o: [o.exp2(o.affine(x(o), 1.7, 0.3))],
        "exp2 of a low-pass": lambda o: [o.exp2(o.affine(o.lowpass(x(o), 7.0), 1.7, 0.3))],
        "lowpass": lambda o: [o.lowpass(x(o), 7.0)],
        "lowpass of a product": lambda o: [o.lowpass(o.product(x(o), y(o)), 0.9)],
        "difference": lambda o: [o.difference(o.lowpass(x(o), 7.0), o.lowpass(x(o), 31.0))],
        "delay": lambda o: [o.delay(o.product(x(o), y(o)), 3.3)],
        "play": lambda o: [o.play(o.product(x(o), y(o)), 0.1234567)],
        "play alone": lambda o: [o.play(x(o), 0.31234567)],
        "clip": lambda o: [o.clip(x(o), -0.1234567, 0.3234567)],
        "clip of a product": lambda o: [o.clip(o.product(x(o), y(o)), -0.3, 0.3)],
        "maximum": lambda o: [o.maximum(o.product(x(o), y(o)), o.power(x(o), 2.0))],
        "minimum": lambda o: [o.minimum(o.product(x(o), y(o)), o.power(x(o), 2.0))],
        "drift": lambda o: [x(o), y(o)],
        "offset": lambda o: [o.product(o.affine(x(o), 1.0, 0.3337), o.affine(x(o), 1.0, 0.777))],
    }


MODELS = _list_models()
NETWORKS = ("tanh", "rectifier", "two layers")


@cache
def make_case(name: str) -> Case:
    """Return a model of few operations with codes that go everywhere."""
    rng = np.random.default_rng(17)
    ops = GraphOperations(PERIOD_S)
    network = name in NETWORKS
    nodes = MODELS["drift" if network else name](ops)
    described, calibration = describe_graph(nodes, draw_codes(5))
    described = replace(
        described, outputs=tuple(replace(o, lsb_per_unit=FINE) for o in described.outputs)
    )
    ends = np.full(len(nodes), 2.0)
    calibration = replace(calibration, drift_low=-ends, drift_high=ends)
    if network:
        layers = [FloatDense(rng.normal(size=(3, 2)), rng.normal(size=3), "tanh")]
        if name == "rectifier":
            layers = [FloatDense(rng.normal(size=(3, 2)), rng.normal(size=3), "clip", -0.31, 0.57)]
        if name == "two layers":
            layers.append(FloatDense(rng.normal(size=(2, 3)), rng.normal(size=2), "tanh"))
        rows = layers[-1].weight.shape[0]
        described = replace(
            described,
            taps=described.features,
            features=(),
            coefficients=np.zeros((0, 2)),
            tap_mean=np.array([0.11, -0.07]),
            whitening=np.array([[0.7, 0.21], [-0.3, 0.9]]),
            network=FloatNetwork.stack(
                layers, 0.3 * rng.normal(size=(2, rows)), rng.normal(size=2) * 0.1
            ),
        )
        calibration = replace(calibration, feature_max=np.array([1.0, 1.0]))
    low, high = np.array(calibration.code_limits).T
    steps = 400
    noise = rng.integers(low, high + 1, size=(BATCH, steps, len(LSBS)))
    turns = np.cumsum(rng.random((BATCH, steps, len(LSBS))) < 0.05, axis=1) % 2
    bang = np.where(turns == 0, low, high)
    walk = np.clip(np.cumsum(rng.integers(-90, 91, noise.shape), axis=1) + 3000, low, high)
    codes = np.concatenate([noise, bang, walk]).astype(np.int64)
    return replace(Case.of(described, calibration), codes=codes)


@cache
def measure(name: str) -> tuple[float, ...]:
    """Return the largest errors of the outputs of a model."""
    return tuple(make_case(name).measure().max(axis=(0, 1)).tolist())


FOUND = (
    PlantedRule("clip", "coefficients", "clip of a product"),
    PlantedRule("clip", "half", "clip of a product"),
    PlantedRule("clip", "inputs", "clip of a product"),
    PlantedRule("clip", "rounding", "clip of a product"),
    PlantedRule("delay", "coefficients", "delay"),
    PlantedRule("delay", "half", "delay"),
    PlantedRule("delay", "inputs", "delay"),
    PlantedRule("delay", "rounding", "delay"),
    PlantedRule("dense", "half", "two layers"),
    PlantedRule("dense", "inputs", "two layers"),
    PlantedRule("difference", "half", "difference"),
    PlantedRule("difference", "inputs", "difference"),
    PlantedRule("difference", "lowpass", "difference"),
    PlantedRule("drift", "coefficients", "product"),
    PlantedRule("drift", "half", "sum"),
    PlantedRule("drift", "inputs", "sum"),
    PlantedRule("drift", "lowpass", "lowpass"),
    PlantedRule("drift", "output", "sum"),
    PlantedRule("drift", "rounding", "sum"),
    PlantedRule("drift", "table", "root"),
    PlantedRule("exp2", "rounding", "exp2"),
    PlantedRule("feature_dense", "inputs", "rectifier"),
    PlantedRule("feature_dense", "rounding", "rectifier"),
    PlantedRule("features", "rounding", "rectifier"),
    PlantedRule("head", "inputs", "rectifier"),
    PlantedRule("head", "rounding", "rectifier"),
    PlantedRule("lowpass", "coefficients", "lowpass of a product"),
    PlantedRule("lowpass", "half", "lowpass"),
    PlantedRule("lowpass", "inputs", "lowpass of a product"),
    PlantedRule("lowpass", "lowpass", "lowpass"),
    PlantedRule("maximum", "coefficients", "maximum"),
    PlantedRule("maximum", "half", "maximum"),
    PlantedRule("maximum", "inputs", "maximum"),
    PlantedRule("maximum", "rounding", "maximum"),
    PlantedRule("minimum", "coefficients", "minimum"),
    PlantedRule("minimum", "half", "minimum"),
    PlantedRule("minimum", "inputs", "minimum"),
    PlantedRule("minimum", "rounding", "minimum"),
    PlantedRule("offset", "coefficients", "product"),
    PlantedRule("offset", "half", "product"),
    PlantedRule("play", "coefficients", "play"),
    PlantedRule("play", "half", "play"),
    PlantedRule("play", "inputs", "play"),
    PlantedRule("play", "rounding", "play"),
    PlantedRule("power", "table", "root"),
    PlantedRule("product", "coefficients", "product"),
    PlantedRule("product", "half", "product"),
    PlantedRule("product", "inputs", "product"),
    PlantedRule("product", "rounding", "product"),
    PlantedRule("sum", "coefficients", "maximum"),
    PlantedRule("sum", "half", "sum"),
    PlantedRule("sum", "inputs", "maximum"),
    PlantedRule("sum", "rounding", "sum"),
)
"""Every one of them is found: an input of its model goes beyond what it claims."""
