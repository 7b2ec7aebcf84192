"""The logger: what its instruments report of a run, rounded as it writes it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.conditions import Conditions
from zerodrift_lab.twin.noise import convert, report_temperature
from zerodrift_lab.twin.recipe import Recipe
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS, draw_stream

Array = NDArray[np.float64]

TARE_S = 10.0
"""A log that is tared is zeroed over its first ten seconds, which are unloaded."""


@dataclass(frozen=True)
class SimulatedRun:
    """One run as its log shows it, and the truth beside it. Arrays are [n] or [n, 6]."""

    name: str
    """Also the file's stem."""
    use: str
    """train | test | dwell."""
    time_s: Array
    """Since power-on; a warmed-up run was powered on two hours before."""
    temperature_degC: Array
    """What the chip's thermometer reported."""
    measured: Array
    reference: Array
    channels: Mapping[str, Array]
    """The other channels that are logged, by the name that effects use."""
    drift: Array
    """Truth: what all effects add, before noise and converter, with the tare taken off."""
    hidden_drift: Array
    """Truth: the part of it that would not be there without the hidden effects."""
    noise: Array
    """Truth: noise before the converter's steps."""
    tare: Array
    """Truth [6]: what zeroing took off."""


#: Channel -> noise RMS and decimals of its instrument.
INSTRUMENTS = {
    "supply": (0.0005, 4),
    "humidity": (0.05, 2),
    "ambient_light": (0.5, 1),
    "acceleration_x": (0.01, 3),
    "acceleration_y": (0.01, 3),
    "acceleration_z": (0.01, 3),
    "clock": (0.0, 3),
}


def sense_channel(run: Conditions, name: str) -> Array:
    """Return the true value [n] of a channel."""
    if name.startswith("acceleration_"):
        return run.acceleration[:, "xyz".index(name[-1])]
    if name == "humidity":
        return run.sample(run.fine_humidity)
    return {"supply": run.supply, "ambient_light": run.ambient_light, "clock": run.clock_s}[name]


def report_channel(run: Conditions, name: str) -> Array:
    """Return what a channel's instrument reports [n], with a little noise of its own."""
    if name == "body_temperature":
        body = run.sample(run.heat.body)
        return np.round(report_temperature(body, run.seed, f"body {run.name}"), 4)
    rms, decimals = INSTRUMENTS[name]
    rng = draw_stream(run.seed, "channel", name, run.name)
    noisy = sense_channel(run, name) + rms * rng.standard_normal(run.time_s.size)
    # No instrument here shows less than nothing, but for the accelerometer.
    shown = noisy if name.startswith("acceleration_") else np.maximum(noisy, 0.0)
    return np.round(shown, decimals) + 0.0


#: Decimals that the logger writes, by the outputs' unit.
DECIMALS = {"N": 3, "Nm": 4}


def round_as_logged(values: Array) -> Array:
    """Return the outputs [n, 6] with the logger's decimals."""
    return np.stack(
        [np.round(values[:, k], DECIMALS[unit]) + 0.0 for k, unit in enumerate(UNITS)], axis=1
    )


def clip_drift(drift: Array, load: Array, rails: Array | None) -> Array:
    """Return the drift [n, 6] as it is once load and drift together meet the rails [6]."""
    if rails is None:
        return drift
    total = load + drift
    return drift + (np.clip(total, -rails, rails) - total)


def log_run(
    run: Conditions,
    recipe: Recipe,
    drift: Array,
    told_drift: Array,
    noise: Array,
    rails: Array | None,
    told_rails: Array | None,
) -> SimulatedRun:
    """Return what the logger writes of one run.

    `drift` is what all effects add [n, 6], `told_drift` what the told ones alone would, both
    before the rails [6] or None of the converter, and `noise` [n, 6] adds to them.
    """
    signal = run.load + drift + noise
    converted = convert(signal if rails is None else np.clip(signal, -rails, rails))
    zeroed = max(1, round(TARE_S / recipe.sample_period_s))
    tare = np.zeros(len(OUTPUTS))
    if recipe.tare == "start":
        tare = converted[:zeroed].mean(axis=0)
    clipped = clip_drift(drift, run.load, rails)
    return SimulatedRun(
        name=run.name,
        use=run.use,
        time_s=run.powered_s,
        temperature_degC=np.round(report_temperature(run.chip, run.seed, run.name), 4),
        measured=round_as_logged(converted - tare),
        reference=round_as_logged(run.load),
        channels={name: report_channel(run, name) for name in recipe.channels},
        drift=clipped - tare,
        hidden_drift=clipped - clip_drift(told_drift, run.load, told_rails),
        noise=noise,
        tare=tare,
    )
