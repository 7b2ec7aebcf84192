"""What is done to the sensor as functions of continuous time: steps, ramps, gait, shaking.

Each programme gives its value at any instant, and loads their exact time derivative too, so
nothing here depends on a grid.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Programme(Protocol):
    """A quantity as a function of time."""

    def evaluate(self, time_s: Array) -> Array:
        """Return the value at each instant."""
        ...

    def differentiate(self, time_s: Array) -> Array:
        """Return the time derivative at each instant, per second."""
        ...


@dataclass(frozen=True)
class Steps:
    """Holds a level, then moves smoothly (a raised cosine of `rise_s`) to the next one."""

    start: float
    times_s: Array
    """[m] when each move begins, at least `rise_s` apart."""
    levels: Array
    """[m] the level that each move ends on."""
    rise_s: float

    def _locate(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Return, at each instant, the level before the last move, the level after, its share."""
        before = np.concatenate([[self.start, self.start], self.levels[:-1]])
        after = np.concatenate([[self.start], self.levels])
        begin = np.concatenate([[-np.inf], self.times_s])
        index = np.searchsorted(self.times_s, time_s, side="right")
        share = np.clip((time_s - begin[index]) / self.rise_s, 0.0, 1.0)
        return before[: after.size][index], after[index], share

    def evaluate(self, time_s: Array) -> Array:
        """Return the level at each instant."""
        before, after, share = self._locate(time_s)
        return before + (after - before) * 0.5 * (1.0 - np.cos(np.pi * share))

    def differentiate(self, time_s: Array) -> Array:
        """Return the derivative at each instant, per second."""
        before, after, share = self._locate(time_s)
        slope: Array = (after - before) * 0.5 * np.pi / self.rise_s * np.sin(np.pi * share)
        return slope


def hold(level: float) -> Steps:
    """Return a programme that never moves."""
    return Steps(level, np.empty(0), np.empty(0), 1.0)


@dataclass(frozen=True)
class Ramps:
    """Straight lines between knots, held before the first and after the last."""

    times_s: Array
    levels: Array

    def evaluate(self, time_s: Array) -> Array:
        """Return the level at each instant."""
        return np.interp(time_s, self.times_s, self.levels)

    def differentiate(self, time_s: Array) -> Array:
        """Return the slope at each instant, per second."""
        slopes = np.concatenate([[0.0], np.diff(self.levels) / np.diff(self.times_s), [0.0]])
        return slopes[np.searchsorted(self.times_s, time_s, side="right")]


@dataclass(frozen=True)
class Following:
    """What lies in the air with a heat capacity of its own: the air, followed within `tau_s`."""

    air: Ramps
    tau_s: float
    share: float
    """1: follows wholly; less: a poor contact that is partly at the air's own temperature."""

    def _solve(self, time_s: Array) -> Array:
        """Return the followed temperature, exactly: each straight piece has a closed form."""
        times_s = np.append(self.air.times_s, np.inf)
        slopes = np.append(np.diff(self.air.levels) / np.diff(self.air.times_s), 0.0)
        value = np.empty_like(time_s)
        behind = 0.0
        for j, slope in enumerate(slopes.tolist()):
            settled = -slope * self.tau_s
            inside = (time_s >= times_s[j]) & (time_s < times_s[j + 1])
            decay = np.exp(-(time_s[inside] - times_s[j]) / self.tau_s)
            value[inside] = settled + (behind - settled) * decay
            behind = settled + (behind - settled) * float(
                np.exp(-(times_s[j + 1] - times_s[j]) / self.tau_s)
            )
        return value

    def evaluate(self, time_s: Array) -> Array:
        """Return the temperature at each instant."""
        return self.air.evaluate(time_s) + self.share * self._solve(time_s)

    def differentiate(self, time_s: Array) -> Array:
        """Return the derivative at each instant, per second."""
        slope = self.air.differentiate(time_s)
        return slope - self.share * (slope + self._solve(time_s) / self.tau_s)


@dataclass(frozen=True)
class Sum:
    """Programmes that add up."""

    parts: tuple[Programme, ...]

    def evaluate(self, time_s: Array) -> Array:
        """Return the sum at each instant."""
        return sum((part.evaluate(time_s) for part in self.parts), np.zeros_like(time_s))

    def differentiate(self, time_s: Array) -> Array:
        """Return the derivative at each instant, per second."""
        return sum((part.differentiate(time_s) for part in self.parts), np.zeros_like(time_s))


