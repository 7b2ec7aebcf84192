"""LSTMs that forget, with outputs so fine that their own error shows, and codes for them."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tests.bound.cases import Case
from tests.bound.recurrent import STEPS, draw_all_codes, make_case
from zerodrift.operations.lstm.cell import FloatLstm

Array = NDArray[np.float64]
REACH = 4.0
"""Of the features on the chip."""


@dataclass(frozen=True)
class Forgetful:
    """What kind of layer to draw."""

    hidden: int = 1
    weights: str = "int16"
    window: int = 0
    coupling: float = 0.25
    """Of a unit's error, what it makes of all others' in a step, at most; 0: no recurrence."""
    forget: float = 0.0
    """Bias of the forget gate; 4: a memory of 50 steps. The input gate's is the opposite."""
    of_gates: float = 0.1
    """Size of the features' weights of input and forget gate."""
    seed: int = 1


def contract(lstm: FloatLstm, coupling: float) -> FloatLstm:
    """Return a layer with recurrent weights so small that no error grows."""
    i, f, g, o = np.abs(lstm.w_h).sum(axis=2)
    # afterwards i is at most 2 coupling, f half of it
    most = lstm.bias + REACH * np.abs(lstm.w_x).sum(axis=2)
    slow = (1.0 + np.exp(most[1] + 0.5 * coupling)) / (1.0 + np.exp(-most[0] - 2.0 * coupling))
    through_cell = slow * (g + 0.25 * i + f)
    growth = np.stack([through_cell, through_cell, through_cell, 0.25 * o])
    factor = 0.5 * coupling / np.maximum(growth, 0.5 * coupling or 1.0)
    return replace(lstm, w_h=lstm.w_h * factor[..., None])


def draw_lstm(kind: Forgetful) -> FloatLstm:
    """Return a layer over two features."""
    rng = np.random.default_rng(kind.seed)
    w_x = rng.normal(size=(4, kind.hidden, 2))
    w_x[:2] *= kind.of_gates
    bias = 0.3 * rng.normal(size=(4, kind.hidden))
    bias[0] -= kind.forget
    bias[1] += kind.forget
    w_h = rng.normal(size=(4, kind.hidden, kind.hidden))
    return contract(FloatLstm(w_x, w_h, bias), kind.coupling)


@cache
def make_lstm(kind: Forgetful) -> Case:
    """Return a model of two features, an LSTM and a head."""
    rng = np.random.default_rng(kind.seed + 17)
    head = 0.3 * rng.normal(size=(2, kind.hidden))
    case = make_case(draw_lstm(kind), head, kind.weights, kind.window)
    return replace(case, codes=draw_all_codes(case.calibration.code_limits, rng, STEPS))


@cache
def measure_lstm(kind: Forgetful) -> tuple[float, ...]:
    """Return the largest errors of the outputs of a model."""
    return tuple(make_lstm(kind).measure().max(axis=(0, 1)).tolist())


def draw_probe() -> FloatLstm:
    """Return a layer whose first unit shows what its candidate is off by, most where x is low.

    The second has a weight so large that the gate is coarse: half a count is what the first one's
    is off.
    """
    w_x, bias = np.zeros((4, 2, 2)), np.zeros((4, 2))
    w_x[2, 0, 0], w_x[2, 1, 0] = -COUNTS / 2.0**8, 64.0
    bias[2, 0], bias[3, 0] = 0.75, 4.0
    return FloatLstm(w_x, np.zeros((4, 2, 2)), bias)


COUNTS = 256.5
"""Of the probe's weight: half of one more than integers hold."""


@cache
def make_lstm_probe() -> Case:
    """Return a model whose first output is the probe's."""
    case = make_case(draw_probe(), np.array([[1.0, 0.0], [0.5, 0.0]]), feature_max=0.25)
    codes = draw_all_codes(case.calibration.code_limits, np.random.default_rng(3), STEPS)
    return replace(case, codes=codes)


@cache
def measure_lstm_probe() -> tuple[float, ...]:
    """Return the largest errors of the probe's outputs."""
    return tuple(make_lstm_probe().measure().max(axis=(0, 1)).tolist())
