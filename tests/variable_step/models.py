"""Models whose steps are told their time: any low-passes, plays, loads and clocks."""

from dataclasses import replace

import numpy as np

from tests.golden.model_factory import Shape, draw_float_model
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations

SHAPE = Shape(
    name="asleep",
    inputs=3,
    hidden=0,
    outputs=2,
    front_end=("lowpass", "difference", "play", "load", "clip", "warm_up"),
    code_limit=12000,
    measured=(1,),
    no_reading=(-32768, None, 32767, -(2**31)),
    ranges=((1, -9000, 9000), (3, -2_000_000, 2_000_000)),
    warm_up_steps=0,
)


def make_model(shape: Shape = SHAPE, seed: int = 1, *, guarded: bool = False) -> IntegerModel:
    """Return a model of a shape that has no layers, with a variable step."""
    floating, calibration = draw_float_model(shape, seed)
    model = quantize(replace(floating, variable_step=True), calibration)
    return replace(model, guarded=guarded)


def make_lowpass(taus_s: tuple[float, ...], period_s: float = 1.0) -> IntegerModel:
    """Return a model whose outputs are low-passes of its temperature."""
    floating, calibration = draw_float_model(
        replace(
            SHAPE,
            inputs=1,
            front_end=(),
            measured=(),
            no_reading=(),
            ranges=(),
            outputs=len(taus_s),
        ),
        1,
    )
    ops = GraphOperations(period_s)
    x = ops.input("source0")
    features = tuple(ops.lowpass(x, tau) for tau in taus_s)
    own = replace(
        floating,
        sample_period_s=period_s,
        features=features,
        coefficients=np.eye(len(taus_s)),
        offset=np.zeros(len(taus_s)),
        variable_step=True,
    )
    ranges = dict.fromkeys((x, *features), (-93.75, 93.75))
    return quantize(own, replace(calibration, ranges=ranges))