@dataclass(frozen=True)
class Gait:
    """Stance after stance of one walking foot, between `begin_s` and `end_s`."""

    begin_s: float
    end_s: float
    stride_s: float
    duty: float
    """Share of the stride that the foot is on the ground."""
    amplitude: float
    """Peak of the stance, in the output's unit."""
    skew: float
    """-1..1: how much of it pushes first and pulls then, as shear does, rather than presses."""

    def _phase(self, time_s: Array) -> tuple[Array, Array]:
        """Return the phase in the stance (0..1) and whether the foot is down."""
        elapsed = time_s - self.begin_s
        strides = np.floor((self.end_s - self.begin_s) / self.stride_s)
        number = np.floor(elapsed / self.stride_s)
        phase = (elapsed / self.stride_s - number) / self.duty
        down = (number >= 0) & (number < strides) & (phase < 1.0)
        return phase, down.astype(np.float64)

    def evaluate(self, time_s: Array) -> Array:
        """Return the load at each instant; value and slope are continuous at both ends."""
        phase, down = self._phase(time_s)
        press = np.sin(np.pi * phase) ** 2
        shear = np.sin(2.0 * np.pi * phase) * press
        value: Array = down * self.amplitude * ((1.0 - abs(self.skew)) * press + self.skew * shear)
        return value

    def differentiate(self, time_s: Array) -> Array:
        """Return the load's derivative at each instant, per second."""
        phase, down = self._phase(time_s)
        angle = np.pi * phase
        press = np.sin(2.0 * angle)
        shear = 2.0 * np.cos(2.0 * angle) * np.sin(angle) ** 2 + np.sin(2.0 * angle) ** 2
        slope = (1.0 - abs(self.skew)) * press + self.skew * shear
        rate: Array = down * self.amplitude * slope * np.pi / (self.stride_s * self.duty)
        return rate


@dataclass(frozen=True)
class Shaking:
    """Bursts of a sine, each smoothly begun and ended."""

    times_s: Array
    """[m] when each burst begins."""
    lasts_s: float
    amplitudes: Array
    """[m]."""
    frequencies_hz: Array
    """[m]."""

    def evaluate(self, time_s: Array) -> Array:
        """Return the value at each instant."""
        value = np.zeros_like(time_s)
        for begin_s, amplitude, frequency_hz in zip(
            self.times_s, self.amplitudes, self.frequencies_hz, strict=True
        ):
            inside = (time_s >= begin_s) & (time_s < begin_s + self.lasts_s)
            elapsed = time_s[inside] - begin_s
            window = np.sin(np.pi * elapsed / self.lasts_s) ** 2
            value[inside] += amplitude * window * np.sin(2.0 * np.pi * frequency_hz * elapsed)
        return value

    def differentiate(self, time_s: Array) -> Array:
        """Return the derivative at each instant, by a central difference of a microsecond."""
        half_s = 5e-7
        return (self.evaluate(time_s + half_s) - self.evaluate(time_s - half_s)) / (2.0 * half_s)


def draw_steps(
    rng: np.random.Generator,
    duration_s: float,
    start: float,
    draw_range: tuple[float, float],
    dwell_range_s: tuple[float, float],
    rise_s: float,
    rest_s: float = 60.0,
) -> Steps:
    """Draw a step-and-hold programme that rests at `start` for `rest_s` first.

    Levels are drawn from `draw_range`, the time between moves from `dwell_range_s`. Now and then a
    level is `start` again, since recovery tells more than loading alone, or within 2 % of an end
    of the range, since the heaviest weight of a set is the same in every run.
    """
    times_s: list[float] = []
    levels: list[float] = []
    now_s = rest_s + float(rng.uniform(0.0, 0.5)) * dwell_range_s[1]
    while now_s < duration_s:
        times_s.append(now_s)
        back = bool(levels) and levels[-1] != start and rng.random() < 0.4
        place = float(rng.uniform()) if rng.random() < 0.65 else float(rng.choice([0.0, 1.0]))
        place = 0.02 * float(rng.uniform()) + 0.98 * place
        level = draw_range[0] + place * (draw_range[1] - draw_range[0])
        levels.append(start if back else level)
        now_s += rise_s + float(rng.uniform(*dwell_range_s))
    return Steps(start, np.array(times_s), np.array(levels), rise_s)
