"""`[network] kind = "auto"`: candidates trained, their errors on runs left out, their cost.

Test logs decide nothing: the candidates are measured on training runs that a second training does
not see, the same ones for all.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.config import AUTO, Config, NetworkConfig
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.lock import make_scratch
from zerodrift.base.progress import Stage
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.codegen.generate import generate
from zerodrift.dataset.runs import Dataset
from zerodrift.export.compose import compose_integer_model, describe_compensator, encode_inputs
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.train.compensator import Compensator
from zerodrift.train.prepare import mark_inputs, read_settings
from zerodrift.train.scores import StageRmse, Trained, measure, score
from zerodrift.train.sequences import split_runs
from zerodrift.train.stages import fit_physics
from zerodrift.train.summary import NetworkChoice, TriedNetwork
from zerodrift.train.training import train
from zerodrift.verify.chip_check import COUNTED_STEPS

CORE = "cortex-m4"
CANDIDATES = (
    *(("none", 16), ("lag_bank", 16)),
    *(("gru", 4), ("gru", 8), ("gru", 16), ("lstm", 8)),
)
"""Kind, and hidden units; all of those with a state carry it from sample to sample."""
LEFT_OUT = "left out"
"""Of a network that found nothing: the linear part in front of it stays."""
TOLERANCE = 1.05
"""Of the best error: what is not worse than this times it is as good."""


@dataclass(frozen=True)
class Chosen:
    """A trained compensator, and the table that it was chosen by where it was."""

    trained: Trained
    choice: NetworkChoice | None


@dataclass(frozen=True)
class _Cost:
    """The cost of a candidate on the chip; None where it cannot be measured."""

    products: int
    instructions: int | None
    flash_bytes: int | None

    @property
    def order(self) -> tuple[int, int]:
        """The cheaper is the smaller one."""
        if self.instructions is None:
            return self.products, 0
        return self.instructions, self.flash_bytes or 0


def train_or_choose(
    config: Config,
    dataset: Dataset,
    *,
    epochs: int | None = None,
    starts: int | None = None,
    resume: bool = True,
    report: Callable[[Stage], None] = lambda _: None,
    catalogue: Catalogue | None = None,
) -> Chosen:
    """Return what `train` does; with kind = "auto" the cheapest candidate that is as good as the
    best.

    Args:
        config: the project.
        dataset: its runs.
        epochs: overrides `[network] epochs`.
        starts: overrides `[network] starts`.
        resume: take up an interrupted training of these very inputs.
        report: called after each epoch.
        catalogue: the known effects; by default the built-ins and the project's own.

    Raises:
        InputError: as `train`; with "auto", no run can be left out, or no candidate can be trained.
    """
    catalogue = catalogue or load_catalogue(config.plugin_files)

    def train_one(own: Config, data: Dataset, tell: Callable[[Stage], None]) -> Trained:
        return train(
            own, data, epochs=epochs, starts=starts, resume=resume, report=tell, catalogue=catalogue
        )

    if config.network.kind != AUTO:
        return Chosen(train_one(config, dataset, report), None)
    inner = replace(dataset, test=())
    floor = _measure_physics(config, inner, catalogue)
    networks = list_candidates(config.network)
    names = [name_network(network) for network in networks]
    found: dict[str, tuple[Trained, StageRmse, _Cost]] = {}
    failed: dict[str, str] = {}
    with make_scratch(config.directory) as scratch:
        for i, (name, network) in enumerate(zip(names, networks, strict=True)):

            def tell(stage: Stage, i: int = i, name: str = name) -> None:
                report(Stage((i + stage.done) / len(networks), f"{name}: {stage.text}"))

            own = replace(config, network=network)
            try:
                trained = train_one(own, inner, tell)
                cost = measure_cost(own, inner, trained.compensator, scratch / str(i))
            except (InputError, CheckError) as error:
                failed[name] = str(error)
                continue
            errors = floor if network.kind == "none" else trained.scores.held_out
            found[name] = trained, errors, cost
    if not found:
        first = next(iter(failed.values()))
        raise InputError(f'[network] kind = "auto": no candidate can be trained. {first}')
    ratios = {
        name: float(np.mean(errors.compensated / np.maximum(floor.compensated, 1e-300)))
        for name, (_, errors, _) in found.items()
    }
    taken = choose(ratios, {name: cost.order for name, (_, _, cost) in found.items()})
    trained, _, _ = found[taken]
    best = min(ratios.values())
    tried = []
    for name in names:
        if name in failed:
            tried.append(TriedNetwork(name, None, None, None, None, None, False, failed[name]))
            continue
        one, errors, cost = found[name]
        parts = one.compensator.network, one.compensator.bank
        why = LEFT_OUT if name != "none" and parts == (None, None) else ""
        rmse = dict(zip(dataset.outputs, errors.compensated.tolist(), strict=True))
        ratio, within = ratios[name] / best, ratios[name] <= TOLERANCE * best
        tried.append(
            TriedNetwork(
                name, rmse, ratio, cost.instructions, cost.flash_bytes, cost.products, within, why
            )
        )
    units = dict(zip(dataset.outputs, dataset.units, strict=True))
    choice = NetworkChoice(taken, tuple(tried), units, CORE, trained.scores.explanation)
    note = f'[network] kind = "auto": {taken} taken of {len(found)} candidates that were trained'
    compensator = replace(
        trained.compensator,
        notes=(*trained.compensator.notes, note),
        trained_from=mark_inputs(config, dataset, read_settings(config.network, epochs, starts)),
    )
    scores = score(compensator, dataset) if dataset.test else trained.scores
    return Chosen(Trained(compensator, scores), choice)


def list_candidates(network: NetworkConfig) -> tuple[NetworkConfig, ...]:
    """Return the candidates as `[network]` tables, with the seed, starts and epochs of this one."""
    return tuple(replace(network, kind=kind, hidden=hidden) for kind, hidden in CANDIDATES)


def name_network(network: NetworkConfig) -> str:
    """Return a candidate's name in the table: the kind, and the units of one with a state."""
    return f"{network.kind} {network.hidden}" if network.kind in ("gru", "lstm") else network.kind


