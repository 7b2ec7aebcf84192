"""From a recipe to a whole campaign of simulated logs, in memory."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.conditions import Conditions, experience
from zerodrift_lab.twin.disturbances import DISTURBANCES
from zerodrift_lab.twin.elements import ELEMENT_EFFECTS, feel
from zerodrift_lab.twin.heat import draw_heat_network
from zerodrift_lab.twin.logger import SimulatedRun, log_run
from zerodrift_lab.twin.noise import Noise, draw_noise, make_noise
from zerodrift_lab.twin.recipe import Recipe, check_recipe
from zerodrift_lab.twin.sensor import draw_stream
from zerodrift_lab.twin.stimuli import draw_stimulus
from zerodrift_lab.twin.strength import (
    DEFAULT_SIZE,
    Absorber,
    Physics,
    add_element_effect,
    add_scaled,
    add_up,
    build_absorber,
    make_told,
    set_rails,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Simulation:
    """A campaign of simulated logs with everything that made them."""

    recipe: Recipe
    runs: tuple[SimulatedRun, ...]
    physics: Physics
    """Truth: every effect with its numbers."""
    noise: Noise
    """Truth."""

    @property
    def noise_rms(self) -> Array:
        """[6] truth: RMS of the noise per output, in its unit."""
        return self.noise.rms

    def select(self, use: str) -> tuple[SimulatedRun, ...]:
        """Return the runs of one use: train, test or dwell."""
        return tuple(run for run in self.runs if run.use == use)


def name_runs(recipe: Recipe) -> list[tuple[str, str, str]]:
    """Return name, kind and use of every run; test runs are called test_..., for the globs."""
    named: list[tuple[str, str, str]] = []
    uses = [(kind, "train") for kind in recipe.train] + [(kind, "test") for kind in recipe.test]
    uses += [("dwell", "dwell")] if recipe.dwell else []
    for kind, use in uses:
        stem = f"test_{kind}" if use == "test" else kind
        number = 1 + sum(name.rpartition("_")[0] == stem for name, _, _ in named)
        named.append(("dwell" if use == "dwell" else f"{stem}_{number}", kind, use))
    return named


def run_campaign(recipe: Recipe) -> tuple[Conditions, ...]:
    """Integrate every run of the recipe, one after the other with drawn pauses between."""
    network = draw_heat_network(recipe.seed)
    pauses = draw_stream(recipe.seed, "pauses")
    clock_s = 0.0
    campaign: list[Conditions] = []
    for name, kind, use in name_runs(recipe):
        stimulus = draw_stimulus(
            kind,
            name,
            seed=recipe.seed,
            network=network,
            duration_s=recipe.duration_s,
            exercise=recipe.exercise,
            first=not campaign,
        )
        run = experience(
            name,
            use,
            recipe.seed,
            stimulus,
            network,
            sample_period_s=recipe.sample_period_s,
            finer=recipe.finer,
            clock_start_s=round(clock_s, 1),
        )
        campaign.append(run)
        clock_s += stimulus.duration_s + float(pauses.uniform(600.0, 5400.0))
    return tuple(campaign)


def make_physics(
    recipe: Recipe, training: Sequence[Conditions], noise: Noise
) -> tuple[Physics, Absorber]:
    """Draw every effect of the sensor and scale the hidden ones to their sizes."""
    told = make_told(recipe, training, noise.rms)
    absorber = build_absorber(told, training, noise.rms)
    physics = told
    for choice in recipe.hidden:
        if choice.name in DISTURBANCES:
            size = choice.size or recipe.size or DEFAULT_SIZE
            physics, got = add_scaled(physics, choice, recipe.seed, training, absorber, size)
            physics = physics.with_size(choice.name, got)
    may_scale_drift = True
    for choice in recipe.hidden:
        if choice.name in ELEMENT_EFFECTS:
            asked = choice.size or recipe.size
            base = replace(
                told, coefficients={n: physics.coefficients[n] for n in told.coefficients}
            )
            physics, got = add_element_effect(
                physics,
                base,
                choice,
                recipe.seed,
                training,
                absorber,
                asked,
                may_scale_drift=may_scale_drift,
            )
            physics = physics.with_size(choice.name, got)
            may_scale_drift = may_scale_drift and asked is None
    return physics, absorber


def simulate(recipe: Recipe) -> Simulation:
    """Return a whole campaign of simulated logs; the same recipe gives the same numbers.

    Raises:
        InputError: the recipe cannot be simulated, with what to change.

    Limits: an hour at 10 Hz takes some tenths of a second; 24 of them about 1 GB of memory.
    """
    check_recipe(recipe)
    campaign = run_campaign(recipe)
    noise = draw_noise(recipe.seed, recipe.noise)
    training = [run for run in campaign if run.use == "train"]
    physics, absorber = make_physics(recipe, training, noise)

    drifts, noises = {}, {}
    for run in campaign:
        drifts[run.name] = add_up(physics, run, feel(run, physics.parameters))
        noises[run.name] = make_noise(
            noise, recipe.seed, run.name, run.time_s.size, recipe.sample_period_s
        )
    for choices, hidden in ((recipe.told, False), (recipe.hidden, True)):
        for choice in choices:
            if choice.name == "adc_saturation":
                signals = [r.load + drifts[r.name] + noises[r.name] for r in training]
                physics = set_rails(choice, recipe, physics, absorber, signals, hidden=hidden)

    hidden_names = {choice.name for choice in recipe.hidden}
    told = replace(
        physics,
        rails=None if "adc_saturation" in hidden_names else physics.rails,
        parameters={n: p for n, p in physics.parameters.items() if n not in hidden_names},
        coefficients={n: c for n, c in physics.coefficients.items() if n not in hidden_names},
    )
    runs = []
    for run in campaign:
        drift, noise_of_run = drifts[run.name], noises[run.name]
        told_drift = add_up(told, run, feel(run, told.parameters)) if hidden_names else drift
        runs.append(
            log_run(run, recipe, drift, told_drift, noise_of_run, physics.rails, told.rails)
        )
    return Simulation(recipe, tuple(runs), physics, noise)
