"""Simulated units of one design: compensators whose parameters scatter from one to the next."""

import numpy as np

from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru

PERIOD_S = 1.0
LSB_K = 2.0**-7
DENSE = 4


def describe_unit(
    seed: int, *, outputs: int = 6, network: bool = True, effects: bool = True, hidden: int = 0
) -> tuple[FloatModel, Calibration]:
    """Return a unit's float model and what its calibration showed.

    A cubic of the temperature, one of a lagging temperature and, with `network`, dense units over
    both: what a lag bank's model is made of.

    Args:
        seed: of the unit.
        outputs: how many.
        network: whether dense units stand on it.
        effects: whether the lagging part is there.
        hidden: units of a GRU in the place of the dense ones; 0: the dense ones stay.
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
    feed_forward = FloatNetwork.stack((dense,), head, np.zeros(outputs))
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
        network=(draw_gru(seed, outputs, hidden) if hidden else feed_forward) if network else None,
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


def describe_effects(
    seed: int, kinds: tuple[str, ...] = ("exp2", "play", "delay", "load", "warm_up")
) -> tuple[FloatModel, Calibration]:
    """Return a unit with a dark current, a hysteresis, a late thermometer, a load and a warm-up.

    Args:
        seed: of the unit; every parameter of its effects is its own.
        kinds: which of them.
    """
    rng = np.random.default_rng(seed)
    ops = GraphOperations(PERIOD_S)
    t = ops.input("temperature_degC")
    rise = ops.affine(t, 1.0, -20.0 + rng.normal(0, 0.5))
    scatter = dict(zip(kinds, np.exp(rng.normal(0, 0.1, len(kinds))).tolist(), strict=True))
    nodes = {"rise": (rise, 100.0)}
    for kind, share in scatter.items():
        if kind == "exp2":
            nodes[kind] = (ops.exp2(ops.affine(rise, 1 / (9.0 * share), 0.0)), 300.0)
        elif kind == "play":
            nodes[kind] = (ops.difference(ops.play(t, 2.0 * share), t), 3.0)
        elif kind == "delay":
            nodes[kind] = (ops.difference(t, ops.delay(t, 2.5 * share**0.5)), 5.0)
        elif kind == "load":
            load = ops.input("load:F0")
            nodes[kind] = (ops.product(ops.affine(rise, 1e-3, 0.0), load), 40.0)
        else:
            halvings = ops.affine(ops.input("elapsed_s"), -1 / (60.0 * share), 0.0)
            nodes[kind] = (ops.exp2(halvings), 1.0)
    limits = (round((-40 + rng.uniform(-2, 2)) / LSB_K), round(80 / LSB_K))
    channels = [Channel("temperature", "degC", LSB_K, no_reading=-32768)]
    sources = {"temperature_degC": 0}
    if "load" in kinds:
        channels.append(Channel("measured", "N", 1e-4, bits=32))
        sources["load:F0"] = 1
    model = FloatModel(
        name="cell",
        sample_period_s=PERIOD_S,
        channels=tuple(channels),
        sources=sources,
        outputs=tuple(OutputFormat(f"F{k}", "N", 10_000, 200.0) for k in range(2)),
        features=tuple(node for node, _ in nodes.values()),
        coefficients=np.stack([rng.normal(0, 1 / most, 2) for _, most in nodes.values()]),
        offset=rng.normal(0, 0.2, 2),
    )
    load = round((400 + rng.uniform(0, 50)) * 10_000)
    calibration = Calibration(
        code_limits=(limits, *(((-load, load),) if "load" in kinds else ())),
        feature_max=np.zeros(0),
        drift_low=np.full(2, -3.0 - rng.random()),
        drift_high=np.full(2, 3.0 + rng.random()),
        rate_max=19,
        warm_up_steps=0,
        temperature_range=(round(-22 / LSB_K), round(62 / LSB_K)),
        ranges={node: (-most, most) for name, (node, most) in nodes.items() if name != "exp2"},
    )
    return model, calibration


def draw_gru(seed: int, outputs: int, hidden: int) -> FloatNetwork:
    """Return a GRU of a unit's own: nothing of it but its size is another unit's.

    Weights are uniform as before a training, each gate's then larger or smaller as a whole.
    """
    rng = np.random.default_rng((seed, 1))
    end = hidden**-0.5
    size = np.exp(rng.normal(0, 0.3, (3, 1, 1)))
    w_x, w_h = (rng.uniform(-end, end, (3, hidden, n)) * 2 * size for n in (2, hidden))
    bias = rng.uniform(-end, end, (4, hidden)) * 2
    gru = FloatGru(w_x, w_h, bias, "after")
    head = rng.normal(0, 0.3, (outputs, hidden)) * end
    return FloatNetwork.stack((gru,), head, np.zeros(outputs))


def make_unit(
    seed: int, *, outputs: int = 6, network: bool = True, effects: bool = True, hidden: int = 0
) -> IntegerModel:
    """Return a unit's integer model, in the format of its own."""
    return quantize(
        *describe_unit(seed, outputs=outputs, network=network, effects=effects, hidden=hidden)
    )
