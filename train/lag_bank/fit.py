"""From runs and a physical model to the lag bank: data, weights, lags, units, and what to note."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.bridges import join_stretches
from zerodrift.dataset.runs import Run
from zerodrift.physics.fit import TARE_RATIO
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.front_end import TEMPERATURE, FrontEnd, read_source
from zerodrift.train.lag_bank.data import DEGREE, BankData, Lag
from zerodrift.train.lag_bank.loads import LOAD_SHARE, LoadPart, fit_loads
from zerodrift.train.lag_bank.model import LagBank
from zerodrift.train.lag_bank.search import Bank, LeftOutJudge, Rows, choose_bank, pick
from zerodrift.train.lag_bank.unit_choice import Choice, choose_units
from zerodrift.train.lag_bank.units import fit_linear

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
    kept: NDArray[np.int64]
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
    logged: Sequence[NDArray[np.bool_]] = (),
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
    kept: NDArray[np.int64],
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
    logged: Sequence[NDArray[np.bool_]],
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
