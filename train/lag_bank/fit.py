"""From runs and a physical model to the lag bank: data, weights, lags, units, and what to note."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.dataset.runs import Run, join_stretches
from zerodrift.operations.backend import NumpyOperations, Operations
from zerodrift.physics.fit import TARE_RATIO
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.front_end import TEMPERATURE, FrontEnd, read_source
from zerodrift.train.lag_bank.data import BLOCKS, DEGREE, BankData, Lag, Scale
from zerodrift.train.lag_bank.model import (
    LOAD,
    POWERS,
    LagBank,
    LoadTerm,
    build_loads,
    list_load_terms,
)
from zerodrift.train.lag_bank.search import Bank, LeftOutJudge, Rows, choose_bank, pick, solve_ridge
from zerodrift.train.lag_bank.units import Choice, choose_units, fit_linear

# The effect of loads on the drift: the gain by temperature, and its curvature.
#
# A weight is applied at once, while drift moves slowly: a change at that moment is due to the load,
# however badly the drift with temperature is known. Rows are therefore differenced, by the
# correlation of neighbouring rows of the residual, before loads are solved (generalised
# least squares with correlation of the first order; Prais and Winsten 1954).


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
    def _sum(rows: Rows, x: Array, parts: Sequence[Mask]) -> Array:
        prepared = [rows.prepare(x, part) if part.any() else x[:0] for part in parts]
        return np.stack([x.T @ x for x in prepared])

    def _pick(self, place: IntArray) -> IntArray:
        """Return the places of the bank's columns, of some load terms, and of the targets."""
        size = self._learnt.shape[1]
        return np.concatenate([np.arange(self._bank), place, np.arange(size - self._outputs, size)])

    def _solve(self, products: Array, ridge: float) -> Array:
        j = len(products) - self._outputs
        shares = np.where(np.arange(j) < self._bank, RIDGE, ridge)
        strength = shares * np.diag(products)[:j]
        return solve_ridge(products[:j, :j], products[:j, j:], strength)

    def choose(self, place: IntArray) -> Bank:
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

    def solve_all(self, place: IntArray, ridge: float) -> Array:
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


def difference(x: Array, alike: float, begins: Mask) -> Array:
    """Return rows [m, J] less `alike` times the row before; the first of a stretch shrinks."""
    y = x.copy()
    y[1:] -= alike * x[:-1]
    y[begins] = np.sqrt(1.0 - alike**2) * x[begins]
    return y


def _list_loaded(data: BankData) -> list[int]:
    """Return the runs with a load on the sensor."""
    return [int(g) for g in np.unique(data.run_group[data.loaded])]


def _split(data: BankData) -> list[Mask]:
    """Return rows [m] of which each part is left out in turn, and those that never are, the last.

    Parts are loaded runs; of a single one, blocks of time.
    """
    parts = [data.run_group == g for g in _list_loaded(data)]
    if len(parts) == 1:
        rows = np.arange(len(data.run_group))
        parts = [np.isin(rows, p) for p in np.array_split(np.flatnonzero(parts[0]), BLOCKS)]
    return [*parts, ~np.any(parts, axis=0)]


# From runs and a physical model to the lag bank: data, weights, lags, units, and what to note.

UNITS = 16
"""tanh units, where they help."""
TRIAL_LAGS_S = (10.0, 60.0, 300.0)
"""Lags of a small bank, for what is asked before the lags are known."""
FEWEST_JUMPS = 20
"""From row to row, before they tell the noise of a class of rows."""
NO_JUMP = 1e-12
"""Squared jump, in units of the fit, that is none: of coarse readings, most."""
LEAST_WEIGHT = 1e-2
"""Of the rows of a noisy class, as a share of the best class's."""
FEWEST_RUNS = 3
"""Runs that it takes to tell another thermometer's part from chance."""


