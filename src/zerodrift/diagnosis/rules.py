"""The rules by which an effect is named: real, worth having, told from others, and enough."""

from dataclasses import dataclass

import numpy as np

from zerodrift.diagnosis.case import Case
from zerodrift.diagnosis.evidence import SURE_NATS, compare_runs
from zerodrift.diagnosis.examination import Examination, Judged, share_explained
from zerodrift.diagnosis.floor import DWELL
from zerodrift.physics.fit import follows_clock_alone

SIGNIFICANT = 0.05
"""Largest p-value of an effect that is named, over all candidates together."""
WORTHWHILE = 0.985
"""An effect must bring the held-out RMSE below this share of what it was, ..."""
WORTHWHILE_ON_ONE = 0.97
"""... or that of one output below this."""
AT_FLOOR = 1.1
"""Held-out RMSE over the floor of a dwell that counts as having arrived."""
AT_ESTIMATED_FLOOR = 1.4
"""The same for a floor that was estimated, which is a lower bound."""
EXPLAINED = 0.95
"""Share of the excess over the floor that an effect of nearly the right form explains."""
LEFT_WITHOUT_DWELL = 0.5
"""Share of the held-out squared error that an effect may leave where no dwell tells the floor,"""
EXPLAINED_WITHOUT_DWELL = 0.7
"""or else it must explain this share of the excess; the floor being a lower bound, it explains more
of what is no noise."""
SURELY_THERE = 0.9
"""Probability from which an effect is named though too much is left for the right form alone."""
MOST_OF_A_PLAY = 0.9
"""A play must explain this share of the excess in runs left out, or all of it: what sticks at
random, or yields once and for all, looks like a play in most of what it does."""
SURE_BESIDE = 10.0
"""With few runs, or if it follows the time alone, an effect that is named beside much that it does
not explain must gain this many times SURE_NATS."""
SHARE_BESIDE = 0.25
"""It must explain this share of the excess: what explains less is a resemblance in passing."""
ENOUGH_RUNS = 6
"""Fewer runs than this are thin evidence, and said to be."""
SURE_UNITS = 300.0
"""An effect that is named must gain this in noise units, or SURE_NATS where it follows more than
the time, ..."""
SURE_SHARE = 0.9
"""... and with few runs lose next to nothing in any run or piece of one."""
CONCENTRATED = 0.8
"""An effect seen in too few runs for a small p-value must explain this share of the excess, ..."""
ALL_GAIN = 0.95
"""... and hardly lose anywhere."""
ALIKE = 0.02
"""Effects whose gains differ by less than this share cannot be told apart, ..."""
ALIKE_UNLESS_SURE = 0.1
"""... nor by less than this if the runs do not agree on it, or something else is missing, ..."""
ALIKE_UNITS = 10.0
"""... nor by less than this in noise units."""
IMPLAUSIBLE = 0.97
"""An effect with values far from typical gives way to one with this share of its gain."""
WANDERING = 0.3
"""Share of slow variance in a dwell above which the sensor wanders even at rest, ..."""
SLOW = 0.125
"""... slow being noise whose memory is longer than this share of the dwell, ..."""
GROWTH, GROWTH_SPREAD = 1.0, 0.5
"""... if variance grows by more than this power of the time at its end, flicker having 1 and a
random walk 2; the second is what one output's power may be off by, to be on the safe side."""


@dataclass(frozen=True)
class Finding:
    """One missing effect with the examination it came from."""

    examination: Examination
    judged: Judged


def lead(examination: Examination, *, beside: bool = False) -> Judged | None:
    """Return the effect to name: the one with most gain, unless its values are implausible.

    Args:
        examination: what each effect would gain.
        beside: another one was found for sure; what explains the rest may be less so.
    """
    helpful = [
        j
        for j in examination.judged
        if (j.sound or beside) and helps(j, examination, beside=beside)
    ]
    if not helpful:
        return None
    best = helpful[0]
    if best.plausible:
        return best
    rivals = [j for j in helpful if j.plausible and j.gain >= IMPLAUSIBLE * best.gain]
    return rivals[0] if rivals else best


