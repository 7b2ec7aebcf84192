"""Which other unit is in place: the known one whose model leaves nothing but noise, if any does.

Each known unit's model foretells the drift since the change. A unit is named once its probability
is `SURE`, where each known one was as likely before: the chance of a false name, whichever of them
is in place, is then the rest at most on average, also if it is looked at again with each new block,
as far as the noise is what was learnt.

How often a stranger is named is not for that probability to say, as with many known units it may
look like one of them. So strangers are drawn, like the known ones or, where these are few, unlike
in their dependence on temperature; and the unit's likelihood ratio to a stranger must exceed what
`FALSE_NAME` of them reach with any known unit, now or before: a Monte Carlo test (Barnard,
J. R. Statist. Soc. B 25, 1963), its chance spent by look (Lan and DeMets, Biometrika 70, 1983).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.polynomial.legendre import legval
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp
from scipy.stats import f as f_distribution

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.field.noise import BlockNoise, fit_noise
from zerodrift.field.watch import SURE, UNLIKE, WAIT_S, BlockMeans, Learned, Rules

FALSE_NAME = 1.0 - SURE
"""Chance of a name although another unit is in place, however many are known."""
ODDS = float(np.log(SURE / FALSE_NAME))
"""Log of the odds for a name."""
ENOUGH = 8
"""Units from which the known ones show how units differ; with fewer, drift may differ otherwise."""
NO_NOISE = 1e-3
"""Chance that the right unit is refused because it leaves more than the noise that was learnt."""
MISFITS = tuple(product((False, True), (0.5, 0.15, 0.05, 0.0)))
"""What a model may leave beside noise, in its calibration's standard uncertainties: whether it is
the next order, which a fit of temperature and its square leaves first, or follows these two; and
the share of what is smooth in temperature, with its change, and of any form, block by block."""
DRAWN = 500
"""Strangers that are drawn: the chance of a false name is then known to a fifth of itself."""
AT_ONCE = 4_000_000
"""Numbers that are held at a time while strangers are weighed."""
FEWEST, MOST = 6, 84
"""Blocks since the change: a day of them, as a day has a warm and a cold hour; and those from which
there is no more to learn: two weeks of four hours each."""


@dataclass(frozen=True)
class Foretold:
    """Means over blocks since the change, with the drift that each unit's model foretells."""

    blocks: BlockMeans
    """Of the unit that should be there."""
    residual: Array
    """[u, n] of the other units."""
    calibrated: Array
    """[u] standard uncertainty of a mean under each one's model inside its range, in its unit."""
    flagged: Array
    """[u, n] share of a block's steps that each one's model flags, as outside its range: of them it
    foretells no more than that the drift is that of some unit."""
    looks: tuple[int, ...] = ()
    """Counts of blocks at which a name was sought before."""


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
    needed: Array
    """[u] log ratio of the two that a name needs: more than strangers reach."""
    is_noise: Mask
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


def add_look(looks: tuple[int, ...], count: int, block_s: float) -> tuple[int, ...]:
    """Return the looks to be kept, with one at `count` blocks where these have doubled since."""
    fewest = 2 * looks[-1] if looks else count_fewest(block_s)
    return looks if count < fewest else (*looks, count)


def find_unit(outputs: Mapping[str, tuple[Foretold, Before]], units: int) -> FoundUnit | None:
    """Return whose model fits all outputs; None where there is too little to tell by.

    Args:
        outputs: output -> what is left of it under each unit's model, and what was before.
        units: how many other units are known.
    """
    enough = [
        (foretold, before)
        for foretold, before in outputs.values()
        if foretold.blocks.place.size >= count_fewest(before.rules.block_s)
    ]
    told = [weigh_units(*one, FALSE_NAME / len(enough)) for one in enough]
    return choose(told, units) if told and units else None


