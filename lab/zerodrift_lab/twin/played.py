"""Protocols played on a simulated sensor: further logs of one that has been simulated before.

The numbers of the sensor, its noise and its hidden effects stay; only what is done to it is new.
"""

from collections.abc import Mapping
from dataclasses import replace

from zerodrift_lab.twin.conditions import experience
from zerodrift_lab.twin.elements import feel
from zerodrift_lab.twin.heat import draw_heat_network
from zerodrift_lab.twin.logger import SimulatedRun, log_run
from zerodrift_lab.twin.noise import make_noise
from zerodrift_lab.twin.programmes import Following
from zerodrift_lab.twin.sensor import draw_stream
from zerodrift_lab.twin.simulate import Simulation
from zerodrift_lab.twin.six_axis.heat import draw_network
from zerodrift_lab.twin.six_axis.protocol import Protocol
from zerodrift_lab.twin.six_axis.timeline import draw_timeline
from zerodrift_lab.twin.strength import add_up

STAND_TAU_S, STAND_SHARE = 1200.0, 0.25
"""What the sensor stands on in the chamber follows the air late, in part."""
FINEST_S = 0.2


def play_protocols(
    simulation: Simulation, protocols: Mapping[str, Protocol], clock_start_s: float = 0.0
) -> tuple[SimulatedRun, ...]:
    """Return the logs of a simulated sensor to which these protocols are done.

    Args:
        simulation: the sensor, as an earlier campaign made it.
        protocols: name of the run -> what is done.
        clock_start_s: absolute time at the first one.

    Raises:
        InputError: a protocol asks for what cannot be done.
    """
    recipe, physics = simulation.recipe, simulation.physics
    hidden = {choice.name for choice in recipe.hidden}
    told = replace(
        physics,
        rails=None if "adc_saturation" in hidden else physics.rails,
        parameters={n: p for n, p in physics.parameters.items() if n not in hidden},
        coefficients={n: c for n, c in physics.coefficients.items() if n not in hidden},
    )
    network = draw_heat_network(recipe.seed)
    runs = []
    clock_s = clock_start_s
    for name, protocol in protocols.items():
        timeline = draw_timeline(
            protocol, draw_stream(recipe.seed, "played", name), draw_network(recipe.seed)
        )
        stimulus = replace(
            timeline.as_stimulus(),
            contact=Following(timeline.air, tau_s=STAND_TAU_S, share=STAND_SHARE),
            finest_s=FINEST_S,
        )
        run = experience(
            name,
            "train",
            recipe.seed,
            stimulus,
            network,
            sample_period_s=recipe.sample_period_s,
            finer=recipe.finer,
            clock_start_s=round(clock_s, 1),
        )
        drift = add_up(physics, run, feel(run, physics.parameters))
        told_drift = add_up(told, run, feel(run, told.parameters))
        noise = make_noise(
            simulation.noise, recipe.seed, name, run.time_s.size, recipe.sample_period_s
        )
        runs.append(log_run(run, recipe, drift, told_drift, noise, physics.rails, told.rails))
        clock_s += timeline.duration_s
    return tuple(runs)
