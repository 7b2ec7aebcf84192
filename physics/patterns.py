"""Under which conditions a model fails: a scan over descriptors, checked on runs left out.

Errors may be concentrated. A condition that holds for a share p of the time and for a share c of
the squared error scores c log(c/p) + (1-c) log((1-c)/(1-p)), the scan statistic of a region for
Poisson counts: zero where errors are spread evenly, larger the more of them lie in the smaller
place. A second condition may be asked to hold too.

Or errors may be spread evenly in size but not in sign, as those of a hysteresis are. Then a
condition scores by the squared error that two levels explain, one where it holds and one elsewhere.

What is found must hold on runs that it was not found on, or it is not told.

Source: M. Kulldorff, "A spatial scan statistic", Commun. Statist. 26 (1997).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.physics.descriptors import Descriptor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_SHARE = 0.3
"""Share of the squared error, on runs left out, that a pattern must hold or explain."""
LEAST_CONCENTRATION = 1.5
"""Share of the error over share of the time, on runs left out."""
LEAST_AGREEING = 2 / 3
"""Share of the left-out runs in which it must hold."""
LEAST_SAY = 0.25
"""Share of the mean run's squared error that a run must have to agree or disagree."""
LEAST_TIME = 0.005
MOST_TIME = 0.6
"""Conditions that hold for less or more of the time than this name no place."""
BETTER_TOGETHER = 1.25
"""A second condition must raise the score, on runs left out, by this factor."""
LEAST_WORTH = 0.1
"""Share of an output's whole squared error that is worth a sentence."""
LEAST_LEFT = 0.15
"""Share of the squared error outside of all patterns that is worth another search."""
MOST_PATTERNS = 3
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
class _Choice:
    """The best condition, and what it is worth on runs that it was not chosen on."""

    condition: Condition
    score: float
    share_of_error: float
    share_of_time: float
    agreeing: int
    checked: int

    @property
    def is_shared(self) -> bool:
        """Whether enough runs agree, and enough of the error is spoken for."""
        return (
            self.share_of_error >= LEAST_SHARE
            and self.checked >= 2
            and self.agreeing >= LEAST_AGREEING * self.checked
        )

    @property
    def is_concentrated(self) -> bool:
        """Whether there is more error here than the time explains."""
        return self.is_shared and self.share_of_error >= LEAST_CONCENTRATION * self.share_of_time


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


def find_patterns(scan: Scan, output: int, error: Array, square: Array) -> list[Pattern]:
    """Return the patterns of one output, the most telling one first; empty where there is none.

    Args:
        scan: the descriptors.
        output: the output's number.
        error: [M] mean error of each block.
        square: [M] mean squared error of each block beyond the floor, not negative.
    """
    if not square.any():
        return []
    return _find_concentrations(scan, output, error, square) or _find_contrast(
        scan, output, error, square
    )


def _find_concentrations(scan: Scan, output: int, error: Array, square: Array) -> list[Pattern]:
    """Return the places that hold most of the squared error, each outside of the earlier ones."""
    patterns: list[Pattern] = []
    area = np.ones(square.size, dtype=np.bool_)
    whole = float(square.sum())
    while len(patterns) < MOST_PATTERNS and float(square[area].sum()) >= LEAST_LEFT * whole:
        choice = _choose_place(scan, output, square, area, area)
        if choice is None or not choice.is_concentrated:
            break
        conditions = [choice.condition]
        second = _choose_place(scan, output, square, area & scan.hold(choice.condition), area)
        if (
            second is not None
            and second.is_concentrated
            and second.score >= BETTER_TOGETHER * choice.score
        ):
            conditions.append(second.condition)
            choice = second
        held = area & scan.hold(*conditions)
        of_error, of_time = float(square[held].sum()) / whole, float(held.mean())
        if of_error < max(LEAST_WORTH, LEAST_CONCENTRATION * of_time):
            break
        words = scan.say(*conditions)
        patterns.append(
            Pattern(
                output,
                CONCENTRATED,
                words,
                of_error,
                of_time,
                choice.agreeing,
                choice.checked,
                float(error[held].mean()),
                held,
            )
        )
        area = area & ~held
    return patterns


