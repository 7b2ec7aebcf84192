"""The stretches of time in which a model is worst, each with what was going on, in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.descriptors import Blocks, Descriptor, cut_blocks, describe

# Conditions on descriptors, tallied run by run; what is found is judged on runs left out.

LEAST_SHARE = 0.3
"""Share of the squared error, on runs left out, that a pattern must hold or explain."""
LEAST_AGREEING = 2 / 3
"""Share of the left-out runs in which it must hold."""
LEAST_SAY = 0.25
"""Share of the mean run's squared error that a run must have to agree or disagree."""
PIECES = 8
"""A single run is cut into this many pieces that stand in for runs."""
ROUNDER = 0.01
"""Relative score that each further digit of a threshold must earn."""

CONCENTRATED = "concentrated"
SIGNED = "signed"


@dataclass(frozen=True)
class Condition:
    """One descriptor above or below a threshold."""

    descriptor: int
    threshold: float
    is_above: bool


@dataclass(frozen=True)
class Pattern:
    """Where an output's error is concentrated, in words and as the blocks it holds for."""

    output: int
    kind: str
    """concentrated: most of the squared error lies here; signed: here the error has one sign, and
    elsewhere the other."""
    words: str
    share_of_error: float
    """Of the output's squared error beyond the floor, on all runs: what lies here, or what the
    two levels explain."""
    share_of_time: float
    runs_agreeing: int
    """Left-out runs in which it held, of `runs_checked` that could show it."""
    runs_checked: int
    mean_error: float
    """Of the output where it holds: measured minus reference minus model, in its unit."""
    blocks: Mask
    """[M] where it holds."""


@dataclass(frozen=True)
class Evidence:
    """What a choice of conditions is worth on runs that it was not chosen on."""

    share_of_error: float
    share_of_time: float
    agreeing: int
    """Runs in which it held, ..."""
    checked: int
    """... of those that could show it."""

    @property
    def is_shared(self) -> bool:
        """Whether enough runs agree, and enough of the error is spoken for."""
        return (
            self.share_of_error >= LEAST_SHARE
            and self.checked >= 2
            and self.agreeing >= LEAST_AGREEING * self.checked
        )


class Scan:
    """Descriptors sorted into bins between their thresholds, ready to be scanned for any error."""

    def __init__(self, descriptors: Sequence[Descriptor], run: NDArray[np.int64]) -> None:
        self.descriptors = tuple(descriptors)
        count = int(run.max()) + 1
        if count == 1:
            run = np.arange(run.size) * PIECES // run.size
            count = PIECES
        self.run = run
        self.runs = count
        self._places = [
            run * (d.thresholds.size + 1) + np.searchsorted(d.thresholds, d.values, side="right")
            for d in self.descriptors
        ]

    def list_conditions(self, output: int) -> list[Condition]:
        """Return all conditions that have words, in the order of `tally`."""
        return [
            Condition(number, float(threshold), is_above)
            for number, descriptor in enumerate(self.descriptors)
            if descriptor.output in (None, output)
            for is_above, words in ((False, descriptor.below), (True, descriptor.above))
            if words
            for threshold in descriptor.thresholds
        ]

    def tally(self, output: int, weight: Array) -> Array:
        """Return the sum of a weight [M] where each condition holds, run by run, [R, N]."""
        sums = [np.zeros((self.runs, 0))]
        for descriptor, place in zip(self.descriptors, self._places, strict=True):
            if descriptor.output not in (None, output):
                continue
            bins = descriptor.thresholds.size + 1
            binned = np.bincount(place, weight, self.runs * bins).reshape(self.runs, bins)
            below = binned.cumsum(axis=1)
            if descriptor.below:
                sums.append(below[:, :-1])
            if descriptor.above:
                sums.append(below[:, -1:] - below[:, :-1])
        return np.concatenate(sums, axis=1)

    def total(self, weight: Array) -> Array:
        """Return the sum of a weight [M] in each run, [R]."""
        return np.asarray(np.bincount(self.run, weight, self.runs).astype(np.float64))

    def hold(self, *conditions: Condition) -> Mask:
        """Return the blocks [M] for which all conditions hold."""
        held = np.ones(self.run.size, dtype=np.bool_)
        for condition in conditions:
            is_above = self.descriptors[condition.descriptor].values >= condition.threshold
            held &= is_above if condition.is_above else ~is_above
        return held

    def say(self, *conditions: Condition) -> str:
        """Return the conditions in words; two of one descriptor become one phrase."""
        words = []
        for number in dict.fromkeys(c.descriptor for c in conditions):
            own = [c for c in conditions if c.descriptor == number]
            low = max((c.threshold for c in own if c.is_above), default=None)
            high = min((c.threshold for c in own if not c.is_above), default=None)
            words.append(self.descriptors[number].say(low, high))
        return " and ".join(words)


