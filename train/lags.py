"""Which lag of the temperature the network is shown, found from the logs themselves.

The network remembers, but it learns soonest when one signal already has the speed of the sensor's
slow part. For each time constant of a grid a small linear model is solved: the physical model's own
features, and a cubic in the temperature after the lag. The time constant that predicts runs left
out best is taken; a second one only when it earns its place.
`docs/decisions/020-what-the-network-sees.md` has the comparison with fixed banks.
"""

from collections.abc import Callable, Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.linear import collect_moments, score_left_out, stack_centred

GRID, REFINE = 16, 9
"""Time constants that are tried, evenly spaced in the logarithm; then again around the best."""
SHORTEST_STEPS = 3.0
"""A lag shorter than this many samples shows the thermometer's noise more than its slope."""
LONGEST_SHARE = 0.25
"""A lag longer than this share of the longest run cannot be told from a slow drift."""
EARNS_ITS_PLACE = 0.8
"""A second lag must bring the error on runs left out below this multiple of the first one's."""
MOST_LAGS = 2


def choose_lags(
    runs: Sequence[Run], features: Sequence[Array], drifts: Sequence[Array]
) -> tuple[float, ...]:
    """Return the time constants in seconds, the best one first.

    Args:
        runs: training runs.
        features: [n, J] per run, those of the physical model.
        drifts: [n, K] per run, in multiples of what physics leaves of each output.
    """
    dt_s = runs[0].sample_period_s
    longest = max(len(run) for run in runs)
    highest_s = max(LONGEST_SHARE * longest, 2.0 * SHORTEST_STEPS) * dt_s
    grid = [float(tau) for tau in np.geomspace(SHORTEST_STEPS * dt_s, highest_s, GRID)]
    ratio = grid[1] / grid[0]
    levels = _standardise([run.temperature_degC[:, None] for run in runs])
    base = [np.concatenate(p, axis=1) for p in zip(levels, _standardise(features), strict=True)]

    def measure(lags_s: Sequence[float]) -> float:
        columns = [
            np.concatenate([x, *(_cube(lowpass(level[:, 0], dt_s, tau)) for tau in lags_s)], axis=1)
            for x, level in zip(base, levels, strict=True)
        ]
        return score_left_out(collect_moments(stack_centred(runs, columns, drifts)))

    chosen: list[float] = []
    error = np.inf
    for _ in range(MOST_LAGS):
        best, _ = _search(measure, chosen, grid)
        near = best * ratio ** np.linspace(-1.0, 1.0, REFINE)
        best, found = _search(measure, chosen, near.tolist())
        if found > EARNS_ITS_PLACE * error:
            break
        chosen.append(best)
        error = found
    return tuple(float(f"{tau:.3g}") for tau in chosen)


def _search(
    measure: Callable[[Sequence[float]], float], chosen: Sequence[float], grid: Sequence[float]
) -> tuple[float, float]:
    """Return the time constant that does best beside those chosen, and its error."""
    scores = {tau: measure((*chosen, tau)) for tau in grid if tau not in chosen}
    best = min(scores, key=lambda tau: scores[tau])
    return best, scores[best]


def _cube(x: Array) -> Array:
    """Return x, x^2, x^3 as columns."""
    return np.stack([x, x**2, x**3], axis=1)


def _standardise(columns: Sequence[Array]) -> list[Array]:
    """Return the columns at mean 0 and variance 1 over all runs, without those that never move."""
    together = np.concatenate(columns)
    spread = together.std(axis=0)
    moves = spread > 1e-12 * np.abs(together).max(axis=0)
    mean = together.mean(axis=0)
    return [((x - mean) / np.where(moves, spread, 1.0))[:, moves] for x in columns]
