"""The sequential test: whether the residual of a compensated sensor is still as at first.

Means over blocks are whitened with the noise that the first days showed (Willsky and Jones, A
generalized likelihood ratio approach to the detection and estimation of jumps, IEEE Trans. AC 21,
1976), and each possible change since each possible time is weighed by its likelihood ratio,
averaged over its size. Their sum over the times is Shiryaev's and Roberts' statistic; it exceeds
A for the first time after A blocks or more on average where nothing has changed (Pollak, Average
run lengths of an optimal method of detecting a change in distribution, Ann. Statist. 15, 1987).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from zerodrift.field.noise import BlockNoise, fit_noise

Array = NDArray[np.float64]

STEP, AGEING, OTHER_MODEL, OTHER_UNIT = CAUSES = ("step", "ageing", "other model", "other unit")
MONTH_S = 30 * 86_400.0
SHARES = {STEP: 0.4, AGEING: 0.3, OTHER_UNIT: 0.3}
"""Of the false alarms."""
ONCE = 0.1
"""False alarms that a change from the first sample on may cause, in those of a month."""
SIZES = (1.5, 5.0, 30.0)
"""Standard deviations of a change of the zero that are averaged over, in those of a block's mean.
None is more than six times the one before: a step whose size lies between two of them would else
be told as a cause of several terms, which fits any size."""
UNLIKE = (10.0, 40.0)
"""The same of another model or unit, whose drift differs by much more than a calibration is
uncertain: what a calibration takes off is ten times what it leaves, or more."""
GRID = {STEP: 1, AGEING: 6, OTHER_UNIT: 3}
"""From one time of change to the next, in blocks."""
LONGEST = 360
"""Blocks that are tested at a time: sixty days of four hours each."""
NEAR = 12
"""Blocks before an alarm in which a change is looked for one by one."""
SURE = 0.95
"""Probability from which a cause is told, ..."""
WAIT_S = 86_400.0
"""... if it has been seen for as long as this: a day has a warm and a cold hour."""
EARLY = (18, 30, 48, 84)
"""Blocks after which another model is looked for while the noise is not known yet."""
FEWEST = 42
"""Blocks that the noise is learnt from, where they are few in the time for it."""
EXCESS = 0.2
"""What the threshold is multiplied by: the statistic jumps over it, the noise is an estimate."""


@dataclass(frozen=True)
class BlockMeans:
    """Means over blocks of time."""

    place: NDArray[np.int64]
    """[n] number of the block, counted from 1970; rises."""
    count: Array
    """[n] samples in it."""
    residual: Array
    """[n] compensated less true value, in the output's unit."""
    temperature: Array
    """[n] as a share of the calibrated range: -1 .. 1 inside."""

    def take(self, chosen: NDArray[np.int64]) -> "BlockMeans":
        """Return some of the blocks."""
        values = (self.count, self.residual, self.temperature)
        count, residual, temperature = (one[chosen] for one in values)
        return BlockMeans(self.place[chosen], count, residual, temperature)

    def first(self, n: int) -> "BlockMeans":
        """Return the first blocks."""
        return self.take(np.arange(n))

    def follow(self) -> Array:
        """Return what a residual may follow [n, 2]: temperature and its square, RMS 1 inside."""
        t = self.temperature
        return np.stack([np.sqrt(3.0) * t, np.sqrt(45.0 / 4.0) * (t * t - 1.0 / 3.0)], axis=1)


@dataclass(frozen=True)
class Learned:
    """What was learnt from the first days."""

    blocks: int
    noises: tuple[BlockNoise, ...]
    """What the noise may be; later means weigh them."""


@dataclass(frozen=True)
class ChangeFound:
    """What was found, at the block at which it was sure."""

    alarm: int
    """Block at which the statistic exceeded its threshold."""
    told: int | None
    """Block from which the cause is sure; None while it is not."""
    cause: str
    """The likeliest."""
    probability: float
    since: int
    """Block at which it began."""
    size: float
    """Step, or change of the zero until now, in the output's unit."""


@dataclass(frozen=True)
class Rules:
    """How the test is set."""

    per_month: float
    """False alarms per unit-month, for this output."""
    block_s: float
    calibrated: float
    """Standard uncertainty of the model inside its range, in the output's unit."""
    learn_s: float = 14 * 86_400.0
    """Time that the noise is learnt from."""


