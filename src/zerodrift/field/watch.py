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
from scipy.linalg import cholesky, solve_triangular

from zerodrift.base.arrays import Array, IntArray
from zerodrift.dataset.outliers import NORMAL_OF_MAD
from zerodrift.dataset.times import DAY_S
from zerodrift.field.noise import BlockNoise, fit_noise

STEP, AGEING, OTHER_MODEL, OTHER_UNIT = CAUSES = ("step", "ageing", "other model", "other unit")
MONTH_S = 30 * DAY_S
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
IN_A_GAP = 12
"""Times within a gap at which a slow change may begin: each as far from the next as a twelfth."""
NEAR = 12
"""Blocks before an alarm in which a change is looked for one by one."""
SMOOTH = 0.2
"""Over how much of half the calibrated range what a model leaves is alike: it then crosses zero
1 / (pi 0.1) = 3.2 times over the range on average (Rice, Mathematical analysis of random noise,
Bell Syst. Tech. J. 24, 1945), once more than temperature's square."""
SURE = 0.95
"""Probability from which a cause is told, ..."""
HELD = 0.99
"""Probability with which a change began in the interval that is told: an interval errs no more than
a fifth as often as a cause."""
WAIT_S = DAY_S
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

    place: IntArray
    """[n] number of the block, counted from 1970; rises."""
    count: Array
    """[n] samples in it."""
    residual: Array
    """[n] compensated less true value, in the output's unit."""
    temperature: Array
    """[n] as a share of the calibrated range: -1 .. 1 inside."""

    def take(self, chosen: IntArray) -> "BlockMeans":
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

    def misfit(self) -> Array:
        """Return the covariance [n, n] of what a model leaves for each unit of its uncertainty.

        It follows temperature and its square, any smooth function of temperature, and its change
        from block to block, as what lags does; each with a variance of 1.
        """
        t, follow = self.temperature, self.follow()
        smooth = np.exp(-0.5 * ((t[:, None] - t[None, :]) / SMOOTH) ** 2)
        next_to = np.diff(self.place) == 1
        change = np.zeros(t.size)
        change[1:] = np.where(next_to, np.diff(t), 0.0)
        change /= max(float(np.linalg.norm(change)) / max(t.size, 1) ** 0.5, 1e-9)
        return np.asarray(follow @ follow.T + smooth + np.outer(change, change))


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
    """Block at which it most likely began."""
    size: float
    """Step, or change of the zero from then until the cause was told, in the output's unit."""
    begun: tuple[int, int] | None = None
    """Numbers of the blocks from whose begin to whose begin it began, with probability `HELD`; None
    in states that were kept before there was this."""
    per_day: float = 0.0
    """Rate of an ageing zero, in the output's unit."""


@dataclass(frozen=True)
class Rules:
    """How the test is set."""

    per_month: float
    """False alarms per unit-month, for this output."""
    block_s: float
    calibrated: float
    """Standard uncertainty of the model inside its range, in the output's unit."""
    learn_s: float = 14 * DAY_S
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
    weight: Array
    """[m]"""
    times: "_Times"
    size: Array
    """[n, m] posterior mean of the first coefficient."""
    per_block: Array
    """[m] of an ageing zero: what takes the first coefficient to a change a block; else 0."""


