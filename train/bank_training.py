"""Training of `[network] kind = "lag_bank"`: it takes seconds, so there are no checkpoints."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from zerodrift.base.config import Config
from zerodrift.base.progress import Stage
from zerodrift.dataset.bridges import join_stretches
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.thermometers import list_thermometers
from zerodrift.operations.dense import FloatDense, FloatFeedForward
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.compensator import Compensator, calibrate
from zerodrift.train.lag_bank.fit import (
    FEWEST_RUNS,
    FittedBank,
    choose_sources,
    fit_lag_bank,
)
from zerodrift.train.onnx_export import build_layers_onnx
from zerodrift.train.scores import WORTH_ITS_FLASH, Trained, measure, score
from zerodrift.train.split import split_runs
from zerodrift.train.stages import fit_physics

VALIDATED = 0.45
"""Share of the work that the validation is."""


def train_bank(
    alone: Compensator,
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    report: Callable[[Stage], None] | None,
) -> Trained:
    """Return the compensator with a lag bank, or physics alone where that does as well.

    Args:
        alone: physics fitted to all training runs.
        config: the project.
        dataset: its runs.
        catalogue: the known effects.
        report: called with the progress.
    """
    tell = report or (lambda _: None)
    split = split_runs(dataset.train)
    physics = fit_physics(config, dataset, split.fit, catalogue)

    def validate(done: float, text: str) -> None:
        tell(Stage(VALIDATED * done, f"runs held out: {text}"))

    def perform(done: float, text: str) -> None:
        tell(Stage(VALIDATED + (1.0 - VALIDATED) * done, f"all runs: {text}"))

    left_out = assemble_bank(
        replace(alone, physics=physics, tared=physics.tared),
        fit_bank(config, physics, split.fit, validate),
        split.fit,
    )
    errors = measure(left_out, split.held_out, left_out.tared, dict(split.skip))
    ratio = float(np.mean(errors.compensated / np.maximum(errors.physics, 1e-300)))
    if ratio < WORTH_ITS_FLASH:
        fitted = fit_bank(config, alone.physics, dataset.train, perform)
        compensator = assemble_bank(alone, fitted, dataset.train)
    else:
        note = (
            "the lag bank found nothing that carries over to the runs held out (error"
            f" {ratio:.3f} of that without it), and was left out"
        )
        compensator = replace(alone, notes=(*alone.notes, note))
        left_out = replace(alone, physics=physics, tared=physics.tared)
    others = list_thermometers(config)
    if others and len({run.group for run in dataset.train}) < FEWEST_RUNS:
        note = (
            f"{', '.join(others)}: not used by the lag bank. It takes {FEWEST_RUNS} runs to tell "
            "another thermometer's part from chance: record more"
        )
        compensator = replace(compensator, notes=(*compensator.notes, note))
    if dataset.test:
        return Trained(compensator, score(compensator, dataset))
    return Trained(compensator, score(compensator, dataset, left_out, split))


def fit_bank(
    config: Config,
    physics: PhysicalModel,
    runs: Sequence[Run],
    report: Callable[[float, str], None] = lambda done, text: None,
) -> FittedBank:
    """Return the lag bank of `[network]`, fitted to what a physical model leaves of these runs."""
    network = config.network
    return fit_lag_bank(
        physics,
        runs,
        choose_sources(list_thermometers(config), runs),
        seed=network.seed,
        lags_s=network.lags_s,
        units=network.hidden,
        report=report,
    )


def assemble_bank(alone: Compensator, fitted: FittedBank, runs: Sequence[Run]) -> Compensator:
    """Return the compensator of physics and a fitted bank, calibrated on its runs."""
    runs, _ = join_stretches(runs)
    whole = replace(
        alone, bank=fitted.bank, tared=fitted.tared, notes=(*alone.notes, *fitted.notes)
    )
    if fitted.front_end is not None:
        outputs = len(alone.outputs)
        network = FloatFeedForward(
            (FloatDense(fitted.weights, fitted.bias, "tanh"),), fitted.head.T, np.zeros(outputs)
        )
        whole = replace(
            whole,
            front_end=fitted.front_end,
            linear=np.zeros((fitted.front_end.width, outputs)),
            constant=np.zeros(outputs),
            network=build_layers_onnx(network, alone.outputs),
        )
    features = [] if whole.front_end is None else [whole.front_end.compute(run) for run in runs]
    predictions = [whole.predict(run) for run in runs]
    return replace(whole, calibration=calibrate(runs, features, predictions))
