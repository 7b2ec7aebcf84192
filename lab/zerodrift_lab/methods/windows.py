"""What the methods of the paper see: the temperature, or the last samples of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.train.front_end import TEMPERATURE, read_source


@dataclass(frozen=True)
class Windows:
    """The last `length` samples of each thermometer, `steps` apart, at mean 0 and variance 1."""

    sources: tuple[str, ...]
    length: int
    steps: int
    mean: Array
    """[S]."""
    spread: Array
    """[S]."""

    def cut(self, run: Run) -> Array:
        """Return the windows [n, length, S] of a run, newest sample first; before it, at rest."""
        columns = np.stack([read_source(run, source) for source in self.sources], axis=1)
        scaled = (columns - self.mean) / self.spread
        places = np.arange(len(run))[:, None] - self.steps * np.arange(self.length)[None, :]
        return np.asarray(scaled[np.maximum(places, 0)])


def fit_windows(
    runs: Sequence[Run], thermometers: Sequence[str], length: int, spacing_s: float
) -> Windows:
    """Return windows scaled by the training runs."""
    sources = (TEMPERATURE, *thermometers)
    signals = [np.concatenate([read_source(run, s) for run in runs]) for s in sources]
    spread = np.array([max(float(x.std()), 1e-9) for x in signals])
    steps = max(1, round(spacing_s / runs[0].sample_period_s))
    return Windows(sources, length, steps, np.array([x.mean() for x in signals]), spread)