def have_say(error: Array) -> Mask:
    """Return the runs [R] with enough squared error to show where it lies."""
    return np.asarray(error >= LEAST_SAY * error.mean()) & (error > 0.0)


def like(scan: Scan, conditions: Sequence[Condition]) -> Array:
    """Return factors on the scores, a little below 1 for thresholds of several digits."""
    return np.array(
        [
            scan.descriptors[c.descriptor].liking * (1.0 - ROUNDER * count_digits(c.threshold))
            for c in conditions
        ]
    )


def count_digits(number: float) -> int:
    """Return how many significant digits a threshold has beyond the first."""
    return max(len(f"{number:.4g}".replace(".", "").replace("-", "").strip("0")) - 1, 0)


# Places where errors are concentrated: one condition or two that hold most of the squared error.
#
# A condition that holds for a share p of the time and for a share c of the squared error scores
# c log(c/p) + (1-c) log((1-c)/(1-p)), the scan statistic of a region for Poisson counts: zero where
# errors are spread evenly, larger the more of them lie in the smaller place.
#
# Source: M. Kulldorff, "A spatial scan statistic", Commun. Statist. 26 (1997).

LEAST_CONCENTRATION = 1.5
"""Share of the error over share of the time, on runs left out."""
LEAST_TIME = 0.005
MOST_TIME = 0.6
"""Conditions that hold for less or more of the time than this name no place."""
BETTER_TOGETHER = 1.25
"""A second condition, on runs left out, must raise the score of the first by this factor."""
LEAST_WORTH = 0.1
"""Share of an output's whole squared error that is worth a sentence."""
LEAST_LEFT = 0.15
"""Share of the squared error outside of all patterns that is worth another search."""
MOST_PATTERNS = 3
GOOD_ENOUGH = 0.8
"""An output is told by the words of all outputs if they score this share of its own best."""


@dataclass(frozen=True)
class Place:
    """Conditions that hold together, and what they are worth."""

    conditions: tuple[Condition, ...]
    evidence: Evidence

    @property
    def is_concentrated(self) -> bool:
        """Whether there is more error here than the time explains, in runs left out too."""
        e = self.evidence
        return e.is_shared and e.share_of_error >= LEAST_CONCENTRATION * e.share_of_time

    @property
    def score(self) -> float:
        """The scan statistic on runs left out."""
        e = self.evidence
        return float(score_place(np.array(e.share_of_error), np.array(e.share_of_time)))


def find_concentrations(
    scan: Scan, output: int, error: Array, square: Array, shared: Place | None = None
) -> list[Pattern]:
    """Return the places that hold most of the squared error, each outside of the earlier ones.

    Args:
        scan: the descriptors.
        output: the output's number.
        error: [M] mean error of each block.
        square: [M] mean squared error of each block beyond the floor, not negative.
        shared: a place found for all outputs together, taken if it is nearly as good as their own.
    """
    patterns: list[Pattern] = []
    area = np.ones(square.size, dtype=np.bool_)
    whole = float(square.sum())
    while len(patterns) < MOST_PATTERNS and float(square[area].sum()) >= LEAST_LEFT * whole:
        place = find_place(scan, output, square, area)
        if shared is not None and not patterns:
            place = _prefer(scan, square, shared, place)
        if place is None:
            break
        held = area & scan.hold(*place.conditions)
        of_error, of_time = float(square[held].sum()) / whole, float(held.mean())
        if of_error < max(LEAST_WORTH, LEAST_CONCENTRATION * of_time):
            break
        patterns.append(
            Pattern(
                output,
                CONCENTRATED,
                scan.say(*place.conditions),
                of_error,
                of_time,
                place.evidence.agreeing,
                place.evidence.checked,
                float(error[held].mean()),
                held,
            )
        )
        area = area & ~held
    return patterns