@dataclass(frozen=True)
class FittedBank:
    """The lag bank and the network of tanh units beside it, fitted to runs."""

    bank: LagBank
    front_end: FrontEnd | None
    """What the units see; None without units."""
    weights: Array
    """[U, I] of the units, over the front end's features."""
    bias: Array
    """[U]."""
    head: Array
    """[U, K] in output units."""
    tared: bool
    errors: tuple[float, ...]
    """RMSE on runs left out with 0, 1, 2, ... lags, then with units if they were tried; in units
    of the drift that the physical model leaves."""
    notes: tuple[str, ...]

    def correct(self, run: Run, physics: PhysicalModel) -> Array:
        """Return what is added to the physical model's drift, [n, K]."""
        run = run.at_rest()
        basis = self.bank.compute(run, physics.outputs)
        drift = physics.features(run) @ self.bank.correction + basis @ self.bank.coefficients
        if self.front_end is not None:
            hidden = np.tanh(self.front_end.compute(run) @ self.weights.T + self.bias)
            drift = drift + hidden @ self.head
        return np.asarray(drift)


@dataclass(frozen=True)
class PreparedBank:
    """Rows of the fit with and without what loads add."""

    raw: Rows
    rows: Rows
    """The same, targets without what loads add."""
    loads: LoadPart
    kept: IntArray
    """Physical features that move."""


def fit_lag_bank(
    physics: PhysicalModel,
    runs: Sequence[Run],
    sources: Sequence[str] = (TEMPERATURE,),
    *,
    seed: int = 0,
    lags_s: Sequence[float] = (),
    units: int = UNITS,
    report: Callable[[float, str], None] = lambda done, text: None,
) -> FittedBank:
    """Return the bank fitted to what a physical model leaves of the training runs.

    Args:
        physics: fitted to the same runs; its coefficients are solved again beside the bank's.
        runs: training runs.
        sources: thermometers, the chip's own first.
        seed: of the units' starts.
        lags_s: time constants of the chip's thermometer; empty: found by leaving runs out.
        units: tanh units, if any help; 0: none.
        report: is told the share that is done, and of what.
    """
    report(0.0, "lag bank")
    runs, logged = join_stretches(runs)
    prepared = prepare(physics, runs, sources, logged)
    banks = [_hold(prepared.rows, lags_s)] if lags_s else choose_bank(prepared.rows)
    bank = pick(banks)
    if prepared.loads.terms:
        prepared = _take_off(prepared.raw, prepared.kept, physics, runs, bank.lags)
        bank = LeftOutJudge(prepared.rows).choose_ridge(bank.lags)
    report(0.3, f"{len(bank.lags)} lags")

    def tell(done: float, text: str) -> None:
        report(0.3 + 0.7 * done, text)

    choice = choose_units(prepared.rows, runs, bank, units, seed, hold=bool(lags_s), report=tell)
    errors = [b.error for b in banks]
    if choice.ratio is not None:
        errors.append(bank.error * choice.ratio)
    notes = _tell(bank, choice, prepared.rows.data)
    fitted = assemble_fit(physics, runs, prepared, choice, tuple(errors), notes)
    report(1.0, "lag bank")
    return fitted


def prepare(
    physics: PhysicalModel,
    runs: Sequence[Run],
    sources: Sequence[str],
    logged: Sequence[Mask] = (),
) -> PreparedBank:
    """Return the rows of the fit, weighted by their noise, without what loads add.

    Args:
        physics: fitted to the same runs.
        runs: in one piece each.
        sources: thermometers, the chip's own first.
        logged: [n] per run: samples that were measured; empty: all.
    """
    features = [physics.features(run) for run in runs]
    together = np.concatenate(features)
    moves = np.ptp(together, axis=0) > 1e-12 * np.maximum(np.abs(together).max(axis=0), 1e-300)
    kept = np.flatnonzero(moves)
    largest = np.max([np.abs(run.reference).max(axis=0) for run in runs], axis=0)
    loaded = [
        np.any(np.abs(run.reference) > LOAD_SHARE * np.maximum(largest, 1e-300), axis=1)
        for run in runs
    ]
    targets = [run.drift - physics.predict(run) for run in runs]
    data = BankData(runs, sources, [x[:, kept] for x in features], targets, loaded, logged)
    drift = np.concatenate([run.drift for run in runs])
    unit = np.sqrt(np.mean((drift - drift.mean(axis=0)) ** 2, axis=0))
    unit[unit == 0.0] = 1.0
    raw = Rows(data, data.counts, False, unit)
    lags = _list_trial_lags(raw)
    prepared = _take_off(raw, kept, physics, runs, lags)
    raw = replace(raw, tared=_is_tared(prepared.rows, runs[0].tared))
    if any(run.reference.any() for run in runs):
        weight = _weigh(replace(prepared.rows, tared=raw.tared))
        raw = replace(raw, weight=weight)
    return _take_off(raw, kept, physics, runs, lags)


