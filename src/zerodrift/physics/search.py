"""Values by variable projection: linear coefficients exactly, shared ones by search."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.dataset.runs import MOST_TOLD
from zerodrift.operations.operation import Node
from zerodrift.physics.campaign import Campaign, Sums
from zerodrift.physics.effect import Arrivals, Feature, Parameter
from zerodrift.physics.reduction import Column
from zerodrift.physics.terms import Term

if TYPE_CHECKING:
    from zerodrift.physics.campaign import Campaign


# Which of many starting values are worth a look octave by octave.
#
# A search follows the best few points of a grid. Where every octave has the same weight, the
# squared error does not depend on how the samples are taken apart (the change of basis is
# orthonormal), so that all points can be compared by plain products of the samples, in one matrix
# product. What comes near the best is then looked at as ever, so that the answer is the same to the
# bit.

MARGIN = 1e-3
"""By how much more than the last of the best, in the sum of the logarithms of squared errors, a
point may cost and still be looked at; round-off is a millionth of it."""
LEAST_LEFT = 1e-6
"""Where a point leaves less of the drift's squares than this share, round-off might decide."""
LEAST_EIGENVALUE = 1e-6
"""The same of the columns of a point that are nearly alike."""

MOST_AT_ONCE, LEAST_PART = 50_000, 16
"""Products in a part, and samples at least."""


def find_promising(
    campaign: Campaign, choices: Sequence[Sequence[Term]], weights: Array, count: int
) -> list[int] | None:
    """Return the places of all choices that may be among the best, in their order.

    Args:
        campaign: the runs.
        choices: the terms at several values.
        weights: [L, K] per octave and output.
        count: how many of the best are wanted.

    Returns:
        None where that cannot be told so, and all have to be looked at.
    """
    if len(choices) <= count or not bool((weights == 1.0).all()):
        return None
    built = [campaign.build(terms) for terms in choices]
    drift = campaign.lay_drift()
    nodes = {id(f.signal): f.signal for features in built for f in features}
    width = len(built[0])
    if (
        drift is None
        or width == 0
        or any(len(features) != width for features in built)
        or any(f.output is not None for features in built for f in features)
        or any(campaign.rates.find_fast(node) for node in nodes.values())
    ):
        return None
    places = {key: i for i, key in enumerate(nodes)}
    with np.errstate(all="ignore"):
        table = np.stack([campaign.rates.lay(node) for node in nodes.values()])
        costs = _compare(
            campaign.level(table),
            campaign.level(drift),
            np.array([[places[id(f.signal)] for f in features] for features in built]),
        )
    if costs is None:
        return None
    limit = np.partition(costs, count - 1)[count - 1] + MARGIN
    return np.flatnonzero(costs <= limit).tolist()


def _compare(table: Array, drift: Array, points: IntArray) -> Array | None:
    """Return the cost [S] of each point; None where round-off might count.

    Args:
        table: [U, n] all columns, levelled.
        drift: [K, n] likewise.
        points: [S, J] the columns of each point.
    """
    gram, right = _multiply(table, table), _multiply(table, drift)
    squares = (drift * drift).sum(axis=1)
    size = np.sqrt(np.diag(gram))
    if not np.isfinite(gram).all() or not (size > 0.0).all():
        return None
    gram, right = gram / (size[:, None] * size), right / size[:, None]
    normal = gram[points[:, :, None], points[:, None, :]]
    if float(np.linalg.eigvalsh(normal)[:, 0].min()) < LEAST_EIGENVALUE:
        return None
    own = right[points]
    left = squares - (own * np.linalg.solve(normal, own)).sum(axis=1)
    if not (left > LEAST_LEFT * squares).all():
        return None
    return np.asarray(np.log(left).sum(axis=1))


