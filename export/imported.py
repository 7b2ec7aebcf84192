"""A network that another program trained, as the compensator of a project."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.bridges import predict_along
from zerodrift.dataset.runs import Run
from zerodrift.export.float_network import FloatNetwork

Array = NDArray[np.float64]

TEMPERATURE = "temperature"
"""Name of the feature that is the chip's own thermometer; others are names of [inputs]."""


@dataclass(frozen=True)
class Scaling:
    """Brings logged columns to -1 .. 1 before they become int16; the network takes it back."""

    features: tuple[str, ...]
    center: Array  # [I]
    scale: Array  # [I]

    def compute(self, run: Run) -> Array:
        """Return the scaled features [n, I] of a run."""
        return np.asarray((read_features(run, self.features) - self.center) / self.scale)


@dataclass(frozen=True)
class ImportedCompensator:
    """A network from an ONNX file as a compensator: its outputs are the drift, in their units."""

    network: FloatNetwork
    """On the columns as they are logged: degC, V, ..."""
    window: int
    """0: the state is carried from sample to sample."""
    front_end: Scaling
    tared: bool = False
    """A network knows nothing of the logs' tares."""
    physics: None = None
    """There is none beside it."""

    def predict(self, run: Run) -> Array:
        """Return the predicted drift [n, K] of a run that starts at rest."""
        if run.before is not None:
            return predict_along(self.predict, run)
        features = read_features(run, self.front_end.features)
        if self.window:
            return self.network.run_windows(features, self.window)
        drift = self.network.run(features[None], self.network.settle(features[:1]))
        return np.asarray(drift[0])


def read_features(run: Run, features: Sequence[str]) -> Array:
    """Return the network's inputs [n, I] of a run, as logged."""
    columns = [run.temperature_degC if f == TEMPERATURE else run.inputs[f] for f in features]
    return np.stack(columns, axis=1)
