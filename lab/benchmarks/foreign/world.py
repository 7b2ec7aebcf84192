"""Courses of temperature, load and channels over time, and noise; nothing knows of an effect."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
Rng = np.random.Generator
OVERSAMPLING = 20
"""Integration steps per logged sample."""
TEMPERATURES = ("ramps", "steps", "soak", "day", "bursts", "walk")
LOADS = ("weights", "stairs", "sway", "random")


@dataclass(frozen=True, eq=False)
class Run:
    """One run on the fine grid: time, s, and temperature, degC [m], loads [m, K], channels [m].

    Time is 0 at the first logged sample, where power comes on; what is before is history that the
    log does not show. `start_s` is the absolute time of that sample.
    """

    name: str
    time_s: Array
    temperature_degC: Array
    loads: Array
    channels: dict[str, Array]
    start_s: float
    stride: int = OVERSAMPLING

    def logged(self, fine: Array) -> Array:
        """Take the logged samples [n, ...] out of a course on the fine grid [m, ...]."""
        return fine[int(np.searchsorted(self.time_s, -1e-9)) :: self.stride]

    def as_logged(self, lsb_degC: float) -> "Run":
        """All that the log tells of this run: no history, a rounded temperature."""
        heat = np.round(self.logged(self.temperature_degC) / lsb_degC) * lsb_degC
        told = {name: self.logged(course) for name, course in self.channels.items()}
        time, loads = self.logged(self.time_s), self.logged(self.loads)
        return Run(self.name, time, heat, loads, told, self.start_s, 1)


def low_pass(course: Array, tau: float, step: float) -> Array:
    """Follow a course [m] with a time constant by the trapezoidal rule, at rest at its start."""
    a = step / (2 * tau)
    moved = lfilter([a / (1 + a)] * 2, [1, -(1 - a) / (1 + a)], course - course[0])
    return np.asarray(course[0] + moved)


def _holds(rng: Rng, share: Array, levels: Array, ramp: tuple[float, float]) -> Array:
    """Go from level to level; each ramp takes a share within `ramp` of its slot, then it holds."""
    cuts = [*np.sort(rng.uniform(0.04, 0.96, len(levels) - 1)), 1.0]
    ends = [cut + rng.uniform(*ramp) * (cuts[i + 1] - cut) for i, cut in enumerate(cuts[:-1])]
    knots = np.column_stack([cuts[:-1], ends]).ravel()
    return np.interp(share, [0, *knots], np.repeat(levels, 2)[:-1])


def _wander(rng: Rng, count: int, memory: float) -> Array:
    """Smooth random course [m] of unit range, with a memory in steps."""
    course = low_pass(low_pass(rng.standard_normal(count), memory, 1), memory / 5, 1)
    return np.asarray((course - course.mean()) / np.ptp(course))


def temperature(rng: Rng, kind: str, count: int, low: float, high: float) -> Array:
    """Course [m] between low and high of one of TEMPERATURES."""
    share = np.linspace(0, 1, count)
    levels = rng.uniform(low, high, int(rng.integers(3, 7)))
    if kind == "ramps":
        return low_pass(_holds(rng, share, levels, (0.3, 0.9)), 0.006, 1 / count)
    if kind == "steps":
        return low_pass(_holds(rng, share, levels, (0.01, 0.05)), 0.04, 1 / count)
    if kind == "soak":
        there = np.array([levels[0], (low, high)[int(rng.integers(2))], levels[0]])
        return low_pass(_holds(rng, share, there, (0.2, 0.5)), 0.01, 1 / count)
    if kind == "day":
        phase = 2 * np.pi * (rng.uniform() + rng.uniform(0.7, 2.2) * share)
        wave = np.sin(phase) + 0.3 * np.sin(2 * phase + 1) + 0.5 * _wander(rng, count, 0.05 * count)
        return np.asarray((low + high) / 2 + (high - low) / 2 * wave / np.abs(wave).max())
    if kind == "bursts":
        begins = rng.uniform(0.05, 0.8, int(rng.integers(1, 4)))
        heat = np.sum([(share > begin) & (share < begin + 0.08) for begin in begins], 0) * 1.0
        wave = low_pass(low_pass(heat, rng.uniform(0.08, 0.2), 1 / count), 0.01, 1 / count)
        return np.asarray(low + (high - low) * wave / wave.max())
    return (low + high) / 2 + (high - low) * _wander(rng, count, rng.uniform(0.08, 0.2) * count)


def load(rng: Rng, kind: str, share: Array) -> Array:
    """Course [m] up to +-1 of one of LOADS, over the share of the run; zero for a twelfth."""
    if kind == "weights":
        levels = np.concatenate([[0], rng.uniform(-1, 1, int(rng.integers(3, 8)))])
        levels[2::3] = 0
        course = _holds(rng, share, levels, (0.01, 0.1))
    elif kind == "stairs":
        up = np.linspace(0, rng.choice([-1, 1]) * rng.uniform(0.5, 1), int(rng.integers(4, 7)))
        course = _holds(rng, share, np.concatenate([up, up[-2::-1]]), (0.02, 0.3))
    elif kind == "sway":
        course = np.sin(2 * np.pi * share * rng.uniform(2, 9)) * rng.uniform(0.4, 1)
    else:
        course = 1.6 * _wander(rng, len(share), rng.uniform(0.01, 0.05) * len(share))
    return np.asarray(course * np.clip((share - 1 / 12) * 40, 0, 1))


def channels(rng: Rng, share: Array) -> dict[str, Array]:
    """Courses [m] of supply V, humidity %, light lux, acceleration m/s2; none follows another."""

    def steps(fastest: float) -> Array:
        return _holds(rng, share, rng.uniform(0, 1, int(rng.integers(4, 9))), (fastest, 0.2))

    count = len(share)
    made = {
        "supply": 11.4 + 1.5 * steps(0.01) + 0.1 * _wander(rng, count, count / 60),
        "humidity": 25 + 55 * steps(0.01),
        "ambient_light": 20 + 1500 * np.round(steps(0.002)) + 60 * steps(0.01),
    }
    for axis in "xyz":
        turned = steps(0.02) + 0.1 * _wander(rng, count, count / 80)
        made[f"acceleration_{axis}"] = 9.81 * np.sin(2 * np.pi * turned)
    return made


def noise(rng: Rng, kind: str, count: int, memory: float) -> Array:
    """Noise [count] of unit RMS in expectation: white, pink, or ar with a memory in samples."""
    rough = rng.standard_normal(32768)
    if kind == "pink":
        shape = np.append(0, np.arange(1, 16385) ** -0.5)
        rough = np.fft.irfft(np.fft.rfft(rough) * shape) / np.sqrt(np.mean(shape**2))
    elif kind == "ar":
        decay = np.exp(-1 / memory)
        slow = lfilter([np.sqrt(1 - decay**2)], [1, -decay], rng.standard_normal(32768))
        rough = 0.8 * rough + 0.6 * slow
    return np.asarray(rough[-count:])
