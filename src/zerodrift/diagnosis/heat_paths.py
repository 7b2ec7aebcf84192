"""Whether all runs were heated the same way, as far as thermometer and drift show.

A sensor that is heated from all sides warms its body, its elements and the board with its
thermometer in one order; from one side, by a warm sole or a lamp, in another. A model of the
thermometer's history holds for the way it learnt. Where a run's lag, predicted from the other
runs, is wrong, and the same lag with coefficients of the run's own is right, that run was heated
another way.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.memory import MemoryTable

ANOTHER_WAY = 1.8
"""A run was heated another way if the others' lags leave this many times what its own leave."""
ONE_WAY = 1.35
"""Below this it was heated the same way. Between the two a slow lag, which a few runs tell badly,
and a second way of heating look alike."""
EXCITED_K = 0.05
"""A further thermometer that moves by more than this beyond the chip's history, kelvin RMS, was
reached by heat of another way; well above a thermometer's noise of a few thousandths."""
RATE_WINDOW_S = 60.0
"""Rates of temperature are taken over this time."""
MOVING = 0.1
"""Share of the fastest rate above which the temperature moves."""
VARIED = 2.0
"""Rates are varied if the 90th percentile of their sizes is this many times the 25th."""
POWER_ON_S = 1.0
"""A log that begins no later than this, or than one sample, begins with the power-on."""


@dataclass(frozen=True)
class Path:
    """How well the lags of the other runs predict one run's drift."""

    run: str
    ratio: float
    """RMSE by the others' lags over that by the same lags with the run's own coefficients."""

    @property
    def differs(self) -> bool:
        """Whether it was heated another way."""
        return self.ratio >= ANOTHER_WAY


@dataclass(frozen=True)
class Programme:
    """What the temperature does in the logs."""

    coldest_degC: float
    hottest_degC: float
    varied: bool
    """Whether fast and slow ramps are both there."""
    longest_s: float
    power_ons: int
    """Logs that begin with the power-on."""


def compare_paths(table: MemoryTable, taus_s: Sequence[float]) -> tuple[Path, ...]:
    """Return how each run fits the others, the one that fits worst first.

    Where no lag helps all runs, since each has its own, two lags a decade apart stand for them.
    One run has nothing to be compared with: the result is empty.
    """
    if len(table.groups) < 2:
        return ()
    third = len(table.grid) // 3
    taus_s = sorted({*taus_s, table.grid[third], table.grid[2 * third]})
    base, lags = table.take_base(), table.lags(taus_s)
    index = [*base, *lags]
    # The lags' linear parts, which a run is long enough to tell.
    own_lags = [len(base) + 3 * i for i in range(len(taus_s))]
    total = table.products.sum(axis=0)
    wide = table.products.shape[1] - len(table.outputs)
    found = []
    for g, group in enumerate(table.groups):
        rest = (total - table.products[g])[None]
        solution = table.solve(rest[:, index][:, :, index], rest[:, index, wide:])[0]
        own = table.products[g][np.ix_(index, index)]
        target = table.products[g][index, wide:]
        power = np.diag(table.products[g][wide:, wide:])
        theirs = _measure(solution, own, target, power)
        # What the others' model leaves, with the lags' coefficients free for this run.
        left = target - own @ solution
        step = table.solve(own[np.ix_(own_lags, own_lags)][None], left[own_lags][None])[0]
        changed = solution.copy()
        changed[own_lags] += step
        ours = _measure(changed, own, target, power)
        ratio = float(np.sqrt(np.mean(theirs / np.maximum(ours, 1e-300))))
        found.append(Path(group, ratio))
    return tuple(sorted(found, key=lambda path: -path.ratio))


def _measure(solution: Array, own: Array, target: Array, power: Array) -> Array:
    """Return the squares [K] that a solution leaves."""
    cross = np.einsum("jk,jk->k", solution, target)
    return np.asarray(
        np.maximum(power - 2.0 * cross + np.einsum("jk,jk->k", solution, own @ solution), 0.0)
    )


def measure_untold(table: MemoryTable, thermometer: str) -> float:
    """Return the RMS in K of a further thermometer that the chip's history does not explain.

    The further thermometer's distance from the chip is fitted, over all runs, by lags of the
    chip's temperature over the whole grid; what remains moved by itself, so heat reached it by
    another way.
    """
    parts = []
    for run in table.runs:
        own = np.stack(table.list_lagged(run), axis=1)
        distance = run.inputs[thermometer] - run.temperature_degC
        rows = np.concatenate([own, distance[:, None]], axis=1)
        parts.append(rows - rows.mean(axis=0))
    rows = np.concatenate(parts)
    coefficients = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=1e-6)[0]
    return float(np.std(rows[:, -1] - rows[:, :-1] @ coefficients))


def describe_programme(runs: Sequence[Run]) -> Programme:
    """Return what the temperature does in the logs."""
    dt_s = runs[0].sample_period_s
    window = max(1, round(RATE_WINDOW_S / dt_s))
    rates = [
        (run.temperature_degC[window:] - run.temperature_degC[:-window]) / (window * dt_s) * 60.0
        for run in runs
        if len(run) > window
    ]
    rate = np.concatenate(rates) if rates else np.zeros(1)
    fastest = float(np.percentile(np.abs(rate), 99.0))
    size = np.abs(rate)
    size = size[size >= MOVING * fastest]
    low, high = np.percentile(size, [25.0, 90.0]) if size.size else (1.0, 1.0)
    starts = {
        run.group: run.time_s[0] if run.start_s is None else run.start_s
        for run in reversed(runs)
        if run.part == 0
    }
    return Programme(
        coldest_degC=min(float(run.temperature_degC.min()) for run in runs),
        hottest_degC=max(float(run.temperature_degC.max()) for run in runs),
        varied=bool(high >= VARIED * low),
        longest_s=max(len(run) for run in runs) * dt_s,
        power_ons=sum(bool(0.0 <= x <= max(POWER_ON_S, dt_s)) for x in starts.values()),
    )