def _multiply(one: Array, other: Array) -> Array:
    """Return the products [U, V] of rows [U, n] and [V, n], part by part.

    In one piece it would be worth several threads to BLAS, which cost more than they save.
    """
    size = max(LEAST_PART, MOST_AT_ONCE // (len(one) * len(other)))
    end = one.shape[1] // size * size
    parts = [x[:, :end].reshape(len(x), -1, size).swapaxes(0, 1) for x in (one, other)]
    whole = (parts[0] @ parts[1].swapaxes(1, 2)).sum(axis=0)
    return np.asarray(whole + one[:, end:] @ other[:, end:].T)


# Variable projection on sums of products: linear coefficients exactly, shared values by slopes.
#
# The columns for values theta were reduced to sums of products (see `campaign`). All that follows -
# the least-squares solution per output, held-out errors, derivatives with respect to theta - is
# small algebra on these sums, whatever the number of samples.
#
# Source: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973); Kaufman, BIT 15 (1975).

RANK_TOLERANCE = 1e-10
"""Eigenvalues of the scaled normal matrix below this share of the largest count as zero."""


@dataclass(frozen=True)
class Coordinate:
    """One fitted parameter of one term, in the coordinate it is searched in."""

    term: int
    parameter: Parameter

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds in the coordinate."""
        return self.encode(self.parameter.lower), self.encode(self.parameter.upper)

    def encode(self, value: float) -> float:
        """Return the coordinate of a value: its logarithm, or its share of the range."""
        p = self.parameter
        return float(np.log(value)) if p.scale == "log" else (value - p.lower) / (p.upper - p.lower)

    def decode(self, u: float) -> float:
        """Return the value of a coordinate."""
        p = self.parameter
        return float(np.exp(u)) if p.scale == "log" else p.lower + u * (p.upper - p.lower)

    def slope(self, u: float) -> float:
        """Return d value / d coordinate."""
        p = self.parameter
        return float(np.exp(u)) if p.scale == "log" else p.upper - p.lower


def list_coordinates(terms: Sequence[Term]) -> list[Coordinate]:
    """Return all fitted parameters of all terms, in order."""
    return [Coordinate(i, p) for i, term in enumerate(terms) for p in term.free]


def set_coordinates(
    terms: Sequence[Term], coordinates: Sequence[Coordinate], u: Array
) -> list[Term]:
    """Return the terms with the coordinates' values put in, none beyond its bounds."""
    values: dict[int, dict[str, float]] = {}
    for coordinate, position in zip(coordinates, u, strict=True):
        place = values.setdefault(coordinate.term, {})
        place[coordinate.parameter.name] = min(
            max(coordinate.decode(float(position)), coordinate.parameter.lower),
            coordinate.parameter.upper,
        )
    return [term.with_values(values.get(i, {})) for i, term in enumerate(terms)]


def get_coordinates(terms: Sequence[Term], coordinates: Sequence[Coordinate]) -> Array:
    """Return the coordinates [P] of the terms' present values."""
    return np.array([c.encode(terms[c.term].values[c.parameter.name]) for c in coordinates])


def invert_scaled(normal: Array) -> Array:
    """Return pseudo-inverses of normal matrices [..., n, n], ranks cut after unit scaling."""
    if normal.shape[-1] == 0:
        return normal
    diagonal = np.sqrt(np.maximum(np.einsum("...ii->...i", normal), 0.0))
    scale = np.where(diagonal > 0.0, diagonal, 1.0)
    scaled = normal / (scale[..., :, None] * scale[..., None, :])
    values, vectors = np.linalg.eigh(scaled)
    keep = values > RANK_TOLERANCE * np.maximum(values[..., -1:], 1e-300)
    inverted = np.where(keep, 1.0 / np.where(keep, values, 1.0), 0.0)
    inverse = (vectors * inverted[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(inverse / (scale[..., :, None] * scale[..., None, :]))


@dataclass(frozen=True)
class Solution:
    """The least-squares answer for one set of values and weights, or for a batch [...] of them."""

    coefficients: Array
    """[..., K, J] of the features; zero where the mask hides one."""
    residual: Array
    """[..., K, C] the residual of each output as a combination of the sums' columns."""
    errors: Array
    """[..., K] weighted sums of squared residuals."""
    inverse: Array
    """[..., K, J + O, J + O] of the normal matrices."""


def weigh(sums: Sums, weights: Array) -> Array:
    """Return the sums per piece, weighted per octave and output, [G, K, C, C].

    Args:
        sums: the sums of products.
        weights: [L, K], the inverse variance of a coefficient of each octave.
    """
    pieces, octaves, size, _ = sums.products.shape
    flat = sums.products.reshape(pieces, octaves, size * size)
    weighted = np.swapaxes(weights, 0, 1) @ flat
    return np.asarray(weighted.reshape(pieces, weights.shape[1], size, size))


def solve(sums: Sums, total: Array, shift: Array | None = None) -> Solution:
    """Return the coefficients for every output, with the values moved by `shift` along the slopes.

    Args:
        sums: the columns' layout.
        total: [..., K, C, C] weighted sums over the pieces to fit.
        shift: [..., P] move of the coordinates; None = none.
    """
    basis, target, seen = _lay_out(sums, shift)
    moved = total @ basis
    normal = np.swapaxes(basis, -1, -2) @ moved * (seen[:, :, None] * seen[:, None, :])
    right = (target[:, None, :] @ moved)[..., 0, :] * seen
    if normal.shape[-3] > 1 and bool((normal == normal[..., :1, :, :]).all()):
        # All outputs see the same features with the same weights: one inverse is everyone's.
        inverse = np.repeat(invert_scaled(normal[..., :1, :, :]), normal.shape[-3], axis=-3)
    else:
        inverse = invert_scaled(normal)
    answer = (inverse @ right[..., None])[..., 0]
    residual = target - (basis @ answer[..., None])[..., 0]
    errors = (residual[..., None, :] @ total @ residual[..., None])[..., 0, 0]
    largest = (target[:, None, :] @ total @ target[:, :, None])[..., 0, 0]
    # Below this, round-off: a fit without any error would make every cost minus infinity.
    errors = np.maximum(errors, 1e-14 * largest + 1e-300)
    return Solution(answer[..., : len(sums.features)], residual, errors, inverse)


def _lay_out(sums: Sums, shift: Array | None) -> tuple[Array, Array, Array]:
    """Return the moved features and offsets as columns, the drifts, and the mask of outputs.

    The basis is [..., 1, C, J + O], the drifts [K, C], the mask [K, J + O] in zeros and ones.
    """
    features, slopes = len(sums.features), len(sums.slopes)
    size = sums.products.shape[-1]
    batch = () if shift is None else shift.shape[:-1]
    basis = np.zeros((*batch, 1, size, features + sums.offsets))
    basis[..., :features, :features] = np.eye(features)
    for o in range(sums.offsets):
        basis[..., features + slopes + o, features + o] = 1.0
    if shift is not None:
        for i, (p, j) in enumerate(sums.slopes):
            basis[..., features + i, j] = shift[..., None, p]
    target = np.zeros((sums.outputs, size))
    target[:, size - sums.outputs :] = np.eye(sums.outputs)
    seen = np.concatenate(
        [sums.mask.T.astype(np.float64), np.ones((sums.outputs, sums.offsets))], axis=1
    )
    return basis, target, seen


def step_values(
    sums: Sums, total: Array, solution: Solution, count: int, shift: Array | None = None
) -> tuple[Array, Array]:
    """Return the descent gradient [..., P] and the Gauss-Newton matrix [..., P, P] of cost / 2.

    The cost is sum_k log SSE_k. With d_pk = dPhi/du_p A_k and the projection Q off the columns
    (Kaufman), gradient_p = sum_k d_pk . r_k / SSE_k, normal_pq = sum_k (Q d_pk).(Q d_qk) / SSE_k.
    """
    basis, _, seen = _lay_out(sums, shift)
    along = slope_directions(sums, solution, count)
    moved = total @ along
    across = np.swapaxes(basis, -1, -2) @ moved * seen[:, :, None]
    curved = np.swapaxes(along, -1, -2) @ moved
    curved = curved - np.swapaxes(across, -1, -2) @ solution.inverse @ across
    pull = (solution.residual[..., None, :] @ moved)[..., 0, :]
    weight = 1.0 / solution.errors
    return (pull * weight[..., None]).sum(axis=-2), (curved * weight[..., None, None]).sum(axis=-3)


def slope_directions(sums: Sums, solution: Solution, count: int) -> Array:
    """Return d_pk as combinations of the sums' columns, [..., K, C, P]."""
    coefficients = solution.coefficients
    along = np.zeros((*coefficients.shape[:-1], sums.products.shape[-1], count))
    for i, (p, j) in enumerate(sums.slopes):
        along[..., len(sums.features) + i, p] = coefficients[..., j]
    return along


def measure_cost(errors: Array) -> float:
    """Return sum_k log SSE_k: the likelihood with each output's own, unknown noise.

    Sharing theta among outputs of different units needs no further weights that way.
    """
    return float(np.log(errors).sum())


# The search for non-linear values: starts in the typical range, then bounded Gauss-Newton.

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


# From where each run came to its first temperature: what a hysteresis remembers from before.
#
# A play begins anywhere within its slack, according to temperatures before the log. A run that
# begins after cooling is not described by a play that begins centred, until the temperature has
# moved by twice the half-width. Three beginnings are tried for every run: from above, from below,
# at rest.

SIDES = (0, 1, -1)
"""At rest, from above, from below."""
LEAST_GAIN = 0.1
"""Share of a run's squared error that another beginning must save, beside lowering the whole."""
MOST_PASSES = 4


def find_memory(terms: Sequence[Term]) -> int | None:
    """Return the place of the term that remembers temperatures, if there is one."""
    places = [i for i, term in enumerate(terms) if term.effect.remembers_temperature]
    return places[0] if places else None


def find_arrivals(campaign: "Campaign", terms: Sequence[Term], weights: Array) -> tuple[Term, ...]:
    """Return the terms with the beginnings of the runs that fit best, values as they are.

    Args:
        campaign: the runs.
        terms: at their values; one of them may remember temperatures.
        weights: [L, K] inverse variance per octave.
    """
    place = find_memory(terms)
    if place is None:
        return tuple(terms)

    def let_come(arrivals: Arrivals) -> tuple[Term, ...]:
        changed = replace(terms[place], arrivals=arrivals)
        return (*terms[:place], changed, *terms[place + 1 :])

    groups = campaign.groups
    weighed = []
    for side in SIDES:
        from_here = let_come(tuple((group, side) for group in groups) if side else ())
        sums = campaign.sum(campaign.build(from_here), from_here)
        weighed.append(weigh(sums, weights))
    owners = campaign.run_of_piece
    # [S, R, K, C, C]: what each run adds, by its beginning.
    parts = np.stack(
        [[each[owners == r].sum(axis=0) for r in range(len(groups))] for each in weighed]
    )
    present = dict(terms[place].arrivals)
    chosen = np.array([SIDES.index(present.get(group, 0)) for group in groups])
    runs = np.arange(len(groups))
    solution = solve(sums, parts[chosen, runs].sum(axis=0))
    for _ in range(MOST_PASSES):
        before = chosen.copy()
        for run in runs:
            for side in range(len(SIDES)):
                trial = chosen.copy()
                trial[run] = side
                attempt = solve(sums, parts[trial, runs].sum(axis=0))
                if measure_cost(attempt.errors) >= measure_cost(solution.errors):
                    continue
                kept = _measure(parts[chosen[run], run], solution.residual)
                saved = 1.0 - _measure(parts[side, run], attempt.residual) / kept
                # Back to rest needs no reason but a lower cost.
                if side == 0 or float(saved.max()) > LEAST_GAIN:
                    chosen, solution = trial, attempt
        if np.array_equal(chosen, before):
            break
    found = zip(groups, chosen.tolist(), strict=True)
    return let_come(tuple((group, SIDES[side]) for group, side in found if side))


def _measure(part: Array, residual: Array) -> Array:
    """Return the squared error [K] that a solution leaves of a run."""
    squares = np.einsum("kc,kcd,kd->k", residual, part, residual)
    return np.asarray(np.maximum(squares, 1e-300))


def note_arrivals(terms: Sequence[Term], groups: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence on the runs that began with a memory of other temperatures."""
    notes = []
    for term in terms:
        sides = [
            f"{text} {_list_some([group for group, side in term.arrivals if side == sign])}"
            for sign, text in ((1, "from warmer:"), (-1, "from colder:"))
            if any(side == sign for _, side in term.arrivals)
        ]
        if sides:
            notes.append(
                f"{term.name}: {len(term.arrivals)} of {len(groups)} training runs began with a "
                f"memory of temperatures before the log ({'; '.join(sides)}). A chip that begins "
                "at rest is off until the temperature has moved by the width of the hysteresis: "
                "save its state over power-off, or begin with a full cycle"
            )
    return tuple(notes)


def _list_some(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_TOLD} more" if len(names) > MOST_TOLD else ""
    return ", ".join(names[:MOST_TOLD]) + more
