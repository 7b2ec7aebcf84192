"""The oracle: which effects a simulated sensor has, by whoever knows how it was simulated.

For a set of effects the evidence is p(data | set), the priors being the generator's. In noise
levels, the data are y = X(v) z + n: X has a constant, the polynomial and the effects' columns; z is
Gaussian about plus or minus the middle size; n is white with a slow part. z is integrated
analytically, the level of the noise by Laplace's approximation in its logarithm, the nonlinear
values v by Laplace's about the best ones, order of the polynomial and share of the slow part by
sums. Only Gram matrices of block means over a grid of values are needed; between the grid's points
columns are interpolated by cubics. Sets are searched by a beam: add each effect, keep the best.

Where it only approximates the generator: the error of a thermometer is taken as a slow part of the
noise of unknown size; the size of each effect, drawn evenly, as a Gaussian of the same mean and
variance; the slow part as known up to steps of a factor of 1.4.

Source: MacKay, Information Theory, Inference, and Learning Algorithms, ch. 27 and 28.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.oracle.forms import (
    BEND,
    BLOCK,
    CHIP,
    LINE,
    MOST_EFFECTS,
    SLOW_S,
    Array,
    SetPrior,
    leave_polynomial,
    rms,
    take_means,
)
from zerodrift_lab.oracle.generator import Case

BEAM = 12
"""Sets kept of each number of effects."""
TRIED = 24
"""Sets of each number of effects whose values are refined."""
RATIOS = (0.0, *(2.0 ** (n / 2.0) for n in range(-4, 10)))
"""RMS of the slow part of the noise over that of the white one."""
WHITE = 0.4
"""Prior probability that the noise has no slow part."""
OFFSET = 300.0
"""Standard deviation of the constant, in noise levels."""
NEVER = -1e300
FIRST = np.array([1.0, 0.0, 0.0, 0.0])
"""Weights of a column that is no function of a value."""
Set = tuple[int, ...]
"""Entries' numbers, rising."""


@dataclass(frozen=True)
class Scored:
    """One set of effects.

    Attributes:
        chosen: entries' numbers.
        values: places on their grids, shape (effects,).
        order: of the polynomial that fits best.
        ratio: number of the best of `RATIOS`.
        log_evidence: nats, values, order and noise integrated out.
        log_joint: the same plus the log prior of the set.
    """

    chosen: Set
    values: Array
    order: int
    ratio: int
    log_evidence: float
    log_joint: float


@dataclass(frozen=True)
class Posterior:
    """What the data say, over the sets that were searched.

    Attributes:
        sets: probability of each set of (kind, form, signal), the most probable first.
        visited: how many sets were scored.
    """

    sets: tuple[tuple[frozenset[tuple[str, str, str]], float], ...]
    visited: int

    @cached_property
    def by_kinds(self) -> dict[frozenset[str], float]:
        """Probability of each set of kinds, forms and thermometers summed."""
        found: dict[frozenset[str], float] = {}
        for chosen, probability in self.sets:
            kinds = frozenset(kind for kind, _, _ in chosen)
            found[kinds] = found.get(kinds, 0.0) + probability
        return found

    def probability_in(self, kind: str, signal: str | None = None) -> float:
        """Return P(an effect of this kind is in), on one thermometer where `signal` is given."""
        return sum(
            probability
            for chosen, probability in self.sets
            if any(one[0] == kind and signal in (None, one[2]) for one in chosen)
        )

    def log_score(self, kinds: Iterable[str]) -> float:
        """Return the log probability of a set of kinds; one not searched has a millionth."""
        return math.log(max(self.by_kinds.get(frozenset(kinds), 0.0), 1e-6))

    @property
    def expected_log_score(self) -> float:
        """The mean of `log_score` over truths drawn from this posterior; nats, at most 0."""
        return sum(p * math.log(p) for p in self.by_kinds.values() if p > 0.0)