def find_place(scan: Scan, output: int, square: Array, area: Mask) -> Place | None:
    """Return the one or two conditions that concentrate the error within `area`, if any do."""
    first = _choose(scan, output, square, area, area)
    if first is None or not first.is_concentrated:
        return None
    held = area & scan.hold(*first.conditions)
    second = _choose(scan, output, square, held, area)
    # The first one was chosen on all runs, so that is where it is compared.
    alone = _score_on_all(square, held, area)
    if second is not None and second.is_concentrated and second.score >= BETTER_TOGETHER * alone:
        return Place((*first.conditions, *second.conditions), second.evidence)
    return first


def _score_on_all(square: Array, held: Mask, area: Mask) -> float:
    """Return the scan statistic of a part of an area, over all runs."""
    share = square[held].sum() / square[area].sum()
    return float(score_place(np.array(share), np.array(held.sum() / area.sum())))


def _prefer(scan: Scan, square: Array, shared: Place, own: Place | None) -> Place | None:
    """Return the shared place, as it is for this output, or the output's own."""
    held = scan.hold(*shared.conditions)
    error, time = scan.total(square * held), scan.total(held.astype(float))
    total_error, total_time = scan.total(square), scan.total(np.ones(square.size))
    evidence = _weigh(error, time, total_error, total_time)
    there = Place(shared.conditions, evidence)
    if not there.is_concentrated:
        return own
    best = 0.0
    if own is not None:
        everywhere = np.ones(square.size, dtype=np.bool_)
        best = _score_on_all(square, scan.hold(*own.conditions), everywhere)
    return there if there.score >= GOOD_ENOUGH * best else own


def _choose(scan: Scan, output: int, square: Array, inside: Mask, area: Mask) -> Place | None:
    """Return the condition within `inside`, a part of `area`, that concentrates the error most.

    Its evidence is that of each run under the condition that the other runs would have chosen.
    """
    conditions = scan.list_conditions(output)
    error, time = scan.tally(output, square * inside), scan.tally(output, inside.astype(float))
    total_error, total_time = scan.total(square * area), scan.total(area.astype(float))
    whole_error, whole_time = float(total_error.sum()), float(total_time.sum())
    if not conditions or whole_error <= 0.0:
        return None
    liking = like(scan, conditions)
    on_all = liking * score_place(error.sum(axis=0) / whole_error, time.sum(axis=0) / whole_time)
    best = int(np.argmax(on_all))
    if on_all[best] <= 0.0:
        return None
    rows = np.flatnonzero((total_error < whole_error) & (total_time < whole_time))
    on_others = liking * score_place(
        (error.sum(axis=0) - error[rows]) / (whole_error - total_error[rows])[:, None],
        (time.sum(axis=0) - time[rows]) / (whole_time - total_time[rows])[:, None],
    )
    chosen = np.argmax(on_others, axis=1)
    held_error, held_time = np.zeros(scan.runs), np.zeros(scan.runs)
    held_error[rows], held_time[rows] = error[rows, chosen], time[rows, chosen]
    return Place((conditions[best],), _weigh(held_error, held_time, total_error, total_time))


def _weigh(error: Array, time: Array, total_error: Array, total_time: Array) -> Evidence:
    """Return the evidence of what a condition holds in each run [R]."""
    can_show = (time > 0.0) & (time < total_time) & have_say(total_error)
    is_dense = error * total_time > time * total_error
    return Evidence(
        float(error.sum() / total_error.sum()),
        float(time.sum() / total_time.sum()),
        int((can_show & is_dense).sum()),
        int(can_show.sum()),
    )


def score_place(share_of_error: Array, share_of_time: Array) -> Array:
    """Return the scan statistic of conditions; zero where they name no place."""
    c = np.clip(share_of_error, 1e-12, 1.0 - 1e-12)
    p = np.clip(share_of_time, 1e-12, 1.0 - 1e-12)
    value = c * np.log(c / p) + (1.0 - c) * np.log((1.0 - c) / (1.0 - p))
    is_named = (c > p) & (share_of_time >= LEAST_TIME) & (share_of_time <= MOST_TIME)
    return np.asarray(np.where(is_named, value, 0.0))


# Conditions by which the sign of an error is told, as the branches of a hysteresis are.
#
# Such errors are spread evenly in size, so no place holds more of them than another. A condition
# scores by the squared error that two levels explain, one where it holds and one elsewhere.


