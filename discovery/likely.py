"""From the expected figures of a programme to the probability of the right verdict.

`diagnose` names an effect where its gain is sure, and alone where its rivals stay far enough
behind. Both are logistic in the logarithm of the expected figures over what the rules ask for.
Offsets and slopes are a maximum-likelihood fit to 125 verdicts on simulated sensors
(`python -m benchmarks.bench_plan probability --seed 1 --plans 18 --draws 7 --budget 3`, whose
simulator shares no code with this one), rounded.
"""

import numpy as np
from numpy.typing import NDArray

from zerodrift.diagnosis.rules import (
    ALIKE_UNITS,
    ALIKE_UNLESS_SURE,
    ENOUGH_RUNS,
    SURE_UNITS,
)
from zerodrift.discovery.criterion import Told

Array = NDArray[np.float64]

APART = (-0.7, 1.5)
"""Offset and slope of being told from the nearest rival."""
NAMED = (1.2, 3.9)
"""Offset and slope of being named at all."""
FAINT_UNITS = 100.0
"""A gain that is sure with enough runs, noise units."""
MOST = 0.98
"""Not even a large effect is always named rightly."""


def grow(apart: Array, gain: Array) -> Array:
    """Return how far rivals stay behind over what is asked for, as a logarithm."""
    return np.asarray(np.log((apart + 1e-9) / (ALIKE_UNITS + 0.5 * ALIKE_UNLESS_SURE * gain)))


def rise(gain: Array, runs: int) -> Array:
    """Return the gain over what makes it sure, as a logarithm."""
    asked = FAINT_UNITS if runs >= ENOUGH_RUNS else SURE_UNITS
    return np.asarray(np.log((gain + 1e-9) / asked))


def logistic(offset: float, slope: float, x: Array) -> Array:
    """Return 1 / (1 + exp(-(offset + slope x)))."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(offset + slope * x, -50.0, 50.0))))


def expect_verdicts(told: Told) -> Array:
    """Return the probability [M, D] that each truth is named, and alone."""
    nearest = told.apart.min(axis=2)
    alone = np.where(np.isfinite(nearest), logistic(*APART, grow(nearest, told.gain)), 1.0)
    return MOST * alone * logistic(*NAMED, rise(told.gain, told.runs))


def expect_pairs(told: Told) -> Array:
    """Return the probability [M, M] that a pair is told apart, whichever is true."""
    named = logistic(*NAMED, rise(told.gain, told.runs))[:, :, None]
    apart = logistic(
        *APART, grow(np.where(np.isfinite(told.apart), told.apart, 1e30), told.gain[:, :, None])
    )
    one_way = (MOST * named * apart).mean(axis=1)
    return np.asarray(0.5 * (one_way + one_way.T))


def weigh(told: Told) -> float:
    """Return the worth of a programme: the mean probability, and a little for what lies beyond.

    Where all probabilities are nearly 0, the second part still gives the search a direction.
    """
    p = expect_verdicts(told)
    nearest = np.minimum(told.apart.min(axis=2), 1e12)
    further = np.tanh(0.1 * (grow(nearest, told.gain) + rise(told.gain, told.runs)))
    return float(p.mean() + 0.02 * further.mean())
