"""The parts before the network: physics, its lags, the linear part, and the residual to learn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import WINDOWED_KINDS, Config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.thermometers import list_thermometers
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import TARE_RATIO, fit
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.front_end import FrontEnd, Tap, fit_front_end
from zerodrift.train.lags import choose_lags
from zerodrift.train.linear import fit_linear
from zerodrift.train.sequences import Sequence32

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
