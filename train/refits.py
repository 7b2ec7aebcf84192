"""Trains networks again without some of the runs, to predict those.

A network is trained for each part of the runs, all of them in parallel, with the settings of the
original one: same first weights, same number of epochs, everything before it fitted again. Needs
PyTorch, as training does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.config import AUTO, Config, NetworkConfig
from zerodrift.base.errors import InputError
from zerodrift.base.extras import TRAIN, require
from zerodrift.base.progress import Stage
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.train.compensator import Compensator
from zerodrift.train.onnx_export import read_onnx_weights
from zerodrift.train.prepare import LEFT_OUT, UNFORESEEN, Handling, read_settings
from zerodrift.train.settings import Settings
from zerodrift.train.stages import Stages, fit_physics, fit_stages

MOST_PARTS = 8
"""Runs are left out one by one, or, where there are more, in so many parts, each a training."""


@dataclass(frozen=True)
class Original:
    """A trained compensator, and what it was trained from."""

    config: Config
    dataset: Dataset
    compensator: Compensator


@dataclass(frozen=True)
class Refit:
    """A compensator that was trained without some runs."""

    groups: frozenset[str]
    """The runs that it did not learn from."""
    compensator: Compensator


@dataclass(frozen=True)
class _Retraining:
    """One training to come."""

    original: int
    groups: frozenset[str]
    others: tuple[Run, ...]
    config: Config
    alone: Compensator
    """Physics, fitted to the others."""
    stages: Stages
    settings: Settings | None
    """None: the original has no network, only what is solved before it."""


def split_parts(runs: Sequence[Run]) -> tuple[frozenset[str], ...]:
    """Return the groups of runs that are left out together."""
    groups = list(dict.fromkeys(run.group for run in runs))
    count = min(len(groups), MOST_PARTS)
    return tuple(frozenset(groups[part::count]) for part in range(count))


def train_refits(
    originals: Sequence[Original], handling: Handling
) -> list[tuple[Refit, ...] | InputError]:
    """Return for each compensator those that were trained without a part of its runs.

    Args:
        originals: with a network, or with what is solved before one.
        handling: device, folder of the checkpoint, progress.

    Returns:
        For each original its refits, in the order of the parts; why there are none where a
        training diverged, there is one run only, or PyTorch is not installed.
    """
    answers: dict[int, InputError] = {}
    parts: list[_Retraining] = []
    for number, original in enumerate(originals):
        try:
            catalogue = load_catalogue(original.config.plugin_files)
            parts += _prepare(number, original, catalogue)
        except InputError as error:
            answers[number] = error
        except UNFORESEEN as error:  # others of a fleet go on
            answers[number] = InputError(f"{type(error).__name__}: {error}")
    found: dict[int, list[Refit]] = {number: [] for number in range(len(originals))}
    for part, trained in zip(parts, _train(parts, handling), strict=True):
        if isinstance(trained, InputError):
            answers.setdefault(part.original, trained)
        else:
            found[part.original].append(Refit(part.groups, trained))
    return [
        answers[number] if number in answers else tuple(found[number])
        for number in range(len(originals))
    ]


def _prepare(number: int, original: Original, catalogue: Catalogue) -> list[_Retraining]:
    """Return the trainings of one compensator, all that is solved exactly done."""
    config, dataset, whole = original.config, original.dataset, original.compensator
    parts = split_parts(dataset.train)
    if len(parts) < 2:
        raise InputError(
            "a network that left out the only training run would have learnt from none; expected"
            " two runs or more. Record another"
        )
    config = replace(config, network=find_network(config.network, whole))
    settings = None
    require(TRAIN, "training without a run, for the uncertainty")
    if whole.network is not None:
        settings = read_settings(config.network)
        if whole.trained_as is not None:
            start, epochs = whole.trained_as.start, whole.trained_as.epochs
            settings = replace(settings, starts=(start,), epochs=epochs)
        else:
            settings = replace(settings, starts=settings.starts[:1])
    found = []
    for groups in parts:
        others = tuple(run for run in dataset.train if run.group not in groups)
        physics = fit_physics(config, dataset, others, catalogue)
        stages = fit_stages(config, physics, others)
        alone = replace(
            whole,
            physics=physics,
            tared=physics.tared,
            front_end=None,
            linear=np.zeros((0, 0)),
            constant=np.zeros(0),
            network=None,
            trained_as=None,
        )
        found.append(_Retraining(number, groups, others, config, alone, stages, settings))
    return found


def _train(parts: Sequence[_Retraining], handling: Handling) -> list[Compensator | InputError]:
    """Train all networks in step; return the compensators with them."""
    if not parts:
        return []
    from zerodrift.train.engine import EpochProgress, train_networks
    from zerodrift.train.network_training import assemble, pose

    posed = [p for p in parts if p.settings is not None]
    checkpoint = handling.folder / LEFT_OUT if handling.folder else None

    def tell(progress: EpochProgress) -> None:
        handling.report(Stage(progress.done, f"without a run, {progress.train_rmse:.3f}"))

    problems = [
        pose(p.config.network, p.settings, p.stages, p.stages.make_sequences(p.others))
        for p in posed
        if p.settings is not None
    ]
    results = iter(
        train_networks(
            problems,
            device=handling.device,
            checkpoint=checkpoint,
            resume=handling.resume,
            report=tell,
        )
    )
    found: list[Compensator | InputError] = []
    for part in parts:
        result = next(results) if part.settings is not None else None
        if isinstance(result, InputError):
            found.append(result)
        else:
            found.append(assemble(part.alone, part.stages, part.others, part.config, result))
    return found


def find_network(network: NetworkConfig, compensator: Compensator) -> NetworkConfig:
    """Return the `[network]` that a compensator was trained by; with "auto", what was taken."""
    if network.kind != AUTO:
        return network
    if compensator.network is None:
        return replace(network, kind="none")
    weights = read_onnx_weights(compensator.network, "network.onnx")
    for kind in ("gru", "lstm"):
        if f"{kind}.W" in weights:
            hidden = int(weights[f"{kind}.R"].shape[-1])
            return replace(network, kind=kind, hidden=hidden, memory=compensator.memory)
    raise InputError('[network] kind = "auto" took a network that is neither GRU nor LSTM')
