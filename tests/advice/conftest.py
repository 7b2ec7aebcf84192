"""Simulated logs of which it is known what they hold: lags, ways of heating, ramps."""

from dataclasses import replace

import numpy as np
import pytest

from zerodrift.base.config import NetworkConfig
from zerodrift.diagnosis.advice import advise
from zerodrift_lab.twin.project import to_config, to_dataset
from zerodrift_lab.twin.recipe import EffectChoice, Recipe
from zerodrift_lab.twin.simulate import simulate

CHAMBER = ("chamber",) * 6
MIXED = ("chamber",) * 4 + ("heating", "cooling") * 3


@pytest.fixture(scope="session")
def project():
    """Return a function that simulates a project: its config and its dataset."""
    kept = {}

    def make(train=CHAMBER, hidden=(), body=False, seed=0, exercise=()):
        key = repr((train, hidden, body, seed, exercise))
        if key not in kept:
            simulation = simulate(
                Recipe(
                    seed=seed,
                    train=train,
                    hidden=hidden,
                    dwell=False,
                    exercise=exercise,
                    channels=("body_temperature",) if body else (),
                )
            )
            kept[key] = to_config(simulation), to_dataset(simulation)
        return kept[key]

    return make


@pytest.fixture(scope="session")
def ask(project):
    """Return a function that advises on a simulated project with some network."""

    def run(network=None, **simulated):
        config, dataset = project(**simulated)
        return advise(replace(config, network=network or NetworkConfig()), dataset)

    return run


def lag(tau_s, **more):
    """Return the hidden effect."""
    return (EffectChoice("thermal_lag", None, {"tau_s": tau_s, **more}),)


HEAT_PATH = (EffectChoice("heat_path"),)


def straighten(dataset, rate_k_per_s):
    """Return the dataset with temperatures that ramp at one rate, between dwells."""
    runs = []
    for run in dataset.train:
        t = 20.0 + np.clip((run.time_s % 3000.0 - 300.0) * rate_k_per_s, 0.0, 40.0)
        runs.append(replace(run, temperature_degC=t))
    return replace(dataset, train=tuple(runs))
