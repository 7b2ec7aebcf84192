"""One run of one specimen: what its converter, thermometers and reference show, and the truth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift_lab.twin.logger import INSTRUMENTS, round_as_logged
from zerodrift_lab.twin.sensor import OUTPUTS
from zerodrift_lab.twin.six_axis.effects import add_effects, clip_codes, feel
from zerodrift_lab.twin.six_axis.electronics import (
    make_noise,
    read_thermometer,
    round_codes,
)
from zerodrift_lab.twin.six_axis.heat import NODE, warm
from zerodrift_lab.twin.six_axis.protocol import Protocol
from zerodrift_lab.twin.six_axis.specimen import Sensor
from zerodrift_lab.twin.six_axis.timeline import TICK_S, Timeline, draw_timeline

Array = NDArray[np.float64]

TARES = ("none", "start")
TARE_S = 10.0
MOST_SAMPLES = 5_000_000
STRIDE_STEP_S = 0.01
"""Longest step where an effect follows the load through strides."""
LOAD_MEMORY = ("creep", "load_hysteresis")


@dataclass(frozen=True)
class Recording:
    """One run as its log shows it, and the truth beside it. Arrays are [n], [n, 6] or [6]."""

    name: str
    """Also the file's stem."""
    protocol: str
    sensor: str
    sample_period_s: float
    time_s: Array
    temperature_degC: Array
    """What the TMP117 on the board reported."""
    body_temperature_degC: Array
    """What a second TMP117 on the elastic body reported; logged on request."""
    adc: NDArray[np.int32]
    """[n, 6] the converter's codes."""
    measured: Array
    """[n, 6] raw forces and moments by the calibration matrix, with the logger's decimals."""
    reference: Array
    """[n, 6] test weights, or what the capacitive sensor showed."""
    channels: Mapping[str, Array]
    """supply, humidity, ambient_light, acceleration_x, _y, _z, clock as their instruments show."""
    load: Array
    """Truth: what acted on the sensor."""
    drift: Array
    """Truth: what a sensor without noise would show beyond the load."""
    noise: Array
    """Truth: what noise, steps and rails of the converter added."""
    floor: Array
    """[6] RMS error of a model that predicts `drift` exactly, against `reference`."""
    nodes: Array
    """Truth [n, 13]: temperatures of the thermal nodes, degC."""

    @property
    def seconds(self) -> float:
        """How long the run lasts."""
        return float(self.time_s[-1] - self.time_s[0])


def _choose_steps(timeline: Timeline, sensor: Sensor, period_s: float, finer: int) -> int:
    """Return the integration steps per logged sample."""
    longest_s = TICK_S
    if timeline.striding and any(hidden.name in LOAD_MEMORY for hidden in sensor.effects):
        longest_s = STRIDE_STEP_S
    return finer * max(1, int(np.ceil(period_s / longest_s - 1e-9)))


def _show_channel(name: str, true: Array, rng: np.random.Generator) -> Array:
    rms, decimals = INSTRUMENTS[name]
    noisy = true + rms * rng.standard_normal(true.size)
    shown = noisy if name.startswith("acceleration_") else np.maximum(noisy, 0.0)
    return np.round(shown, decimals) + 0.0


def _show_channels(timeline: Timeline, time_s: Array, sensor: Sensor, key: str) -> dict[str, Array]:
    true = {
        "supply": timeline.supply.evaluate(time_s),
        "humidity": timeline.humidity.evaluate(time_s),
        "ambient_light": timeline.light.evaluate(time_s),
    }
    for axis, programme in zip("xyz", timeline.acceleration, strict=True):
        true[f"acceleration_{axis}"] = programme.evaluate(time_s)
    return {
        name: _show_channel(name, values, sensor.stream("channel", name, key))
        for name, values in true.items()
    }


