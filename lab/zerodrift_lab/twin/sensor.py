"""The simulated six-axis sensor: its axes, its ranges, and how far temperature moves it.

Source: the ranges, the 14 bits and the size of the drift are those of the paper on GRU
temperature compensation of a photo-coupler force/torque sensor (arXiv 2502.17528).
"""

import zlib

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OUTPUTS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
UNITS = ("N", "N", "N", "Nm", "Nm", "Nm")

#: Full scale of each output, in its unit.
FULL_SCALE: Array = np.array([600.0, 600.0, 2000.0, 14.0, 14.0, 20.0])

#: Span of the uncompensated drift over -20..60 degC, in each output's unit, before unit-to-unit
#: spread. Fz is the worst: its photo-couplers look at a reflector that is further away.
DRIFT_SPAN: Array = np.array([35.0, 25.0, 160.0, 1.4, 1.6, 0.8])

#: Share of that span which the dark current brings; the rest is the straight zero shift.
DARK_SHARE: Array = np.array([0.30, 0.30, 0.50, 0.40, 0.40, 0.25])

COLDEST = -20.0
"""degC: lower end of the range that the spans above belong to."""
HOTTEST = 60.0
"""degC: upper end of that range."""
REFERENCE_TEMPERATURE = 25.0
"""degC: T0 in the effects' equations."""

ADC_BITS = 14
#: One count of the converter in each output's unit: full scale to both sides over 2^14 codes.
OUTPUT_LSB: Array = 2.0 * FULL_SCALE / 2.0**ADC_BITS

TEMPERATURE_LSB = 0.0078125
"""degC per count of the TMP117 (Texas Instruments, data sheet SNOSD82, table of register 0)."""

SUPPLY_NOMINAL = 5.0
"""V: V0 in the supply effect's equation."""


def draw_stream(seed: int, *names: str) -> np.random.Generator:
    """Return the random stream of that seed and name.

    Every thing that is drawn has its own stream, so that switching one effect on leaves all
    other draws, and hence the rest of the simulated world, as they were.
    """
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])


def draw_signs(rng: np.random.Generator, count: int) -> Array:
    """Return `count` random signs."""
    return np.where(rng.random(count) < 0.5, -1.0, 1.0)
