"""Random models of three sorts and random signals for them; each case is drawn from its number."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.effects_on_chip import random_graphs
from tests.effects_on_chip.bench import (
    draw_runs,
    make_compensator,
    make_config,
    make_physics,
)
from tests.golden.model_factory import (
    FRONT_ENDS,
    Draw,
    Shape,
    draw_float_model,
    draw_network,
)

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import CheckError
from zerodrift.codegen.selftest import limits_of
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import calibrate, describe_compensator, encode_inputs
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.operations.operation import Node, list_nodes
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.effect import Effect, Parameter

Described = tuple[FloatModel, Calibration]

SEQUENCES, STEPS = 8, 60
LOG_STEPS = 1200
PERIODS_S = (0.01, 0.5, 1.0, 10.0)
MOST_EFFECTS = 6
RANDOM_ACTIVATIONS = ("tanh", "relu", "relu6")


@dataclass(frozen=True)
class Case:
    """A model, and what it is run on."""

    number: int
    sort: str
    """effects | operations | shapes."""
    model: IntegerModel
    codes: CodeArray  # [B, T, C]
    settled: bool
    refused: int
    """Models drawn before it that the quantizer refused."""


def draw_case(seed: int, number: int) -> Case:
    """Return a case, always the same for the same seed and number."""
    rng = np.random.default_rng((seed, number))
    sort = str(rng.choice(list(SORTS)))
    refused = 0
    while True:
        try:
            described, logs = SORTS[sort](rng)
            described = replace(described[0], name=f"case{number}"), described[1]
            weights = str(rng.choice(["int16", "int8"]))
            model = quantize(*described, weights)
            break
        except CheckError:
            refused += 1
    steps = int(rng.choice([0, 1, 40]))
    model = replace(model, guards=replace(model.guards, warm_up_steps=steps))
    codes = draw_signals(rng, model, logs)
    return Case(number, sort, model, codes, bool(rng.integers(2)), refused)


def draw_effects(rng: np.random.Generator) -> tuple[Described, list[Run]]:
    """Return any effects of the catalogue at any values in their bounds, with a network or not."""
    period_s = float(rng.choice(PERIODS_S))
    runs = _draw_logs(period_s)
    catalogue = load_catalogue()
    kinds = rng.permutation(list(catalogue))[: rng.integers(1, MOST_EFFECTS + 1)]
    effects = [draw_effect(rng, catalogue[str(kind)]) for kind in kinds]
    compensator, drifting = make_compensator(make_physics(effects, runs), runs)
    config = make_config(period_s)
    model = describe_compensator(compensator, config, drifting)
    calibration = calibrate(model, drifting)
    nodes = [n for n in list_nodes(model.features) if n in calibration.ranges]
    taps = [(n, max(map(abs, calibration.ranges[n])) or 1.0) for n in nodes]
    return add_network(rng, model, calibration, taps), list(drifting)


@cache
def _draw_logs(period_s: float) -> tuple[Run, ...]:
    return draw_runs(2, LOG_STEPS, period_s)


def draw_effect(rng: np.random.Generator, effect: Effect) -> EffectConfig:
    """Return the `[[effect]]` table of an effect with every parameter drawn within its bounds."""
    held: dict[str, Any] = dict(effect.variants[rng.integers(len(effect.variants))])
    for parameter in effect.parameters:
        exists = all(held.get(name, value) == value for name, value in parameter.when.items())
        if parameter.default is None and exists:
            held[parameter.name] = _draw_value(rng, parameter)
    other = effect.is_thermal and rng.random() < 0.2
    return EffectConfig(effect.kind, held, {"signal": "body_temperature"} if other else {})


def _draw_value(rng: np.random.Generator, parameter: Parameter) -> float:
    """Return a value as hardware has it, or any within the bounds."""
    ends = parameter.typical if rng.random() < 0.5 else (parameter.lower, parameter.upper)
    if parameter.scale == "log":
        return float(np.exp(rng.uniform(*np.log(ends))))
    return float(rng.uniform(*ends))


def draw_operations(rng: np.random.Generator) -> tuple[Described, list[Run]]:
    """Return a graph of any operations on any operations, with a network or not."""
    codes = random_graphs.draw_codes(int(rng.integers(2**31)))
    inputs = {f"x{i}": codes[:, i] * lsb for i, lsb in enumerate(random_graphs.LSBS)}
    plan: list[random_graphs.Draw] = [
        (
            str(rng.choice(random_graphs.OPERATIONS)),
            *map(int, rng.integers(0, 20, 2)),
            *rng.random(2),
        )
        for _ in range(rng.integers(1, 17))
    ]
    nodes, values = random_graphs.build(plan, inputs)
    model, calibration = random_graphs.describe_graph(nodes, codes)
    known = [n for n in list_nodes(model.features) if n in values]
    taps = [(n, float(np.abs(values[n]).max()) or 1.0) for n in known]
    return add_network(rng, model, calibration, taps), []


def add_network(
    rng: np.random.Generator,
    model: FloatModel,
    calibration: Calibration,
    taps: list[tuple[Node, float]],
) -> Described:
    """Return the model with a random network on some of its signals, in three of five cases."""
    if rng.random() < 0.4 or not taps:
        return model, calibration
    inputs = int(rng.integers(1, min(len(taps), 6) + 1))
    chosen = [taps[i] for i in rng.permutation(len(taps))[: rng.integers(inputs, len(taps) + 1)]]
    shape = draw_shape(rng, inputs, len(model.outputs))
    fields = draw_network(chosen, replace(shape, hidden=max(shape.hidden, 1)), _seeded(rng))
    largest = np.full(inputs, float(rng.choice([0.5, 2.0, 8.0])))
    return replace(model, **fields), replace(calibration, feature_max=largest)


def draw_shapes(rng: np.random.Generator) -> tuple[Described, list[Run]]:
    """Return a model of any shape that the tests' factory makes."""
    shape = draw_shape(rng, int(rng.integers(1, 9)), int(rng.integers(1, 17)))
    return draw_float_model(shape, int(rng.integers(2**31))), []


