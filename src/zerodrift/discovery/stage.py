"""Logs on the stage: what a sensor is exposed to in them, and how their noise becomes white.

Signals are taken apart into octaves, in which the measured noise is white once each octave is
weighted (see `physics.octaves`). A log's mean is left out, since logs may be tared.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.discovery.contenders import Scene
from zerodrift.discovery.programme import Log, PlannedCourse
from zerodrift.physics.effect import Signals
from zerodrift.physics.reduction import MEANS, Octaves, cut_octaves

POWERED_EARLIER_S = 7200.0


@dataclass(frozen=True)
class Whitening:
    """How block means of one log become white coefficients without the mean."""

    octaves: Octaves
    keep: NDArray[np.bool_]
    """Its rows but for the mean."""
    scale: Array
    """[K', R] one over the noise of each coefficient."""

    @property
    def octave(self) -> NDArray[np.int64]:
        """[R] the number of each coefficient's octave, larger is slower."""
        return self.octaves.octave[self.keep]

    @property
    def variance(self) -> Array:
        """[K', R] of each coefficient's noise, before it is white."""
        return np.asarray(self.scale**-2)

    def whiten(self, x: Array, k: int) -> Array:
        """Return the coefficients [P, R, J] of columns [P, n, J] of output k."""
        cut = self.octaves
        running = np.concatenate([np.zeros_like(x[:, :1]), np.cumsum(x, axis=1)], axis=1)
        middle = running[:, cut.middle[self.keep]]
        first = (middle - running[:, cut.start[self.keep]]) * cut.left[self.keep][:, None]
        second = (running[:, cut.stop[self.keep]] - middle) * cut.right[self.keep][:, None]
        return np.asarray((first - second) * self.scale[k][:, None])


@dataclass(frozen=True)
class Staged:
    """Staged signals [P, n] of P logs of one length, and how they become white."""

    signals: Signals[Array]
    period_s: float
    white: Whitening
    weight: Array
    """[P] square root of how many logs each stands for."""

    @property
    def rows(self) -> float:
        """Blocks of all logs."""
        return float(np.sum(self.weight**2) * self.signals.elapsed_s.shape[1])


def make_white(scene: Scene, rows: int, block: int, outputs: Sequence[int]) -> Whitening:
    """Return what turns `rows` means over `block` samples into white coefficients."""
    octaves = cut_octaves(np.array([rows], dtype=np.int64), block)
    keep = octaves.octave != MEANS
    numbers, place = np.unique(octaves.octave[keep], return_inverse=True)
    variance = scene.noise.variance(numbers, rows * block, block)[:, list(outputs)]
    floor = np.maximum(variance, 1e-30 + 1e-12 * variance.max(axis=0))
    return Whitening(octaves, keep, np.asarray(np.sqrt(block / floor)[place].T))


def make_signals(
    scene: Scene, logs: Sequence[Log], courses: Sequence[PlannedCourse]
) -> Signals[Array]:
    """Return what a sensor is exposed to in logs of one length."""
    plan = scene.plan
    time_s: Array = np.stack([course.time_s for course in courses])
    earlier = np.array([0.0 if log.power_on else POWERED_EARLIER_S for log in logs])
    elapsed: Array = time_s + earlier[:, None]
    still = np.zeros_like(time_s)

    def channel(name: str) -> Array:
        if name == "clock":
            return elapsed
        first = courses[0]
        if name in first.inputs:
            return np.stack([course.inputs[name] for course in courses])
        return still

    return Signals(
        temperature_degC=np.stack([course.temperature_degC for course in courses]),
        elapsed_s=elapsed,
        clock_s=elapsed,
        load={
            name: np.stack([c.loads[name] for c in courses]) if name in courses[0].loads else still
            for name in plan.loaded
        },
        saturated=dict.fromkeys(plan.saturated, still),
        channels={name: channel(name) for name in plan.channels},
        outputs=plan.outputs,
        full_scale=dict(zip(plan.outputs, plan.full_scale, strict=True)),
        reference_temperature_degC=plan.reference_temperature_degC,
    )
