"""The truth about a simulation, for people and benchmarks to compare answers with."""

from typing import Any

import numpy as np

from zerodrift_lab.twin.disturbances import DISTURBANCES
from zerodrift_lab.twin.recipe import LISTED_EFFECTS, recipe_to_dict
from zerodrift_lab.twin.sensor import OUTPUTS, REFERENCE_TEMPERATURE, UNITS
from zerodrift_lab.twin.simulate import Simulation


def describe_effect(simulation: Simulation, name: str, role: str) -> dict[str, Any]:
    """Return everything about one effect of the simulated sensor as plain data."""
    physics = simulation.physics
    described: dict[str, Any] = {
        "role": role,
        "in_catalogue": name in LISTED_EFFECTS,
        "parameters": dict(physics.parameters[name]),
    }
    if name in physics.sizes:
        described["size"] = physics.sizes[name]
    if name in physics.coefficients:
        coefficients = physics.coefficients[name]
        described["columns"] = list(DISTURBANCES[name].terms[: coefficients.shape[1]])
        described["coefficients"] = {
            output: row.tolist() for output, row in zip(OUTPUTS, coefficients, strict=True)
        }
    return described


def describe_truth(simulation: Simulation) -> dict[str, Any]:
    """Return the truth as plain data: effects with their numbers, noise, runs, and the recipe.

    A coefficient is in the output's unit per unit of its column; size is the RMS of what the told
    model cannot absorb over the noise RMS, pooled over outputs and training runs.
    """
    recipe = simulation.recipe
    roles = [(choice.name, "told") for choice in recipe.told]
    roles += [(choice.name, "hidden") for choice in recipe.hidden]
    runs = [
        {
            "name": run.name,
            "use": run.use,
            "samples": run.time_s.size,
            "temperature_degC": [
                float(run.temperature_degC.min()),
                float(run.temperature_degC.max()),
            ],
            "tare": dict(zip(OUTPUTS, run.tare.tolist(), strict=True)),
            "hidden_drift_rms": dict(
                zip(OUTPUTS, np.sqrt(np.mean(run.hidden_drift**2, axis=0)).tolist(), strict=True)
            ),
        }
        for run in simulation.runs
    ]
    return {
        "simulated": True,
        "note": "The truth behind simulated logs. No command of zerodrift reads this file.",
        "effects": {name: describe_effect(simulation, name, role) for name, role in roles},
        "reference_temperature_degC": REFERENCE_TEMPERATURE,
        "units": dict(zip(OUTPUTS, UNITS, strict=True)),
        "noise_rms": dict(zip(OUTPUTS, simulation.noise_rms.tolist(), strict=True)),
        "noise_correlation_s": simulation.noise.coloured_tau_s,
        "runs": runs,
        "recipe": recipe_to_dict(recipe),
    }
