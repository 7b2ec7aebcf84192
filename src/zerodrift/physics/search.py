"""The search for non-linear values: starts in the typical range, then bounded Gauss-Newton."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.operations.graph import Node
from zerodrift.physics.arrivals import find_arrivals
from zerodrift.physics.campaign import Campaign, Sums
from zerodrift.physics.effect import Feature
from zerodrift.physics.projection import (
    Coordinate,
    Solution,
    get_coordinates,
    invert_scaled,
    list_coordinates,
    measure_cost,
    set_coordinates,
    solve,
    step_values,
    weigh,
)
from zerodrift.physics.reduction import Column
from zerodrift.physics.shortlist import find_promising
from zerodrift.physics.terms import Term

GRID = 5
"""Starting values per parameter over its typical range."""
MOST_STARTS = 32
"""Several parameters share this many starts."""
MOST_STEPS = 20
"""Gauss-Newton steps; each must lower the cost or be shortened."""
SLOPE_STEP = 1e-3
"""Finite-difference step in a parameter's own coordinate (its natural logarithm, or its range)."""
FILLS = 5
"""How often samples at a converter's rail are filled anew."""
SMALL_GAIN = 1e-7
"""Relative gain of squared error at which a search ends."""
MOST_ARRIVALS = 3
"""How often the runs' beginnings and the values are sought in turn."""
ROUGHLY = 0.003
"""A rough search ends at this share of what the whole change gains."""
NEAR = 0.01
"""A start whose next step ends so near the optimum of a better one, in every coordinate, would come
to the same optimum."""
SAME = 1e-9
"""Starts that are no further apart are one start but for round-off."""


@dataclass(frozen=True)
class Found:
    """The end of a search: terms with values, and the least-squares answer there."""

    terms: tuple[Term, ...]
    sums: Sums
    solution: Solution
    cost: float


def search(
    campaign: Campaign,
    terms: Sequence[Term],
    weights: Array,
    *,
    vary: Sequence[int] | None = None,
    refined_starts: int = 2,
    without: float | None = None,
) -> Found:
    """Return the terms with the values that fit best.

    Args:
        campaign: the runs.
        terms: at starting values.
        weights: [L, K] inverse variance per octave.
        vary: indices of the terms whose parameters start from a grid over their typical ranges;
            None = all, () = start where the terms are.
        refined_starts: how many of the best starts are followed to their optimum.
        without: for a rough search, the cost without the terms that are searched for: the search
            ends where a step adds almost nothing to the gain over that cost.
    """
    coordinates = list_coordinates(terms)
    on_grid = [c for c in coordinates if vary is None or c.term in vary]
    points = [
        set_coordinates(terms, on_grid, np.array(u)) for u in (grid(on_grid) if on_grid else [])
    ]
    choices = [terms, *points]
    if coordinates and on_grid:
        promising = find_promising(campaign, choices, weights, refined_starts)
        choices = choices if promising is None else [choices[i] for i in promising]
    starts = assess_all(campaign, choices, weights)
    starts.sort(key=lambda found: found.cost)
    if not coordinates:
        return let_arrive(campaign, starts[0], weights, without)
    followed = starts[: refined_starts if on_grid else 1]
    best = _follow(campaign, followed, weights, coordinates, without)
    return let_arrive(campaign, best, weights, without)


def _follow(
    campaign: Campaign,
    starts: Sequence[Found],
    weights: Array,
    coordinates: Sequence[Coordinate],
    without: float | None,
) -> Found:
    """Return the best of the optima near the starts; one that is found is not sought twice."""
    best = refine(campaign, starts[0], weights, coordinates, without)
    followed = [get_coordinates(starts[0].terms, coordinates)]
    for start in starts[1:]:
        place = get_coordinates(start.terms, coordinates)
        if all(float(np.abs(place - other).max()) > SAME for other in followed):
            followed.append(place)
            found = refine(campaign, start, weights, coordinates, without, known=best)
            best = min(best, found, key=lambda each: each.cost)
    return best


def let_arrive(
    campaign: Campaign,
    found: Found,
    weights: Array,
    without: float | None,
) -> Found:
    """Return the optimum with the beginnings of the runs sought, too, where an effect remembers.

    Beginnings and values are sought in turn.
    """
    coordinates = list_coordinates(found.terms)
    for _ in range(MOST_ARRIVALS):
        terms = find_arrivals(campaign, found.terms, weights)
        if terms == found.terms:
            break
        found = assess(campaign, terms, weights)
        if coordinates:
            found = refine(campaign, found, weights, coordinates, without)
    return found


def search_beyond_rails(
    campaign: Campaign,
    terms: Sequence[Term],
    weights: Array,
    *,
    vary: Sequence[int] | None = None,
) -> Found:
    """Return what `search` returns, samples at a converter's rail filled by the model found.

    The filling comes from a fit that included those samples, so the fit is repeated: one repetition
    leaves of the first fit's error the share of samples that were filled.
    """
    found = search(campaign, terms, weights, vary=vary)
    if campaign.set_aside and campaign.plan.saturated:
        for _ in range(FILLS):
            campaign.fill(found.terms, found.solution.coefficients)
            found = search(campaign, found.terms, weights, vary=())
    return found


def grid(coordinates: Sequence[Coordinate]) -> list[tuple[float, ...]]:
    """Return starting points over the typical ranges, fewer per parameter the more there are."""
    per_axis = GRID
    while per_axis > 2 and per_axis ** len(coordinates) > MOST_STARTS:
        per_axis -= 1
    axes = []
    for c in coordinates:
        low, high = (c.encode(value) for value in c.parameter.typical)
        axes.append(np.linspace(low, high, per_axis).tolist())
    return list(itertools.islice(itertools.product(*axes), MOST_STARTS))