def find_contrast(scan: Scan, output: int, error: Array, square: Array) -> list[Pattern]:
    """Return the two sides of the condition that tells the error's sign best, or nothing.

    Args:
        scan: the descriptors.
        output: the output's number.
        error: [M] mean error of each block.
        square: [M] mean squared error of each block beyond the floor, not negative.
    """
    # A descriptor must have words for both sides; then one of its two conditions is enough.
    listed = scan.list_conditions(output)
    two_sided = [not c.is_above and bool(scan.descriptors[c.descriptor].above) for c in listed]
    conditions = [c for c, keep in zip(listed, two_sided, strict=True) if keep]
    if not conditions:
        return []
    ones = np.ones(error.size)
    sums, counts = scan.tally(output, error), scan.tally(output, ones)
    # [2, R, N]: where each condition holds, and elsewhere.
    total = np.stack([sums, scan.total(error)[:, None] - sums])[:, :, two_sided]
    count = np.stack([counts, scan.total(ones)[:, None] - counts])[:, :, two_sided]
    liking = like(scan, conditions)
    gains = np.zeros(scan.runs)
    for run in range(scan.runs):
        left = count.sum(axis=1) - count[:, run]
        level = (total.sum(axis=1) - total[:, run]) / np.maximum(left, 1.0)
        best = int(np.argmax(liking * (level**2 * left).sum(axis=0)))
        explained = 2.0 * level * total[:, run] - level**2 * count[:, run]
        gains[run] = explained[:, best].sum()
    whole, says = float(square.sum()), have_say(scan.total(square))
    evidence = Evidence(
        float(gains.sum()) / whole, 1.0, int(((gains > 0.0) & says).sum()), int(says.sum())
    )
    if not evidence.is_shared:
        return []
    on_all = (total.sum(axis=1) ** 2 / np.maximum(count.sum(axis=1), 1.0)).sum(axis=0)
    best = int(np.argmax(liking * on_all))
    patterns = []
    for is_above in (False, True):
        side = Condition(conditions[best].descriptor, conditions[best].threshold, is_above)
        held = scan.hold(side)
        patterns.append(
            Pattern(
                output,
                SIGNED,
                scan.say(side),
                float(on_all[best]) / whole,
                float(held.mean()),
                evidence.agreeing,
                evidence.checked,
                float(error[held].mean()),
                held,
            )
        )
    return patterns


# Under which conditions a model fails, in words that hold on runs left out.
#
# Errors may be concentrated in some place, or be of one sign here and of the other there. Outputs
# that fail in the same place are told by the same words: the cause is one.

ALL = -1
"""Number that stands for all outputs together; no descriptor is of this one alone."""


def find_patterns(scan: Scan, error: Array, square: Array) -> list[Pattern]:
    """Return the patterns of all outputs, those of one output most telling first.

    Args:
        scan: the descriptors.
        error: [M, K] mean error of each block.
        square: [M, K] mean squared error of each block beyond the floor, not negative; zeros for
            outputs that are not to be searched.
    """
    whole = square.sum(axis=0)
    searched = np.flatnonzero(whole > 0.0)
    shared = None
    if searched.size > 1:
        together = (square[:, searched] / whole[searched]).sum(axis=1)
        shared = find_place(scan, ALL, together, np.ones(together.size, dtype=np.bool_))
    patterns: list[Pattern] = []
    for k in searched.tolist():
        own = error[:, k], square[:, k]
        patterns += find_concentrations(scan, k, *own, shared) or find_contrast(scan, k, *own)
    return patterns


# The stretches of time in which a model is worst, each with what was going on, in words.

NO_PATTERN = "no pattern found"
CLOSED_GAP = 3
"""Gaps of up to this many blocks within a segment are bridged."""
STANDS_OUT = 1.5
"""A segment is told if its RMSE is this much above the noise floor, and above the output's own."""
STANDS_ALONE = 2.0
"""The same for a segment without a pattern, which may be chance."""
SHORTEST = 30
"""Samples that a segment without a pattern has at least; less is an outlier."""
ALIKE = 2
"""Most segments of one output and one pattern."""
MOST_SEGMENTS = 10


@dataclass(frozen=True)
class Segment:
    """An uninterrupted stretch of one run in which one output is badly off."""

    run: str
    output: str
    from_s: float
    """First sample, on the log's own clock."""
    to_s: float
    """Last sample."""
    rmse: float
    """In the output's unit."""
    mean_error: float
    """What is left on average: measured minus reference minus model."""
    pattern: str
    """In words, or `no pattern found`."""


@dataclass(frozen=True)
class Failures:
    """Where a model fails."""

    worst: tuple[Segment, ...]
    """The worst stretches, by RMSE over full scale, a few of each kind."""
    patterns: tuple[Pattern, ...]


