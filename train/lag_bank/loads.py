"""The effect of loads on the drift: the gain by temperature, and its curvature.

A weight is applied at once, while drift moves slowly: a change at that moment is due to the load,
however badly the drift with temperature is known. Rows are therefore differenced, by the
correlation of neighbouring rows of the residual, before loads are solved (generalised
least squares with correlation of the first order; Prais and Winsten 1954).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.operations.backend import NumpyOperations, Operations
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.lag_bank.data import BLOCKS, BankData, Lag, Scale
from zerodrift.train.lag_bank.model import (
    LOAD,
    POWERS,
    LoadTerm,
    build_loads,
    list_load_terms,
)
from zerodrift.train.lag_bank.projection import solve_ridge
from zerodrift.train.lag_bank.search import Bank, Rows, pick

Places = NDArray[np.int64]

LOAD_SHARE = 1e-3
"""Share of the largest load from which a sample counts as loaded."""
LOAD_SPAN = 0.05
"""Share of its full scale that a load must span to be taken for a cause of drift."""
PAIR_SPAN = 0.05
"""Share of both loads' largest values, multiplied, that a product must come to in some sample."""
STILL = 0.01
"""Median jump from sample to sample of a load that is held, as a share of its span."""
USUAL_ORDER = 2
"""Of the load terms whose remainder tells how alike neighbouring rows are."""
RIDGE = 1e-8
"""Of the columns beside the loads, as a share of each column's square."""
HELD = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Likewise of the load terms, to choose from: few runs are loaded, and loads go together."""
MOST_ALIKE = 0.98
"""Beyond that the mean of a run would count for nothing."""


@dataclass(frozen=True)
class LoadPart:
    """Load terms and what they add to the drift."""

    terms: tuple[LoadTerm, ...]
    coefficients: Array
    """[T, K] in output units."""

    def predict(self, runs: Sequence[Run], physics: PhysicalModel, scale: Scale) -> list[Array]:
        """Return what loads add to the drift [n, K] of each run."""
        return [see_loads(run, physics, scale, self.terms) @ self.coefficients for run in runs]


def see_loads(run: Run, physics: PhysicalModel, scale: Scale, terms: Sequence[LoadTerm]) -> Array:
    """Return the load terms [n, T] of a run; `scale` is that of the chip's thermometer."""
    ops: Operations[Array] = NumpyOperations(run.sample_period_s, (len(run),))

    def read(source: str) -> Array:
        return run.reference[:, physics.outputs.index(source.removeprefix(LOAD))]

    level = (run.temperature_degC - scale.centre) / scale.half_span
    columns = build_loads(ops, read, level, terms)
    return np.stack(columns, axis=1) if columns else np.zeros((len(run), 0))


def list_loads(physics: PhysicalModel, runs: Sequence[Run]) -> tuple[str, ...]:
    """Return the outputs whose load is held still in some run, as test weights hold it.

    A load that jumps from sample to sample, as a gait's does, leaves its mean alone to tell the
    gain from the drift, and a reference's noise and delay count as gain.
    """
    names = []
    for name in physics.plan.loaded:
        k = physics.outputs.index(name)
        full_scale = physics.plan.full_scale[k]
        for run in runs:
            load = run.reference[:, k]
            on = np.abs(load) > LOAD_SHARE * full_scale
            still = float(np.median(np.abs(np.diff(load))[on[1:]])) if on[1:].any() else np.inf
            if np.ptp(load) > LOAD_SPAN * full_scale and still < STILL * np.ptp(load):
                names.append(name)
                break
    return tuple(names)


def list_pairs(
    loads: Sequence[str], physics: PhysicalModel, runs: Sequence[Run]
) -> tuple[tuple[str, str], ...]:
    """Return squares and products of loads that some sample shows; of others nothing is known."""
    places = [physics.outputs.index(name) for name in loads]
    largest, seen = np.zeros(len(loads)), np.zeros((len(loads), len(loads)))
    for run in runs:
        load = np.abs(run.reference[:, places])
        largest = np.maximum(largest, load.max(axis=0))
        seen = np.maximum(seen, [(load * load[:, [k]]).max(axis=0) for k in range(len(loads))])
    shown = seen >= PAIR_SPAN * np.outer(largest, largest)
    pairs = itertools.combinations_with_replacement(range(len(loads)), 2)
    return tuple((loads[a], loads[b]) for a, b in pairs if shown[a, b])


def fit_loads(
    physics: PhysicalModel,
    runs: Sequence[Run],
    rows: Rows,
    lags: Sequence[Lag],
    *,
    choice: Sequence[int] = tuple(range(len(POWERS))),
    alike: float | None = None,
) -> LoadPart:
    """Return the load terms that runs left out ask for, solved beside a bank.

    Args:
        physics: the physical model; its features are the rows' further columns.
        runs: training runs.
        rows: of these runs.
        lags: of the bank.
        choice: orders of the load terms to choose from, see `POWERS`.
        alike: correlation of neighbouring rows of the residual; None: as found.
    """
    data, outputs = rows.data, rows.unit.size
    loads = list_loads(physics, runs)
    pairs = list_pairs(loads, physics, runs)
    orders = [list_load_terms(loads, order, pairs) for order in range(len(POWERS))]
    terms = orders[-1]
    if not terms:
        return LoadPart((), np.zeros((0, outputs)))
    seen = data.average(
        np.concatenate([see_loads(r, physics, data.scales[0], terms) for r in runs])
    )
    base = rows.columns(lags)
    places = [base.shape[1] + np.array([terms.index(t) for t in o], dtype=int) for o in orders]
    columns = np.concatenate([base, seen], axis=1)
    if alike is None:
        usual = np.concatenate([np.arange(base.shape[1]), places[USUAL_ORDER]])
        alike = _correlate(rows, columns[:, usual])
    system = _System(rows, columns, base.shape[1], alike)
    found = {order: system.choose(places[order]) for order in choice}
    chosen = pick(list(found.values()))
    order = next(order for order in found if found[order] is chosen)
    return LoadPart(orders[order], system.solve_all(places[order], chosen.ridge) * rows.unit)