def choose(told: Sequence[UnitsWeighed], units: int) -> FoundUnit:
    """Return the unit that all outputs name, if one does.

    The outputs' noise may be one and the same, so that their ratios are averaged, not multiplied:
    the mean's chance to exceed A is 1/A at most, too (Markov). Strangers must be left behind in one
    output, whose chance is a share of the whole. No output may speak against a name.

    Args:
        told: by output.
        units: how many; `own` of each holds one more.
    """
    rivals = np.stack([_list_ratios(one, units) for one in told])
    is_apart = np.stack([(one.own - one.unknown > one.needed)[:units] for one in told])
    mean = np.logaddexp.reduce(rivals, axis=0) - np.log(len(told))
    least = rivals.min(axis=(0, 2))
    noise = np.all([one.is_noise[:units] for one in told], axis=0)
    likely = np.sum([one.own[:units] for one in told], axis=0)
    is_sure = logsumexp(-mean[:, :-1], axis=1) < -ODDS  # the last one is the stranger
    is_named = noise & is_sure & is_apart.any(axis=0) & (least > np.log(FALSE_NAME / units))
    possible = noise & (least > np.log(FALSE_NAME))
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


@dataclass(frozen=True)
class _Left:
    """What units leave, given what was before the change, for one noise."""

    covariance: Array
    """[n, n] of the noise and the zero."""
    middle: Array
    """[n] expected."""
    before: int
    squares: float
    """Blocks before the change, and the sum of their squares, whitened; ..."""
    scale: float
    """... and the log of what whitening divided them by."""


@dataclass(frozen=True)
class _Way:
    """One of the ways in which the drift may be what it is, for some of the units."""

    chosen: Mask
    """[u] units that foretell the drift with this uncertainty."""
    share: int
    """Place in `MISFITS`."""
    own: Array
    """[n, n] Cholesky factor of what such a unit leaves."""
    near: tuple[Array, ...]
    """Those of what a stranger leaves that differs from the unit it is weighed against; ..."""
    spread: Array
    """... or from the mean of all."""


def weigh_units(foretold: Foretold, before: Before, false: float = FALSE_NAME) -> UnitsWeighed:
    """Return what one output tells, averaged over what its noise may be.

    Args:
        foretold: what is left.
        before: what was before.
        false: chance of a false name from this output where nobody knows the unit in place.
    """
    new = foretold.blocks
    left = np.vstack([foretold.residual, new.residual])
    noises = before.learned.noises if before.learned is not None else _fit_noises(new, left, before)
    calibrated = np.append(foretold.calibrated, before.rules.calibrated)
    flagged = np.vstack([foretold.flagged, np.zeros(new.place.size)])
    middle = left.mean(axis=0)
    apart = left - middle
    each = [_list_ways(new, left, calibrated, flagged, before, noise) for noise in noises]
    own, unknown, is_noise, by_way = _weigh(each, middle[:, None], apart, np.array([middle.size]))
    own, unknown = own[-1, 0], unknown[-1, 0]
    needed = np.full(len(left), np.inf)
    worth = is_noise & (own > unknown)
    worth[-1] = False
    if worth.any():
        best = int(np.argmax(np.where(worth, own, -np.inf)))
        looks = np.unique([*foretold.looks, middle.size])
        doubled = np.log2(2 * np.append(looks, MOST) / count_fewest(before.rules.block_s))
        spent = false * doubled[:-1] / doubled.max()
        needed[best] = _find_needed(each, middle, apart, best, by_way[:, best], looks, spent)
    return UnitsWeighed(own, unknown, needed, is_noise)


def _fit_noises(new: BlockMeans, left: Array, before: Before) -> tuple[BlockNoise, ...]:
    """Return the noise that the unit leaves which leaves least: what all of them have in common."""
    regressors = np.column_stack([np.ones(new.place.size), new.follow()])
    bare = left - (regressors @ np.linalg.lstsq(regressors, left.T, rcond=None)[0]).T
    least = int(np.argmin(np.sum(bare**2, axis=1)))
    return fit_noise(left[least], new, regressors, before.rules.block_s, few=True)


