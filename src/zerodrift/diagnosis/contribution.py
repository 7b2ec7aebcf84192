"""What one effect explains of each run's drift: a model with it less the same without it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import fit_config
from zerodrift.physics.model import PhysicalModel


@dataclass(frozen=True)
class Contribution:
    """What an effect would explain of what is left, if it were added."""

    effect: str
    curves: Mapping[str, Array]
    """Run -> [K, n], each output in its unit, the run's stretches laid end to end. Each run's mean
    is taken off where logs are tared."""


@dataclass(frozen=True)
class Baseline:
    """A project's model as it is, and what it predicts: what contributions are counted from."""

    config: Config
    dataset: Dataset
    catalogue: Catalogue
    model: PhysicalModel
    predictions: Mapping[str, Array]
    """Stretch's name -> [n, K]."""

    @property
    def runs(self) -> tuple[Run, ...]:
        """The stretches that are drawn."""
        return (*self.dataset.train, *self.dataset.test)


def open_baseline(config: Config, dataset: Dataset, catalogue: Catalogue) -> Baseline:
    """Return the model as it is, fitted and applied.

    Raises:
        InputError: as `fit_config`.
    """
    model = fit_config(config, dataset, catalogue)
    runs = (*dataset.train, *dataset.test)
    return Baseline(
        config, dataset, catalogue, model, {run.name: model.predict(run) for run in runs}
    )


def find_contribution(
    baseline: Baseline, kind: str, parameters: Mapping[str, float]
) -> Contribution | None:
    """Return what an effect would explain; None where it cannot stand beside the others.

    Args:
        baseline: the model without it.
        kind: the effect.
        parameters: its values as the diagnosis found them: choices are held, the rest is fitted.
    """
    effect, config = baseline.catalogue[kind], baseline.config
    held = {
        p.name: parameters[p.name] for p in effect.parameters if p.choices and p.name in parameters
    }
    changed = replace(config, effects=(*config.effects, EffectConfig(kind, held)))
    try:
        model = fit_config(changed, baseline.dataset, baseline.catalogue)
    except InputError:
        return None
    gains: dict[str, list[Array]] = {}
    for run in baseline.runs:
        gains.setdefault(run.group, []).append(model.predict(run) - baseline.predictions[run.name])
    curves = {group: np.concatenate(parts).T for group, parts in gains.items()}
    if model.tared or baseline.model.tared:
        curves = {g: curve - curve.mean(axis=1, keepdims=True) for g, curve in curves.items()}
    return Contribution(kind, curves)
