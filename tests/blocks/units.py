"""Simulated units of one design: compensators whose parameters scatter from one to the next."""

import numpy as np

from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.dense import FloatDense, FloatFeedForward

PERIOD_S = 1.0
LSB_K = 2.0**-7
DENSE = 4


def describe_unit(
    seed: int, *, outputs: int = 6, network: bool = True, effects: bool = True
) -> tuple[FloatModel, Calibration]:
    """Return a unit's float model and what its calibration showed.

    A cubic of the temperature, one of a lagging temperature and, with `network`, dense units over
    both: what a lag bank's model is made of.

    Args:
        seed: of the unit.
        outputs: how many.
        network: whether dense units stand on it.
        effects: whether the lagging part is there.
    """
    rng = np.random.default_rng(seed)
    ops = GraphOperations(PERIOD_S)
    t = ops.input("temperature_degC")
    t0 = 20.0 + rng.normal(0, 0.5)
    late = ops.lowpass(t, 95.0 * np.exp(rng.normal(0, 0.08)))
    features = []
    for x in (t, late) if effects else (t,):
        d = ops.affine(x, 1.0, -t0)
        square = ops.product(d, d)
        features += [d, square, ops.product(square, d)]
    size = np.resize([2e-2, 1e-4, 1e-6], len(features))[:, None]
    coefficients = rng.normal(0, 1, (len(features), outputs)) * size
    span = rng.uniform(-2, 2, 2)
    limits = (round((-40 + span[0]) / LSB_K), round((80 + span[1]) / LSB_K))
    drift = 3.0 + rng.random(outputs)
    taps = (t, ops.difference(t, late))
    dense = FloatDense(rng.normal(0, 1, (DENSE, 2)), rng.normal(0, 0.5, DENSE), "tanh")
    head = rng.normal(0, 0.1, (outputs, DENSE))
    model = FloatModel(
        name="cell",
        sample_period_s=PERIOD_S,
        channels=(Channel("temperature", "degC", LSB_K, no_reading=-32768),),
        sources={"temperature_degC": 0},
        outputs=tuple(OutputFormat(f"F{k}", "N", 10_000, 200.0) for k in range(outputs)),
        features=tuple(features),
        coefficients=coefficients,
        offset=rng.normal(0, 0.2, outputs),
        taps=taps if network else (),
        tap_mean=np.array([20.0, 0.0]) + rng.normal(0, 1, 2) if network else None,
        whitening=np.diag([1 / 25.0, 1 / 3.0]) + rng.normal(0, 1e-3, (2, 2)) if network else None,
        network=FloatFeedForward((dense,), head, np.zeros(outputs)) if network else None,
    )
    calibration = Calibration(
        code_limits=(limits,),
        feature_max=np.array([2.5, 3.0]) * rng.uniform(0.8, 1.2, 2),
        drift_low=-drift,
        drift_high=drift + rng.random(outputs),
        rate_max=19 + int(rng.integers(3)),
        warm_up_steps=0,
        temperature_range=(round(-22 / LSB_K), round(62 / LSB_K)),
    )
    return model, calibration


def make_unit(
    seed: int, *, outputs: int = 6, network: bool = True, effects: bool = True
) -> IntegerModel:
    """Return a unit's integer model, in the format of its own."""
    return quantize(*describe_unit(seed, outputs=outputs, network=network, effects=effects))
