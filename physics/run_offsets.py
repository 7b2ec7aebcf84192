"""Whether runs have offsets of their own, and whether these follow the clock: ageing, no tare."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.chip_codes import FLAG_MARGIN_K
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.effect import Effect
from zerodrift.physics.search import Found
from zerodrift.physics.tracks import build_stretches

Array = NDArray[np.float64]

TARE_RATIO = 1.25
"""Runs have offsets of their own where these lower the squared error by more than this factor."""
ROUND_OFF = 1e-12
"""Of the largest squared error of an output: what is less is none."""

FEWEST = 3
"""Two offsets lie on a line whatever they are, and one of two runs may be the odd one."""
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


def leaves_offsets(tared: Campaign, found: Found) -> bool:
    """Return whether a model leaves runs offsets of their own; see `have_own_offsets`.

    Args:
        tared: the runs, each with an offset of its own.
        found: the model fitted to them.
    """
    left = []
    built = build_stretches(tared.runs, tared.plan, found.terms, tared.order)
    for run, (_, *columns) in zip(tared.runs, built, strict=True):
        rest = run.steady_drift
        for column, row in zip(columns, found.solution.coefficients.T, strict=True):
            rest = rest - column.signal[:, None] * row
        left.append(rest)
    names = {group: i for i, group in enumerate(tared.groups)}
    return have_own_offsets(
        np.concatenate([np.full(len(run), names[run.group]) for run in tared.runs]),
        np.concatenate([run.temperature_degC for run in tared.runs]),
        np.concatenate(left),
    )


def have_own_offsets(
    run: NDArray[np.int64], temperature_degC: Array, left: Sequence[Array] | Array
) -> bool:
    """Return whether what a model leaves shows an offset of each run, as tared logs have.

    An offset is one beside any function of temperature: runs are compared where they were at the
    same temperature, to FLAG_MARGIN_K, and what each of them adds there is solved by least squares.
    So soaks, a run for each temperature, have none that could be told. And the offsets must lower
    the squared error by more than TARE_RATIO whichever run is left aside, or a single bad one would
    make all logs tared: two runs are too few to tell.

    Args:
        run: [n] the run of each row, numbered from 0.
        temperature_degC: [n].
        left: [n, K] what the model leaves of the drift, the runs' offsets in it.
    """
    count = int(run.max()) + 1
    if count < FEWEST:
        return False
    bins = np.floor(temperature_degC / FLAG_MARGIN_K).astype(np.int64)
    places, cell = np.unique(np.stack([run, bins - bins.min()]), axis=1, return_inverse=True)
    runs, where = places
    rows = np.bincount(cell.ravel()).astype(np.float64)
    values = np.asarray(left, dtype=np.float64)
    values = values - values.mean(axis=0)
    sums = np.stack([np.bincount(cell.ravel(), column) for column in values.T], axis=1)
    squares = np.stack([np.bincount(cell.ravel(), column) for column in values.T**2], axis=1)
    within = squares - sums**2 / rows[:, None]
    return all(
        _compare_offsets(
            runs[runs != r], where[runs != r], rows[runs != r], sums[runs != r], within[runs != r]
        )
        >= TARE_RATIO
        for r in range(count)
    )


def _compare_offsets(
    run: NDArray[np.int64],
    place: NDArray[np.int64],
    rows: Array,
    sums: Array,
    within: Array,
) -> float:
    """Return the squared error without offsets over that with them, averaged over outputs.

    Args:
        run: [C] of each cell, a run at a temperature.
        place: [C] its temperature.
        rows: [C] how many samples it has.
        sums: [C, K] of what is left.
        within: [C, K] squares about the cell's mean.
    """
    _, run = np.unique(run, return_inverse=True)
    _, place = np.unique(place, return_inverse=True)
    shape = (int(run.max()) + 1, int(place.max()) + 1)
    counts = np.zeros(shape)
    counts[run, place] = rows
    of_place = counts.sum(axis=0)
    totals = np.zeros((*shape, sums.shape[1]))
    totals[run, place] = sums
    means = totals.sum(axis=0) / of_place[:, None]
    shared = within.sum(axis=0) + np.sum(sums**2 / rows[:, None], axis=0)
    shared -= np.sum(of_place[:, None] * means**2, axis=0)
    # The normal equations of the runs' offsets, those of the temperatures eliminated.
    normal = np.diag(counts.sum(axis=1)) - (counts / of_place) @ counts.T
    right = totals.sum(axis=1) - counts @ means
    offsets = np.linalg.lstsq(normal, right, rcond=None)[0]
    own = shared - np.sum(offsets * right, axis=0)
    floor = ROUND_OFF * max(float(shared.max()), 1e-300)
    return float(np.mean((shared + floor) / (np.maximum(own, 0.0) + floor)))


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
