"""GRUs that forget, with outputs so fine that their own error shows, and codes for them."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tests.bound.cases import Case
from tests.bound.planted import BATCH, FINE, PERIOD_S
from tests.effects_on_chip.random_graphs import LSBS, describe_graph, draw_codes
from zerodrift.export.float_network import FloatNetwork
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.lstm.cell import FloatLstm

Array = NDArray[np.float64]
STEPS = 400


@dataclass(frozen=True)
class Forgetful:
    """What kind of layer to draw."""

    hidden: int = 1
    reset: str = "after"
    weights: str = "int16"
    window: int = 0
    coupling: float = 0.5
    """Of a unit's error, what it makes of all others' in a step, at most; 0: no recurrence."""
    update: float = 0.0
    """Bias of the update gate; 6: the state is the candidate, -6: a memory of 400 steps."""
    of_update: float = 1.0
    """Size of the features' weights there."""
    of_candidate: float = 1.0
    exact: bool = False
    """Whether weights and biases are multiples of 1/16, which integers hold."""
    seed: int = 1
    upper: tuple[int, ...] = ()
    """Units of further layers, each on the state of the one below."""


def contract(gru: FloatGru, coupling: float) -> FloatGru:
    """Return a layer with recurrent weights so small that no error grows."""
    r, u, n = np.abs(gru.w_h).sum(axis=2)
    inside = n + np.abs(gru.bias[3])
    if gru.reset == "before":
        inside = n
        r = np.full_like(r, r.max())
    growth = n + 0.25 * inside * r + u
    factor = coupling / np.maximum(growth, coupling or 1.0)
    return replace(
        gru, w_h=gru.w_h * factor[:, None] if gru.reset == "after" else gru.w_h * factor.min()
    )


def draw_gru(kind: Forgetful) -> FloatGru:
    """Return a layer over two features."""
    return _draw_layer(kind, np.random.default_rng(kind.seed), 2)


def draw_upper(kind: Forgetful) -> tuple[FloatGru, ...]:
    """Return the layers on top of it."""
    rng, below = np.random.default_rng(kind.seed + 31), kind.hidden
    layers: list[FloatGru] = []
    for hidden in kind.upper:
        layers.append(_draw_layer(replace(kind, hidden=hidden), rng, below))
        below = hidden
    return tuple(layers)


def _draw_layer(kind: Forgetful, rng: np.random.Generator, inputs: int) -> FloatGru:
    w_x = rng.normal(size=(3, kind.hidden, inputs))
    w_x[1] *= kind.of_update
    w_x[2] *= kind.of_candidate
    bias = 0.3 * rng.normal(size=(4, kind.hidden))
    bias[1] += kind.update
    if kind.reset == "before":
        bias[3] = 0.0
    w_h = rng.normal(size=(3, kind.hidden, kind.hidden))
    gru = contract(FloatGru(w_x, w_h, bias, kind.reset), kind.coupling)
    if not kind.exact:
        return gru
    return FloatGru(*(np.round(16.0 * w) / 16.0 for w in (gru.w_x, gru.w_h, gru.bias)), kind.reset)


@cache
def make_recurrent(kind: Forgetful) -> Case:
    """Return a model of two features, a GRU and a head."""
    rng = np.random.default_rng(kind.seed + 17)
    head = 0.3 * rng.normal(size=(2, (kind.hidden, *kind.upper)[-1]))
    case = make_case(draw_gru(kind), head, kind.weights, kind.window, upper=draw_upper(kind))
    return replace(case, codes=draw_all_codes(case.calibration.code_limits, rng, STEPS))


def make_case(
    cell: FloatGru | FloatLstm,
    head: Array,
    weights: str = "int16",
    window: int = 0,
    feature_max: float = 1.0,
    upper: tuple[FloatGru, ...] = (),
) -> Case:
    """Return a model of two features, GRUs or an LSTM and a head [2, H], without codes."""
    bias = np.array([0.11, -0.07])
    network = FloatNetwork.stack((cell, *upper), head, bias)
    ops = GraphOperations(PERIOD_S)
    x = ops.affine(ops.input("x0"), 1.0 / 47.0, 0.0)
    nodes = [x, ops.affine(ops.input("x1"), 1.0 / 9.0, 0.13)]
    described, calibration = describe_graph(nodes, draw_codes(5))
    outputs = tuple(replace(o, lsb_per_unit=FINE) for o in described.outputs)
    described = replace(
        described,
        outputs=outputs,
        taps=described.features,
        features=(),
        coefficients=np.zeros((0, 2)),
        tap_mean=np.array([0.11, -0.07]),
        whitening=np.array([[0.7, 0.21], [-0.3, 0.9]]),
        network=network,
        window=window,
    )
    ends = np.full(2, 2.0)
    largest = np.full(2, feature_max)
    calibration = replace(calibration, drift_low=-ends, drift_high=ends, feature_max=largest)
    return Case.of(described, calibration, weights)


