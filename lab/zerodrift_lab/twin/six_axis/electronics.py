"""What converter, thermometers and reference sensor add: noise, steps, lag, offset."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.integrate import relax
from zerodrift_lab.twin.noise import FLICKER_TAUS_S, make_coloured
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, TEMPERATURE_LSB, draw_stream
from zerodrift_lab.twin.six_axis.optics import ADC_CODES

Array = NDArray[np.float64]
Codes = NDArray[np.int32]

WHITE_CODES = 1.5
"""RMS of the white noise of one logged value, in codes; with 1/f about 14 bits of full scale."""
FLICKER_CODES = 1.0
"""RMS of the noise of about 1/f between 2 and 2048 s, in codes."""

THERMOMETER_LAG_S = 1.5
"""Of the TMP117's package on the board."""
THERMOMETER_NOISE = 0.4 * TEMPERATURE_LSB
"""degC RMS of one averaged conversion."""
THERMOMETER_OFFSET = 0.04
"""degC, standard deviation between chips: 0.1 degC at most from -20 to 50 degC."""
CONVERSION_PERIOD_S = 1.0
"""The TMP117's default cycle: a value stands until the next one is ready."""

#: N and Nm RMS of the capacitive sensor beside the foot, and its gain error (standard deviation).
REFERENCE_NOISE: Array = np.array([0.2, 0.2, 0.3, 0.005, 0.005, 0.005])
REFERENCE_GAIN_PERCENT = 0.3


@dataclass(frozen=True)
class Noise:
    """Noise of one specimen's converter, RMS in codes [6]."""

    white: Array
    flicker: Array


def draw_noise(seed: int | None, factor: float) -> Noise:
    """Draw the converter's noise; `factor` multiplies it all."""
    spread = np.ones((2, 6))
    if seed is not None:
        rng = draw_stream(seed, "six axis", "noise level")
        spread = np.exp(rng.normal(0.0, 0.10, (2, 6)))
    return Noise(factor * WHITE_CODES * spread[0], factor * FLICKER_CODES * spread[1])


def make_noise(noise: Noise, rng: np.random.Generator, count: int, period_s: float) -> Array:
    """Return the converter's noise [n, 6] of one run, in codes."""
    shape = (count, 6)
    total = noise.white * rng.standard_normal(shape)
    share = noise.flicker / np.sqrt(len(FLICKER_TAUS_S))
    for tau_s in FLICKER_TAUS_S:
        total += share * make_coloured(rng, shape, tau_s, period_s)
    return total


def round_codes(signal: Array) -> Codes:
    """Return the converter's whole codes [n, 6]; at the rails it clips."""
    return np.clip(np.round(signal), 0, ADC_CODES - 1).astype(np.int32)


def read_thermometer(
    node: Array, fine_step_s: float, every: int, rng: np.random.Generator, offset: float
) -> Array:
    """Return what a TMP117 reports at the logged instants [n], degC.

    `node` is the temperature under it on the fine grid, of which every `every`-th instant is
    logged. The chip lags, converts once a second on its own clock, and holds the value.
    """
    package = relax(node, THERMOMETER_LAG_S, fine_step_s)
    logged_s = np.arange(0, node.size, every) * fine_step_s
    phase_s = float(rng.uniform(0.0, CONVERSION_PERIOD_S))
    number = np.floor((logged_s + CONVERSION_PERIOD_S - phase_s) / CONVERSION_PERIOD_S)
    ready_s = (number - 1.0) * CONVERSION_PERIOD_S + phase_s
    fine_s = np.arange(node.size) * fine_step_s
    converted = np.interp(ready_s, fine_s, package) + offset
    kicks = THERMOMETER_NOISE * rng.standard_normal(int(number[-1]) + 1)
    noisy = converted + kicks[number.astype(np.intp)]
    return np.asarray(np.round(noisy / TEMPERATURE_LSB) * TEMPERATURE_LSB)


@dataclass(frozen=True)
class Reference:
    """The capacitive sensor beside the foot."""

    gain: Array
    """[6]."""
    noise: Array
    """[6] RMS in the outputs' units."""

    def read(self, load: Array, rng: np.random.Generator) -> Array:
        """Return what it shows of the load [n, 6]."""
        return self.gain * load + self.noise * rng.standard_normal(load.shape)


def draw_reference(seed: int | None) -> Reference:
    """Draw the reference sensor that belongs to a specimen's bench."""
    gain = np.ones(len(OUTPUTS))
    if seed is not None:
        rng = draw_stream(seed, "six axis", "reference sensor")
        gain = 1.0 + 0.01 * REFERENCE_GAIN_PERCENT * rng.standard_normal(len(OUTPUTS))
    return Reference(gain, REFERENCE_NOISE * np.ones_like(FULL_SCALE))
