"""Hysteresis and stick-slip: what a value does to a solid depends on where it came from.

Source: Brokate, Sprekels, Hysteresis and Phase Transitions, ch. 2 (the play operator; Prandtl and
Ishlinskii's superposition, a Preisach model whose density lies in bands); Al Janaideh, Rakheja, Su,
IEEE/ASME Trans. Mechatronics 16 (2011) 734 (unlike branches by an envelope).
"""

import numpy as np

from benchmarks.third_simulator.heat import Array


def superpose_plays(
    driven: Array, radii: Array, weights: Array, start: float, bend: float = 0.0
) -> Array:
    """Return the sum of plays of many widths less the value itself, shape (n,).

    Args:
        driven: shape (n,).
        radii: shape (plays,), half-widths in the unit of `driven`.
        weights: shape (plays,), their sum is 1.
        start: where the value came from, in one move, before the first sample.
        bend: how unlike the branches are: the plays see driven + bend driven^2 / widest.
    """
    width = float(radii.max())
    seen = driven + bend * driven**2 / (8.0 * width)
    came = start + bend * start**2 / (8.0 * width)
    state = np.full(radii.size, came)
    found = np.empty_like(driven)
    for row, value in enumerate(seen):
        state = np.clip(state, value - radii, value + radii)
        found[row] = weights @ state - value
    return found


def stick_and_slip(driven: Array, rng: np.random.Generator, hold: float) -> Array:
    """Return by how much something that sticks lies behind `driven`, shape (n,).

    It stays until the pull is beyond a threshold, which is another one each time, and then slips to
    somewhere near: a valve's stem, a joint under thermal stress.

    Args:
        driven: shape (n,).
        rng: draws thresholds and how far it slips.
        hold: mean threshold, in the unit of `driven`.
    """
    place = float(driven[0])
    threshold = hold * rng.uniform(0.4, 1.8)
    found = np.empty_like(driven)
    for row, value in enumerate(driven):
        if abs(value - place) > threshold:
            place = value - rng.uniform(-0.3, 0.5) * (value - place)
            threshold = hold * rng.uniform(0.4, 1.8)
        found[row] = place - value
    return found