@dataclass(frozen=True)
class _Times:
    """Times of change that are weighed, each for itself and the time around it."""

    begin: IntArray
    """[m] first block that holds the change."""
    onset: Array
    """[m] when it begins, in numbers of blocks."""
    low: Array
    """[m] from when to when a change is told by this one."""
    high: Array
    cell: Array
    """[m] how many blocks of time it stands for."""


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
    whole = covariance + wide + rules.calibrated**2 * blocks.misfit()
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
        n - 1,
        n - 1,
        OTHER_MODEL,
        float(1.0 / (1.0 + np.exp(-log))),
        0,
        float(best[1][-1, 0]),
        (int(blocks.place[0]), int(blocks.place[0])),
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
        age = (
            blocks.place[n]
            + 1
            - blocks.place[_place(ratios, cause, n, int(blocks.place[n]) + 1)[0]]
        )
        if age * rules.block_s >= WAIT_S:
            told = n
            break
    at = told if told is not None else blocks.place.size - 1
    chances = _share(ratios, at)
    cause = max(chances, key=lambda name: chances[name])
    since, size, rate = _place(ratios, cause, at, int(blocks.place[at]) + 1)
    per_day = rate * DAY_S / rules.block_s
    begun = _hold(ratios, CAUSES if told is None else (cause,), at)
    begun = (begun[0], min(begun[1], int(blocks.place[at]) + 1))
    return ChangeFound(alarm, told, cause, chances[cause], since, size, begun, per_day)