def find_failures(
    runs: Sequence[Sequence[Run]],
    errors: Sequence[Sequence[Array]],
    floor: Array,
    *,
    outputs: Sequence[str],
    units: Sequence[str],
    full_scale: Sequence[float],
    channel_units: Mapping[str, str] | None = None,
    most: int = MOST_SEGMENTS,
) -> Failures:
    """Return the patterns in the errors of these runs, and the worst segments.

    Args:
        runs: the stretches of each run.
        errors: [n, K] of each stretch.
        floor: [K] RMS of the noise.
        outputs: names of the K outputs.
        units: their units.
        full_scale: their full scales, by which segments of different outputs are ranked.
        channel_units: units of the input channels.
        most: how many segments to return.
    """
    blocks = cut_blocks(runs)
    flat = [error for stretches in errors for error in stretches]
    squares = blocks.average([error**2 for error in flat])
    means = blocks.average(flat)
    excess = np.maximum(squares - floor**2, 0.0)
    scan = Scan(describe(blocks, flat, outputs, units, channel_units), blocks.run)
    rmse = np.sqrt(squares.mean(axis=0))
    patterns = find_patterns(scan, means, np.where(rmse > floor, excess, 0.0))
    candidates: list[Segment] = []
    for k, output in enumerate(outputs):
        least = max(STANDS_OUT * float(floor[k]), float(rmse[k]))
        segments: list[Segment] = []
        free = np.ones(blocks.run.size, dtype=np.bool_)
        for pattern in (p for p in patterns if p.output == k):
            held = pattern.blocks
            if pattern.kind != CONCENTRATED:
                held = held & _find_bursts(blocks, np.where(held, squares[:, k], 0.0), least**2)
            segments += _list_segments(blocks, flat, held, k, output, pattern.words)
            free &= ~held
        rest = _find_bursts(blocks, np.where(free, squares[:, k], 0.0), least**2)
        shortest_s = (SHORTEST - 1) * blocks.seconds / blocks.size
        segments += [
            segment
            for segment in _list_segments(blocks, flat, rest, k, output, NO_PATTERN)
            if segment.to_s - segment.from_s >= shortest_s
            and segment.rmse >= STANDS_ALONE * float(floor[k])
        ]
        candidates += [s for s in segments if s.rmse >= least]
    scale = dict(zip(outputs, full_scale, strict=True))
    candidates.sort(key=lambda s: (-s.rmse / scale[s.output], s.run, s.from_s))
    kept: list[Segment] = []
    for segment in candidates:
        kind = (segment.output, segment.pattern)
        if sum((s.output, s.pattern) == kind for s in kept) < ALIKE and len(kept) < most:
            kept.append(segment)
    return Failures(tuple(kept), tuple(patterns))


def _find_bursts(blocks: Blocks, square: Array, level: float) -> Mask:
    """Return in each stretch the interval that exceeds a level most in total, if one does.

    The level is raised to the stretch's own mean, so that a run that is bad throughout is told by
    its worst part.
    """
    found = np.zeros(square.size, dtype=np.bool_)
    for stretch in range(len(blocks.stretches)):
        here = np.flatnonzero(blocks.stretch == stretch)
        own = square[here]
        sums = np.concatenate([[0.0], np.cumsum(own - max(level, float(own.mean())))])
        rise = sums - np.minimum.accumulate(sums)
        stop = int(np.argmax(rise))
        if rise[stop] > 0.0:
            start = int(np.argmin(sums[:stop]))
            found[here[start:stop]] = True
    return found


def _list_segments(
    blocks: Blocks, errors: Sequence[Array], held: Mask, k: int, output: str, words: str
) -> list[Segment]:
    """Return the uninterrupted parts of the blocks that are marked."""
    segments = []
    for number, run in enumerate(blocks.stretches):
        marked = np.flatnonzero(held & (blocks.stretch == number))
        if not marked.size:
            continue
        for part in np.split(marked, np.flatnonzero(np.diff(marked) > CLOSED_GAP) + 1):
            first, last = int(blocks.row[part[0]]), int(blocks.row[part[-1]]) + blocks.size - 1
            error = errors[number][first : last + 1, k]
            segments.append(
                Segment(
                    run.group,
                    output,
                    float(run.time_s[first]),
                    float(run.time_s[last]),
                    float(np.sqrt(np.mean(error**2))),
                    float(error.mean()),
                    words,
                )
            )
    return segments