def _take_off(
    raw: Rows,
    kept: IntArray,
    physics: PhysicalModel,
    runs: Sequence[Run],
    lags: Sequence[Lag],
) -> PreparedBank:
    """Return the rows without what loads add, which is solved beside a bank of these lags."""
    loads = fit_loads(physics, runs, raw, lags)
    if not loads.terms:
        return PreparedBank(raw, raw, loads, kept)
    parts = loads.predict(runs, physics, raw.data.scales[0])
    return PreparedBank(raw, replace(raw, data=raw.data.less(parts)), loads, kept)


def _list_trial_lags(rows: Rows) -> list[Lag]:
    return [(s, tau_s) for s in range(len(rows.data.sources)) for tau_s in TRIAL_LAGS_S]


def _residual(rows: Rows) -> Array:
    """Return what a small bank leaves of the targets, [m, K], rows weighted and centred."""
    columns = rows.columns(_list_trial_lags(rows))
    member = fit_linear(rows, columns, 1e-6, rows.everything)
    return rows.prepare(rows.targets - columns @ member.linear, rows.everything)


def _is_tared(rows: Rows, said: bool | None) -> bool:
    """Return whether offsets of their own for the runs lower the squared error by enough.

    Args:
        rows: without what loads add.
        said: `[logs] tared`; None: not stated.
    """
    if len(np.unique(rows.data.run_group)) < 2:
        return False
    if said is not None:
        return said
    own = Rows(rows.data, rows.weight, True, rows.unit)
    shared, apart = (np.sum(_residual(r) ** 2, axis=0) + 1e-12 for r in (rows, own))
    return bool(np.mean(shared / apart) >= TARE_RATIO)


def _weigh(rows: Rows) -> Array:
    """Return the rows' weights [m]: less where a class of rows, by run and load, is noisier.

    A reference with noise of its own, such as a second sensor under a walking robot, would
    otherwise dominate the fit. Noise is estimated from jumps between rows; drift that the model
    does not explain yet moves slowly and does not lower the weight.
    """
    labels = 2 * rows.data.run_group + rows.data.loaded
    jumps = np.diff(_residual(rows) / np.sqrt(rows.weight)[:, None], axis=0) ** 2
    jumps *= rows.weight[1:, None]
    same = labels[1:] == labels[:-1]
    by_class = {}
    for label in np.unique(labels):
        own = same & (labels[1:] == label)
        if own.sum() >= FEWEST_JUMPS:
            by_class[label] = _measure_jumps(jumps[own])
    if not by_class:
        return rows.weight
    least = np.min(list(by_class.values()), axis=0) + NO_JUMP
    scatter = {label: float(np.mean(found / least)) for label, found in by_class.items()}
    best, worst = min(scatter.values()), max(scatter.values())
    share = np.array([best / scatter.get(label, worst) for label in labels])
    return np.asarray(rows.weight * np.maximum(share, LEAST_WEIGHT))


def _measure_jumps(jumps: Array) -> Array:
    """Return the typical squared jump [K] of rows [n, K].

    The median; of readings so coarse that most neighbours are equal, that of the others, by their
    share of the rows. It is above zero, since a reading that never jumps is not exact.
    """
    typical = np.asarray(np.median(jumps, axis=0))
    for k in np.flatnonzero(typical <= NO_JUMP):
        moved = jumps[jumps[:, k] > NO_JUMP, k]
        share = moved.size / len(jumps)
        typical[k] = NO_JUMP + (share * float(np.median(moved)) if moved.size else 0.0)
    return typical