def weigh(
    blocks: BlockMeans, learned: Learned, rules: Rules, alarm: int | None = None
) -> tuple[Array, list[_Ratios]]:
    """Return the log of the statistic [n] after each block, and what it is made of.

    Args:
        blocks: all of them.
        learned: from the first.
        rules: the test.
        alarm: None for the test; else the block of an alarm, whose cause is asked for. Changes near
            it are then looked for one by one, each within a block, which may have any value; each
            stands for the time since the one before, so that a gap is as likely to hold a change
            as that much time with logs; and an ageing zero is as likely as a step to have moved
            as far as that by now, so that neither is told for its size.
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
    whole = covariance + 1e4 * spread**2 + rules.calibrated**2 * blocks.misfit()
    factor = cholesky(whole, lower=True)
    white = solve_triangular(factor, blocks.residual, lower=True)
    squares = np.cumsum(white**2)
    wide = typical + rules.calibrated

    def run(
        cause: str, shapes: Array, scales: Array, weights: Array, times: _Times, per_block: Array
    ) -> list[_Ratios]:
        told = []
        flat = solve_triangular(factor, shapes.reshape(n, -1), lower=True).reshape(shapes.shape)
        sizes = UNLIKE if cause in (OTHER_UNIT, OTHER_MODEL) else SIZES
        for width in sizes:
            logs, first = _ratio(white, squares, flat, width * scales)
            told.append(_Ratios(cause, logs, weights / len(sizes), times, first, per_block))
        return told

    ratios: list[_Ratios] = []
    rows = np.arange(n)
    month = MONTH_S / rules.block_s
    once = np.array([ONCE / 2 * month / rules.per_month / 100])

    def slope(times: _Times) -> tuple[Array, Array, Array]:
        """Return the shapes of an ageing zero, their scales, and `per_block`."""
        if alarm is None:
            until, scale = np.full(times.onset.size, month), typical
        else:
            until, scale = np.maximum(blocks.place[alarm] + 1 - times.onset, 1.0), wide
        shapes = np.maximum(blocks.place[:, None] - times.onset[None, :], 0.0) / until
        return shapes[:, :, None], np.array([scale]), 1.0 / until

    for cause, share in SHARES.items():
        times = _list_times(blocks.place, begin, GRID[cause], alarm, is_slow=cause == AGEING)
        since = rows[:, None] >= times.begin[None, :]
        per_block = np.zeros(times.begin.size)
        if cause == AGEING:
            shapes, scales, per_block = slope(times)
        elif cause == STEP:
            shapes = since[:, :, None].astype(np.float64)
            scales = np.array([wide])
        else:
            terms = np.column_stack([np.ones(n), follow])
            shapes = since[:, :, None].astype(np.float64) * terms[:, None, :]
            scales = np.full(3, wide)
        if alarm is not None and cause != AGEING:
            # of a block after a gap all is changed: a value of its own would speak against it
            whole_block = times.cell > times.begin - np.append(begin - 1, times.begin[:-1])
            within = (rows[:, None] == times.begin[None, :]) & ~whole_block[None, :]
            shapes = np.concatenate([shapes, within[:, :, None].astype(np.float64)], axis=2)
            scales = np.append(scales, wide)
        ratios += run(cause, shapes, scales, share * times.cell, times, per_block)
    at_first = _Times(*(np.array([value]) for value in _span_first(blocks.place, begin)))
    shapes, scales, per_block = slope(at_first)
    ratios += run(AGEING, shapes, scales, once, at_first, per_block)
    shapes, scales = follow[:, None, :], np.full(2, wide)
    ratios += run(OTHER_MODEL, shapes, scales, once, at_first, np.zeros(1))
    total = np.full(n, -np.inf)
    for one in ratios:
        with np.errstate(divide="ignore"):
            began = rows[:, None] >= one.times.begin[None, :]
            logs = np.where(began, one.log + np.log(one.weight), -np.inf)
        total = np.logaddexp(total, np.logaddexp.reduce(logs, axis=1))
    number = np.arange(1, n + 1)
    likelihood = -0.5 * number * np.log(squares / number) - np.cumsum(np.log(np.diag(factor)))
    return likelihood, total, ratios


def _list_times(
    place: IntArray, begin: int, grid: int, alarm: int | None, *, is_slow: bool
) -> _Times:
    """Return the times of change that are weighed.

    Args:
        place: [n] numbers of the blocks.
        begin: the first block that is not learnt from.
        grid: from one time to the next, in blocks.
        alarm: as `weigh` has it; without, gaps are passed over.
        is_slow: whether what begins then goes on, so that it may begin at any time of a gap.
    """
    n = place.size
    index = np.arange(begin, n, grid)
    if alarm is None:
        onset = place[index].astype(np.float64)
        return _Times(index, onset, onset, onset, np.full(index.size, float(grid)))
    if not is_slow:
        near = np.arange(max(begin, alarm - NEAR), min(n, alarm + 2))
        index = np.union1d(index, near)
        onset = place[index].astype(np.float64)
        before, after = np.append(begin - 1, index[:-1]), np.append(index[1:], n)
        cell = (place[index] - place[before]).astype(np.float64)
        return _Times(index, onset, place[before] + 1.0, place[after - 1] + 1.0, cell)
    onsets = [place[index].astype(np.float64)]
    for k in np.flatnonzero(np.diff(place) > grid):
        if k + 1 >= begin:
            gap = float(place[k + 1] - place[k])
            parts = int(min(IN_A_GAP, gap // grid))
            onsets.append(place[k] + gap * np.arange(1, parts + 1) / parts)
    onset = np.unique(np.concatenate(onsets))
    low = np.append(place[begin - 1], onset[:-1])
    high = np.append(onset[1:], onset[-1] + grid)
    return _Times(np.searchsorted(place, onset), onset, low, high, onset - low)


def _span_first(place: IntArray, begin: int) -> tuple[float, ...]:
    """Return the numbers of `_Times` of what was so from the first block on, or while learning."""
    first = float(place[0])
    return 0, first, first, float(place[min(begin, place.size - 1)]), 1.0


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
        told = _list_logs(one, n)
        if told.size:
            logs[one.cause] = np.logaddexp(logs[one.cause], np.logaddexp.reduce(told))
    total = np.logaddexp.reduce(list(logs.values()))
    return {cause: float(np.exp(log - total)) for cause, log in logs.items()}


def _list_logs(one: _Ratios, n: int) -> Array:
    """Return the weighted log ratios of the times that have begun by block `n`."""
    began = one.times.begin <= n
    return np.asarray(np.log(one.weight[began]) + one.log[n, began])


def _place(ratios: list[_Ratios], cause: str, n: int, until: int) -> tuple[int, float, float]:
    """Return the likeliest block of a change, its size, and its rate, after block `n`.

    The size of an ageing zero is how far it has moved until the begin of the block of number
    `until`, its rate that of a block of time; of any other change the rate is 0.
    """
    best, found = -np.inf, (0, 0.0, 0.0)
    for one in ratios:
        logs = _list_logs(one, n)
        if one.cause != cause or not logs.size or logs.max() <= best:
            continue
        best, at = logs.max(), int(np.argmax(logs))
        k = int(np.flatnonzero(one.times.begin <= n)[at])
        size = float(one.size[n, k])
        rate = size * float(one.per_block[k])
        moved = rate * (until - float(one.times.onset[k])) if cause == AGEING else size
        found = int(one.times.begin[k]), moved, rate
    return found


def _hold(ratios: list[_Ratios], causes: tuple[str, ...], n: int) -> tuple[int, int]:
    """Return the span of blocks in which a change began with probability `HELD`, after block `n`.

    It is that of the likeliest times, which hold so much, and of all between them.
    """
    spans = []
    for one in ratios:
        if one.cause in causes:
            began = one.times.begin <= n
            told = (_list_logs(one, n), one.times.low[began], one.times.high[began])
            spans.append(np.stack(told))
    logs, low, high = np.concatenate(spans, axis=1)
    order = np.argsort(-logs)
    held = np.cumsum(np.exp(logs[order] - np.logaddexp.reduce(logs)))
    chosen = order[: int(np.searchsorted(held, HELD)) + 1]
    return int(np.floor(low[chosen].min())), int(np.ceil(high[chosen].max()))


# Samples become means over blocks of time; a spike does not move a mean.

FAR = 4.0
"""Standard deviations of its block's samples beyond which a sample counts as that far off."""
"""Of a normal distribution: standard deviation over median absolute deviation."""
FEWEST_READINGS = 8
"""Samples in a block from which its own spread tells a spike."""


