"""What logs can show: times between a sample and a run, and what is more than a signal's noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.dataset.shared_rows import measure_white_noise
from zerodrift.physics.terms import Term

ABOVE_NOISE = 3.0
"""Half-widths of a play, in standard deviations of its signal's noise, that smooth nothing."""
SMOOTHED = 1.5
"""Of the reference's noise, squared: an effect with a memory of the load must take away more than
that. What it remembers of the load lacks the noise that measured less reference has."""


@dataclass(frozen=True)
class LogSpan:
    """What logs can show."""

    shortest_s: float
    """Their sample period."""
    longest_s: float
    """Length of the longest run."""
    least_slack: Mapping[str, float] = field(default_factory=dict)
    """Signal -> the half-width of a play that its noise leaves to be seen: load in percent of the
    full scale, temperature in K."""
    reference_noise: Array = field(default_factory=lambda: np.zeros(1))
    """[K] RMS of each reference's noise, in the output's unit."""

    def is_more_than_smoothing(self, term: Term, gained: Array) -> bool:
        """Return whether an effect takes away more than the reference's noise.

        Args:
            term: the effect. One without a memory of the load cannot smooth the reference.
            gained: [K] by how much the mean squared error falls, in the outputs' units squared.
        """
        remembers = any(p.unit == "s" or p.slack_in == "load" for p in term.free)
        if "load" not in term.effect.needs or not remembers:
            return True
        return bool((gained > SMOOTHED * self.reference_noise**2).any())


def measure_span(runs: Sequence[Run], full_scale: Sequence[float]) -> LogSpan:
    """Return the sample period, the length of the longest run, and the signals' noise.

    Args:
        runs: stretches of runs.
        full_scale: [K] of the outputs, in their units.
    """
    lengths: dict[str, int] = {}
    for run in runs:
        lengths[run.group] = lengths.get(run.group, 0) + len(run)
    period_s = runs[0].sample_period_s
    temperature = [measure_white_noise(run.temperature_degC) for run in runs]
    references = [[measure_white_noise(c) for c in run.reference.T] for run in runs]
    noise = np.median(references, axis=0)
    least = {
        "temperature": ABOVE_NOISE * float(np.median(temperature)),
        "load": ABOVE_NOISE * 100.0 * float(np.max(noise / np.array(full_scale))),
    }
    return LogSpan(period_s, max(lengths.values()) * period_s, least, noise)
