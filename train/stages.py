"""The parts before the network: physics, its lags, the linear part, and the residual to learn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.config import WINDOWED_KINDS, Config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.drivers import list_thermometers
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import TARE_RATIO, fit
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.front_end import FrontEnd, Tap, fit_front_end
from zerodrift.train.lag_bank.search import LONGEST_SHARE, SHORTEST_STEPS
from zerodrift.train.sequences import Sequence32

# The linear part of what physics leaves, solved exactly before the network sees anything.
#
# A network needs units and epochs to approximate a straight line, and bends where the training data
# end. So the part of the residual that is linear in the network's features is first removed by
# least squares, and the network learns only the non-linear part. It is kept where it predicts runs
# left out better than nothing does.

BLOCKS = 5
"""A single run is left out in this many blocks of time."""
RIDGE = 1e-6
"""Share of each column's own square that is added to the normal equations."""
HELPS = 0.97
"""The linear part is kept if the error on runs left out falls below this multiple."""


@dataclass(frozen=True)
class Moments:
    """Sums of products of columns and targets, by what is left out together."""

    by_group: Array
    """[G, J + K, J + K]."""
    width: int
    """Number of columns J."""
    samples: int
    """Number of samples times outputs."""


@dataclass(frozen=True)
class FeatureTable:
    """Columns and targets of all samples, each group without its mean."""

    group: IntArray
    """[m]."""
    rows: Array
    """[m, J + K]."""
    width: int


def stack_centred(
    runs: Sequence[Run], columns: Sequence[Array], targets: Sequence[Array]
) -> FeatureTable:
    """Return columns [n, J] and targets [n, K] of all runs as one table.

    A group's mean is taken off, since its offset may be that of a tare. A single run is cut into
    blocks of time, which keep the run's mean.
    """
    names = list(dict.fromkeys(run.group for run in runs))
    rows = np.concatenate(
        [np.concatenate(pair, axis=1) for pair in zip(columns, targets, strict=True)]
    )
    if len(names) > 1:
        group = np.concatenate([np.full(len(run), names.index(run.group)) for run in runs])
        for g in range(len(names)):
            rows[group == g] -= rows[group == g].mean(axis=0)
    else:
        rows -= rows.mean(axis=0)
        group = np.arange(len(rows)) * BLOCKS // len(rows)
    return FeatureTable(group, rows, columns[0].shape[1])


def collect_moments(table: FeatureTable) -> Moments:
    """Return the sums of products of a table."""
    groups = [table.rows[table.group == g] for g in range(int(table.group.max()) + 1)]
    by_group = np.stack([rows.T @ rows for rows in groups])
    outputs = table.rows.shape[1] - table.width
    return Moments(by_group, table.width, len(table.rows) * outputs)


def score_left_out(moments: Moments) -> float:
    """Return the RMSE of the linear model on each group when it is fitted to the others."""
    total = moments.by_group.sum(axis=0)
    j = moments.width
    squares = 0.0
    for own in moments.by_group:
        solution = _solve(total - own, j)
        squares += float(
            np.trace(own[j:, j:])
            - 2.0 * np.sum(solution * own[:j, j:])
            + np.sum(solution * (own[:j, :j] @ solution))
        )
    return float(np.sqrt(max(squares, 0.0) / moments.samples))