class _System:
    """Normal equations of a small bank and load terms, by parts that are left out in turn.

    Args:
        rows: rows and targets.
        columns: [m, J] of the bank, then of the richest load terms.
        bank: how many columns are the bank's.
        alike: how alike neighbouring rows of what is left are.
    """

    def __init__(self, rows: Rows, columns: Array, bank: int, alike: float) -> None:
        self._bank, self._outputs = bank, rows.unit.size
        data = rows.data
        together = np.concatenate([columns, rows.targets], axis=1)
        together = difference(together, alike, data.begins)
        parts = _split(data)
        self._learnt = self._sum(rows, together, parts)
        judged = [part & data.covered for part in parts[:-1]]
        self._judged = self._sum(rows, together, judged)
        self._weight = float(sum(rows.weight[part].sum() for part in judged)) * self._outputs

    @staticmethod
    def _sum(rows: Rows, x: Array, parts: Sequence[NDArray[np.bool_]]) -> Array:
        prepared = [rows.prepare(x, part) if part.any() else x[:0] for part in parts]
        return np.stack([x.T @ x for x in prepared])

    def _pick(self, place: Places) -> Places:
        """Return the places of the bank's columns, of some load terms, and of the targets."""
        size = self._learnt.shape[1]
        return np.concatenate([np.arange(self._bank), place, np.arange(size - self._outputs, size)])

    def _solve(self, products: Array, ridge: float) -> Array:
        j = len(products) - self._outputs
        shares = np.where(np.arange(j) < self._bank, RIDGE, ridge)
        strength = shares * np.diag(products)[:j]
        return solve_ridge(products[:j, :j], products[:j, j:], strength)

    def choose(self, place: Places) -> Bank:
        """Return the least ridge that no larger one beats on parts left out, with its error."""
        picked = self._pick(place)
        learnt, judged = (x[:, picked][:, :, picked] for x in (self._learnt, self._judged))
        total = learnt.sum(axis=0)
        tried = []
        for ridge in HELD if place.size else HELD[:1]:
            squares = 0.0
            for own, seen in zip(learnt, judged, strict=False):
                solved = self._solve(total - own, ridge)
                gaps = np.concatenate([-solved, np.eye(self._outputs)])
                squares += float(np.sum(gaps * (seen @ gaps)))
            error = np.sqrt(max(squares, 0.0) / max(self._weight, 1e-300))
            tried.append(Bank((), ridge, float(error)))
        return pick(tried)

    def solve_all(self, place: Places, ridge: float) -> Array:
        """Return the coefficients [T, K] of load terms from all rows, in units."""
        picked = np.ix_(self._pick(place), self._pick(place))
        return self._solve(self._learnt.sum(axis=0)[picked], ridge)[self._bank :]


def _correlate(rows: Rows, columns: Array) -> float:
    """Return how alike neighbouring rows of what columns [m, J] leave are, 0 to `MOST_ALIKE`."""
    everything = rows.everything
    x = rows.prepare(columns, everything)
    y = rows.prepare(rows.targets, everything)
    left = y - x @ solve_ridge(x.T @ x, x.T @ y, RIDGE * np.sum(x**2, axis=0))
    left[~np.isin(rows.data.run_group, _list_loaded(rows.data))] = 0.0
    follows = ~rows.data.begins[1:]
    shared = np.sum(left[1:][follows] * left[:-1][follows], axis=0)
    alike = np.mean(shared / np.maximum(np.sum(left**2, axis=0), 1e-300))
    return float(np.clip(alike, 0.0, MOST_ALIKE))


def difference(x: Array, alike: float, begins: NDArray[np.bool_]) -> Array:
    """Return rows [m, J] less `alike` times the row before; the first of a stretch shrinks."""
    y = x.copy()
    y[1:] -= alike * x[:-1]
    y[begins] = np.sqrt(1.0 - alike**2) * x[begins]
    return y


def _list_loaded(data: BankData) -> list[int]:
    """Return the runs with a load on the sensor."""
    return [int(g) for g in np.unique(data.run_group[data.loaded])]


def _split(data: BankData) -> list[NDArray[np.bool_]]:
    """Return rows [m] of which each part is left out in turn, and those that never are, the last.

    Parts are loaded runs; of a single one, blocks of time.
    """
    parts = [data.run_group == g for g in _list_loaded(data)]
    if len(parts) == 1:
        rows = np.arange(len(data.run_group))
        parts = [np.isin(rows, p) for p in np.array_split(np.flatnonzero(parts[0]), BLOCKS)]
    return [*parts, ~np.any(parts, axis=0)]
