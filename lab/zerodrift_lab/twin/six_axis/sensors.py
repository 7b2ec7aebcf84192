"""Draws specimens with effects switched on, each scaled to its size in one bundled protocol."""

from collections.abc import Sequence
from dataclasses import replace

from zerodrift.base.errors import InputError
from zerodrift_lab.twin.recipe import EffectChoice
from zerodrift_lab.twin.six_axis.effects import (
    choose_hidden,
    contribute,
    describe_run,
    feel,
    scale_hidden,
)
from zerodrift_lab.twin.six_axis.heat import warm
from zerodrift_lab.twin.six_axis.protocol import load_protocol
from zerodrift_lab.twin.six_axis.specimen import Hidden, Sensor, draw_specimen
from zerodrift_lab.twin.six_axis.timeline import draw_timeline

SCALING_PROTOCOL = "exercise"
"""The size of an effect that adds to the outputs is measured in one run of this protocol."""


def draw_sensor(
    seed: int | None, effects: Sequence[EffectChoice] = (), *, noise: float = 1.0
) -> Sensor:
    """Draw one specimen of the sensor.

    Args:
        seed: decides every unit-to-unit deviation; None gives the nominal specimen.
        effects: effects of the twin's catalogue to switch on beyond the specimen's own physics.
            One that adds to the outputs gets its size (2 if left out): the RMS about its mean over
            the noise RMS, pooled over outputs, in one run of the protocol `exercise`.
        noise: factor on the converter's noise.

    Raises:
        InputError: an unknown effect or a value out of range.
    """
    sensor = draw_specimen(seed, noise)
    names = [choice.name for choice in effects]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"twin: '{name}' is asked for twice; ask for it once.")
    hidden = [choose_hidden(sensor, choice) for choice in effects]
    on_temperatures = tuple(one for one in hidden if one.coefficients is None)
    bare = replace(sensor, effects=on_temperatures)
    additive = [one for one in hidden if one.coefficients is not None]
    return replace(bare, effects=(*on_temperatures, *_scale(bare, additive)))


def _scale(sensor: Sensor, additive: Sequence[Hidden]) -> list[Hidden]:
    """Return the effects with the coefficients that give their sizes."""
    if not additive:
        return []
    key, step_s, every = "scaling", 0.1, 10
    protocol = load_protocol(SCALING_PROTOCOL)
    timeline = draw_timeline(protocol, sensor.stream("protocol", key), sensor.network)
    count = int(timeline.duration_s)
    fine_nodes = warm(sensor.network, timeline.surround(step_s, (count - 1) * every + 1))
    felt = feel(sensor.effects, fine_nodes, step_s, every)
    run, elements = describe_run(
        sensor, timeline, key, fine_nodes, felt, every, step_s * every, 0.0
    )
    scaled = []
    for hidden in additive:
        added = contribute(hidden, run, elements)
        scaled.append(scale_hidden(hidden, added, sensor.noise_rms))
    return scaled
