"""The network's inputs: a few linear, causal filters of the thermometers, decorrelated.

Temperature and its lags or differences are nearly the same signal, and a network that is given them
unchanged has to learn first to separate them. The front end therefore passes on, tap by tap, only
what a tap adds to those before it, at unit variance over the training logs:

    x = matrix (v - mean)

with a lower triangular `matrix`, so that each feature needs only its own tap and the earlier ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.linalg import solve_triangular

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.runs import Run
from zerodrift.operations.backend import GraphOperations, NumpyOperations, Operations
from zerodrift.operations.operation import Node

S = TypeVar("S")

MAX_TAPS = 8
"""Taps of one sample: more of them cost instructions and have not been seen to help."""
MAX_FEATURES = 64
"""Taps of a whole window."""
TEMPERATURE = "temperature_degC"
NOISE_FLOOR = 10.0
"""A feature is given unit variance only down to this multiple of the thermometer's noise variance:
a fast lag of a slow signal is mostly noise, and must not be blown up into one."""


@dataclass(frozen=True)
class Tap:
    """One linear view of one signal."""

    kind: str
    """level: the signal itself; lag: signal - lowpass(signal, tau_s); step: signal - its past."""
    source: str = TEMPERATURE
    """temperature_degC, or an input channel by the name that effects use."""
    tau_s: float = 0.0
    """Time constant of a lag, seconds."""
    steps: int = 0
    """How far back a step looks, samples; of a level or a lag, how long ago it is taken."""
    hops: int = 1
    """Delays in a row that make up `steps`; taps of one window share them."""

    def build(self, ops: Operations[S], signal: S) -> S:
        """Return the tap of `signal`, computed or recorded; every tap is at rest at the start."""
        if self.kind == "step":
            return ops.difference(signal, ops.delay(signal, self.steps * ops.sample_period_s))
        view = signal
        if self.kind == "lag":
            view = ops.difference(signal, ops.lowpass(signal, self.tau_s))
        for _ in range(self.hops if self.steps else 0):
            view = ops.delay(view, self.steps / self.hops * ops.sample_period_s)
        return view

    def __str__(self) -> str:
        """Return how reports name the tap."""
        ago = f", {self.steps} samples ago" if self.steps else ""
        match self.kind:
            case "lag":
                return f"{self.source} - lowpass({self.tau_s:g} s){ago}"
            case "step":
                return f"{self.source} - {self.steps} samples ago"
            case _:
                return f"{self.source}{ago}"


@dataclass(frozen=True)
class FrontEnd:
    """The taps, and the linear map that makes features of unit variance from them."""

    taps: tuple[Tap, ...]
    mean: Array
    """[I] of the taps over the training logs, in their units."""
    matrix: Array
    """[I, I] lower triangular, features per unit of the taps."""
    sample_period_s: float

    @property
    def width(self) -> int:
        """Number of features I."""
        return len(self.taps)

    def compute(self, run: Run) -> Array:
        """Return the features [n, I] of a run.

        Raises:
            InputError: the run lacks a channel that the front end reads.
        """
        return np.asarray((compute_taps(self.taps, run) - self.mean) @ self.matrix.T)

    def graph(self, ops: GraphOperations) -> tuple[Node, ...]:
        """Return the raw taps v as graph nodes; `mean` and `matrix` make the features of them."""
        return tuple(tap.build(ops, ops.input(tap.source)) for tap in self.taps)


def read_source(run: Run, source: str) -> Array:
    """Return the signal [n] of a run that a tap reads.

    Raises:
        InputError: the run has no such channel.
    """
    if source == TEMPERATURE:
        return run.temperature_degC
    if source not in run.inputs:
        raise InputError(
            f"{run.source}: run '{run.name}' has no input '{source}', which the network reads"
            f"{nearest(source, run.inputs)} Add the column to the log, or train again without it."
        )
    return run.inputs[source]


def compute_taps(taps: Sequence[Tap], run: Run) -> Array:
    """Return the raw taps v [n, I] of a run, in their units."""
    ops = NumpyOperations(run.sample_period_s, (len(run),))
    return np.stack([tap.build(ops, read_source(run, tap.source)) for tap in taps], axis=1)


def fit_front_end(
    taps: Sequence[Tap], runs: Sequence[Run], *, decorrelate: bool = True
) -> FrontEnd:
    """Return the front end whose features are uncorrelated over `runs`, of variance 1 or less.

    Args:
        taps: of one sample at most MAX_TAPS; the order is that in which each takes what the earlier
            left.
        runs: the training runs.
        decorrelate: False only scales, for a network that treats the samples of a window alike.

    Raises:
        InputError: too many taps, or a tap does not move over the runs.
    """
    present = sum(not (tap.steps and tap.kind != "step") for tap in taps)
    if present > MAX_TAPS or len(taps) > MAX_FEATURES:
        raise InputError(
            f"the network would see {len(taps)} signals, {present} of them of the present sample;"
            f" at most {MAX_FEATURES} and {MAX_TAPS} fit. Name fewer lags under [network] lags_s,"
            " or a shorter memory."
        )
    raw = np.concatenate([compute_taps(taps, run) for run in runs])
    mean = raw.mean(axis=0)
    covariance = np.atleast_2d(np.cov(raw, rowvar=False, bias=True))
    for tap, variance in zip(taps, np.diag(covariance), strict=True):
        if variance == 0.0:
            raise InputError(
                f"'{tap}' is constant over all training runs, so the network cannot learn from it."
                " Train on logs in which it moves, or leave it out."
            )
    noise = np.array([_noise_variance(tap.source, runs) for tap in taps])
    if not decorrelate:
        covariance = np.diag(np.diag(covariance))
    factor = np.linalg.cholesky(covariance + np.diag(NOISE_FLOOR * noise))
    matrix = solve_triangular(factor, np.eye(len(taps)), lower=True)
    return FrontEnd(tuple(taps), mean, matrix, runs[0].sample_period_s)


def _noise_variance(source: str, runs: Sequence[Run]) -> float:
    """Return the variance of a signal's white noise, from its second differences.

    White noise of variance s^2 has second differences of variance 6 s^2; what a thermal mass lets
    through has next to none at the sample period. A floor keeps noiseless signals invertible.
    """
    signals = [read_source(run, source) for run in runs]
    curvature = np.concatenate([np.diff(x, n=2) for x in signals])
    spread = max(float(np.ptp(np.concatenate(signals))), 1e-12)
    return max(float(np.mean(curvature**2)) / 6.0, (1e-6 * spread) ** 2)