@dataclass(frozen=True)
class Followed:
    """How far the test is."""

    learned: Learned | None
    """None while the noise is being learnt."""
    finding: ChangeFound | None
    ready: int
    """Blocks from which the noise is learnt."""


@dataclass(frozen=True)
class _Ratios:
    """Log likelihood ratios [n, m] of a change since each of m times."""

    cause: str
    log: Array
    weight: float
    begin: NDArray[np.int64]
    size: Array
    """[n, m] posterior mean of the first coefficient."""


def follow(blocks: BlockMeans, rules: Rules, learned: Learned | None) -> Followed:
    """Return the result of all blocks: another model first, then, once the noise is known, the
    rest.

    Args:
        blocks: all since the model, or the block of coefficients, came into use.
        rules: the test.
        learned: what an earlier call learnt; None learns it as soon as there is enough.
    """
    n = blocks.place.size
    age = (blocks.place - blocks.place[0] + 1) * rules.block_s if n else np.zeros(0)
    ready = int(np.searchsorted(age, rules.learn_s * (1.0 - 1e-9))) + 1
    ready = max(ready, FEWEST)
    known = learned.blocks if learned is not None else min(ready, n)
    for first in (early for early in EARLY if early <= known):
        found = check_model(blocks.first(first), rules)
        if found is not None:
            return Followed(learned, found, ready)
    if learned is None and n >= ready:
        learned = learn(blocks.first(ready), rules.block_s)
    found = watch(blocks, learned, rules) if learned is not None and n > learned.blocks else None
    return Followed(learned, found, ready)


def check_model(blocks: BlockMeans, rules: Rules) -> ChangeFound | None:
    """Return that the residual follows temperature as that of the right model would not."""
    n = blocks.place.size
    follow = blocks.follow()
    regressors = np.column_stack([np.ones(n), follow])
    noise = fit_noise(blocks.residual, blocks, regressors, rules.block_s, few=True)[0]
    covariance = noise.covariance(blocks)
    typical = float(np.sqrt(np.mean(np.diag(covariance))))
    wide = 1e4 * (float(np.std(blocks.residual)) + typical) ** 2
    whole = covariance + wide + rules.calibrated**2 * (follow @ follow.T)
    factor = cholesky(whole, lower=True)
    white = solve_triangular(factor, blocks.residual, lower=True)
    flat = solve_triangular(factor, follow, lower=True)[:, None, :]
    scales = np.full(2, typical + rules.calibrated)
    ratios = [_ratio(white, np.cumsum(white**2), flat, width * scales) for width in UNLIKE]
    log = float(np.logaddexp.reduce([r[0][-1, 0] for r in ratios])) - np.log(len(UNLIKE))
    if log < -np.log(ONCE * rules.per_month):
        return None
    best = max(ratios, key=lambda ratio: float(ratio[0][-1, 0]))
    return ChangeFound(
        n - 1, n - 1, OTHER_MODEL, float(1.0 / (1.0 + np.exp(-log))), 0, best[1][-1, 0]
    )


def learn(blocks: BlockMeans, block_s: float) -> Learned:
    """Return the noise of the first blocks."""
    regressors = np.column_stack([np.ones(blocks.place.size), blocks.follow()])
    return Learned(blocks.place.size, fit_noise(blocks.residual, blocks, regressors, block_s))


