"""Noise of a channel: white, flicker, random walk, converter steps, wild rows, lost rows.

Source: Kasdin, Proc. IEEE 83 (1995) 802 (power laws); IEEE Std 952 (angle random walk, bias
instability, rate random walk); IEEE Std 1241 (quantization: step^2 / 12).
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.third_simulator.heat import Array, Flags

KINDS = ("white", "flicker", "walk", "mixed", "coarse")
"""coarse: white noise of a third of the converter's step."""
SHARES = {
    "white": (1.0, 0.0, 0.0),
    "flicker": (0.5, 0.5, 0.0),
    "walk": (0.7, 0.0, 0.3),
    "mixed": (0.5, 0.3, 0.2),
    "coarse": (1.0, 0.0, 0.0),
}
"""Of the noise's power over a run: white, flicker, random walk."""


def draw_flicker(rng: np.random.Generator, rows: int) -> Array:
    """Return noise whose power falls as 1/f, RMS 1 over `rows` on average, shape (rows,)."""
    size = 2 * rows
    frequencies = np.fft.rfftfreq(size)[1:]
    amplitude = np.concatenate([[0.0], frequencies**-0.5])
    phases = rng.standard_normal(amplitude.size) + 1j * rng.standard_normal(amplitude.size)
    found: Array = np.fft.irfft(amplitude * phases, size)[:rows]
    power = 4.0 * np.sum(amplitude**2) / size**2
    found /= np.sqrt(power)
    return found


def draw_walk(rng: np.random.Generator, rows: int) -> Array:
    """Return a random walk, RMS 1 about its mean over `rows` on average, shape (rows,)."""
    walk: Array = np.cumsum(rng.standard_normal(rows))
    walk -= walk.mean()
    walk /= np.sqrt(rows / 6.0)
    return walk


def draw_noise(rng: np.random.Generator, rows: int, kind: str) -> Array:
    """Return noise of RMS 1 on average over a run, shape (rows,)."""
    white, flicker, walk = SHARES[kind]
    found: Array = np.sqrt(white) * rng.standard_normal(rows)
    if flicker:
        found += np.sqrt(flicker) * draw_flicker(rng, rows)
    if walk:
        found += np.sqrt(walk) * draw_walk(rng, rows)
    return found


@dataclass(frozen=True)
class Recorder:
    """How rows are taken and what the converter does to them.

    Attributes:
        kind: one of `KINDS`.
        sigma: RMS of the channel's noise, in its unit.
        lsb: the converter's step, in the same unit.
        reference_sigma: RMS of the reference's noise; 0 without a reference.
        jitter: of the time between two rows, half the range in which a row's time lies.
        lost: share of rows that are lost one by one.
        gaps: stretches of rows lost together, per run at most.
        outliers: share of rows that are wild, by 15 to 60 sigma.
    """

    kind: str
    sigma: float
    lsb: float
    reference_sigma: float
    jitter: float
    lost: float
    gaps: int
    outliers: float

    @property
    def expected_rms(self) -> float:
        """RMS of measured less reference less drift that is to be expected, wild rows apart."""
        return float(np.sqrt(self.sigma**2 + self.reference_sigma**2 + self.lsb**2 / 12.0))

    def take_rows(
        self, rng: np.random.Generator, seconds: float, period_s: float
    ) -> tuple[Array, Flags]:
        """Return the times of all rows, s, to the millisecond, rising, and which are kept."""
        rows = int(seconds / period_s)
        times = (np.arange(rows) + 0.5) * period_s
        times += rng.uniform(-self.jitter, self.jitter, rows) * period_s
        keep = rng.random(rows) >= self.lost
        for _ in range(int(rng.integers(0, self.gaps + 1))):
            first = int(rng.integers(rows // 10, rows - rows // 10))
            keep[first : first + int(rng.integers(4, 40))] = False
        return np.round(times, 3), keep

    def spoil(self, rng: np.random.Generator, value: Array) -> tuple[Array, Flags]:
        """Return what the converter gives for `value`, and which rows are wild; shape (rows,)."""
        noisy = value + self.sigma * draw_noise(rng, value.size, self.kind)
        wild = rng.random(value.size) < self.outliers
        size = rng.uniform(15.0, 60.0, value.size) * rng.choice([-1.0, 1.0], value.size)
        noisy = noisy + np.where(wild, size * self.sigma, 0.0)
        return np.round(noisy / self.lsb) * self.lsb, wild
