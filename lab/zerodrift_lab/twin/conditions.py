"""What one run was like: the programmes evaluated and the heat integrated."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.heat import HeatHistory, HeatNetwork, warm
from zerodrift_lab.twin.stimuli import BOARD_POWER_W, Stimulus

Array = NDArray[np.float64]

POWERED_EARLIER_S = 7200.0
"""How long before its log a warmed-up run was powered on."""


@dataclass(frozen=True)
class Conditions:
    """One run before any drift: arrays on the logged grid [n] unless they are called fine."""

    name: str
    """Name of the run, also of its file: `chamber_1`."""
    use: str
    """train | test | dwell."""
    seed: int
    stimulus: Stimulus
    sample_period_s: float
    fine_per_sample: int
    """Integration steps per logged sample."""
    clock_start_s: float
    """Absolute time of the first sample, counted from the campaign's first run."""
    heat: HeatHistory
    """On the fine grid."""

    @property
    def fine_step_s(self) -> float:
        """The integration step."""
        return self.sample_period_s / self.fine_per_sample

    @cached_property
    def fine_time_s(self) -> Array:
        """Instants of the fine grid."""
        return np.arange(self.heat.chip.size, dtype=np.float64) * self.fine_step_s

    @cached_property
    def time_s(self) -> Array:
        """Instants of the logged samples, from the start of the run."""
        count = (self.heat.chip.size - 1) // self.fine_per_sample + 1
        return np.round(np.arange(count) * self.sample_period_s, 6)

    @property
    def clock_s(self) -> Array:
        """Absolute time of the logged samples."""
        return self.clock_start_s + self.time_s

    @property
    def powered_s(self) -> Array:
        """Time since power-on."""
        return self.time_s + (POWERED_EARLIER_S if self.stimulus.powered_before else 0.0)

    def sample(self, fine: Array) -> Array:
        """Return the logged instants of a fine signal."""
        return fine[:: self.fine_per_sample]

    @cached_property
    def chip(self) -> Array:
        """Board temperature, degC."""
        return self.sample(self.heat.chip)

    @cached_property
    def load(self) -> Array:
        """True load [n, 6] in each output's unit."""
        return np.stack([axis.evaluate(self.time_s) for axis in self.stimulus.load], axis=1)

    @cached_property
    def fine_load(self) -> Array:
        """True load on the fine grid [fine n, 6]."""
        return np.stack([axis.evaluate(self.fine_time_s) for axis in self.stimulus.load], axis=1)

    @cached_property
    def load_rate(self) -> Array:
        """Time derivative of the load [n, 6], per second."""
        return np.stack([axis.differentiate(self.time_s) for axis in self.stimulus.load], axis=1)

    @cached_property
    def supply(self) -> Array:
        """Supply voltage, V."""
        return self.stimulus.supply.evaluate(self.time_s)

    @cached_property
    def fine_humidity(self) -> Array:
        """Relative humidity on the fine grid, %."""
        return self.stimulus.humidity.evaluate(self.fine_time_s)

    @cached_property
    def ambient_light(self) -> Array:
        """Illuminance, lux."""
        return self.stimulus.ambient_light.evaluate(self.time_s)

    @cached_property
    def acceleration(self) -> Array:
        """Acceleration [n, 3], m/s2."""
        axes = [axis.evaluate(self.time_s) for axis in self.stimulus.acceleration]
        return np.stack(axes, axis=1)


def experience(
    name: str,
    use: str,
    seed: int,
    stimulus: Stimulus,
    network: HeatNetwork,
    *,
    sample_period_s: float,
    finer: int,
    clock_start_s: float,
) -> Conditions:
    """Integrate the heat of one run.

    The step is the longest that divides the logged period at least five times and resolves the
    programmes, over `finer`.
    """
    per_sample = finer * max(5, int(np.ceil(sample_period_s / stimulus.finest_s - 1e-9)))
    samples = int(np.floor(stimulus.duration_s / sample_period_s + 1e-9)) + 1
    count = (samples - 1) * per_sample + 1
    fine_time_s = np.arange(count, dtype=np.float64) * (sample_period_s / per_sample)
    heat = warm(
        network,
        sample_period_s / per_sample,
        air=stimulus.air.evaluate(fine_time_s),
        contact=stimulus.contact.evaluate(fine_time_s),
        infrared=stimulus.infrared.evaluate(fine_time_s),
        board=np.full(fine_time_s.size, BOARD_POWER_W),
        powered_before=stimulus.powered_before,
    )
    return Conditions(name, use, seed, stimulus, sample_period_s, per_sample, clock_start_s, heat)