def helps(judged: Judged, examination: Examination, *, beside: bool = False) -> bool:
    """Return whether an effect's held-out gain is real and worth having.

    Chance alone gains in most runs, now and then, and in all of a few: the gain must also be larger
    than what slow noise explains. At the floor there is no excess that an effect could explain.
    """
    worthwhile = judged.rmse_ratio <= WORTHWHILE or judged.best_output_ratio <= WORTHWHILE_ON_ONE
    reachable = 2.0 ** -float(judged.gains.size)
    sure = judged.p_value <= max(SIGNIFICANT, reachable)
    if not beside:
        large = judged.gain >= SURE_UNITS and judged.nats > 0.0
        large = large or (judged.follows_signal and judged.nats >= SURE_NATS)
        everywhere = examination.runs >= ENOUGH_RUNS or judged.positive_share >= SURE_SHARE
        sure = sure and large and everywhere
    # Seen in a few runs only, sign flips cannot be sure; reaching the floor by one effect can.
    clear = judged.share >= CONCENTRATED and judged.positive_share >= ALL_GAIN
    clear = clear and not is_at_floor(examination, examination.fitted_ratio)
    return worthwhile and judged.gain > 0.0 and (sure or clear)


def find_ageing(case: Case, examination: Examination) -> list[Finding]:
    """Return the ageing that lowers the error of runs left out, where their offsets follow it.

    That they do is known by a test of its own; see `measure_clock_trend`.
    """
    return [
        Finding(examination, judged)
        for judged in examination.judged
        if follows_clock_alone(case.catalogue[judged.kind])
        and judged.sound
        and judged.rmse_ratio <= WORTHWHILE
    ][:1]


def is_enough(finding: Finding) -> bool:
    """Return whether an effect explains what its kind must explain to be named alone."""
    leading, examination = finding.judged, finding.examination
    own = [term for term in leading.found.terms if term.effect.kind == leading.kind]
    if not any(parameter.slack_in for term in own for parameter in term.free):
        return True
    share = share_explained(examination.floor_ratio**2, leading.floor_ratio**2)
    return is_at_floor(examination, leading.floor_ratio) or share >= MOST_OF_A_PLAY


def is_there(finding: Finding) -> bool:
    """Return whether an effect is there though it leaves much that something else must explain.

    It gains in all runs, more than chance does, and more likelihood than slow noise explains. A
    richer form of what the model has, such as a higher order, is not that sure: it follows any
    curve over the same signal.
    """
    leading, examination = finding.judged, finding.examination
    if not leading.sound or leading.gain <= 0.0 or leading.positive_share < SURE_SHARE:
        return False
    if any(term.effect.kind == leading.kind for term in examination.terms):
        return False
    reachable = 2.0 ** -float(leading.gains.size)
    plain = examination.runs >= ENOUGH_RUNS and leading.follows_signal
    sure = leading.nats >= (SURE_NATS if plain else SURE_BESIDE * SURE_NATS)
    sure = sure and leading.p_value <= max(SIGNIFICANT, reachable)
    return sure and leading.share >= SHARE_BESIDE


def list_lookalikes(finding: Finding, *, beside: bool = False) -> list[Judged]:
    """Return the effects that these data cannot tell from the one found.

    Args:
        finding: the effect, and the examination that it was found in.
        beside: something else is missing too, which moves all gains by more than runs show.
    """
    leading = finding.judged
    alike_share = ALIKE_UNLESS_SURE if beside else ALIKE
    alike = []
    for judged in finding.examination.judged:
        if judged.kind == leading.kind or not helps(judged, finding.examination):
            continue
        if not judged.sound:
            continue
        behind = leading.gain - judged.gain
        # A play as wide as the range, a time constant without end: another effect in disguise,
        # unless it does better than what it would be in disguise.
        if leading.plausible and not judged.plausible and behind > 0.0:
            continue
        close = behind <= max(ALIKE_UNITS, alike_share * leading.gain)
        unsure = compare_runs(leading.gains, judged.gains) > SIGNIFICANT
        if close or (unsure and behind <= ALIKE_UNLESS_SURE * leading.gain):
            alike.append(judged)
    return alike


def is_at_floor(examination: Examination, ratio: float) -> bool:
    """Return whether an RMSE of so many floors is at the floor, as well as that is known."""
    if examination.noise.source != DWELL:
        return ratio <= AT_ESTIMATED_FLOOR
    return ratio <= AT_FLOOR + 2.0 * examination.noise.uncertainty


def wanders(case: Case, examination: Examination) -> bool:
    """Return whether the dwell wanders slowly, which no noise of a converter does."""
    if not case.dataset.dwell:
        return False
    noise = examination.noise
    longest = max(len(run) for run in case.dataset.dwell)
    slow = noise.weights[noise.tau_samples > SLOW * longest].sum(axis=0)
    share_of = slow / np.maximum(noise.weights.sum(axis=0), 1e-300)
    limit = GROWTH + GROWTH_SPREAD / np.sqrt(share_of.size)
    return float(share_of.mean()) > WANDERING and noise.measure_growth(longest) > limit
