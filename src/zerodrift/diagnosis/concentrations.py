"""Places where errors are concentrated: one condition or two that hold most of the squared error.

A condition that holds for a share p of the time and for a share c of the squared error scores
c log(c/p) + (1-c) log((1-c)/(1-p)), the scan statistic of a region for Poisson counts: zero where
errors are spread evenly, larger the more of them lie in the smaller place.

Source: M. Kulldorff, "A spatial scan statistic", Commun. Statist. 26 (1997).
"""

from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.diagnosis.scan import (
    CONCENTRATED,
    Condition,
    Evidence,
    Pattern,
    Scan,
    have_say,
    like,
)

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
