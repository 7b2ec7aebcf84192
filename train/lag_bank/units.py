"""A few tanh units beside the linear part: several starts, each by Levenberg-Marquardt."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.runs import Run
from zerodrift.train.front_end import FrontEnd, Tap, fit_front_end
from zerodrift.train.lag_bank.data import DEGREE, Lag
from zerodrift.train.lag_bank.search import (
    EARNS_ITS_PLACE,
    Bank,
    Columns,
    ProjectionProblem,
    Rows,
    minimise,
    solve_ridge,
    span_of,
)

PRIOR = 1e-5
"""Weight per row of a unit's own weights squared: units that are not needed stay straight."""
HEAD_RIDGE = 1e-6
"""Weight per row of what units add to an output squared, in units of what is left to them."""
SPREAD = 0.7
"""Of a unit's first weights on features of unit variance."""
FOLDS = 4
STEPS = 50


@dataclass(frozen=True)
class Member:
    """One fit: tanh units, and everything that is linear beside them."""

    weights: Array
    """[U, I + 1], the bias last."""
    linear: Array
    """[J, K] of the linear columns."""
    head: Array
    """[U, K]."""

    def predict(self, columns: Array, features: Array) -> Array:
        """Return [m, K] for linear columns [m, J] and features [m, I]."""
        hidden = np.tanh(features @ self.weights[:, :-1].T + self.weights[:, -1])
        return np.asarray(columns @ self.linear + hidden @ self.head)


def fit_linear(rows: Rows, columns: Array, ridge: float, some: Mask) -> Member:
    """Return the linear part alone, fitted to some of the rows."""
    part = rows.take(some)
    f, y = (part.prepare(part.cut(x)) for x in (columns, rows.targets))
    linear = solve_ridge(f.T @ f, f.T @ y, ridge * np.sum(f**2, axis=0))
    return Member(np.zeros((0, 1)), linear, np.zeros((0, y.shape[1])))


