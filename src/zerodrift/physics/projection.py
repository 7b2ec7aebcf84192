"""Variable projection on sums of products: linear coefficients exactly, shared values by slopes.

The columns for values theta were reduced to sums of products (see `campaign`). All that follows -
the least-squares solution per output, held-out errors, derivatives with respect to theta - is
small algebra on these sums, whatever the number of samples.

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973); Kaufman, BIT 15 (1975).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.physics.campaign import Sums
from zerodrift.physics.effect import Parameter
from zerodrift.physics.terms import Term

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
