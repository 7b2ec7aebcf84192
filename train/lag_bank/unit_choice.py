"""Decides whether tanh units are added to the bank, and which lags they see."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.train.front_end import FrontEnd, Tap, fit_front_end
from zerodrift.train.lag_bank.data import DEGREE, Lag
from zerodrift.train.lag_bank.search import EARNS_ITS_PLACE, Bank, Rows, span_of
from zerodrift.train.lag_bank.units import (
    STEPS,
    Member,
    fit_linear,
    fit_member,
    measure_left_out,
)

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

    def fit(self, seed: Sequence[int], some: NDArray[np.bool_], steps: int = STEPS) -> Member:
        """Return the units from one start, fitted to some of the rows [m]."""
        rows, columns, features = self._rows, self._columns, self._features
        return fit_member(rows, columns, features, self.ridge, self.count, seed, some, steps)

    def measure(self, seed: Sequence[int]) -> float:
        """Return the error on runs left out, in units of the drift."""

        def learn(some: NDArray[np.bool_]) -> Callable[[], Array]:
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

    def learn(some: NDArray[np.bool_]) -> Callable[[], Array]:
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
