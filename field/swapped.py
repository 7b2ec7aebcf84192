"""Which other unit is in place: the known one whose model leaves nothing but noise, if any does.

Each known unit's model foretells the drift since the change. Its likelihood is weighed against
those of the other units, and against units that nobody knows: drawn like the known ones, or unlike
in their dependence on temperature. A likelihood ratio exceeds A with probability 1/A at most where
the other hypothesis is true (Markov), also if it is looked at again with each new block (Ville);
with N units, each must exceed N / `FALSE_NAME`, so that the chance of a false name is that at most
(Bonferroni), as far as the noise is what was learnt.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import f as f_distribution

from zerodrift.field.noise import BlockNoise, fit_noise
from zerodrift.field.watch import SURE, UNLIKE, WAIT_S, BlockMeans, Learned, Rules

Array = NDArray[np.float64]

FALSE_NAME = 1.0 - SURE
"""Chance of a name although another unit is in place, however many are known."""
ENOUGH = 8
"""Units from which the known ones show how units differ; with fewer, drift may differ otherwise."""
NO_NOISE = 1e-3
"""Chance that the right unit is refused because it leaves more than the noise that was learnt."""
MISFITS = (0.5, 0.15, 0.05, 0.0)
"""What a model may leave beside noise and what follows temperature and its square, in its
calibration's standard uncertainties: smooth in temperature, with its change, and of any form,
another in each block; the three together nearly as much as the uncertainty at most. As that holds
the noise of a reading too, which a mean over a block does not, it may be much less."""
FEWEST = 6
"""Blocks since the change, and a day of them: a day has a warm and a cold hour."""


@dataclass(frozen=True)
class Foretold:
    """Means over blocks since the change, with the drift that each unit's model foretells."""

    blocks: BlockMeans
    """Of the unit that should be there."""
    residual: Array
    """[u, n] of the other units."""
    calibrated: Array
    """[u] standard uncertainty of each one's model inside its range, in the output's unit."""


@dataclass(frozen=True)
class Before:
    """What is known from before the change."""

    blocks: BlockMeans
    """Those that the noise was learnt from; none where another unit was there from the first."""
    learned: Learned | None
    rules: Rules


@dataclass(frozen=True)
class UnitsWeighed:
    """What one output tells of each unit."""

    own: Array
    """[u] log likelihood of each unit; the last is the one that should be there."""
    unknown: Array
    """[u] that of a unit which nobody knows, drawn in one of several ways."""
    is_noise: NDArray[np.bool_]
    """[u] whether no more than the noise is left."""


@dataclass(frozen=True)
class FoundUnit:
    """Which unit it is."""

    named: int | None
    """The only one that it can be; None where there is none, or more than one."""
    possible: tuple[int, ...]
    """Those that are not ruled out, the likeliest first."""


def count_fewest(block_s: float) -> int:
    """Return how many blocks since the change are needed."""
    return max(FEWEST, int(np.ceil(WAIT_S / block_s)))


def find_unit(outputs: Mapping[str, tuple[Foretold, Before]], units: int) -> FoundUnit | None:
    """Return whose model fits all outputs; None where there is too little to tell by.

    Args:
        outputs: output -> what is left of it under each unit's model, and what was before.
        units: how many other units are known.
    """
    told = [
        weigh_units(foretold, before)
        for foretold, before in outputs.values()
        if foretold.blocks.place.size >= count_fewest(before.rules.block_s)
    ]
    return choose(told, units) if told and units else None


def choose(told: Sequence[UnitsWeighed], units: int) -> FoundUnit:
    """Return the unit that all outputs name, if one does.

    The outputs' noise may be one and the same, so that their ratios are averaged, not multiplied:
    the mean's chance to exceed A is 1/A at most, too. No output may speak against a name.

    Args:
        told: by output.
        units: how many; `own` of each holds one more.
    """
    rivals = np.stack([_list_ratios(one, units) for one in told])
    mean = np.logaddexp.reduce(rivals, axis=0) - np.log(len(told))
    least, against = rivals.min(axis=0), np.log(FALSE_NAME / units)
    noise = np.all([one.is_noise[:units] for one in told], axis=0)
    enough = np.log(units / FALSE_NAME)
    likely = np.sum([one.own[:units] for one in told], axis=0)
    is_named = noise & (mean >= enough).all(axis=1) & (least > against).all(axis=1)
    possible = noise & (least > np.log(FALSE_NAME)).all(axis=1)
    ranked = [int(k) for k in np.argsort(-likely, kind="stable")]
    named = next((k for k in ranked if is_named[k]), None)
    left = (named,) if named is not None else tuple(k for k in ranked if possible[k])
    return FoundUnit(named, left)


def _list_ratios(told: UnitsWeighed, units: int) -> Array:
    """Return the log likelihood ratios [units, rivals] of each unit against all that it may be."""
    own = told.own[:units, None]
    others = own - told.own[None, :]
    others[np.arange(units), np.arange(units)] = np.inf
    return np.concatenate([others, own - told.unknown[:units, None]], axis=1)


