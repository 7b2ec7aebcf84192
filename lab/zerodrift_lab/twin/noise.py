"""What the electronics add: coloured noise, and the steps of the converters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from zerodrift_lab.twin.sensor import OUTPUT_LSB, OUTPUTS, TEMPERATURE_LSB, draw_stream

Array = NDArray[np.float64]

#: Relaxation times, two octaves apart, whose equal shares add up to a spectrum of about 1/f.
FLICKER_TAUS_S = (2.0, 8.0, 32.0, 128.0, 512.0, 2048.0)

TEMPERATURE_NOISE = 0.4 * TEMPERATURE_LSB
"""degC RMS of the thermometer before its converter."""


@dataclass(frozen=True)
class Noise:
    """The noise of one sensor, as RMS per output in its unit."""

    white: Array
    """[K] independent from sample to sample."""
    coloured: Array
    """[K] of first order with `coloured_tau_s`."""
    coloured_tau_s: float
    flicker: Array
    """[K] about 1/f."""

    @property
    def rms(self) -> Array:
        """[K] all of it together, the converter's steps included."""
        quantisation = OUTPUT_LSB**2 / 12.0
        total: Array = np.sqrt(self.white**2 + self.coloured**2 + self.flicker**2 + quantisation)
        return total


def draw_noise(seed: int, factor: float) -> Noise:
    """Draw the noise of the sensor with this seed; `factor` multiplies all but the steps."""
    rng = draw_stream(seed, "noise level")
    spread = np.exp(rng.normal(0.0, 0.15, (3, len(OUTPUTS))))
    level = factor * OUTPUT_LSB * spread
    return Noise(
        white=0.75 * level[0],
        coloured=0.45 * level[1],
        coloured_tau_s=float(rng.uniform(3.0, 15.0)),
        flicker=0.45 * level[2],
    )


def make_coloured(
    rng: np.random.Generator, shape: tuple[int, int], tau_s: float, dt: float
) -> Array:
    """Return stationary noise [n, K] of unit RMS whose correlation falls as exp(-t/tau)."""
    decay = float(np.exp(-dt / tau_s))
    kick = np.sqrt(1.0 - decay**2) * rng.standard_normal(shape)
    start = rng.standard_normal(shape[1])
    kick[0] = start
    noise = lfilter([1.0], [1.0, -decay], kick, axis=0)
    return np.asarray(noise, dtype=np.float64)


def make_noise(noise: Noise, seed: int, run: str, count: int, sample_period_s: float) -> Array:
    """Return the noise [n, K] of one run, before the converter's steps."""
    rng = draw_stream(seed, "noise", run)
    shape = (count, len(OUTPUTS))
    total = noise.white * rng.standard_normal(shape)
    total += noise.coloured * make_coloured(rng, shape, noise.coloured_tau_s, sample_period_s)
    share = noise.flicker / np.sqrt(len(FLICKER_TAUS_S))
    for tau_s in FLICKER_TAUS_S:
        total += share * make_coloured(rng, shape, tau_s, sample_period_s)
    return total


def report_temperature(chip: Array, seed: int, run: str) -> Array:
    """Return what the thermometer reports, in degC, for the board's temperature [n] in degC."""
    noisy = chip + TEMPERATURE_NOISE * draw_stream(seed, "thermometer", run).standard_normal(
        chip.size
    )
    return np.round(noisy / TEMPERATURE_LSB) * TEMPERATURE_LSB


def convert(signal: Array) -> Array:
    """Return the signal [n, K] in whole counts of the 14-bit converter, in each output's unit."""
    return np.round(signal / OUTPUT_LSB) * OUTPUT_LSB