def watch(blocks: BlockMeans, learned: Learned, rules: Rules) -> ChangeFound | None:
    """Return the first alarm and its cause as all blocks tell it; None where there is none.

    Args:
        blocks: all since the block of coefficients, or the model, came into use.
        learned: from the first of them.
        rules: the test.

    Limits: a change is looked for in the last `LONGEST` blocks; those between them and the ones
    that were learnt from are left out.
    """
    n = blocks.place.size
    if n > learned.blocks + LONGEST:
        kept = np.concatenate([np.arange(learned.blocks), np.arange(n - LONGEST, n)])
        found = watch(blocks.take(kept), learned, rules)
        if found is None:
            return None
        told = int(kept[found.told]) if found.told is not None else None
        alarm, since = int(kept[found.alarm]), int(kept[found.since])
        return replace(found, alarm=alarm, told=told, since=since)
    log_statistic, ratios = weigh(blocks, learned, rules)
    limit = np.log(EXCESS * MONTH_S / rules.block_s / rules.per_month)
    over = np.flatnonzero(log_statistic > limit)
    over = over[over >= learned.blocks]
    if not over.size:
        return None
    alarm = int(over[0])
    ratios = weigh(blocks, learned, rules, alarm)[1]
    told = None
    for n in range(alarm, blocks.place.size):
        chances = _share(ratios, n)
        cause = max(chances, key=lambda name: chances[name])
        if chances[cause] < SURE:
            continue
        age = blocks.place[n] + 1 - blocks.place[_place(ratios, cause, n)[0]]
        if age * rules.block_s >= WAIT_S:
            told = n
            break
    at = told if told is not None else blocks.place.size - 1
    chances = _share(ratios, at)
    cause = max(chances, key=lambda name: chances[name])
    since, size = _place(ratios, cause, at)
    return ChangeFound(alarm, told, cause, chances[cause], since, size)


def weigh(
    blocks: BlockMeans, learned: Learned, rules: Rules, alarm: int | None = None
) -> tuple[Array, list[_Ratios]]:
    """Return the log of the statistic [n] after each block, and what it is made of.

    Args:
        blocks: all of them.
        learned: from the first.
        rules: the test.
        alarm: a block near which changes are looked for one by one, each within a block, which may
            then have any value.
    """
    each = [_weigh_one(blocks, noise, learned.blocks, rules, alarm) for noise in learned.noises]
    likely = np.stack([told[0] for told in each])
    likely = likely - np.logaddexp.reduce(likely, axis=0)
    total = np.logaddexp.reduce(
        [more + told[1] for more, told in zip(likely, each, strict=True)], axis=0
    )
    ratios = [
        replace(ratio, log=ratio.log + more[:, None])
        for more, told in zip(likely, each, strict=True)
        for ratio in told[2]
    ]
    return total, ratios


def _weigh_one(
    blocks: BlockMeans, noise: BlockNoise, begin: int, rules: Rules, alarm: int | None
) -> tuple[Array, Array, list[_Ratios]]:
    """Return what `weigh` does for one kind of noise, and before it its log likelihood [n]."""
    n = blocks.place.size
    follow = blocks.follow()
    covariance = noise.covariance(blocks)
    typical = float(np.sqrt(np.mean(np.diag(covariance))))
    spread = float(np.std(blocks.residual[:begin])) + typical
    whole = covariance + 1e4 * spread**2 + rules.calibrated**2 * (follow @ follow.T)
    factor = cholesky(whole, lower=True)
    white = solve_triangular(factor, blocks.residual, lower=True)
    squares = np.cumsum(white**2)
    day = (blocks.place - blocks.place[0]) * rules.block_s / MONTH_S
    size, wide = typical, typical + rules.calibrated

    def run(cause: str, shapes: Array, scales: Array, weight: float, at: object) -> list[_Ratios]:
        begins = np.asarray(at, dtype=np.int64)
        told = []
        flat = solve_triangular(factor, shapes.reshape(n, -1), lower=True).reshape(shapes.shape)
        sizes = UNLIKE if cause in (OTHER_UNIT, OTHER_MODEL) else SIZES
        for width in sizes:
            logs, first = _ratio(white, squares, flat, width * scales)
            told.append(_Ratios(cause, logs, weight / len(sizes), begins, first))
        return told

    ratios: list[_Ratios] = []
    rows = np.arange(n)
    month = MONTH_S / rules.block_s / rules.per_month
    for cause, share in SHARES.items():
        times = np.arange(begin, n, GRID[cause])
        if alarm is not None and cause != AGEING:
            near = np.arange(max(begin, alarm - NEAR), min(n, alarm + 2))
            times = np.union1d(times, near)
        since = rows[:, None] >= times[None, :]
        if cause == AGEING:
            shapes = (np.maximum(day[:, None] - day[times][None, :], 0.0))[:, :, None]
            scales = np.array([size])
        elif cause == STEP:
            shapes = since[:, :, None].astype(np.float64)
            scales = np.array([wide])
        else:
            terms = np.column_stack([np.ones(n), follow])
            shapes = since[:, :, None] * terms[:, None, :]
            scales = np.full(3, wide)
        if alarm is not None and cause != AGEING:
            within = (rows[:, None] == times[None, :])[:, :, None].astype(np.float64)
            shapes = np.concatenate([shapes, within], axis=2)
            scales = np.append(scales, wide)
        ratios += run(cause, shapes, scales, share * GRID[cause], times)
    ratios += run(AGEING, day[:, None, None], np.array([size]), ONCE / 2 * month / 100, [0])
    scales = np.full(2, wide)
    ratios += run(OTHER_MODEL, follow[:, None, :], scales, ONCE / 2 * month / 100, [0])
    total = np.full(n, -np.inf)
    for one in ratios:
        with np.errstate(divide="ignore"):
            began = rows[:, None] >= one.begin[None, :]
            logs = np.where(began, one.log, -np.inf)
        total = np.logaddexp(total, np.log(one.weight) + np.logaddexp.reduce(logs, axis=1))
    number = np.arange(1, n + 1)
    likelihood = -0.5 * number * np.log(squares / number) - np.cumsum(np.log(np.diag(factor)))
    return likelihood, total, ratios


