"""A small simulated sensor of its own: no numerical code shared with what it tests."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset, Run

OUTPUTS, UNITS, FULL_SCALE = ("Fz", "Mx"), ("N", "Nm"), (2000.0, 14.0)
STEP_S = 2.0
NOISE = np.array([0.5, 0.004])
SLOPE = np.array([1.2, 0.01])


@dataclass(frozen=True)
class Bench:
    """Where a simulated run's disturbance comes from: everything that happened in it."""

    time_s: np.ndarray
    temperature: np.ndarray
    load: np.ndarray
    supply: np.ndarray
    rng: np.random.Generator


def draw_bench(seed, length, span=25.0):
    """Draw one run: temperature between random knots, a stepped load, a wavering supply."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(length) * STEP_S
    knots = np.sort(rng.uniform(0.0, time_s[-1], 6))
    levels = rng.uniform(25.0 - span, 25.0 + span, 6)
    temperature = np.interp(time_s, knots, levels) + 0.002 * rng.normal(size=length)
    edges = np.sort(rng.integers(0, length, 5))
    steps = rng.uniform(-1.0, 1.0, (5, 2)) * np.array([600.0, 5.0])
    load = np.zeros((length, 2))
    for edge, step in zip(edges, steps, strict=True):
        load[edge:] = step
    load[:10] = 0.0
    supply = 5.0 + 0.05 * np.sign(np.sin(time_s / rng.uniform(40.0, 90.0)))
    return Bench(time_s, temperature, load, supply, rng)


def follow(x, tau_s, finer=10):
    """First-order lag by small explicit steps."""
    fine = np.interp(np.arange(x.size * finer) / finer, np.arange(x.size), x).tolist()
    share, now, y = STEP_S / finer / tau_s, fine[0], []
    for value in fine:
        now += share * (value - now)
        y.append(now)
    return np.array(y[::finer])


def draw_noise(rng, length, scale=1.0):
    """White noise, and as much of noise with a memory of twenty steps."""
    white, kick = rng.normal(size=(length, 2)), rng.normal(size=(length, 2))
    # A sum over the last hundred kicks, each weighing 5 % less than the next.
    weights = np.sqrt(1 - 0.95**2) * 0.95 ** np.arange(100)
    coloured = np.stack([np.convolve(column, weights)[:length] for column in kick.T], axis=1)
    return scale * NOISE * (white + coloured) / np.sqrt(2.0)


def make_dataset(
    disturb, *, runs=8, length=900, seed=0, tared=True, dwell=True, inputs=("supply",), noise=1.0
):
    """Return simulated runs whose drift is what `disturb(bench)` gives, [n, 2], plus noise."""

    def record(name, bench, drift):
        offset = bench.rng.normal(size=2) * 20 * NOISE if tared else np.zeros(2)
        measured = bench.load + drift + offset + draw_noise(bench.rng, bench.time_s.size, noise)
        channels = {"supply": bench.supply, "humidity": 50.0 + 0.0 * bench.supply}
        return Run(
            name=name,
            group=name,
            part=0,
            source=Path(f"{name}.csv"),
            sample_period_s=STEP_S,
            time_s=bench.time_s,
            temperature_degC=np.round(bench.temperature / 0.0078125) * 0.0078125,
            measured=measured,
            reference=bench.load,
            inputs={key: channels[key] for key in inputs},
        )

    train = []
    for i in range(runs):
        bench = draw_bench(1000 * seed + i, length)
        train.append(record(f"run_{i}", bench, disturb(bench)))
    still = draw_bench(1000 * seed + 999, length, span=0.0)
    still = Bench(
        still.time_s, still.temperature, 0.0 * still.load, 5.0 + 0 * still.supply, still.rng
    )
    quiet = (record("dwell", still, disturb(still)),) if dwell else ()
    return Dataset(tuple(train), (), quiet, OUTPUTS, UNITS, FULL_SCALE)


def linear(bench):
    """A linear zero shift, with which the others are added."""
    return (bench.temperature - 25.0)[:, None] * SLOPE


@pytest.fixture
def tempco():
    """A model that knows the zero shift alone."""
    return [EffectConfig("zero_tempco")]