def _list_ways(
    new: BlockMeans,
    left: Array,
    calibrated: Array,
    flagged: Array,
    before: Before,
    noise: BlockNoise,
) -> tuple[_Left, list[_Way]]:
    """Return what is left of the noise, and the ways to explain the rest.

    What a unit's model leaves beside noise is as large as its own calibration says (`calibrated`
    [u]), and as much as units differ by where it is `flagged` [u, n]; a stranger leaves the drift
    between units beside that.
    """
    old, units, n = before.blocks, len(left), new.place.size
    m = old.place.size
    place, count = (np.concatenate([getattr(b, k) for b in (old, new)]) for k in ("place", "count"))
    common = noise.covariance(BlockMeans(place, count, np.zeros(m + n), np.zeros(m + n)))
    typical = float(np.sqrt(np.mean(np.diag(common))))
    wide = 1e4 * (float(np.std(left)) + typical) ** 2
    common[:m, :m] += wide + before.rules.calibrated**2 * old.misfit()
    common[m:, m:] += wide
    factor = cholesky(common, lower=True)
    white = solve_triangular(factor[:m, :m], old.residual, lower=True) if m else np.zeros(0)
    rest_factor, across = factor[m:, m:], factor[m:, :m]
    given = _Left(
        covariance=rest_factor @ rest_factor.T,
        middle=across @ white,
        before=m,
        squares=float(white @ white),
        scale=float(np.sum(np.log(np.diag(factor)[:m]))),
    )
    apart = left - left.mean(axis=0)
    spread = apart.T @ apart / max(units - 1, 1) * (1.0 + 1.0 / units)
    follow = new.follow()
    linear = follow @ follow.T
    cubic = np.sqrt(7.0) * legval(new.temperature, (0.0, 0.0, 0.0, 1.0))  # RMS 1 inside
    rest = new.misfit() - linear + np.eye(n)
    ways = []
    widths = UNLIKE if units < ENOUGH else ()
    kinds, kind = np.unique(np.column_stack([calibrated, flagged]), axis=0, return_inverse=True)
    for number, (uncertainty, *shares) in enumerate(kinds):
        outside = np.diag(np.square(shares) * np.diag(spread))
        for share, (is_next, part) in enumerate(MISFITS):
            shape = (np.outer(cubic, cubic) if is_next else linear) + part**2 * rest
            whole = given.covariance + uncertainty**2 * shape + outside
            near = tuple(
                cholesky(whole + (width * (typical + uncertainty)) ** 2 * linear, lower=True)
                for width in widths
            )
            factors = cholesky(whole, lower=True), near, cholesky(whole + spread, lower=True)
            ways.append(_Way(kind.ravel() == number, share, *factors))
    return given, ways


def _weigh(
    each: Sequence[tuple[_Left, list[_Way]]], drift: Array, apart: Array, looks: IntArray
) -> tuple[Array, Array, Mask, Array]:
    """Return what some drifts tell of each unit.

    Args:
        each: by noise.
        drift: [n, d] less the mean of what the units' models foretell.
        apart: [u, n] what each unit's model leaves less that mean.
        looks: [l] counts of blocks after which they are weighed; the last is n.

    Returns:
        Log likelihoods [l, d, u] of each unit and of a stranger;
        whether the first drift leaves no more than noise [u], after the last; and the parts of its
        likelihood [noises, u, shares].
    """
    (n, d), u = drift.shape, len(apart)
    is_noise = np.zeros(u, dtype=bool)
    parts = np.empty((2, len(each), looks.size, d, u))
    by_way = np.empty((len(each), u, len(MISFITS)))
    for number, (given, ways) in enumerate(each):
        both = np.empty((2, len(MISFITS), looks.size, d, u))
        for way in ways:
            deviation = drift - given.middle[:, None]
            those = apart[way.chosen].T
            likely, white = _likelihood(way.own, deviation, those, given, looks)
            strange = [_likelihood(one, deviation, those, given, looks)[0] for one in way.near]
            whole = _likelihood(way.spread, deviation, np.zeros((n, 1)), given, looks)[0]
            strange.append(np.broadcast_to(whole, likely.shape))
            both[0][way.share][..., way.chosen] = likely
            both[1][way.share][..., way.chosen] = logsumexp(strange, axis=0) - np.log(len(strange))
            is_noise[way.chosen] |= _is_noise(white, given)
        by_way[number] = both[0, :, -1, 0].T
        whole = logsumexp(both[0], axis=0)
        parts[0, number] = whole - np.log(len(MISFITS))
        # a stranger leaves as much as this unit does: else the smoother hypothesis is the likelier
        parts[1, number] = logsumexp(both[1] + both[0] - whole, axis=0)
    own, unknown = logsumexp(parts, axis=1) - np.log(len(each))
    return own, unknown, is_noise, by_way