def _hold(rows: Rows, lags_s: Sequence[float]) -> Bank:
    return LeftOutJudge(rows).choose_ridge([(0, float(tau_s)) for tau_s in lags_s])


def assemble_fit(
    physics: PhysicalModel,
    runs: Sequence[Run],
    prepared: PreparedBank,
    choice: Choice,
    errors: tuple[float, ...],
    notes: tuple[str, ...],
) -> FittedBank:
    """Return what was fitted, its columns as the chip's basis has them."""
    rows, data, member = prepared.rows, prepared.rows.data, choice.member
    unit, outputs = rows.unit, rows.unit.size
    linear = member.linear * unit
    features = len(prepared.kept)
    correction = np.zeros((physics.coefficients.shape[0], outputs))
    correction[0] = linear[0]
    correction[prepared.kept] += linear[1 : 1 + features]
    at = 1 + features
    levels = linear[at : at + DEGREE * len(data.sources)].reshape(-1, DEGREE, outputs).copy()
    lags = linear[at + DEGREE * len(data.sources) :].reshape(-1, choice.degree, outputs)
    for (source, _), own in zip(choice.lags, lags, strict=True):
        levels[source, : choice.degree] -= own  # the fit's columns are v^p - u^p
    coefficients = np.concatenate(
        [prepared.loads.coefficients, levels.reshape(-1, outputs), lags.reshape(-1, outputs)]
    )
    whole = LagBank(
        sources=data.sources,
        scales=data.scales,
        lags=choice.lags,
        loads=prepared.loads.terms,
        correction=correction,
        coefficients=coefficients,
        degree=choice.degree,
    )
    fitted = FittedBank(
        bank=whole,
        front_end=choice.front_end,
        weights=member.weights[:, :-1],
        bias=member.weights[:, -1],
        head=member.head * unit,
        tared=rows.tared,
        errors=errors,
        notes=notes,
    )
    return _settle_constant(fitted, physics, runs, data.logged)


def _tell(bank: Bank, choice: Choice, data: BankData) -> tuple[str, ...]:
    """Return what users should know about the choice."""
    named = ", ".join(
        f"{tau_s:.3g} s" + (f" of {data.sources[s]}" if len(data.sources) > 1 else "")
        for s, tau_s in choice.lags
    )
    units = len(choice.member.weights) if choice.front_end else 0
    what = f"lags {named or 'none'}" + (f" and {units} tanh units" if units else "")
    if len(bank.lags) > 1 or len(data.sources) > 1:
        return (f"the lag bank holds {what}, chosen on runs left out",)
    return (
        f"the logs ask for no more than the plain physical model: {what}. Heat that reaches the "
        "sensor another way than in these logs (through the sole, infrared from one side) is "
        "unverified: record such runs and add them to [logs] train",
    )


def _settle_constant(
    fitted: FittedBank,
    physics: PhysicalModel,
    runs: Sequence[Run],
    logged: Sequence[Mask],
) -> FittedBank:
    """Return the bank with its constant at the mean of what is left, each run counting once."""
    if not fitted.tared:
        return fitted
    left: dict[str, list[Array]] = {}
    for run, there in zip(runs, logged, strict=True):
        error = run.drift - physics.predict(run) - fitted.correct(run, physics)
        left.setdefault(run.group, []).append(error[there])
    means = [np.concatenate(parts).mean(axis=0) for parts in left.values()]
    fitted.bank.correction[0] += np.mean(means, axis=0)
    return fitted


def choose_sources(others: Sequence[str], runs: Sequence[Run]) -> tuple[str, ...]:
    """Return the chip's thermometer and those of the others that every run has and that move.

    Others need `FEWEST_RUNS` runs: within one history anything that moves slowly, such as the air
    of the room, seems to explain the residual, but not in the next run.
    """
    if len({run.group for run in runs}) < FEWEST_RUNS:
        return (TEMPERATURE,)
    moving = [
        name
        for name in others
        if all(name in run.inputs for run in runs)
        and any(float(np.ptp(read_source(run, name))) > 0.0 for run in runs)
    ]
    return (TEMPERATURE, *moving)