def _ratio(white: Array, squares: Array, flat: Array, scales: Array) -> tuple[Array, Array]:
    """Return log ratios [n, m] after each block, and the posterior mean of the first size.

    Args:
        white: [n] whitened residual.
        squares: [n] sum of its squares so far.
        flat: [n, m, d] whitened shapes of m changes.
        scales: [d] standard deviations of their sizes.
    """
    n, m, d = flat.shape
    scaled = flat * scales
    told = np.cumsum(scaled * white[:, None, None], axis=0)
    gram = np.empty((n, m, d, d))
    for i in range(d):
        for j in range(i + 1):
            gram[..., i, j] = np.cumsum(scaled[..., i] * scaled[..., j], axis=0)
    lower = np.zeros((n, m, d, d))
    for i in range(d):
        for j in range(i + 1):
            rest = gram[..., i, j] + (1.0 if i == j else 0.0)
            rest = rest - np.sum(lower[..., i, :j] * lower[..., j, :j], axis=-1)
            lower[..., i, j] = np.sqrt(rest) if i == j else rest / lower[..., j, j]
    forward = np.empty((n, m, d))
    for i in range(d):
        known = np.sum(lower[..., i, :i] * forward[..., :i], axis=-1)
        forward[..., i] = (told[..., i] - known) / lower[..., i, i]
    gained = np.sum(forward**2, axis=-1)
    back = np.empty((n, m, d))
    for i in reversed(range(d)):
        known = np.sum(lower[..., i + 1 :, i] * back[..., i + 1 :], axis=-1)
        back[..., i] = (forward[..., i] - known) / lower[..., i, i]
    number = np.arange(1, n + 1)[:, None]
    rest = np.maximum(squares[:, None] - gained, 1e-12 * squares[:, None])
    diagonal = np.sum(np.log(np.stack([lower[..., i, i] for i in range(d)])), axis=0)
    log = 0.5 * number * (np.log(squares[:, None]) - np.log(rest)) - diagonal
    return log, back[..., 0] * scales[0]


def _share(ratios: list[_Ratios], n: int) -> dict[str, float]:
    """Return cause -> its probability after block `n`, given that something changed."""
    logs = dict.fromkeys(CAUSES, -np.inf)
    for one in ratios:
        began = one.begin <= n
        if began.any():
            told = np.log(one.weight) + np.logaddexp.reduce(one.log[n, began])
            logs[one.cause] = np.logaddexp(logs[one.cause], told)
    total = np.logaddexp.reduce(list(logs.values()))
    return {cause: float(np.exp(log - total)) for cause, log in logs.items()}


def _place(ratios: list[_Ratios], cause: str, n: int) -> tuple[int, float]:
    """Return the likeliest block of a change, and its size, after block `n`."""
    best, found = -np.inf, (0, 0.0)
    for one in ratios:
        began = np.flatnonzero(one.begin <= n)
        if one.cause != cause or not began.size:
            continue
        k = int(began[np.argmax(one.log[n, began])])
        if one.log[n, k] > best:
            best, found = one.log[n, k], (int(one.begin[k]), float(one.size[n, k]))
    return found