def _choose_place(
    scan: Scan, output: int, square: Array, inside: Mask, area: Mask
) -> _Choice | None:
    """Return the condition within `inside`, a part of `area`, that concentrates the error most."""
    conditions = scan.list_conditions(output)
    error, time = scan.tally(output, square * inside), scan.tally(output, inside.astype(float))
    total_error, total_time = scan.total(square * area), scan.total(area.astype(float))
    whole_error, whole_time = float(total_error.sum()), float(total_time.sum())
    if not conditions or whole_error <= 0.0:
        return None
    liking = _like(scan, conditions)
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
    error, time = error[rows, chosen], time[rows, chosen]
    can_show = (time > 0.0) & (time < total_time[rows]) & _have_say(total_error)[rows]
    is_dense = error * total_time[rows] > time * total_error[rows]
    share_of_error = float(error.sum()) / whole_error
    share_of_time = float(time.sum()) / whole_time
    return _Choice(
        conditions[best],
        float(score_place(np.array(share_of_error), np.array(share_of_time))),
        share_of_error,
        share_of_time,
        int((can_show & is_dense).sum()),
        int(can_show.sum()),
    )


def _have_say(error: Array) -> Mask:
    """Return the runs [R] with enough squared error to show where it lies."""
    return np.asarray(error >= LEAST_SAY * error.mean()) & (error > 0.0)


def score_place(share_of_error: Array, share_of_time: Array) -> Array:
    """Return the scan statistic of conditions; zero where they name no place."""
    c = np.clip(share_of_error, 1e-12, 1.0 - 1e-12)
    p = np.clip(share_of_time, 1e-12, 1.0 - 1e-12)
    value = c * np.log(c / p) + (1.0 - c) * np.log((1.0 - c) / (1.0 - p))
    is_named = (c > p) & (share_of_time >= LEAST_TIME) & (share_of_time <= MOST_TIME)
    return np.asarray(np.where(is_named, value, 0.0))


def _find_contrast(scan: Scan, output: int, error: Array, square: Array) -> list[Pattern]:
    """Return the two sides of the condition by which the error's sign is best told, or nothing."""
    # A descriptor must have words for both sides; then one of its two conditions is enough.
    whole = float(square.sum())
    conditions = scan.list_conditions(output)
    two_sided = [not c.is_above and bool(scan.descriptors[c.descriptor].above) for c in conditions]
    conditions = [c for c, keep in zip(conditions, two_sided, strict=True) if keep]
    if not conditions:
        return []
    ones = np.ones(error.size)
    sums = scan.tally(output, error)[:, two_sided]
    counts = scan.tally(output, ones)[:, two_sided]
    sides = (
        (sums, counts),
        (scan.total(error)[:, None] - sums, scan.total(ones)[:, None] - counts),
    )
    liking = _like(scan, conditions)
    gains = np.zeros(scan.runs)
    have_say = _have_say(scan.total(square))
    for run in range(scan.runs):
        levels = [
            np.divide(
                s.sum(axis=0) - s[run],
                n.sum(axis=0) - n[run],
                where=n.sum(axis=0) > n[run],
                out=np.zeros(len(conditions)),
            )
            for s, n in sides
        ]
        on_others = sum(
            level**2 * (n.sum(axis=0) - n[run]) for level, (_, n) in zip(levels, sides, strict=True)
        )
        best = int(np.argmax(liking * on_others))
        gains[run] = sum(
            2.0 * level[best] * s[run, best] - level[best] ** 2 * n[run, best]
            for level, (s, n) in zip(levels, sides, strict=True)
        )
    on_all = sum(s.sum(axis=0) ** 2 / np.maximum(n.sum(axis=0), 1.0) for s, n in sides)
    best = int(np.argmax(liking * on_all))
    choice = _Choice(
        conditions[best],
        0.0,
        float(gains.sum()) / whole,
        1.0,
        int(((gains > 0.0) & have_say).sum()),
        int(have_say.sum()),
    )
    if not choice.is_shared:
        return []
    explained = float(np.atleast_1d(on_all)[best]) / whole
    patterns = []
    for is_above in (False, True):
        side = Condition(choice.condition.descriptor, choice.condition.threshold, is_above)
        held = scan.hold(side)
        patterns.append(
            Pattern(
                output,
                SIGNED,
                scan.say(side),
                explained,
                float(held.mean()),
                choice.agreeing,
                choice.checked,
                float(error[held].mean()),
                held,
            )
        )
    return patterns


def _like(scan: Scan, conditions: Sequence[Condition]) -> Array:
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