class Oracle:
    """The evidence of sets of effects for one case's data."""

    def __init__(self, case: Case, sizes: tuple[float, float] | None = None) -> None:
        """Take block means, whiten them for each noise and keep their Gram matrices.

        Args:
            case: the data; of the truth only the range of sizes is read.
            sizes: between which effects are drawn; left out, the case's.
        """
        self.entries = case.entries
        low, high = sizes or case.truth.sizes
        self.middle = 0.5 * (low + high)
        self.width = max((high - low) / math.sqrt(12.0), 0.1 * self.middle)
        self.prior = SetPrior([entry.candidate for entry in self.entries])
        self.scales = [np.abs(np.nan_to_num(entry.scale, nan=1.0)) for entry in self.entries]
        chip = case.signals.series[CHIP]
        middle = float(chip.mean())
        base = np.concatenate(
            [
                take_means((chip - middle)[None], case.lengths),
                take_means((chip - middle)[None] ** 2, case.lengths),
            ]
        )
        y = take_means((case.measured - case.reference)[None], case.lengths)[0]
        columns = [np.ones_like(y), *base]
        self.places: list[list[NDArray[np.int64]]] = []
        for entry in self.entries:
            mine = []
            for column in entry.columns:
                mine.append(len(columns) + np.arange(len(column)))
                columns.extend(column)
            self.places.append(mine)
        x = np.stack(columns)
        x[1:] -= x[1:].mean(axis=1, keepdims=True)
        # Columns of like length keep the products of a set's few columns accurate.
        self.lengths = np.maximum(rms(x), 1e-300)
        x /= self.lengths[:, None]
        y = y - y.mean()
        y /= rms(y)
        self.bend = float(rms(leave_polynomial(base[1:], base[0])[0]))
        self.slope = float(base[0].std())
        self.rows = y.size
        self._keep_products(np.concatenate([x, y[None]]), case)

    def _keep_products(self, x: Array, case: Case) -> None:
        """Keep Gram matrices (ratios, columns, columns) and log determinants of the whiteners."""
        blocks = [length // BLOCK for length in case.lengths]
        self.products = np.zeros((len(RATIOS), len(x), len(x)))
        self.log_whiteners = np.zeros(len(RATIOS))
        for number, ratio in enumerate(RATIOS):
            whole = _covariance(max(blocks), case.signals.step_s, ratio)
            # The first rows of a Cholesky factor are the factor of a shorter run.
            factor = np.linalg.cholesky(whole)
            white = np.empty_like(x)
            start = 0
            inverse = np.linalg.inv(factor)
            for size in blocks:
                part = x[:, start : start + size]
                white[:, start : start + size] = part @ inverse[:size, :size].T
                self.log_whiteners[number] -= float(np.log(np.diag(factor)[:size]).sum())
                start += size
            self.products[number] = white @ white.T

    # The evidence of a set at given values.

    def weigh(self, chosen: Set, x: Array, order: int, ratio: int | NDArray[np.int64]) -> Array:
        """Return log p(data | set, values, order, noise) plus the log prior of the values.

        Args:
            chosen: entries.
            x: places on the grids, shape (batch, effects).
            order: of the polynomial.
            ratio: number of the slow share, one or of shape (batch,).

        Returns:
            shape (batch,), `NEVER` where a value is off its grid or not drawn.
        """
        batch = len(x)
        index: list[NDArray[np.int64]] = [np.zeros((batch, 4), dtype=np.int64)]
        weight: list[Array] = [np.broadcast_to(FIRST, (batch, 4))]
        sd: list[Array] = [np.full(batch, OFFSET)]
        signed: list[bool] = [False]
        line = math.sqrt((LINE[0] ** 2 + LINE[0] * LINE[1] + LINE[1] ** 2) / 3.0) / self.slope
        polynomial = [(np.array([1]), line), (np.array([2]), BEND / self.bend)][:order]
        rewriting = None
        log_prior = np.zeros(batch)
        effects = []
        for number, one in enumerate(chosen):
            entry = self.entries[one]
            nodes, shares, inside = _interpolate(x[:, number], entry.allowed)
            log_prior = np.where(inside, log_prior - math.log(entry.allowed.sum()), NEVER)
            scale = np.abs((self.scales[one][:, nodes] * shares).sum(axis=2))  # (columns, batch)
            if entry.candidate.form.rewrites:
                rewriting = (one, nodes, shares, scale[0])
            else:
                effects.append((one, nodes, shares, scale))
        for power, (place, width) in enumerate(polynomial):
            if rewriting is None:
                index.append(np.broadcast_to(place, (batch, 4)))
                weight.append(weight[0])
                sd.append(np.full(batch, width))
                signed.append(False)
                continue
            one, nodes, shares, scale_of_line = rewriting
            index.append(self.places[one][power][nodes])
            weight.append(shares)
            sd.append(self.width / scale_of_line if power == 0 else np.full(batch, width))
            signed.append(power == 0)
        for one, nodes, shares, scale in effects:
            several = len(scale) > 1
            wide = math.sqrt((self.middle**2 + self.width**2) / len(scale))
            for coefficient, places in enumerate(self.places[one]):
                index.append(
                    places[nodes] if len(places) > 1 else np.broadcast_to(places, (batch, 4))
                )
                weight.append(shares)
                sd.append((wide if several else self.width) / scale[coefficient])
                signed.append(not several)
        ratios = np.broadcast_to(ratio, batch)
        return log_prior + self._integrate(index, weight, sd, signed, ratios)

    def _integrate(
        self,
        index: Sequence[NDArray[np.int64]],
        weight: Sequence[Array],
        sd: Sequence[Array],
        signed: Sequence[bool],
        ratio: NDArray[np.int64],
    ) -> Array:
        """Return log p(data), coefficients and noise level integrated, signs summed, (batch,)."""
        of_y = self.products[ratio, -1, -1]
        places = np.stack(index, axis=1)  # (batch, columns, 4)
        # In units of each coefficient's standard deviation.
        shares = np.stack(weight, axis=1) * np.stack(sd, axis=1)[:, :, None]
        shares = shares * self.lengths[places]
        batch, size, _ = shares.shape
        flat, of = places.reshape(batch, -1), shares.reshape(batch, -1)
        whole = self.products[ratio[:, None, None], flat[:, :, None], flat[:, None, :]]
        whole = whole * of[:, :, None] * of[:, None, :]
        inner = whole.reshape(batch, size, 4, size, 4).sum(axis=(2, 4))
        with_y = (self.products[ratio[:, None], flat, -1] * of).reshape(batch, size, 4).sum(axis=2)
        matrix = inner + np.eye(size)
        inverse = np.linalg.inv(matrix)
        log_determinant = np.linalg.slogdet(matrix)[1]
        solved = np.einsum("bij,bj->bi", inverse, with_y)
        left = np.maximum(of_y - (with_y * solved).sum(axis=1), 1e-12 * of_y)
        signs = _list_signs(signed) * (self.middle / self.width)  # (signs, columns)
        beta = solved @ signs.T  # (batch, signs)
        gamma = (signs**2).sum(axis=1) - np.einsum("si,bij,sj->bs", signs, inverse, signs)
        # u is 1 / noise level: n log u - (left u^2 - 2 beta u + gamma) / 2, by Laplace in log u.
        n, a = self.rows, left[:, None]
        u = (beta + np.sqrt(beta**2 + 4.0 * a * n)) / (2.0 * a)
        found = n * np.log(u) - 0.5 * (a * u**2 - 2.0 * beta * u + gamma)
        found -= 0.5 * np.log(a * u**2 + n)
        summed = _log_sum(found, axis=1) - math.log(found.shape[1])
        total: Array = summed - 0.5 * log_determinant + self.log_whiteners[ratio]
        return total

    # The evidence of a set.

    def score(self, chosen: Set, start: Array, order: int, ratio: int) -> Scored:
        """Return a set with its values refined and integrated.

        Args:
            chosen: entries, rising.
            start: places on their grids, shape (effects,).
            order: of the polynomial to begin with.
            ratio: number of the slow share to begin with.
        """
        x = start
        log_volume = 0.0
        table = self._tabulate(chosen, x)
        for _ in range(4):
            x, log_volume = self._climb(chosen, x, order, ratio)
            table = self._tabulate(chosen, x)
            best = np.unravel_index(int(np.argmax(table)), table.shape)
            if (int(best[0]) + 1, int(best[1])) == (order, ratio):
                break
            order, ratio = int(best[0]) + 1, int(best[1])
        log_evidence = float(_log_sum(table.ravel(), axis=0)) + log_volume
        prior = self.prior.log_probability([self.entries[one].candidate for one in chosen])
        return Scored(chosen, x, order, ratio, log_evidence, log_evidence + prior)

    def _tabulate(self, chosen: Set, x: Array) -> Array:
        """Return `weigh` plus log prior for each order and slow share, shape (2, ratios)."""
        prior = np.full(len(RATIOS), math.log((1.0 - WHITE) / (len(RATIOS) - 1)) - math.log(2.0))
        prior[0] = math.log(WHITE) - math.log(2.0)
        repeated, ratios = np.repeat(x[None], len(RATIOS), axis=0), np.arange(len(RATIOS))
        return np.array([self.weigh(chosen, repeated, order, ratios) + prior for order in (1, 2)])

    def _climb(self, chosen: Set, x: Array, order: int, ratio: int) -> tuple[Array, float]:
        """Return the best values near x and the log volume of the peak, by damped Newton steps."""
        free = [n for n, one in enumerate(chosen) if self.entries[one].grid.size > 1]
        if not free:
            return x, 0.0
        top = np.array([self.entries[chosen[n]].grid.size - 1.0 for n in free])
        curvature = np.zeros((len(free), len(free)))
        for _ in range(25):
            inside = x.copy()
            inside[free] = np.clip(x[free], 0.02, top - 0.02)
            stencil, unpack = _lay_stencil(inside, free, 0.02)
            slope, curvature = unpack(self.weigh(chosen, stencil, order, ratio))
            values, vectors = np.linalg.eigh(-curvature)
            along = vectors.T @ slope
            step = vectors @ (along / np.maximum(np.abs(values), 1e-3))
            step *= min(1.0, 2.0 / (np.abs(step).max() + 1e-300))
            parts = np.array([0.0, 1.0, 0.5, 0.2, 0.05, 0.01])
            tried = np.repeat(x[None], parts.size, axis=0)
            tried[:, free] = np.clip(x[free] + parts[:, None] * step, 0.0, top)
            found = self.weigh(chosen, tried, order, ratio)
            best = int(np.argmax(found))
            x = tried[best]
            if found[best] - found[0] < 0.01:
                break
        widths = np.array([math.log(self.entries[chosen[n]].allowed.sum()) for n in free])
        peak = 0.5 * np.log(2.0 * math.pi / np.maximum(np.linalg.eigvalsh(-curvature), 1e-9))
        # No peak is wider than the prior.
        return x, float(np.minimum(peak, widths.max()).sum())

    # The search.

    def search(self) -> list[Scored]:
        """Return the scored sets, the most probable first."""
        empty = self.score((), np.zeros(0), 2, 0)
        found: dict[Set, Scored] = {(): empty}
        beam = [empty]
        for _ in range(min(MOST_EFFECTS, self.prior.most)):
            proposals: dict[Set, tuple[float, Array, int, int]] = {}
            for parent in beam:
                for one in range(len(self.entries)):
                    self._propose(parent, one, proposals)
            ranked = sorted(proposals, key=lambda chosen: -proposals[chosen][0])[:TRIED]
            scored = [self.score(chosen, *proposals[chosen][1:]) for chosen in ranked]
            found.update((one.chosen, one) for one in scored)
            beam = sorted(scored, key=lambda one: -one.log_joint)[:BEAM]
        return sorted(found.values(), key=lambda one: -one.log_joint)

    def _propose(
        self, parent: Scored, one: int, proposals: dict[Set, tuple[float, Array, int, int]]
    ) -> None:
        """Add an effect to a set at the best place of its grid, where that is better."""
        chosen = tuple(sorted((*parent.chosen, one)))
        candidates = [self.entries[n].candidate for n in chosen]
        prior = self.prior.log_probability(candidates) if one not in parent.chosen else -math.inf
        if math.isinf(prior):
            return
        place = chosen.index(one)
        grid = np.flatnonzero(self.entries[one].allowed)
        grid = grid[:: 1 + grid.size // 33]
        ratios = np.array(sorted({0, *range(parent.ratio % 3, parent.ratio + 1, 3)}))
        x = np.insert(np.repeat(parent.values[None], grid.size, axis=0), place, grid, axis=1)
        x = np.repeat(x, ratios.size, axis=0)
        tried = np.tile(ratios, grid.size)
        found = self.weigh(chosen, x, parent.order, tried) + prior
        best = int(np.argmax(found))
        if found[best] > proposals.get(chosen, (-math.inf,))[0]:
            proposals[chosen] = (float(found[best]), x[best], parent.order, int(tried[best]))

    def judge(self) -> Posterior:
        """Return the posterior over the sets that the search visits."""
        scored = self.search()
        joint = np.array([one.log_joint for one in scored])
        probability = np.exp(joint - _log_sum(joint, axis=0))
        return Posterior(
            tuple(
                (frozenset(self._name(n) for n in one.chosen), float(p))
                for one, p in zip(scored, probability, strict=True)
            ),
            len(scored),
        )

    def _name(self, number: int) -> tuple[str, str, str]:
        candidate = self.entries[number].candidate
        return candidate.form.kind, candidate.form.name, candidate.signal


def judge(case: Case) -> Posterior:
    """Return the posterior over sets of effects of one case."""
    return Oracle(case).judge()


def _covariance(blocks: int, step_s: float, ratio: float) -> Array:
    """Return the covariance of the noise's block means, white part 1, shape (blocks, blocks)."""
    within = np.arange(BLOCK) * step_s
    apart = (within[:, None] - within).ravel()
    lag = np.abs(np.arange(blocks)[:, None] * BLOCK * step_s + apart) / SLOW_S
    slow = ratio**2 * ((1.0 + lag) * np.exp(-lag)).mean(axis=1)
    slow[0] += 1.0 / BLOCK
    distance = np.abs(np.arange(blocks)[:, None] - np.arange(blocks))
    found: Array = slow[distance]
    return found


def _interpolate(
    x: Array, allowed: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Return four nodes about each place, their weights by Lagrange, and whether it is allowed."""
    size = allowed.size
    if size == 1:
        nodes = np.zeros((x.size, 4), dtype=np.int64)
        return nodes, np.broadcast_to(FIRST, (x.size, 4)), np.ones(x.size, dtype=bool)
    inside = (x >= -1e-9) & (x <= size - 1 + 1e-9)
    inside &= allowed[np.clip(np.round(x).astype(np.int64), 0, size - 1)]
    first = np.clip(np.floor(x).astype(np.int64) - 1, 0, size - 4)
    t = x - first
    shares = np.stack(
        [
            -(t - 1) * (t - 2) * (t - 3) / 6.0,
            t * (t - 2) * (t - 3) / 2.0,
            -t * (t - 1) * (t - 3) / 2.0,
            t * (t - 1) * (t - 2) / 6.0,
        ],
        axis=1,
    )
    return first[:, None] + np.arange(4), shares, inside


def _lay_stencil(
    x: Array, free: Sequence[int], step: float
) -> tuple[Array, Callable[[Array], tuple[Array, Array]]]:
    """Return places for central differences about x, and what makes slope and Hessian of them."""
    size = len(free)
    moves = [np.zeros(size)]
    moves += [sign * np.eye(size)[i] for i in range(size) for sign in (1.0, -1.0)]
    pairs = [(i, j) for i in range(size) for j in range(i)]
    for i, j in pairs:
        for a, b in ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)):
            moves.append(a * np.eye(size)[i] + b * np.eye(size)[j])
    places = np.repeat(x[None], len(moves), axis=0)
    places[:, list(free)] += step * np.array(moves)

    def unpack(values: Array) -> tuple[Array, Array]:
        up, down = values[1 : 2 * size + 1 : 2], values[2 : 2 * size + 1 : 2]
        slope = (up - down) / (2.0 * step)
        hessian = np.diag((up - 2.0 * values[0] + down) / step**2)
        for number, (i, j) in enumerate(pairs):
            four = values[2 * size + 1 + 4 * number :][:4]
            hessian[i, j] = hessian[j, i] = (four[0] + four[1] - four[2] - four[3]) / (4 * step**2)
        return slope, hessian

    return places, unpack


def _list_signs(signed: Sequence[bool]) -> Array:
    """Return every choice of signs, 0 for columns of no middle size, shape (choices, columns)."""
    found = np.zeros((1, len(signed)))
    for column in np.flatnonzero(signed):
        plus, minus = found.copy(), found.copy()
        plus[:, column], minus[:, column] = 1.0, -1.0
        found = np.concatenate([plus, minus])
    return found


def _log_sum(x: Array, axis: int) -> Array:
    """Return log sum exp along an axis."""
    top = x.max(axis=axis, keepdims=True)
    found: Array = np.log(np.exp(x - top).sum(axis=axis)) + top.squeeze(axis)
    return found
