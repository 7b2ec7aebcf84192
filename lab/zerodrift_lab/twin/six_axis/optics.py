"""Six reflective photo-couplers: light by distance and temperature, dark current, converter.

Odd couplers (1, 3, 5) look upwards at a reflector about a millimetre away, on the falling side of
their response; even ones (2, 4, 6) look along the circumference from close by, on the rising side.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.sensor import REFERENCE_TEMPERATURE, draw_stream
from zerodrift_lab.twin.six_axis.heat import NODE

Array = NDArray[np.float64]

VERTICAL = np.array([True, False, True, False, True, False])
#: rad, where each coupler sits; side A, which faces the lamp, is at 0.
AZIMUTH: Array = np.deg2rad([0.0, 60.0, 120.0, 180.0, 240.0, 300.0])
#: Share of side A in what a coupler feels of its surroundings.
SIDE_A: Array = 0.5 * (1.0 + np.cos(AZIMUTH))

PEAK_DISTANCE_MM = 0.5
"""Where a subminiature reflective coupler answers most."""
REST_DISTANCE_MM: Array = np.where(VERTICAL, 1.0, 0.2)
PEAK_CURRENT_NA = 100_000.0
"""Photo-current at the peak of the response."""

#: nA at 25 degC. Datasheets of this class: typically 1 to 10, at most 100 to 200.
DARK_CURRENT_NA: Array = np.array([20.0, 14.0, 15.0, 12.0, 13.0, 16.0])
#: ppm/K of the light that the drive's optical feedback leaves, at the couplers' temperature.
LIGHT_PPM_PER_K: Array = np.array([15.0, -80.0, 0.0, 60.0, -45.0, 20.0])
OPEN_LOOP_PERCENT_PER_K = -0.05
"""LED and transistor together without feedback; acts on what coupler and feedback differ by."""

ADC_CODES = 2**16
#: nA per code: a window of 30 uA around the rest current upwards, of 40 uA sideways.
NANOAMPERE_PER_CODE: Array = np.where(VERTICAL, 30_000.0, 40_000.0) / ADC_CODES


@dataclass(frozen=True)
class Couplers:
    """The six couplers of one specimen, [6] each."""

    rest_distance_mm: Array
    peak_distance_mm: Array
    peak_current_na: Array
    dark_current_na: Array
    """At 25 degC."""
    doubling_kelvin: Array
    light_ppm_per_k: Array
    open_loop_percent_per_k: Array
    bias_na: Array
    """What the converter subtracts: the current at 25 degC without load."""

    def answer(self, distance_mm: Array) -> Array:
        """Return the photo-current [n, 6] at 25 degC in nA, by the distance [n, 6].

        2x/(1 + x^2) of the distance over the peak's: linear close by, 1/x far away, and a fifth at
        some 0.1 and 10 times the peak, as datasheets draw it.
        """
        x = distance_mm / self.peak_distance_mm
        current: Array = self.peak_current_na * 2.0 * x / (1.0 + x * x)
        return current

    def feel(self, nodes: Array) -> Array:
        """Return the couplers' own temperatures [n, 6] from the nodes' [n, 13]."""
        a, b = nodes[:, NODE["couplers_a"], None], nodes[:, NODE["couplers_b"], None]
        return SIDE_A * a + (1.0 - SIDE_A) * b

    def convert(self, distance_mm: Array, nodes: Array) -> Array:
        """Return the converter's codes [n, 6] before noise, rounding and its rails.

        `nodes` are the temperatures [n, 13] in degC.
        """
        own = self.feel(nodes)
        away = own - REFERENCE_TEMPERATURE
        feedback = nodes[:, NODE["board"], None]
        light = 1.0 + 1e-6 * self.light_ppm_per_k * away
        light = light + 1e-2 * self.open_loop_percent_per_k * (own - feedback)
        dark = self.dark_current_na * np.exp2(away / self.doubling_kelvin)
        current = self.answer(distance_mm) * light + dark
        codes: Array = (current - self.bias_na) / NANOAMPERE_PER_CODE + ADC_CODES / 2
        return codes


def draw_couplers(seed: int | None) -> Couplers:
    """Draw the couplers of one specimen; None gives the nominal ones."""
    ones = np.ones(6)
    distance, peak, current, dark, doubling, light, loop = (
        REST_DISTANCE_MM,
        PEAK_DISTANCE_MM * ones,
        PEAK_CURRENT_NA * ones,
        DARK_CURRENT_NA,
        10.0 * ones,
        LIGHT_PPM_PER_K,
        OPEN_LOOP_PERCENT_PER_K * ones,
    )
    if seed is not None:
        rng = draw_stream(seed, "six axis", "couplers")
        distance = distance * (1.0 + 0.02 * rng.standard_normal(6))
        peak = peak * (1.0 + 0.02 * rng.standard_normal(6))
        current = current * np.exp(rng.normal(0.0, 0.05, 6))
        dark = dark * np.exp(rng.normal(0.0, 0.20, 6))
        doubling = rng.uniform(8.5, 11.5, 6)
        light = light + rng.normal(0.0, 4.0, 6)
        loop = loop + rng.normal(0.0, 0.02, 6)
    bare = Couplers(distance, peak, current, dark, doubling, light, loop, np.zeros(6))
    at_rest = bare.answer(distance[None])[0] + dark
    return Couplers(distance, peak, current, dark, doubling, light, loop, at_rest)