def make_blocks(time_s: Array, residual: Array, temperature: Array, block_s: float) -> BlockMeans:
    """Return the means over blocks.

    Args:
        time_s: [n] since 1970, rising.
        residual: [n] compensated less true value, in the output's unit; finite.
        temperature: [n] as a share of the calibrated range.
        block_s: length of a block.
    """
    if not time_s.size:
        return BlockMeans(np.zeros(0, dtype=np.int64), *(np.zeros(0) for _ in range(3)))
    number = np.floor(time_s / block_s).astype(np.int64)
    place, begin, count = np.unique(number, return_index=True, return_counts=True)
    column = np.arange(time_s.size) - np.repeat(begin, count)
    row = np.repeat(np.arange(place.size), count)
    table = np.full((place.size, int(count.max())), np.inf)
    table[row, column] = residual
    middle = _take_median(table, count)
    away = np.full(table.shape, np.inf)
    away[row, column] = np.abs(residual - middle[row])
    spread = FAR * NORMAL_OF_MAD * _take_median(away, count)
    spread[count < FEWEST_READINGS] = np.inf
    clipped = np.clip(residual, (middle - spread)[row], (middle + spread)[row])
    means = [np.add.reduceat(values, begin) / count for values in (clipped, temperature)]
    return BlockMeans(place, count.astype(np.float64), means[0], means[1])


def join_blocks(older: BlockMeans, newer: BlockMeans) -> BlockMeans:
    """Return two lists of blocks as one; blocks that both have are averaged by their samples."""
    place = np.concatenate([older.place, newer.place])
    count = np.concatenate([older.count, newer.count])
    places, index = np.unique(place, return_inverse=True)
    counts = np.bincount(index, weights=count).astype(np.float64)

    def average(own: Array, other: Array) -> Array:
        values = np.concatenate([own, other])
        return np.asarray(np.bincount(index, weights=values * count) / counts)

    return BlockMeans(
        places,
        counts,
        average(older.residual, newer.residual),
        average(older.temperature, newer.temperature),
    )


def _take_median(table: Array, count: IntArray) -> Array:
    """Return the median of the first `count` values of each row; the others are infinite."""
    ranked = np.sort(table, axis=1)
    rows = np.arange(len(table))
    return 0.5 * (ranked[rows, (count - 1) // 2] + ranked[rows, count // 2])
