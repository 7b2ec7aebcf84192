"""What the photo-couplers' elements feel of the heat, which is what their drift follows.

The thermometer sits on the board. If nothing is hidden here the elements are as warm as it is;
otherwise they sit partly on the body, are read at another moment, lag, or remember turns.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.conditions import Conditions
from zerodrift_lab.twin.hysteresis import play
from zerodrift_lab.twin.integrate import relax

Array = NDArray[np.float64]

#: The effects that change what the elements feel, in the order in which they act.
ELEMENT_EFFECTS = ("heat_path", "clock_delay", "thermal_lag", "thermal_hysteresis")

Physics = Mapping[str, Mapping[str, float]]
"""Effect -> parameter -> value."""


@dataclass(frozen=True)
class Elements:
    """Temperature of the elements at the logged instants, [n] each."""

    temperature: Array
    """degC."""
    rate: Array
    """K/s, before any thermal hysteresis."""


def feel(conditions: Conditions, physics: Physics) -> Elements:
    """Return what the elements feel under those of `physics` that are in `ELEMENT_EFFECTS`."""
    heat, step_s = conditions.heat, conditions.fine_step_s
    temperature, rate = heat.chip, heat.chip_rate
    if "heat_path" in physics:
        share = physics["heat_path"]["share"]
        temperature = (1.0 - share) * temperature + share * heat.body
        rate = (1.0 - share) * rate + share * heat.body_rate
    if "clock_delay" in physics:
        time_s = conditions.fine_time_s
        moment_s = time_s - physics["clock_delay"]["delay_s"]
        beyond_s = np.maximum(moment_s - time_s[-1], 0.0)
        temperature = np.interp(moment_s, time_s, temperature) + beyond_s * rate[-1]
        rate = np.interp(moment_s, time_s, rate, left=0.0)
    if "thermal_lag" in physics:
        lag = physics["thermal_lag"]
        ways = [(1.0 - lag.get("slow_share", 0.0), lag["tau_s"])]
        if "slow_tau_s" in lag:
            ways.append((lag["slow_share"], lag["slow_tau_s"]))
        # The element begins at rest, so its rate begins at zero and follows the chip's rate.
        lagged = [(w * relax(temperature, tau_s, step_s), tau_s, w) for w, tau_s in ways]
        rate = sum((w * relax(rate, tau_s, step_s, 0.0) for _, tau_s, w in lagged), 0.0 * rate)
        temperature = sum((part for part, _, _ in lagged), 0.0 * temperature)
    if "thermal_hysteresis" in physics:
        temperature = play(temperature, physics["thermal_hysteresis"]["half_width_K"])
    return Elements(conditions.sample(temperature), conditions.sample(rate))