def record(
    sensor: Sensor,
    protocol: Protocol,
    name: str = "",
    seed: int = 0,
    period_s: float = 1.0,
    *,
    tare: str = "none",
    clock_start_s: float = 0.0,
    finer: int = 1,
) -> Recording:
    """Return one run of a specimen.

    Args:
        sensor: the specimen.
        protocol: what is done to it; ranges are drawn from `name` and `seed`.
        name: name of the run; left out, the protocol's with `_1`.
        seed: decides the draws of this run, its noise included.
        period_s: seconds per logged sample.
        tare: `start` zeroes the outputs over their first ten seconds.
        clock_start_s: absolute time at the first sample, for ageing.
        finer: factor on the integration steps, to check that they are fine enough.

    Raises:
        InputError: the protocol cannot be done, or a value is out of range.

    Limits: an hour at 10 Hz takes some tenths of a second.
    """
    name = name or f"{protocol.name}_1"
    if not 0.001 <= period_s <= 60.0:
        raise InputError(f"twin: sample period is {period_s:g} s; expected 0.001 to 60 s.")
    if tare not in TARES:
        raise InputError(f"twin: tare is '{tare}'; expected {' or '.join(TARES)}.")
    key = f"{name} {seed}"
    timeline = draw_timeline(protocol, sensor.stream("protocol", key), sensor.network)
    count = int(np.floor(timeline.duration_s / period_s + 1e-9)) + 1
    if not 2 <= count <= MOST_SAMPLES:
        raise InputError(
            f"{protocol.where}: {timeline.duration_s:g} s at {period_s:g} s per sample are {count} "
            f"samples; expected 2 to {MOST_SAMPLES}."
        )
    every = _choose_steps(timeline, sensor, period_s, finer)
    step_s = period_s / every
    fine_nodes = warm(sensor.network, timeline.surround(step_s, (count - 1) * every + 1))
    time_s = np.round(np.arange(count) * period_s, 6)
    load = np.stack([axis.evaluate(time_s) for axis in timeline.load], axis=1)

    nodes = fine_nodes[::every]
    felt = feel(sensor.effects, fine_nodes, step_s, every)
    clean = sensor.sense(load, felt)
    clean = clean + add_effects(
        sensor, timeline, key, fine_nodes, felt, every, period_s, clock_start_s
    )
    noisy = clean + make_noise(sensor.noise, sensor.stream("noise", key), count, period_s)
    adc = round_codes(clip_codes(sensor.effects, noisy))
    raw, ideal = (
        sensor.to_load(adc.astype(np.float64)),
        sensor.to_load(clip_codes(sensor.effects, clean)),
    )

    reference = load
    if timeline.reference == "capacitive":
        reference = sensor.reference.read(load, sensor.stream("reference", key))
    zeroed = max(1, round(TARE_S / period_s))
    zero = raw[:zeroed].mean(axis=0) if tare == "start" else np.zeros(len(OUTPUTS))
    measured, shown = round_as_logged(raw - zero), round_as_logged(reference)
    drift = ideal - load - zero
    channels = _show_channels(timeline, time_s, sensor, key)
    channels["clock"] = np.round(clock_start_s + time_s, 3)
    body = read_thermometer(
        fine_nodes[:, NODE["beams"]],
        step_s,
        every,
        sensor.stream("body thermometer", key),
        sensor.body_thermometer_offset,
    )
    temperature = read_thermometer(
        fine_nodes[:, NODE["board"]],
        step_s,
        every,
        sensor.stream("thermometer", key),
        sensor.thermometer_offset,
    )
    return Recording(
        name=name,
        protocol=protocol.name,
        sensor=sensor.name,
        sample_period_s=period_s,
        time_s=time_s,
        temperature_degC=np.round(temperature, 4),
        body_temperature_degC=np.round(body, 4),
        adc=adc,
        measured=measured,
        reference=shown,
        channels=channels,
        load=load,
        drift=drift,
        noise=measured - load - drift,
        floor=np.sqrt(np.mean((measured - shown - drift) ** 2, axis=0)),
        nodes=nodes,
    )
