"""What comes before the network: physics, its lag, the linear part, and what is left to learn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.config import Config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import fit
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.front_end import FrontEnd, Tap, fit_front_end
from zerodrift.train.lags import choose_lags
from zerodrift.train.linear import fit_linear
from zerodrift.train.sequences import Sequence32

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stages:
    """Everything that is solved exactly, fitted to some runs."""

    physics: PhysicalModel
    front_end: FrontEnd
    linear: Array
    """[I, K] output units per feature."""
    scale: Array
    """[K] RMS of what is left over the runs it was fitted to, in the outputs' units."""

    def leave(self, run: Run) -> Array:
        """Return what physics and the linear part leave of a run's drift, [n, K]."""
        explained = self.physics.predict(run) + self.front_end.compute(run) @ self.linear
        return np.asarray(run.drift - explained - get_offset(self.physics, run))

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
    residuals = [run.drift - physics.predict(run) - get_offset(physics, run) for run in runs]
    lags_s = config.network.lags_s or choose_lags(runs, _scale(residuals))
    front_end = fit_front_end(list_taps(config, runs, lags_s), runs)
    features = [front_end.compute(run) for run in runs]
    linear = fit_linear(runs, features, residuals)
    left = np.concatenate([r - x @ linear for r, x in zip(residuals, features, strict=True)])
    scale = np.sqrt(np.mean(left**2, axis=0))
    scale[scale == 0.0] = 1.0
    return Stages(physics, front_end, linear, scale)


def list_taps(config: Config, runs: Sequence[Run], lags_s: Sequence[float]) -> tuple[Tap, ...]:
    """Return what the network sees: the chip's temperature, other thermometers, the lags.

    Channels other than thermometers reach the compensator through effects: a network that is shown
    a supply voltage or a clock learns the few values it had while the logs were taken.
    """
    others = [
        name
        for name in config.inputs
        if "temperature" in name
        and any(float(np.ptp(run.inputs[name])) > 0.0 for run in runs if name in run.inputs)
    ]
    return (
        Tap("level"),
        *(Tap("level", source=name) for name in others),
        *(Tap("lag", tau_s=tau_s) for tau_s in lags_s),
    )


def get_offset(physics: PhysicalModel, run: Run) -> Array:
    """Return the offset [K] that is the run's own, where logs are tared; else zeros."""
    offset = physics.offsets.get(run.group)
    if not physics.tared or offset is None:
        return np.zeros(len(physics.outputs))
    return np.asarray(offset - physics.coefficients[0])


def _scale(residuals: Sequence[Array]) -> list[Array]:
    scale = np.concatenate(residuals).std(axis=0)
    scale[scale == 0.0] = 1.0
    return [residual / scale for residual in residuals]