def weigh_units(foretold: Foretold, before: Before) -> UnitsWeighed:
    """Return what one output tells, averaged over what its noise may be."""
    new = foretold.blocks
    left = np.vstack([foretold.residual, new.residual])
    noises = before.learned.noises if before.learned is not None else _fit_noises(new, left, before)
    calibrated = np.append(foretold.calibrated, before.rules.calibrated)
    each = [_weigh_one(new, left, calibrated, before, noise) for noise in noises]
    own, unknown = (
        np.logaddexp.reduce([one[i] for one in each], axis=0) - np.log(len(each)) for i in (0, 1)
    )
    return UnitsWeighed(own, unknown, np.any([one[2] for one in each], axis=0))


def _fit_noises(new: BlockMeans, left: Array, before: Before) -> tuple[BlockNoise, ...]:
    """Return the noise that the unit leaves which leaves least: what all of them have in common."""
    regressors = np.column_stack([np.ones(new.place.size), new.follow()])
    bare = left - (regressors @ np.linalg.lstsq(regressors, left.T, rcond=None)[0]).T
    least = int(np.argmin(np.sum(bare**2, axis=1)))
    return fit_noise(left[least], new, regressors, before.rules.block_s, few=True)


def _weigh_one(
    new: BlockMeans, left: Array, calibrated: Array, before: Before, noise: BlockNoise
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return log likelihoods [u] of each unit and of one that nobody knows, and who leaves noise
    alone [u], for one noise.

    What a unit's model leaves beside noise is as large as its own calibration says (`calibrated`
    [u]); a stranger leaves the drift between units beside that.
    """
    old, units, n = before.blocks, len(left), new.place.size
    m = old.place.size
    place, count = (np.concatenate([getattr(b, k) for b in (old, new)]) for k in ("place", "count"))
    both = BlockMeans(place, count, np.zeros(m + n), np.zeros(m + n))
    common = noise.covariance(both)
    typical = float(np.sqrt(np.mean(np.diag(common))))
    wide = 1e4 * (float(np.std(left)) + typical) ** 2
    common[:m, :m] += wide + before.rules.calibrated**2 * old.misfit()
    common[m:, m:] += wide
    data = np.vstack([np.repeat(old.residual[:, None], units, axis=1), left.T])
    middle = np.concatenate([old.residual, left.mean(axis=0)])[:, None]
    apart = left - left.mean(axis=0)
    spread = apart.T @ apart / max(units - 1, 1) * (1.0 + 1.0 / units)
    follow, degrees = new.follow(), (n - 1, m - 1)  # a zero is taken off both
    rest = new.misfit() - follow @ follow.T + np.eye(n)
    own, unknown = np.empty(units), np.empty(units)
    is_noise = np.full(units, m < FEWEST)
    limit = float(f_distribution.isf(NO_NOISE, *degrees)) if m >= FEWEST else 0.0
    for uncertainty in np.unique(calibrated):
        chosen = calibrated == uncertainty
        likely: list[Array] = []
        strange: list[Array] = []
        for share in MISFITS:
            covariance = common.copy()
            covariance[m:, m:] += uncertainty**2 * (follow @ follow.T + share**2 * rest)
            white, log = _whiten(covariance, data[:, chosen])
            likely.append(log - 0.5 * (m + n) * np.log(np.sum(white**2, axis=0)))
            ways = []
            for width in UNLIKE if units < ENOUGH else ():
                extra = (width * (typical + uncertainty)) ** 2 * (follow @ follow.T)
                ways.append(_likelihood(covariance, extra, data[:, chosen]))
            ways.append(np.repeat(_likelihood(covariance, spread, middle), int(chosen.sum())))
            strange.append(np.logaddexp.reduce(ways, axis=0) - np.log(len(ways)))
            if m >= FEWEST:
                more, usual = (
                    np.sum(w**2, axis=0) / d
                    for w, d in zip((white[m:], white[:m]), degrees, strict=True)
                )
                is_noise[chosen] |= more / usual <= limit
        own[chosen] = np.logaddexp.reduce(likely, axis=0) - np.log(len(MISFITS))
        # a stranger leaves as much as this unit does: else the smoother hypothesis is the likelier
        rough = likely - np.logaddexp.reduce(likely, axis=0)
        unknown[chosen] = np.logaddexp.reduce(strange + rough, axis=0)
    return own, unknown, is_noise


def _likelihood(covariance: Array, extra: Array, data: Array) -> Array:
    """Return log likelihoods [u] of data [m + n, u] where the last n may hold more."""
    n = len(extra)
    whole = covariance.copy()
    whole[-n:, -n:] += extra
    white, log = _whiten(whole, data)
    return np.asarray(log - 0.5 * len(data) * np.log(np.sum(white**2, axis=0)))


def _whiten(covariance: Array, data: Array) -> tuple[Array, float]:
    factor = cholesky(covariance, lower=True)
    white = solve_triangular(factor, data, lower=True)
    return np.asarray(white), -float(np.sum(np.log(np.diag(factor))))
