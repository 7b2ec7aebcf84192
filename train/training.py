"""From zerodrift.toml and its logs to a trained compensator, of one sensor or of many at once.

Effects and lag bank are solved; PyTorch is loaded only where a network is trained by epochs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zerodrift.base.config import AUTO, Config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.progress import Stage
from zerodrift.dataset.chip_codes import refuse_unsayable
from zerodrift.dataset.runs import Dataset, Run, join_stretches
from zerodrift.diagnosis.drivers import list_thermometers
from zerodrift.operations.dense import FloatDense, FloatFeedForward
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.compensator import Compensator, calibrate
from zerodrift.train.lag_bank.fit import (
    FEWEST_RUNS,
    FittedBank,
    choose_sources,
    fit_lag_bank,
)
from zerodrift.train.onnx_export import build_layers_onnx
from zerodrift.train.prepare import (
    FINAL,
    FREE,
    LEFT_OUT,
    UNFORESEEN,
    VALIDATION,
    Answer,
    Handling,
    Report,
    Task,
    prepare,
    read_settings,
    stand_alone,
)
from zerodrift.train.scores import WORTH_ITS_FLASH, Trained, measure, score
from zerodrift.train.sequences import split_runs
from zerodrift.train.settings import Settings
from zerodrift.train.stages import fit_physics

# Training of `[network] kind = "lag_bank"`: it takes seconds, so there are no checkpoints.

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


# From zerodrift.toml and its logs to a trained compensator, of one sensor or of many at once.


def list_checkpoints(config: Config) -> tuple[Path, ...]:
    """Return where trainings keep their state, which is removed with the result's arrival."""
    return tuple(config.build_directory / name for name in (VALIDATION, FINAL, LEFT_OUT, FREE))


def train(
    config: Config,
    dataset: Dataset,
    *,
    epochs: int | None = None,
    starts: int | None = None,
    resume: bool = True,
    report: Report | None = None,
    catalogue: Catalogue | None = None,
) -> Trained:
    """Fit physics, then train the network on what it leaves; checkpoints go to build/.

    Args:
        config: the project.
        dataset: its runs.
        epochs: overrides `[network] epochs`.
        starts: overrides `[network] starts`.
        resume: take up an interrupted training of these very inputs.
        report: called after each epoch.
        catalogue: the known effects; by default the built-ins and the project's own.

    Raises:
        InputError: an effect cannot be fitted, a setting of the network is out of range, or a log
            leaves what the chip's codes can say.
    """
    catalogue = catalogue or load_catalogue(config.plugin_files)
    settings = read_settings(config.network, epochs, starts)
    handling = Handling(folder=config.build_directory, resume=resume)
    if report is not None:
        handling = replace(handling, report=report)
    begun = _begin(config, dataset, settings, catalogue, handling.report)
    if isinstance(begun, Trained):
        return begun
    (answer,) = _train_networks([begun], handling)
    if isinstance(answer, Exception):
        raise answer
    return answer


def train_together(
    sensors: Sequence[tuple[Config, Dataset]], catalogue: Catalogue, *, device: str = "cpu"
) -> list[Answer]:
    """Return what `train` returns for each sensor, or the error that it would raise.

    Args:
        sensors: configuration and runs of each; effects, network and outputs are the same for all.
        catalogue: the known effects.
        device: where networks are trained: "cpu" or "cuda".
    """
    answers: dict[int, Answer] = {}
    tasks: dict[int, Task] = {}
    for i, (config, dataset) in enumerate(sensors):
        try:
            settings = read_settings(config.network)
            begun = _begin(config, dataset, settings, catalogue, lambda _: None)
        except (ZerodriftError, *UNFORESEEN) as error:
            answers[i] = error
            continue
        if isinstance(begun, Task):
            tasks[i] = begun
        else:
            answers[i] = begun
    found = _train_networks(list(tasks.values()), Handling(device=device))
    answers |= dict(zip(tasks, found, strict=True))
    return [answers[i] for i in range(len(sensors))]


def _begin(
    config: Config, dataset: Dataset, settings: Settings, catalogue: Catalogue, report: Report
) -> Trained | Task:
    """Return the result where no network is trained by epochs, else what is to be trained."""
    if config.network.kind == AUTO:
        raise InputError(
            f'{config.path}: [network] kind = "auto" chooses for one sensor. Run `zerodrift train`'
            " there, and name here the kind that it takes."
        )
    refuse_unsayable(config, dataset)
    if config.network.kind not in ("none", "lag_bank"):
        return Task(config, dataset, settings, prepare(config, dataset, settings, catalogue))
    physics = fit_physics(config, dataset, dataset.train, catalogue)
    alone = stand_alone(config, dataset, physics, settings)
    if config.network.kind == "none":
        return Trained(alone, score(alone, dataset))
    return train_bank(alone, config, dataset, catalogue, report)


def _train_networks(tasks: Sequence[Task], handling: Handling) -> list[Answer]:
    """Return what `train_tasks` does; without a task PyTorch is not needed."""
    if not tasks:
        return []
    from zerodrift.train.network_training import train_tasks

    return train_tasks(tasks, handling)