def draw_shape(rng: np.random.Generator, inputs: int, outputs: int) -> Shape:
    """Return any shape with that many inputs and outputs."""
    return Shape(
        inputs=inputs,
        hidden=int(rng.integers(0, 33)),
        outputs=outputs,
        reset=str(rng.choice(["after", "before"])),
        window=int(rng.choice([0, 0, 1, 2, 10])),
        front_end=tuple(rng.choice(FRONT_ENDS, size=rng.integers(0, 6)).tolist()),
        gain=float(rng.choice([0.1, 1.0, 5.0, 40.0])),
        update_bias=float(rng.choice([0.0, -4.0, -9.0])),
        code_limit=int(rng.choice([32768, 12000, 300])),
        drift_limit=float(rng.choice([1e9, 1e4, 20.0])),
        measured=tuple(range(int(rng.integers(0, min(outputs, 3) + 1)))),
        upper=tuple(rng.integers(1, 13, size=rng.choice([0, 0, 1, 2])).tolist()),
        dense=tuple(
            (int(rng.integers(1, 13)), str(rng.choice(RANDOM_ACTIVATIONS)))
            for _ in range(rng.choice([0, 0, 1, 2]))
        ),
    )


def _seeded(rng: np.random.Generator) -> Draw:
    return Draw(int(rng.integers(2**31)))


SORTS: dict[str, Callable[[np.random.Generator], tuple[Described, list[Run]]]] = {
    "effects": draw_effects,
    "operations": draw_operations,
    "shapes": draw_shapes,
}


def draw_signals(rng: np.random.Generator, model: IntegerModel, logs: list[Run]) -> CodeArray:
    """Return codes [B, T, C]; in each sequence every channel has a signal of its own kind.

    Noise, rails and steps over all that the type holds and within the calibrated range, walks,
    sines, ramps from rail to rail, constants; one sequence is of the logs, where there are any.
    """
    low, high = (np.array(x, dtype=np.int64) for x in limits_of(model))
    codes = np.empty((SEQUENCES, STEPS, len(model.channels)), dtype=np.int64)
    for sequence in codes:
        for channel, known in enumerate(model.channels):
            limit = 1 << (known.bits - 1)
            signal = _draw_signal(rng, int(low[channel]), int(high[channel]), limit)
            sequence[:, channel] = np.clip(np.round(signal), -limit, limit - 1)
    if logs:
        log = encode_inputs(model, logs[0])
        start = int(rng.integers(0, len(log) - STEPS))
        codes[0] = log[start : start + STEPS]
    return codes.astype(model.code_type)


def _draw_signal(
    rng: np.random.Generator, low: int, high: int, limit: int
) -> Array | NDArray[np.int64]:
    if rng.random() < 0.5:
        low, high = -limit, limit - 1
    span = high - low
    match rng.choice(["noise", "ends", "steps", "walk", "sine", "ramp", "constant"]):
        case "noise":
            return rng.integers(low, high + 1, STEPS)
        case "ends":  # held for any number of steps
            turns = rng.random(STEPS) < rng.choice([0.02, 0.2, 1.0])
            return np.where(np.cumsum(turns) % 2 == 0, low, high)
        case "steps":
            held = int(rng.integers(1, 50))
            return np.repeat(rng.integers(low, high + 1, STEPS // held + 1), held)[:STEPS]
        case "walk":
            walk = rng.uniform(low, high) + np.cumsum(rng.normal(size=STEPS)) * span / 50.0
            return np.clip(walk, low, high)
        case "sine":
            phase = np.arange(STEPS) / rng.uniform(3.0, 100.0)
            return (low + high) / 2.0 + span / 2.0 * np.sin(phase)
        case "ramp":
            return np.linspace(low, high, STEPS)[:: int(rng.choice([-1, 1]))]
        case _:
            return np.full(STEPS, rng.choice([low, high, rng.integers(low, high + 1)]))
