"""From the expected figures of a programme to the probability of the right verdict.

`diagnose` names an effect where its gain is sure and the error falls by enough, and alone where its
rivals stay far enough behind, or are seen to be another effect in disguise. All but the last are
logistic in the logarithm of the expected figures over what the rules ask for. An effect that is not
among the open ones is named instead where noise makes up for its expected distance, which spreads
by twice its root (the log-likelihood ratio of two models of Gaussian noise is so distributed; Cox,
JRSS B 24 (1962)).
Offsets and slopes are a maximum-likelihood fit to 290 verdicts on simulated sensors (`python -m
benchmarks.study_likely`, whose simulator shares no code with this one), rounded. The offset
for one or two logs is of 29 earlier verdicts; of 40 of this version (`python -m
benchmarks.study_few_logs`) the likeliest is 2.5, and the one below is less likely by 0.2 nats.
"""

import numpy as np
from scipy.special import ndtr

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.evidence import SURE_NATS
from zerodrift.diagnosis.judgement import MANY_RUNS
from zerodrift.diagnosis.rules import (
    ALIKE_UNITS,
    ALIKE_UNLESS_SURE,
    ENOUGH_RUNS,
    SURE_UNITS,
    WORTHWHILE,
    WORTHWHILE_ON_ONE,
)
from zerodrift.discovery.criterion import Told

APART = (-0.2, 2.4)
"""Offset and slope of being told from the nearest rival."""
NAMED = (1.1, 3.7)
"""Offset and slope of being named at all with enough runs, ..."""
NAMED_OF_FEW = (-0.5, 2.6)
"""... and with fewer, where it may also lose next to nothing in any run, ..."""
NAMED_OF_FEWEST = (2.0, 2.6)
"""... but with one or two, whose pieces are the evidence; the slope is that of few."""
WORTH = (-1.4, 2.9)
"""Offset and slope of lowering the error by enough; in runs left out, by which `diagnose` judges,
it falls by less than is expected of a fit to all."""
MOST = 0.98
"""Not even a large effect is always named rightly."""


def grow(apart: Array, gain: Array) -> Array:
    """Return how far rivals stay behind over what is asked for, as a logarithm."""
    return np.asarray(np.log((apart + 1e-9) / (ALIKE_UNITS + 0.5 * ALIKE_UNLESS_SURE * gain)))


def rise(gain: Array, nats: Array) -> Array:
    """Return the gain over what makes it sure, as a logarithm, by the surer measure."""
    return np.asarray(np.log(np.maximum(gain / SURE_UNITS, nats / SURE_NATS) + 1e-9))


def outgrow(excess: Array) -> Array:
    """Return [M, D] the fall of the squared error over what is worth having, as a logarithm."""
    overall = excess.mean(axis=2) / (WORTHWHILE**-2 - 1.0)
    best = excess.max(axis=2) / (WORTHWHILE_ON_ONE**-2 - 1.0)
    return np.asarray(np.log(np.maximum(overall, best) + 1e-9))


def logistic(offset: float, slope: float, x: Array) -> Array:
    """Return 1 / (1 + exp(-(offset + slope x)))."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(offset + slope * x, -50.0, 50.0))))


def _expect_naming(told: Told) -> Array:
    """Return the probability [M, D] that each truth is named at all, before any other effect."""
    sure = NAMED if told.runs >= ENOUGH_RUNS else NAMED_OF_FEW
    sure = NAMED_OF_FEWEST if told.runs < MANY_RUNS else sure
    named = logistic(*sure, rise(told.gain, told.nats))
    worth = logistic(*WORTH, outgrow(told.excess))
    return np.asarray(MOST * named * worth * ndtr(0.5 * np.sqrt(np.maximum(told.beside, 0.0))))


def tell_disguised(apart: Array, distance: Array, disguised: Array) -> Array:
    """Return the probability that a rival is told from the truth, which may be in disguise.

    One that is seen to be in disguise is no look-alike unless it does better than the truth by
    chance: a difference of two squared errors spreads by twice its root.

    Args:
        apart: probability that it stays far enough behind.
        distance: squared distance of the two, noise units.
        disguised: probability that it is seen to be in disguise.
    """
    behind = ndtr(0.5 * np.sqrt(np.maximum(distance, 0.0)))
    return np.asarray(apart + disguised * np.maximum(behind - apart, 0.0))


def tell_rivals_apart(told: Told) -> Array:
    """Return the probability [M, D, M] that each rival is told from each truth."""
    near = np.isfinite(told.apart)
    distance = np.where(near, told.apart, 1e30)
    apart = logistic(*APART, grow(distance, told.gain[:, :, None]))
    return np.where(near, tell_disguised(apart, distance, told.disguised), 1.0)


def expect_verdicts(told: Told) -> Array:
    """Return the probability [M, D] that each truth is named, and alone."""
    return np.asarray(tell_rivals_apart(told).min(axis=2) * _expect_naming(told))


def expect_pairs(told: Told) -> Array:
    """Return the probability [M, M] that a pair is told apart, whichever is true."""
    one_way = (_expect_naming(told)[:, :, None] * tell_rivals_apart(told)).mean(axis=1)
    return np.asarray(0.5 * (one_way + one_way.T))


def weigh(told: Told) -> float:
    """Return the worth of a programme: the mean probability, and a little for what lies beyond.

    Where all probabilities are nearly 0, the second part still gives the search a direction.
    """
    p = expect_verdicts(told)
    nearest = np.minimum(told.apart.min(axis=2), 1e12)
    further = np.tanh(
        0.1
        * (
            grow(nearest, told.gain)
            + rise(told.gain, told.nats)
            + np.minimum(outgrow(told.excess), 0.0)
        )
    )
    return float(p.mean() + 0.02 * further.mean())