def assess(campaign: Campaign, terms: Sequence[Term], weights: Array) -> Found:
    """Return the least-squares solution at the terms' present values."""
    (found,) = assess_all(campaign, [terms], weights)
    return found


def assess_all(
    campaign: Campaign, choices: Sequence[Sequence[Term]], weights: Array
) -> list[Found]:
    """Return what `assess` returns for each of several values of the terms.

    Those that give columns of the same layout are solved together, each as it would be alone.
    """
    found = [campaign.sum(campaign.build(terms), terms) for terms in choices]
    layouts: dict[tuple[object, ...], list[int]] = {}
    for i, sums in enumerate(found):
        layouts.setdefault((sums.products.shape, sums.mask.tobytes()), []).append(i)
    answers: dict[int, Found] = {}
    for alike in layouts.values():
        total = np.stack([weigh(found[i], weights).sum(axis=0) for i in alike])
        together = solve(found[alike[0]], total)
        for i, *parts in zip(
            alike,
            together.coefficients,
            together.residual,
            together.errors,
            together.inverse,
            strict=True,
        ):
            own = Solution(*parts)
            answers[i] = Found(tuple(choices[i]), found[i], own, measure_cost(own.errors))
    return [answers[i] for i in range(len(found))]


def refine(
    campaign: Campaign,
    found: Found,
    weights: Array,
    coordinates: Sequence[Coordinate],
    without: float | None = None,
    known: Found | None = None,
) -> Found:
    """Return the optimum near `found`, by damped Gauss-Newton steps within the bounds.

    Args:
        campaign: the runs.
        found: where to begin.
        weights: [L, K] inverse variance per octave.
        coordinates: the fitted parameters.
        without: see `search`.
        known: an optimum that another start came to; a search that comes to it ends there.
    """
    target = None if known is None else get_coordinates(known.terms, coordinates)
    bounds = np.array([c.bounds for c in coordinates])
    damping = 1e-3
    for _ in range(MOST_STEPS):
        u = get_coordinates(found.terms, coordinates)
        sums = sum_with_slopes(campaign, found.terms, coordinates)
        total = weigh(sums, weights).sum(axis=0)
        solution = solve(sums, total)
        gradient, normal = step_values(sums, total, solution, len(coordinates))
        # A coordinate at its bound whose step would leave the range stays there.
        stuck = ((u <= bounds[:, 0]) & (gradient < 0)) | ((u >= bounds[:, 1]) & (gradient > 0))
        free = np.flatnonzero(~stuck & (np.diag(normal) > 0.0))
        if free.size == 0:
            return found
        better = None
        for _ in range(6):
            damped = normal[np.ix_(free, free)].copy()
            damped[np.diag_indices(free.size)] *= 1.0 + damping
            step = np.zeros_like(u)
            step[free] = np.clip(invert_scaled(damped) @ gradient[free], -1.0, 1.0)
            if without is not None and gradient @ step < _find_enough(found, without):
                return found
            trial = np.clip(u + step, bounds[:, 0], bounds[:, 1])
            is_there = target is not None and float(np.abs(trial - target).max()) < NEAR
            if known is not None and is_there and known.cost <= found.cost:
                return known
            attempt = assess(campaign, set_coordinates(found.terms, coordinates, trial), weights)
            if attempt.cost < found.cost:
                better = attempt
                damping = max(damping / 10.0, 1e-9)
                break
            if float(np.abs(trial - u).max()) < 1e-6:
                return found
            damping = max(10.0 * damping, 0.1)
        if better is None:
            return found
        gain = found.cost - better.cost
        found = better
        if gain < _find_enough(found, without):
            break
    return found


def _find_enough(found: Found, without: float | None) -> float:
    """Return the gain of a step below which a search ends."""
    least = SMALL_GAIN * len(found.solution.errors)
    return least if without is None else max(least, ROUGHLY * (without - found.cost))


def sum_with_slopes(
    campaign: Campaign, terms: Sequence[Term], coordinates: Sequence[Coordinate]
) -> Sums:
    """Return the sums of the terms' columns and of their slopes along each coordinate."""
    features, slopes = list_slopes(campaign, terms, coordinates)
    return campaign.sum(features, terms, slopes)


def list_slopes(
    campaign: Campaign, terms: Sequence[Term], coordinates: Sequence[Coordinate]
) -> tuple[tuple[Feature[Node], ...], list[tuple[int, int, Column]]]:
    """Return the features, and (coordinate, feature, column) of each slope that is not zero."""
    u = get_coordinates(terms, coordinates)
    # Decoded in the same way as the moved ones, so that equal values give the same node.
    features = campaign.build(set_coordinates(terms, coordinates, u))
    slopes: list[tuple[int, int, Column]] = []
    for p, coordinate in enumerate(coordinates):
        step = SLOPE_STEP if u[p] + SLOPE_STEP <= coordinate.bounds[1] else -SLOPE_STEP
        moved = u.copy()
        moved[p] += step
        shifted = campaign.build(set_coordinates(terms, coordinates, moved))
        for j, (now, then) in enumerate(zip(features, shifted, strict=True)):
            if then.signal is not now.signal:
                change = campaign.column(then.signal) - campaign.column(now.signal)
                slopes.append((p, j, change.scale(1.0 / step)))
    return features, slopes
