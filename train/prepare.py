"""Before a network is trained: the settings, and all parts that are solved exactly."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.config import CONSTRAINTS, RECURRENT_KINDS, Config, NetworkConfig
from zerodrift.base.extras import TRAIN, require
from zerodrift.base.progress import Stage
from zerodrift.dataset.runs import Dataset
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.compensator import Compensator, calibrate
from zerodrift.train.scores import Trained
from zerodrift.train.sequences import Split, split_runs
from zerodrift.train.settings import Settings
from zerodrift.train.stages import Stages, fit_physics, fit_stages

RATE = 5e-3
"""Peak learning rate of networks without a recurrence."""
WINDOW_EPOCHS = 24
"""Default for windows: there are as many of them as samples, and each is a sequence of its own."""


def read_settings(
    network: NetworkConfig, epochs: int | None = None, starts: int | None = None
) -> Settings:
    """Return the training's settings: those of `[network]`, then the defaults.

    Args:
        network: the table of zerodrift.toml.
        epochs: overrides the table's.
        starts: overrides the table's.
    """
    default = Settings()
    options = network.options
    count = starts or int(options.get("starts", len(default.starts)))
    memory = walk_of(network)
    usual = default.epochs if memory == "stream" else WINDOW_EPOCHS
    return replace(
        default,
        memory=memory,
        seed=network.seed,
        starts=tuple(range(count)),
        epochs=epochs or int(options.get("epochs", usual)),
        learning_rate=float(
            options.get(
                "learning_rate", default.learning_rate if network.kind in RECURRENT_KINDS else RATE
            )
        ),
    )


def walk_of(network: NetworkConfig) -> str | int:
    """Return how a network walks through time: "stream", or a window that it runs over.

    Windows of the other kinds are in what they see, so that they answer sample by sample.
    """
    return network.memory if network.kind in RECURRENT_KINDS else "stream"


@dataclass(frozen=True)
class Prepared:
    """What is fitted before a network is trained."""

    alone: Compensator
    """Physics alone."""
    split: Split
    validated: Stages
    """Fitted to the runs that are not held out."""
    stages: Stages
    """Fitted to all training runs."""


def prepare(config: Config, dataset: Dataset, settings: Settings, catalogue: Catalogue) -> Prepared:
    """Return what is fitted before a network is trained.

    Raises:
        InputError: an effect cannot be fitted, a setting of the network is out of range, or PyTorch
            is not installed.
    """
    require(TRAIN, f'[network] kind = "{config.network.kind}"')
    from zerodrift.train.networks import check_network

    physics = fit_physics(config, dataset, dataset.train, catalogue)
    split = split_runs(dataset.train)
    validated = fit_stages(config, fit_physics(config, dataset, split.fit, catalogue), split.fit)
    stages = fit_stages(config, physics, dataset.train)
    width, outputs = stages.front_end.width, len(stages.scale)
    check_network(config.network, width, outputs)  # raises for this sensor alone
    return Prepared(stand_alone(config, dataset, physics, settings), split, validated, stages)


def stand_alone(
    config: Config, dataset: Dataset, physics: PhysicalModel, settings: Settings
) -> Compensator:
    """Return the compensator of the physical model alone."""
    return Compensator(
        physics=physics,
        outputs=dataset.outputs,
        units=dataset.units,
        sample_period_s=config.sample_period_s,
        tared=physics.tared,
        calibration=calibrate(dataset.train, [], physics.predict_all(dataset.train)),
        trained_from=mark_inputs(config, dataset, settings),
        notes=physics.notes,
    )


def mark_inputs(config: Config, dataset: Dataset, settings: Settings | None = None) -> str:
    """Return a mark of everything that a training depends on: settings, effects, logs.

    Args:
        config: the project.
        dataset: its runs.
        settings: those of the training; by default those of zerodrift.toml.
    """
    settings = settings or read_settings(config.network)
    effects = [[e.kind, dict(e.held), dict(e.options)] for e in config.effects]
    network = [
        config.network.kind,
        config.network.hidden,
        list(config.network.lags_s),
        config.network.memory,
        config.network.options.get("spacing_s"),
        list(config.inputs),
    ]
    form = config.network.options.get("form", "reset_after")
    network += [key for key in CONSTRAINTS if config.network.options.get(key)]
    values = [
        effects,
        network,
        form,
        asdict(settings),
        list(dataset.outputs),
        config.sample_period_s,
    ]
    digest = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
    for file in config.plugin_files:
        digest.update(Path(file).read_bytes())
    for run in dataset.train:
        digest.update(f"{run.name} {run.group} {len(run)}".encode())
        for column in (run.time_s, run.temperature_degC, run.drift, run.reference):
            digest.update(np.ascontiguousarray(column).tobytes())
        for name in sorted(run.inputs):
            digest.update(name.encode() + np.ascontiguousarray(run.inputs[name]).tobytes())
    return digest.hexdigest()


# What the training of networks is given, one task per sensor, and what comes of it.

VALIDATION, FINAL, LEFT_OUT = "rehearsal.npz", "performance.npz", "left_out.npz"
FREE = "free.npz"
"""Checkpoints in build/; the third stays when it is complete: the next `firmware` takes it."""
UNFORESEEN = (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError)
"""What one sensor's numbers might raise that nobody thought of; the others go on."""
Answer = Trained | Exception
Report = Callable[[Stage], None]


@dataclass(frozen=True)
class Task:
    """One sensor whose network is to be trained."""

    config: Config
    dataset: Dataset
    settings: Settings
    prepared: Prepared


@dataclass(frozen=True)
class Handling:
    """What the training of networks is told beside the tasks."""

    device: str = "cpu"
    """"cpu" or "cuda"."""
    folder: Path | None = None
    """Where checkpoints are kept; None = nowhere."""
    resume: bool = True
    """Take up an interrupted training of these very inputs."""
    report: Report = lambda _: None
    """Called after each epoch."""