def fit_linear(runs: Sequence[Run], features: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return the coefficients [I, K] of the features, or zeros where they do not help.

    Args:
        runs: training runs.
        features: [n, I] per run.
        residuals: [n, K] per run, drift that physics leaves, in multiples of each output's scale.
    """
    moments = collect_moments(stack_centred(runs, features, residuals))
    total = moments.by_group.sum(axis=0)
    nothing = float(np.sqrt(np.trace(total[moments.width :, moments.width :]) / moments.samples))
    if score_left_out(moments) > HELPS * nothing:
        return np.zeros((moments.width, residuals[0].shape[1]))
    return _solve(total, moments.width)


def _solve(moment: Array, width: int) -> Array:
    """Return the least-squares coefficients [J, K] of moments [J + K, J + K]."""
    normal = moment[:width, :width]
    ridge = RIDGE * np.diag(np.diag(normal)) + 1e-12 * np.trace(normal) * np.eye(width)
    return np.asarray(np.linalg.solve(normal + ridge, moment[:width, width:]))


# Which lag of the temperature the network is shown, found from the logs themselves.
#
# The network remembers, but it learns soonest when one signal already has the speed of the sensor's
# slow part. For each time constant of a grid a small linear model is solved: the physical model's
# own features, and a cubic in the temperature after the lag. The time constant that predicts runs
# left out best is taken; a second one only when it earns its place. `docs/decisions/020-what-the-
# network-sees.md` has the comparison with fixed banks.

GRID, REFINE = 16, 9
"""Time constants that are tried, evenly spaced in the logarithm; then again around the best."""
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


# The parts before the network: physics, its lags, the linear part, and the residual to learn.

SPACING_S = 10.0
"""Between the samples of a window: at 0.1 s the thermometer's noise hides the slope."""


@dataclass(frozen=True)
class Stages:
    """Everything that is solved exactly, fitted to some runs."""

    physics: PhysicalModel
    front_end: FrontEnd
    linear: Array
    """[I, K] output units per feature."""
    constant: Array
    """[K] what the linear part adds at features of zero, in the outputs' units."""
    tared: bool
    """Whether each run has an offset of its own, which is not predictable."""
    offsets: Mapping[str, Array]
    """Group -> [K] offset of its own, where logs are tared; empty otherwise."""
    scale: Array
    """[K] RMS of what is left over the runs it was fitted to, in the outputs' units."""

    def explain(self, run: Run) -> Array:
        """Return the drift [n, K] that physics and the linear part predict for a run."""
        run = run.at_rest()
        features = self.front_end.compute(run)
        return np.asarray(self.physics.predict(run) + features @ self.linear + self.constant)

    def leave(self, run: Run) -> Array:
        """Return what is left of a run's drift [n, K], without the run's own offset if known."""
        offset = self.offsets.get(run.group, np.zeros(self.scale.size))
        return np.asarray(run.drift - self.explain(run) - offset)

    def make_sequences(
        self, runs: Sequence[Run], skip: Mapping[str, int] | None = None
    ) -> list[Sequence32]:
        """Return the runs as the network's training sees them."""
        return [
            Sequence32(
                group=run.group,
                features=self.front_end.compute(run).astype(np.float32),
                target=(self.leave(run) / self.scale).astype(np.float32),
                skip=(skip or {}).get(run.name, 0),
            )
            for run in runs
        ]


def fit_physics(
    config: Config, dataset: Dataset, runs: Sequence[Run], catalogue: Catalogue
) -> PhysicalModel:
    """Return the physical model of zerodrift.toml fitted to these runs."""
    return fit(
        config.effects,
        runs,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        catalogue=catalogue,
    )


def fit_stages(config: Config, physics: PhysicalModel, runs: Sequence[Run]) -> Stages:
    """Choose the front end and solve the linear part on what physics leaves of these runs.

    Args:
        config: the project; `[network] lags_s` overrides the choice of lags.
        physics: fitted to the same runs.
        runs: training runs.
    """
    runs = [run.at_rest() for run in runs]
    residuals = [run.drift - physics.predict(run) for run in runs]
    unit = _measure_scale(runs, residuals)
    lags_s = config.network.lags_s or choose_lags(
        runs, [physics.features(run) for run in runs], [run.drift / unit for run in runs]
    )
    taps = list_taps(config, runs, lags_s)
    if config.network.kind in WINDOWED_KINDS:
        taps = list_window(taps, config)
    front_end = fit_front_end(taps, runs, decorrelate=config.network.kind != "tcn")
    features = [front_end.compute(run) for run in runs]
    linear = fit_linear(runs, features, [residual / unit for residual in residuals]) * unit
    left = [r - x @ linear for r, x in zip(residuals, features, strict=True)]
    constant, offsets = settle_offsets(runs, left)
    rest = [r - constant - offsets.get(run.group, 0.0) for run, r in zip(runs, left, strict=True)]
    scale = np.sqrt(np.mean(np.concatenate(rest) ** 2, axis=0))
    scale[scale == 0.0] = 1.0
    return Stages(physics, front_end, linear, constant, bool(offsets), offsets, scale)


def settle_offsets(runs: Sequence[Run], left: Sequence[Array]) -> tuple[Array, dict[str, Array]]:
    """Return the constant [K], and each group's own offset beyond it if the logs are tared.

    The fit of the physical model decides the same, but from its own residual, in which a lag may
    hide a tare.
    """
    together = np.concatenate(left)
    constant = together.mean(axis=0)
    means = mean_by_group(runs, left)
    own = np.concatenate([r - means[run.group] for run, r in zip(runs, left, strict=True)])
    squares = np.sum((together - constant) ** 2, axis=0)
    floor = 1e-12 * max(float(squares.max()), 1e-300)
    ratio = float(np.mean((squares + floor) / (np.sum(own**2, axis=0) + floor)))
    said = runs[0].tared
    shared = ratio < TARE_RATIO if said is None else not said
    if len(means) < 2 or shared:
        return constant, {}
    # Each run counts once in the constant; what it has beyond that is its tare's.
    constant = np.mean(list(means.values()), axis=0)
    return constant, {group: mean - constant for group, mean in means.items()}


def mean_by_group(runs: Sequence[Run], values: Sequence[Array]) -> dict[str, Array]:
    """Return the mean [K] of values [n, K] over the stretches of each group."""
    parts: dict[str, list[Array]] = {}
    for run, value in zip(runs, values, strict=True):
        parts.setdefault(run.group, []).append(value)
    return {group: np.concatenate(found).mean(axis=0) for group, found in parts.items()}


def list_taps(config: Config, runs: Sequence[Run], lags_s: Sequence[float]) -> tuple[Tap, ...]:
    """Return what the network sees: the chip's temperature, other thermometers, the lags.

    Channels other than thermometers reach the compensator through effects: a network that is given
    a supply voltage or a clock learns the few values that the logs have.
    """
    others = [
        name
        for name in list_thermometers(config)
        if any(float(np.ptp(run.inputs[name])) > 0.0 for run in runs if name in run.inputs)
    ]
    return (
        Tap("level"),
        *(Tap("level", source=name) for name in others),
        *(Tap("lag", tau_s=tau_s) for tau_s in lags_s),
    )


def list_window(taps: Sequence[Tap], config: Config) -> tuple[Tap, ...]:
    """Return taps of the present sample and of those before it, newest sample first."""
    network = config.network
    spacing_s = float(network.options.get("spacing_s", SPACING_S))
    steps = max(1, round(spacing_s / config.sample_period_s))
    return tuple(
        replace(tap, steps=age * steps, hops=max(age, 1))
        for age in range(int(network.memory))
        for tap in taps
    )


def _measure_scale(runs: Sequence[Run], residuals: Sequence[Array]) -> Array:
    """Return the RMS [K] of residuals, each group without its mean; 1 for an output without any."""
    means = mean_by_group(runs, residuals)
    rest = [r - means[run.group] for run, r in zip(runs, residuals, strict=True)]
    scale = np.sqrt(np.mean(np.concatenate(rest) ** 2, axis=0))
    scale[scale == 0.0] = 1.0
    return np.asarray(scale)
