"""The golden models: one for each thing that has gone wrong in somebody's fixed-point network."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from tests.golden.model_factory import Draw, Shape, draw_model
from tests.golden.vectors import Golden, compute

from zerodrift.operations.arithmetic import CodeArray

STEPS = 120
Codes = CodeArray


@dataclass(frozen=True)
class Case:
    """How a golden file is made."""

    shape: Shape
    inputs: Callable[[Draw, int], Codes]
    """(draw, channels) -> codes [T, C]."""
    settled: bool = True
    every: int = 1


def walk(draw: Draw, channels: int) -> Codes:
    """Return a random walk, limited to the codes of -40 .. 100 degC of a TMP117."""
    steps = draw.uniform(-600.0, 600.0, STEPS, channels).cumsum(axis=0) + 3000.0
    return np.clip(np.round(steps), -5120, 12800).astype(np.int16)


def rails(draw: Draw, channels: int) -> Codes:
    """Return codes at either end of int16, each channel jumping on its own."""
    return np.where(draw.uniform(0.0, 1.0, STEPS, channels) < 0.5, -32768, 32767).astype(np.int16)


def noise(draw: Draw, channels: int) -> Codes:
    """Return any int16 codes."""
    return draw.codes(-32768, 32767, STEPS, channels)


def dwell(draw: Draw, channels: int) -> Codes:
    """Return 4,000 equal samples after a step from another temperature."""
    before, after = draw.codes(-2000, 8000, 2, channels)
    return np.concatenate([np.repeat(before[None], 10, 0), np.repeat(after[None], 3990, 0)])


def steps_of_load(draw: Draw, channels: int) -> Codes:
    """Return a walk whose last channel, a raw output of 32 bits, jumps every tenth step."""
    codes = walk(draw, channels).astype(np.int32)
    loads = draw.uniform(-4e6, 4e6, STEPS // 10).astype(np.int32)
    codes[:, -1] = np.repeat(loads, 10)
    return codes


LOWEST, HIGHEST, LOWEST_WIDE = -32768, 32767, -(2**31)
"""Codes that mean no reading in the case of that name."""


def gaps(draw: Draw, channels: int) -> Codes:
    """Return steps of load and jumps of a wide thermometer, with codes that mean no reading.

    The first two steps have none of something; then every input lacks some on its own.
    """
    codes = steps_of_load(draw, channels)
    codes[60:66, 0] = [LOWEST_WIDE + 1, 2**31 - 1, 0, -(2**31) + 1, 40000, -40000]
    none = np.array([LOWEST_WIDE, HIGHEST, codes[0, 2], LOWEST_WIDE])
    lacks = draw.uniform(0.0, 1.0, STEPS, channels) < 0.12
    lacks[0], lacks[1], lacks[2] = [True, False, False, False], [False, True, False, True], False
    lacks[:, 2] = False
    return np.where(lacks, none, codes).astype(np.int32)


CASES: dict[str, Case] = {
    "ordinary": Case(Shape(front_end=("lowpass",), update_bias=-2.0, code_limit=10000), walk),
    "rails": Case(Shape(hidden=8, outputs=2), rails),
    "saturation": Case(Shape(gain=40.0, drift_limit=60.0, code_limit=6000), noise),
    "long_dwell": Case(Shape(hidden=6, update_bias=-5.0), dwell, settled=False, every=100),
    "odd_hidden": Case(Shape(hidden=7, inputs=3), walk),
    "one_input": Case(Shape(inputs=1, hidden=5, outputs=1), walk),
    "eight_inputs": Case(Shape(inputs=8, hidden=6, outputs=16), noise),
    "reset_before": Case(Shape(reset="before", hidden=10), walk, settled=False),
    "int8": Case(Shape(weights="int8", hidden=12), walk),
    "int8_before": Case(Shape(weights="int8", reset="before", hidden=5), noise),
    "windowed": Case(Shape(window=10, outputs=6), walk, settled=False),
    "effects": Case(
        Shape(
            inputs=3,
            hidden=5,
            outputs=2,
            front_end=("exp2", "root", "play", "clip", "late", "mix", "warm_up", "load"),
            code_limit=12000,
            drift_limit=1e4,
            measured=(1,),
        ),
        steps_of_load,
        settled=False,
    ),
    "no_reading": Case(
        Shape(
            inputs=3,
            hidden=5,
            outputs=2,
            front_end=("lowpass", "delay", "play", "load"),
            code_limit=12000,
            drift_limit=1e4,
            measured=(1,),
            wide=(0,),
            no_reading=(LOWEST_WIDE, HIGHEST, None, LOWEST_WIDE),
            ranges=((1, 2000, 6000), (2, LOWEST, 4000), (3, -3_000_000, 3_000_000)),
        ),
        gaps,
        settled=True,
    ),
    "lstm": Case(Shape(inputs=3, layered=(("lstm", 7, (0,)),), forget_bias=2.0), walk),
    "lstm_saturated": Case(
        Shape(inputs=2, layered=(("lstm", 4, (0,)),), gain=30.0, outputs=2), noise, settled=False
    ),
    "lstm_int8": Case(
        Shape(inputs=3, layered=(("lstm", 6, (0,)), ("lstm", 5, (1,))), weights="int8"), walk
    ),
    "lstm_windowed": Case(
        Shape(inputs=2, layered=(("lstm", 5, (0,)), ("lstm", 3, (1,))), window=6, outputs=2), rails
    ),
    "layered": Case(
        Shape(
            inputs=3,
            layered=(
                ("relu", 5, (0,)),
                ("gru", 6, (0, 1)),
                ("tanh", 4, (1, 2)),
                ("lstm", 5, (3,)),
                ("relu", 4, (2, 4)),
            ),
        ),
        walk,
    ),
    "layer_norm": Case(
        Shape(
            inputs=3,
            layered=(
                ("relu", 5, (0,)),
                ("norm", 5, (1,)),
                ("gru", 6, (0, 2)),
                ("norm", 6, (3,)),
                ("norm", 6, (4,)),
                ("lstm", 5, (5,)),
                ("norm", 5, (6,)),
            ),
            outputs=2,
        ),
        walk,
    ),
    "front_end": Case(
        Shape(
            name="front_end",
            inputs=3,
            front_end=("lowpass", "product", "delay", "difference", "power"),
            code_limit=12000,
            channel_names=("temperature", "supply", "humidity"),
            output_names=("Fx", "Fy", "Fz"),
        ),
        walk,
        settled=False,
    ),
}
C_CASE = "front_end"
"""The model whose generated C lies here too."""


def make(name: str) -> Golden:
    """Return a golden model with its vectors, from nothing but this file."""
    case = CASES[name]
    seed = sum(name.encode())
    model = draw_model(case.shape, seed)
    codes = case.inputs(Draw(seed + 1), len(model.channels))
    return compute(model, codes, case.settled, case.every)
