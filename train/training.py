"""From zerodrift.toml and its logs to a trained compensator: a rehearsal, then the performance.

In the rehearsal some training runs are held out; it tells which start does best, after how many
epochs, and whether the network is worth its flash at all. In the performance the same training is
repeated with all runs, since a run left out is a run not learnt from.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from zerodrift.base.config import Config, NetworkConfig
from zerodrift.dataset.chip_codes import refuse_unsayable
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.operations.dense import FloatFeedForward
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.bank_training import train_bank
from zerodrift.train.compensator import Compensator, calibrate
from zerodrift.train.networks import GruNetwork, build_network
from zerodrift.train.onnx_export import build_layers_onnx, build_onnx
from zerodrift.train.optimise import Progress, Result, Settings, Trainer
from zerodrift.train.scores import WORTH_ITS_FLASH, Stage, Trained, score
from zerodrift.train.sequences import Sequence32
from zerodrift.train.split import Split, split_runs
from zerodrift.train.stages import Stages, fit_physics, fit_stages

RATE = 5e-3
"""Peak learning rate of networks without a recurrence."""
WINDOW_EPOCHS = 24
"""Default for windows: there are as many of them as samples, and each is a sequence of its own."""
REHEARSAL, PERFORMANCE = "rehearsal.npz", "performance.npz"


def list_checkpoints(config: Config) -> tuple[Path, ...]:
    """Return where trainings keep their state, which is removed with the result's arrival."""
    return tuple(config.build_directory / name for name in (REHEARSAL, PERFORMANCE))


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
            options.get("learning_rate", default.learning_rate if network.kind == "gru" else RATE)
        ),
    )


def walk_of(network: NetworkConfig) -> str | int:
    """Return how a network walks through time: "stream", or a window that a GRU runs over.

    Windows of the other kinds are in what they see, so that they answer sample by sample.
    """
    return network.memory if network.kind == "gru" else "stream"