def choose(ratios: dict[str, float], costs: dict[str, tuple[int, int]]) -> str:
    """Return the cheapest candidate whose error is within `TOLERANCE` of the best one's.

    Args:
        ratios: candidate -> error on the runs left out, relative to one scale for all.
        costs: candidate -> what is compared, the cheaper the smaller.
    """
    best = min(ratios.values())
    good = [name for name, ratio in ratios.items() if ratio <= TOLERANCE * best]
    return min(good, key=lambda name: (costs[name], ratios[name]))


def _measure_physics(config: Config, dataset: Dataset, catalogue: Catalogue) -> StageRmse:
    """Return the errors of physics alone, fitted without the runs left out, over those."""
    split = split_runs(dataset.train)
    if not split.held_out:
        raise InputError(
            '[network] kind = "auto" compares candidates on runs left out, and there is none to'
            " leave out. Record more, or name a kind."
        )
    physics = fit_physics(config, dataset, split.fit, catalogue)
    plain = replace(config, network=replace(config.network, kind="none"))
    alone = train(plain, dataset, catalogue=catalogue).compensator
    refit = replace(alone, physics=physics, tared=physics.tared)
    return measure(refit, split.held_out, refit.tared, dict(split.skip))


def measure_cost(config: Config, dataset: Dataset, compensator: Compensator, folder: Path) -> _Cost:
    """Return what a compensator takes on a Cortex-M4: the most instructions of some steps, flash.

    Raises:
        CheckError: no safe integer format.
    """
    described = describe_compensator(compensator, config, dataset.train)
    model = compose_integer_model(described, config, dataset)
    products = compensator.macs_per_step
    if importlib.util.find_spec("unicorn") is None or not find_cross_compilers(CORE):
        return _Cost(products, None, None)
    from zerodrift.c_runtime.emulator import EmulatedModel

    code = generate(model)
    folder.mkdir()
    chip = EmulatedModel(model, code, CORE, folder)
    codes = encode_inputs(model, dataset.train[0])[:COUNTED_STEPS]
    flash_bytes = measure_footprint(code, CORE).flash_bytes
    return _Cost(products, max(chip.count_instructions(codes)), flash_bytes)