def _is_noise(white: Array, given: _Left) -> Mask:
    """Return which of some units [u] leave no more than noise, by what is left [n, u], whitened."""
    if given.before < FEWEST:
        return np.ones(white.shape[1], dtype=bool)
    degrees = len(white) - 1, given.before - 1  # a zero is taken off both
    more, usual = np.sum(white**2, axis=0) / degrees[0], given.squares / degrees[1]
    return np.asarray(more / usual <= f_distribution.isf(NO_NOISE, *degrees))


def _likelihood(
    factor: Array, deviation: Array, apart: Array, given: _Left, looks: IntArray
) -> tuple[Array, Array]:
    """Return log likelihoods [l, d, u] of deviations [n, d] after each look, and those of the first
    [n, u] whitened.

    Args:
        factor: [n, n] of their covariance.
        deviation: [n, d] of the mean of the units.
        apart: [n, u] to be added for each unit.
        given: the blocks before.
        looks: [l] counts of blocks.
    """
    drift, those = (solve_triangular(factor, one, lower=True) for one in (deviation, apart))
    white = drift[:, :, None] + those[:, None, :]
    parts = np.add.reduceat(white**2, np.append(0, looks[:-1]), axis=0)
    squares = given.squares + np.cumsum(parts, axis=0)
    number = (given.before + looks)[:, None, None]
    logs = given.scale + np.cumsum(np.log(np.diag(factor)))[looks - 1, None, None]
    return np.asarray(-0.5 * number * np.log(squares) - logs), white[:, 0]


def _find_needed(
    each: Sequence[tuple[_Left, list[_Way]]],
    middle: Array,
    apart: Array,
    best: int,
    by_way: Array,
    looks: IntArray,
    spent: Array,
) -> float:
    """Return the log ratio against a stranger that one unit needs to be named.

    Strangers that leave as much beside noise as this unit does are drawn, and followed from look to
    look: those that were named at one are not there at the next. `apart` [u, n] is what each unit's
    model leaves less the mean of all, `middle` [n]; `by_way` [noises, shares] the log likelihood of
    the unit `best`; `looks` [l] the counts of blocks at which a name was sought and is now, and
    `spent` [l] the chance of a false name by then.
    """
    rng = np.random.default_rng(0)
    n, u = apart.shape[1], len(apart)
    chances = np.exp(by_way - logsumexp(by_way)).ravel()
    chosen = rng.choice(chances.size, size=DRAWN, p=chances / chances.sum())
    drift = np.empty((n, DRAWN))
    for number, (given, ways) in enumerate(each):
        for way in (way for way in ways if way.chosen[best]):
            here = np.flatnonzero(chosen == number * len(MISFITS) + way.share)
            mean = (middle - given.middle)[:, None]
            white = _likelihood(way.own, mean, apart[best][:, None], given, looks)[1]
            squares, degrees = given.squares + float(np.sum(white**2)), given.before + n - 1
            scale = np.sqrt(squares / rng.chisquare(degrees, size=here.size))
            kind = rng.integers(len(way.near) + 1, size=here.size)
            for place, factor in enumerate((way.spread, *way.near)):
                those = here[kind == place]
                noise = rng.normal(size=(n, those.size)) * scale[kind == place]
                around = given.middle - (apart[best] if place else 0.0)
                drift[:, those] = around[:, None] + factor @ noise
    step = max(1, AT_ONCE // (n * u * len(MISFITS)))
    ratios = []
    for start in range(0, DRAWN, step):
        own, unknown, _, _ = _weigh(each, drift[:, start : start + step], apart, looks)
        ratios.append((own - unknown)[..., :-1].max(axis=2))
    ratio = np.concatenate(ratios, axis=1)
    needed = 0.0
    for look, chance in enumerate(spent):
        needed = max(0.0, float(np.sort(ratio[look])[DRAWN - 1 - int(DRAWN * chance)]))
        ratio = ratio[:, ratio[look] <= needed]
    return needed
