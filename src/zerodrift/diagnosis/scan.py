"""Conditions on descriptors, tallied run by run; what is found is judged on runs left out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, Mask
from zerodrift.diagnosis.descriptors import Descriptor

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