def train(
    config: Config,
    dataset: Dataset,
    *,
    epochs: int | None = None,
    starts: int | None = None,
    resume: bool = True,
    report: Callable[[Stage], None] | None = None,
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
    refuse_unsayable(config, dataset)
    catalogue = catalogue or load_catalogue(config.plugin_files)
    settings = read_settings(config.network, epochs, starts)
    physics = fit_physics(config, dataset, dataset.train, catalogue)
    alone = stand_alone(config, dataset, physics, settings)
    if config.network.kind == "none":
        return Trained(alone, score(alone, dataset))
    if config.network.kind == "lag_bank":
        return train_bank(alone, config, dataset, catalogue, report)
    split = split_runs(dataset.train)
    course = _Course(config, settings, resume, report)
    rehearsed = fit_stages(config, fit_physics(config, dataset, split.fit, catalogue), split.fit)
    rehearsal = course.rehearse(rehearsed, split)
    stages = fit_stages(config, physics, dataset.train)
    result = None
    if is_worth_its_flash(rehearsal):
        result = course.perform(stages, dataset.train, rehearsal)
    prepared = Prepared(alone, split, rehearsed, stages)
    return conclude(config, dataset, prepared, rehearsal, result)


@dataclass(frozen=True)
class Prepared:
    """What is fitted before a network is trained."""

    alone: Compensator
    """Physics alone."""
    split: Split
    rehearsed: Stages
    """Fitted to the runs that are not held out."""
    stages: Stages
    """Fitted to all training runs."""


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


def is_worth_its_flash(rehearsal: Result) -> bool:
    """Return whether the network helped on the runs held out."""
    return rehearsal.rmse < WORTH_ITS_FLASH * rehearsal.rmse_without


def choose_length(rehearsal: Result, epochs: int) -> int:
    """Return the epochs of the performance.

    A cycle that is cut short ends while its steps are long, so the cycle is walked to its end;
    unless the rehearsal had lost by then what it had gained, which calls for a shorter one.
    """
    whole = rehearsal.last_rmse < WORTH_ITS_FLASH * rehearsal.rmse_without
    return epochs if whole else rehearsal.epoch


def conclude(
    config: Config,
    dataset: Dataset,
    prepared: Prepared,
    rehearsal: Result,
    result: Result | None,
) -> Trained:
    """Return the compensator and its errors once the network is trained.

    Args:
        config: the project.
        dataset: its runs.
        prepared: what was fitted before the network.
        rehearsal: the network trained with runs held out.
        result: the network trained on all runs; None leaves it out.
    """
    alone, rehearsed, split = prepared.alone, prepared.rehearsed, prepared.split
    compensator = assemble(alone, prepared.stages, dataset.train, config, result)
    if result is None:
        note = (
            "the network found nothing that carries over to the runs held out "
            f"(error {rehearsal.rmse / rehearsal.rmse_without:.3f} of that without it), and was "
            "left out"
        )
        compensator = replace(compensator, notes=(*compensator.notes, note))
    if dataset.test:
        return Trained(compensator, score(compensator, dataset))
    kept = rehearsal if compensator.network is not None else None
    understudy = assemble(
        replace(alone, physics=rehearsed.physics), rehearsed, split.fit, config, kept
    )
    return Trained(compensator, score(compensator, dataset, understudy, split))


class _Course:
    """The two trainings of the network, with their checkpoints and one progress report."""

    def __init__(
        self,
        config: Config,
        settings: Settings,
        resume: bool,
        report: Callable[[Stage], None] | None,
    ) -> None:
        self._config, self._settings = config, settings
        self._resume = resume
        self._report = report or (lambda _: None)
        self._directory = config.build_directory
        self._total = (len(settings.starts) + 1) * settings.epochs

    def rehearse(self, stages: Stages, split: Split) -> Result:
        """Train with runs held out; return the start and epoch that did best on them."""

        def tell(progress: Progress) -> None:
            before = self._settings.starts.index(progress.start) * self._settings.epochs
            text = f"start {progress.start + 1}, held out {progress.heldout_rmse:.3f}"
            self._report(Stage((before + progress.epoch) / self._total, text))

        sequences = stages.make_sequences(split.fit)
        held_out = stages.make_sequences(split.held_out, split.skip)
        return self._train(stages, self._settings, REHEARSAL, tell, sequences, held_out)

    def perform(self, stages: Stages, runs: Sequence[Run], rehearsal: Result) -> Result:
        """Train with all runs, from the start that did best in the rehearsal."""
        length = choose_length(rehearsal, self._settings.epochs)
        settings = replace(self._settings, starts=(rehearsal.start,), epochs=length)

        def tell(progress: Progress) -> None:
            share = progress.epoch / length
            done = 1.0 - (1.0 - share) * self._settings.epochs / self._total
            self._report(Stage(done, f"all runs, {progress.train_rmse:.3f}"))

        sequences = stages.make_sequences(runs)
        return self._train(stages, settings, PERFORMANCE, tell, sequences, ())

    def _train(
        self,
        stages: Stages,
        settings: Settings,
        checkpoint: str,
        tell: Callable[[Progress], None],
        sequences: Sequence[Sequence32],
        held_out: Sequence[Sequence32],
    ) -> Result:
        trainer = Trainer(
            lambda generator: build_network(
                self._config.network, stages.front_end.width, len(stages.scale), generator
            ),
            sequences,
            held_out,
            settings,
            tared=stages.tared,
            checkpoint=self._directory / checkpoint,
            report=tell,
        )
        return trainer.run(self._resume)


def assemble(
    alone: Compensator,
    stages: Stages,
    runs: Sequence[Run],
    config: Config,
    result: Result | None,
) -> Compensator:
    """Return the compensator of fitted stages and a trained network, calibrated on its runs.

    Args:
        alone: the compensator of physics alone.
        stages: what was solved before the network.
        runs: what they were fitted to.
        config: the project.
        result: the trained network, or None to leave it out.
    """
    if result is None and not stages.linear.any():
        return alone
    network = None
    if result is not None:
        network = _to_onnx(config, stages, result)
    whole = replace(
        alone,
        front_end=stages.front_end,
        linear=stages.linear,
        constant=stages.constant,
        tared=stages.tared,
        network=network,
        memory=walk_of(config.network),
    )
    features = [stages.front_end.compute(run) for run in runs]
    predictions = [whole.predict(run) for run in runs]
    return replace(whole, calibration=calibrate(runs, features, predictions))


def _to_onnx(config: Config, stages: Stages, result: Result) -> bytes:
    """Return the ONNX file of a trained network, its head in the outputs' units."""
    network = build_network(
        config.network, stages.front_end.width, len(stages.scale), torch.Generator()
    )
    network.load_state_dict({k: torch.from_numpy(v) for k, v in result.weights.items()})
    head = network.head.detach().numpy() * stages.scale[:, None]
    bias = network.head_bias.detach().numpy() * stages.scale
    names = [output.name for output in config.outputs]
    if not isinstance(network, GruNetwork):
        return build_layers_onnx(FloatFeedForward(network.to_dense(), head, bias), names)
    return build_onnx(network.to_float(), head, bias, names)


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
