"""Means over blocks of time, and their noise: white, flicker, and noise with a memory of hours."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import minimize

from zerodrift.base.arrays import Array, IntArray

# The noise of means over blocks of time: white, flicker, and noise with a memory of hours.
#
# Flicker noise is a sum of first-order processes whose time constants double and whose variances
# are equal (Keshner, 1/f noise, Proc. IEEE 70, 1982). Variances are fitted by restricted maximum
# likelihood, which takes a zero and a dependence on temperature off without counting them as noise
# (Patterson and Thompson, Biometrika 58, 1971).

MEMORIES = (0.25, 0.75, 2.0)
"""Time constants of the noise with a memory, in blocks."""
LONGEST_S = 3.0e8
"""Of flicker noise: ten years; slower than that is a constant."""
MORE = (3.0, 10.0)
"""Flicker noise that is possible, too, in halves of the variance that was seen: fourteen days show
a share of what the slow octaves hold, and what is learnt too small is told as ageing later."""
LEAST = 1e-7
"""Of a variance that is fitted, as a share of the data's."""


class BlockTimes(Protocol):
    """When blocks were, in whole blocks, and how many samples each holds."""

    @property
    def place(self) -> IntArray:
        """[n] number of the block, counted from 1970."""
        ...

    @property
    def count(self) -> Array:
        """[n] samples in it."""
        ...


@dataclass(frozen=True)
class BlockNoise:
    """Variances in the squared unit of the output."""

    white: float
    """Of a single sample."""
    flicker: float
    """Of each octave."""
    memories: tuple[float, ...]
    """Of the processes whose time constants are `MEMORIES`."""
    block_s: float

    def covariance(self, spans: BlockTimes) -> Array:
        """Return the covariance [n, n] of the blocks' means."""
        parts = list_parts(spans, self.block_s)
        variances = (self.white, self.flicker, *self.memories)
        whole = np.zeros_like(parts[0])
        for variance, part in zip(variances, parts, strict=True):
            whole += variance * part
        return whole


def list_parts(spans: BlockTimes, block_s: float) -> list[Array]:
    """Return the covariance [n, n] that a variance of 1 of each kind of noise gives."""
    lag = np.abs(spans.place[:, None] - spans.place[None, :])
    lags, index = np.unique(lag, return_inverse=True)
    index = index.reshape(lag.shape)
    octaves = int(np.ceil(np.log2(LONGEST_S / block_s))) + 2
    flicker = np.zeros(lags.size)
    for k in range(octaves):
        flicker += correlate(lags.astype(np.float64), 0.25 * 2.0**k)
    parts = [np.diag(1.0 / spans.count), flicker[index]]
    parts += [correlate(lags.astype(np.float64), memory)[index] for memory in MEMORIES]
    return parts


def correlate(lags: Array, memory: float) -> Array:
    """Return the covariance of the means over two blocks of a first-order process of variance 1.

    Args:
        lags: [m] from the begin of one to that of the other, in blocks: 0, or at least 1.
        memory: its time constant in blocks.
    """
    rise = -np.expm1(-1.0 / memory)
    apart = memory**2 * rise**2 * np.exp(-np.maximum(lags - 1.0, 0.0) / memory)
    same = 2.0 * memory**2 * (1.0 / memory - rise)
    return np.asarray(np.where(lags == 0.0, same, apart), dtype=np.float64)


def fit_noise(
    values: Array, spans: BlockTimes, regressors: Array, block_s: float, *, few: bool = False
) -> tuple[BlockNoise, ...]:
    """Return what the noise of blocks may be, by restricted maximum likelihood.

    White and flicker noise; the same with a noise that has a memory; and more flicker noise, as
    a quiet beginning may hide. A short record does not distinguish them, so the later test weighs
    them.

    Args:
        values: [n] means, in the output's unit.
        spans: when they were.
        regressors: [n, m] what is no noise: a constant, a dependence on temperature.
        block_s: length of a block.
        few: whether these are too few to tell the kinds apart; white and flicker noise then.
    """
    parts = list_parts(spans, block_s)
    kinds: list[tuple[int, ...]] = [(0, 1), *((0, 1, k) for k in range(2, len(parts)))]
    fits = [_fit(values, [parts[i] for i in kind], regressors) for kind in kinds[: 1 if few else 9]]
    best = min(range(1, len(fits)), key=lambda i: fits[i][0]) if not few else 0
    noises = []
    for i in dict.fromkeys((0, best)):
        told = np.zeros(len(parts))
        told[list(kinds[i])] = fits[i][1]
        white, flicker, *memories = (float(v) for v in told)
        noises.append(BlockNoise(white, flicker, tuple(memories), block_s))
    left = values - regressors @ np.linalg.lstsq(regressors, values, rcond=None)[0]
    # the slow octaves look like a constant
    half = [0.5 * float(np.var(left) / (np.mean(np.diag(p)) - np.mean(p))) for p in parts[:2]]
    none = (0.0,) * len(MEMORIES)
    more = (BlockNoise(half[0], part * half[1], none, block_s) for part in MORE)
    return (*noises, *more)


def _fit(values: Array, parts: list[Array], regressors: Array) -> tuple[float, Array]:
    """Return the cost, in nats, and the variances of some kinds of noise."""
    stack = np.stack(parts)
    left = values - regressors @ np.linalg.lstsq(regressors, values, rcond=None)[0]
    scale = float(np.var(left)) or 1.0
    typical = np.array([np.mean(np.diag(part)) for part in parts])

    def cost(logs: Array) -> tuple[float, Array]:
        variances = np.exp(logs) / typical
        whole = np.tensordot(variances, stack, axes=1)
        factor = np.linalg.cholesky(whole)
        half = np.linalg.inv(factor)
        inverse = half.T @ half
        seen = inverse @ regressors
        inner = regressors.T @ seen
        projected = inverse - seen @ np.linalg.solve(inner, seen.T)
        told = projected @ left
        logdet = np.sum(np.log(np.diag(factor))) + 0.5 * np.linalg.slogdet(inner)[1]
        value = logdet + 0.5 * float(left @ told) / scale
        slopes = [
            0.5 * v * (np.sum(projected * part) - told @ part @ told / scale)
            for v, part in zip(variances, parts, strict=True)
        ]
        return float(value), np.array(slopes)

    start = np.log(np.full(len(parts), 1.0 / len(parts)))
    bounds = [(np.log(LEAST), np.log(30.0))] * len(parts)
    found = minimize(
        cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 15}
    )
    return float(found.fun), scale * np.exp(found.x) / typical
