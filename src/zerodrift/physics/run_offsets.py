"""Whether the offsets of the runs follow the clock: then they are ageing, and no tare."""

import itertools
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.effect import Effect
from zerodrift.physics.search import Found

FEWEST = 3
"""Two offsets lie on a line whatever they are."""
BENDS = (0.03, 0.1, 0.3, 1.0)
"""A logarithmic drift turns from a line into a logarithm after these shares of the clock's span."""
STILL_SCATTERED = 0.1
"""Share of the offsets' squares that what explains them may leave: an effect that is missing, or a
line or a logarithm over the clock, ..."""
TREND_BY_CHANCE = 0.005
"""... so little being left by chance with at most this probability."""
DRAWS = 4000
"""Normal offsets drawn to tell what chance leaves; as many orders of the runs, where there are
more."""


@dataclass(frozen=True)
class ClockTrend:
    """How well the offsets of the runs follow the clock."""

    share: float
    """Of their squares that the best line or logarithm over the clock leaves."""
    chance: float
    """Probability that offsets drawn at random leave so little."""

    @property
    def is_real(self) -> bool:
        """Whether the offsets follow the clock by more than chance."""
        return self.share <= STILL_SCATTERED and self.chance <= TREND_BY_CHANCE


NO_TREND = ClockTrend(1.0, 1.0)


def follows_clock_alone(effect: Effect) -> bool:
    """Return whether an effect needs the clock and nothing else."""
    return set(effect.needs) == {"clock"}


def measure_clock_trend(tared: Campaign, found: Found) -> ClockTrend:
    """Return how well the offsets follow the clock, beside the model without its ageing.

    Args:
        tared: the runs, each with an offset of its own.
        found: the model fitted to them.
    """
    if "clock" not in tared.plan.channels or len(tared.groups) < FEWEST:
        return NO_TREND
    others = [term for term in found.terms if not follows_clock_alone(term.effect)]
    names = {feature.name for feature in tared.build(others)}
    offsets = tared.drift_means()
    for feature, row in zip(tared.build(found.terms), found.solution.coefficients.T, strict=True):
        if feature.name in names:
            offsets = offsets - tared.mean_of(feature.signal)[:, None] * row
    noise = np.sqrt(np.maximum(found.solution.errors, 0.0))
    alive = noise > 0.0
    return weigh_trend(tared.average_runs(offsets)[:, alive] / noise[alive], _read_clock(tared))


def weigh_trend(offsets: Array, clock: Array) -> ClockTrend:
    """Return how well offsets follow a clock.

    What is left is held against two kinds of chance: normal offsets, and these very offsets in any
    other order of the runs. One run that is far off, first or last, fools the one, and a line
    through three runs the other.

    Args:
        offsets: [R, K] of the runs, each output in units of its noise.
        clock: [R] when the runs were.
    """
    runs = clock.size
    centred = offsets - offsets.mean(axis=0)
    span = float(np.ptp(clock))
    if runs < FEWEST or span == 0.0 or not centred.any():
        return NO_TREND
    shapes = _list_shapes((clock - clock.min()) / span)
    share = float(_leave(centred[None], shapes)[0])
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(DRAWS, runs, 1))
    by_noise = _leave(normal - normal.mean(axis=1, keepdims=True), shapes)
    orders = list(itertools.islice(itertools.permutations(range(runs)), DRAWS + 1))
    drawn = len(orders) > DRAWS
    if drawn:
        orders = [tuple(rng.permutation(runs).tolist()) for _ in range(DRAWS)]
    by_order = _leave(centred[np.array(orders)], shapes) <= share * (1.0 + 1e-9)
    # Few runs have few orders: then this one and its reverse have to be the best of all.
    best = 0.0 if by_order.sum() <= 2 and not drawn else float(by_order.mean())
    return ClockTrend(share, max(float((by_noise <= share).mean()), best))


def _read_clock(campaign: Campaign) -> Array:
    """Return the mean of the clock over each run [R]."""
    total = dict.fromkeys(campaign.groups, 0.0)
    count = dict.fromkeys(campaign.groups, 0)
    for run in campaign.runs:
        total[run.group] += float(run.inputs["clock"].sum())
        count[run.group] += len(run)
    return np.array([total[group] / max(count[group], 1) for group in campaign.groups])


def _list_shapes(clock: Array) -> Array:
    """Return a line and logarithms over a clock [R] from 0 to 1, centred, of unit length [S, R]."""
    shapes = np.stack([clock, *(np.log1p(clock / bend) for bend in BENDS)])
    shapes -= shapes.mean(axis=1, keepdims=True)
    return np.asarray(shapes / np.linalg.norm(shapes, axis=1, keepdims=True))


def _leave(offsets: Array, shapes: Array) -> Array:
    """Return the share [N] of centred offsets' squares [N, R, K] that the best shape leaves."""
    explained = np.einsum("sr,nrk->nsk", shapes, offsets) ** 2
    whole = np.einsum("nrk,nrk->n", offsets, offsets)
    return np.asarray(1.0 - explained.sum(axis=2).max(axis=1) / np.maximum(whole, 1e-300))
