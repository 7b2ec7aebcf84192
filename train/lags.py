"""Which lag of the temperature the network is shown, found from the logs themselves.

The network remembers, but it learns soonest when one signal already has the speed of the sensor's
slow part. For each time constant of a grid a small linear model of what physics leaves is solved:
the temperature, and a cubic in the temperature after the lag. The time constant that predicts runs
left out best is taken; a second one only when it earns its place.
`docs/decisions/020-what-the-network-sees.md` has the comparison with fixed banks.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.linear import Moments, collect_moments, score_left_out, stack_centred

Array = NDArray[np.float64]

GRID, REFINE = 16, 9
"""Time constants that are tried, evenly spaced in the logarithm; then again around the best."""
SHORTEST_STEPS = 3.0
"""A lag shorter than this many samples shows the thermometer's noise more than its slope."""
LONGEST_SHARE = 0.25
"""A lag longer than this share of the longest run cannot be told from a slow drift."""
EARNS_ITS_PLACE = 0.8
"""A second lag must bring the error on runs left out below this multiple of the first one's."""
MOST_LAGS = 2


def choose_lags(runs: Sequence[Run], residuals: Sequence[Array]) -> tuple[float, ...]:
    """Return the time constants in seconds, the best one first.

    Args:
        runs: training runs.
        residuals: [n, K] per run, drift that physics leaves, in multiples of each output's scale.
    """
    dt_s = runs[0].sample_period_s
    longest = max(len(run) for run in runs)
    highest_s = max(LONGEST_SHARE * longest, 2.0 * SHORTEST_STEPS) * dt_s
    grid = [float(tau) for tau in np.geomspace(SHORTEST_STEPS * dt_s, highest_s, GRID)]
    ratio = grid[1] / grid[0]
    chosen: list[float] = []
    error = np.inf
    for _ in range(MOST_LAGS):
        best, found = _search(runs, residuals, chosen, grid)
        near = best * ratio ** np.linspace(-1.0, 1.0, REFINE)
        best, found = _search(runs, residuals, chosen, near.tolist())
        if found > EARNS_ITS_PLACE * error:
            break
        chosen.append(best)
        error = found
    return tuple(float(f"{tau:.3g}") for tau in chosen)


def _search(
    runs: Sequence[Run], residuals: Sequence[Array], chosen: Sequence[float], grid: Sequence[float]
) -> tuple[float, float]:
    """Return the time constant that does best beside those chosen, and its error."""
    scores = {
        tau: score_left_out(_collect(runs, residuals, (*chosen, tau)))
        for tau in grid
        if tau not in chosen
    }
    best = min(scores, key=lambda tau: scores[tau])
    return best, scores[best]


def _collect(runs: Sequence[Run], residuals: Sequence[Array], lags_s: Sequence[float]) -> Moments:
    """Return the moments of the small linear model with these lags."""
    temperature = np.concatenate([run.temperature_degC for run in runs])
    middle, spread = temperature.mean(), max(float(temperature.std()), 1e-9)
    columns = []
    for run in runs:
        level = (run.temperature_degC - middle) / spread
        terms = [level]
        for tau_s in lags_s:
            slow = lowpass(level, run.sample_period_s, tau_s)
            terms += [slow, slow**2, slow**3]
        columns.append(np.stack(terms, axis=1))
    return collect_moments(stack_centred(runs, columns, residuals))