def fit_member(
    rows: Rows,
    columns: Array,
    features: Array,
    ridge: float,
    count: int,
    seed: Sequence[int],
    some: Mask,
    steps: int = STEPS,
) -> Member:
    """Return `count` units and the linear part beside them, fitted from one random start.

    Args:
        rows: the rows of the whole fit.
        columns: [m, J] of the linear part.
        features: [m, I] what the units see, of unit variance.
        ridge: of the linear part, as a share of each column's square.
        count: number of units.
        seed: of the start.
        some: [m] rows to learn from.
        steps: of Levenberg-Marquardt, at most.
    """
    part = rows.take(some)
    f, y = (part.prepare(part.cut(x)) for x in (columns, rows.targets))
    linear_ridge = ridge * np.sum(f**2, axis=0)
    basis = np.linalg.qr(np.concatenate([f, np.diag(np.sqrt(linear_ridge))]))[0]

    def project(x: Array) -> Array:
        """Return rows without what the linear part explains of them, its ridge included."""
        left = basis @ -(basis[: len(f)].T @ x)
        left[: len(f)] += x
        return np.asarray(left)

    left = project(y)
    scale = np.sqrt(np.maximum(np.sum(left**2, axis=0) / part.weight, 1e-300))
    x = part.cut(np.concatenate([features, np.ones((len(features), 1))], axis=1))
    inputs = x.shape[1]
    places = np.arange(count * inputs)

    def build(theta: Array) -> Columns:
        hidden = np.tanh(x @ theta.reshape(count, inputs).T)
        bent = (1.0 - hidden**2)[:, :, None] * x[:, None, :]
        both = project(part.prepare(np.concatenate([hidden, bent.reshape(len(x), -1)], axis=1)))
        return Columns(both[:, :count], both[:, count:], places, places // inputs)

    start = np.random.default_rng(seed).normal(size=(count, inputs)) * SPREAD
    problem = ProjectionProblem(
        build,
        left / scale,
        np.full(count, HEAD_RIDGE * part.weight),
        np.full(count * inputs, PRIOR * part.weight),
        np.zeros(count * inputs),
    )
    weights = minimise(problem, start.ravel(), steps).reshape(count, inputs)
    both = np.concatenate([f, part.prepare(np.tanh(x @ weights.T))], axis=1)
    strength = np.concatenate([linear_ridge, np.full(count, HEAD_RIDGE * part.weight)])
    solved = solve_ridge(both.T @ both, both.T @ y, strength)
    return Member(weights, solved[: f.shape[1]], solved[f.shape[1] :])


def split_folds(rows: Rows) -> list[Mask]:
    """Return which rows [m] each of a few folds leaves out; whole groups, spread evenly."""
    groups = np.arange(rows.data.groups)
    return [np.isin(rows.data.group, groups[i::FOLDS]) for i in range(min(FOLDS, rows.data.groups))]


def measure_left_out(rows: Rows, fit: Callable[[Mask], Callable[[], Array]]) -> float:
    """Return the RMSE in units on covered rows of folds left out, every run counting once.

    Infinite where no row is covered.

    Runs have equal weight: by samples, hours in the chamber would hide the gain of units in a short
    run under a lamp.

    Args:
        rows: the rows.
        fit: rows to learn from -> a function that predicts all rows [m, K].
    """
    data, found = rows.data, []
    for left_out in split_folds(rows):
        judged = left_out & data.covered
        if not judged.any():
            continue
        errors = np.sum(rows.prepare(rows.targets - fit(~left_out)(), judged) ** 2, axis=1)
        group, samples = data.group[judged], data.counts[judged]
        found += [
            float(errors[group == g].sum() / samples[group == g].sum()) for g in np.unique(group)
        ]
    return float(np.sqrt(np.mean(found) / rows.unit.size)) if found else np.inf


# Decides whether tanh units are added to the bank, and which lags they see.

FEW_UNITS = 4
STARTS = (2, 1)
"""Of few units, which may end in a poor minimum, and of many."""
STEPS_ASKED = 25
"""Of a fit that is only judged, at most."""
SPREAD_LAGS = 4
"""Lags that are spread over all that the logs can tell."""


@dataclass(frozen=True)
class Choice:
    """What is fitted beside the physical model: lags and their powers, units or none."""

    lags: tuple[Lag, ...]
    ridge: float
    degree: int
    """Powers of each lag."""
    member: Member
    front_end: FrontEnd | None
    """What the units see; None without units."""
    ratio: float | None
    """Error on runs left out with units over that without; None where none were asked for."""


class Trial:
    """Units over certain lags, beside a linear part with so many powers of each.

    Args:
        rows: the rows of the fit.
        runs: the runs behind them.
        lags: what the units see beside the thermometers.
        ridge: of the linear part.
        degree: powers of each lag in the linear part.
        count: tanh units.
    """

    def __init__(
        self,
        rows: Rows,
        runs: Sequence[Run],
        lags: Sequence[Lag],
        ridge: float,
        degree: int,
        count: int,
    ) -> None:
        sources = rows.data.sources
        taps = [Tap("level", source=s) for s in sources]
        taps += [Tap("lag", source=sources[s], tau_s=tau_s) for s, tau_s in lags]
        self.front_end = fit_front_end(taps, runs)
        self.lags, self.ridge, self.degree, self.count = tuple(lags), ridge, degree, count
        self._rows, self._columns = rows, rows.columns(lags, degree)
        features = np.concatenate([self.front_end.compute(run) for run in runs])
        self._features = rows.data.average(features)

    def fit(self, seed: Sequence[int], some: Mask, steps: int = STEPS) -> Member:
        """Return the units from one start, fitted to some of the rows [m]."""
        rows, columns, features = self._rows, self._columns, self._features
        return fit_member(rows, columns, features, self.ridge, self.count, seed, some, steps)

    def measure(self, seed: Sequence[int]) -> float:
        """Return the error on runs left out, in units of the drift."""

        def learn(some: Mask) -> Callable[[], Array]:
            member = self.fit(seed, some, STEPS_ASKED)
            return lambda: member.predict(self._columns, self._features)

        return measure_left_out(self._rows, learn)


def choose_units(
    rows: Rows,
    runs: Sequence[Run],
    bank: Bank,
    count: int,
    seed: int,
    *,
    hold: bool = False,
    report: Callable[[float, str], None] = lambda done, text: None,
) -> Choice:
    """Return the bank alone, or with tanh units where they help on runs left out.

    A few units are tried over the bank's lags, `count` of them over the same lags and, for a single
    thermometer, over lags spread evenly in the logarithm; the best on runs left out is taken.
    Beside many units a lag has no powers of its own.

    Args:
        rows: the rows of the fit.
        runs: the runs behind them.
        bank: the lags of the linear part alone.
        count: tanh units; 0: none are tried.
        seed: of the units' starts.
        hold: whether the lags were given, so that no others may be tried.
        report: is told the share that is done, and of what.
    """
    columns = rows.columns(bank.lags)
    alone = fit_linear(rows, columns, bank.ridge, rows.everything)
    if not count:
        return Choice(bank.lags, bank.ridge, DEGREE, alone, None, None)

    def learn(some: Mask) -> Callable[[], Array]:
        member = fit_linear(rows, columns, bank.ridge, some)
        return lambda: columns @ member.linear

    without = max(measure_left_out(rows, learn), 1e-300)
    trials = list_trials(rows, runs, bank, count, hold=hold)
    asked = [(trial, start) for trial in trials for start in range(STARTS[trial.count > FEW_UNITS])]
    errors = []
    for done, (trial, start) in enumerate(asked):
        report(done / (len(asked) + 1), "tanh units")
        errors.append(trial.measure((seed, start)))
    ratio = min(errors) / without
    if not ratio < EARNS_ITS_PLACE:  # nor where nothing could be judged
        return Choice(bank.lags, bank.ridge, DEGREE, alone, None, ratio)
    best, start = asked[int(np.argmin(errors))]
    report(len(asked) / (len(asked) + 1), "tanh units")
    member = best.fit((seed, start), rows.everything)
    return Choice(best.lags, best.ridge, best.degree, member, best.front_end, ratio)


def list_trials(
    rows: Rows, runs: Sequence[Run], bank: Bank, count: int, *, hold: bool
) -> list[Trial]:
    """Return what units are asked for: few over the bank's lags, then all, over these and others.

    One lag of one thermometer is what logs of a single way of heat ask for; many units over it
    would learn that way by heart, and are not tried.
    """
    few = Trial(rows, runs, bank.lags, bank.ridge, DEGREE, min(FEW_UNITS, count))
    thermometers = len(rows.data.sources)
    if count <= FEW_UNITS or (len(bank.lags) < 2 and thermometers == 1):
        return [few]
    places = [bank.lags]
    if thermometers == 1 and not hold:
        places.append(spread_lags(rows))
    return [few, *(Trial(rows, runs, lags, bank.ridge, 1, count) for lags in places)]


def spread_lags(rows: Rows) -> tuple[Lag, ...]:
    """Return lags of the chip's thermometer, evenly spaced in the logarithm."""
    taus_s = np.geomspace(*span_of(rows.data), SPREAD_LAGS)
    return tuple((0, float(f"{tau_s:.3g}")) for tau_s in taus_s)
