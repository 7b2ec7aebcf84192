"""From zerodrift.toml and its logs to a trained compensator, of one sensor or of many at once.

Effects and lag bank are solved; PyTorch is loaded only where a network is trained by epochs.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from zerodrift.base.config import AUTO, Config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.dataset.chip_codes import refuse_unsayable
from zerodrift.dataset.runs import Dataset
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.train.bank_training import train_bank
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
from zerodrift.train.scores import Trained, score
from zerodrift.train.settings import Settings
from zerodrift.train.stages import fit_physics


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