def draw_all_codes(
    limits: tuple[tuple[int, int], ...], rng: np.random.Generator, steps: int
) -> NDArray[np.int64]:
    """Return noise, bang-bang at several rates, rests and walks [B, steps, C]."""
    low, high = np.array(limits).T
    shape = (BATCH, steps, len(LSBS))
    noise = rng.integers(low, high + 1, size=shape)
    bangs = []
    for rate in (0.3, 0.05, 0.01):
        turns = np.cumsum(rng.random(shape) < rate, axis=1) % 2
        bangs.append(np.where(turns == 0, low, high))
    rests = np.repeat(rng.integers(low, high + 1, size=(BATCH, 8, len(LSBS))), steps // 8, axis=1)
    walk = np.clip(np.cumsum(rng.integers(-90, 91, shape), axis=1) + 3000, low, high)
    return np.concatenate([noise, *bangs, rests, walk]).astype(np.int64)


@cache
def measure_recurrent(kind: Forgetful) -> tuple[float, ...]:
    """Return the largest errors of the outputs of a model."""
    return tuple(make_recurrent(kind).measure().max(axis=(0, 1)).tolist())


MEMORY = 2400
"""Steps of the layer with a memory of 1100."""
PROBES = ("alone", "slow", "states", "update", "reset", "passed on", "passed to u")


def draw_probe(name: str) -> FloatGru:
    """Return a layer whose first unit shows one part of the rule; u = 1/2 unless it is about u.

    Units 1 to 8 hold still, or follow x. A last one has a weight so large that its gate is coarse,
    so that a weight halfway between two integers is off by much.
    """
    w_x, w_h, bias = np.zeros((3, 10, 2)), np.zeros((3, 10, 10)), np.zeros((4, 10))
    probe, others, spoiler = 0, slice(1, 9), 9
    w_x[2, probe, 0] = 1.0
    bias[2, others] = 1.5
    if name == "slow":
        bias[1, probe] = -7.0
        w_x[2, probe, 0] = 4.0
    if name == "states":
        w_x[2, spoiler, 0] = 16.0
        w_h[2, probe, others] = 40.5 / 2.0**12
    if name == "update":
        w_x[1, spoiler, 0] = 4.0
        w_x[2, probe, 0] = 4.0
        w_h[1, probe, others] = 40.5 / 2.0**13
    if name == "reset":
        w_x[0, spoiler, 0] = 4.0
        w_h[0, probe, others] = 40.5 / 2.0**13
        bias[3, probe], bias[2, probe] = 4.0, -2.0
    if name.startswith("passed"):
        w_x[2, spoiler, 0] = 64.0
        w_x[2, others, 1] = 128.5 / 2.0**9
        bias[2, others] = 0.0
        w_h[1 if name == "passed to u" else 2, probe, others] = 0.125
        w_x[2, probe, 0] = 4.0 if name == "passed to u" else 0.5
    return FloatGru(w_x, w_h, bias, "after")


@cache
def make_probe(name: str) -> Case:
    """Return a model whose first output is the first unit's state."""
    head = np.zeros((2, 10))
    head[:, 0] = 1.0, 0.5
    case = make_case(draw_probe(name), head, feature_max=0.25)
    steps = MEMORY if name == "slow" else STEPS
    rng = np.random.default_rng(3)
    return replace(case, codes=draw_all_codes(case.calibration.code_limits, rng, steps))


@cache
def measure_probe(name: str) -> tuple[float, ...]:
    """Return the largest errors of the outputs of a probe."""
    return tuple(make_probe(name).measure().max(axis=(0, 1)).tolist())
