"""A model held against the logs: the models that there are, and what comes of it."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_text
from zerodrift.base.progress import SILENT, Progress
from zerodrift.dataset.runs import Run
from zerodrift.dataset.units import read_unit
from zerodrift.diagnosis.advice import Advice, advise
from zerodrift.diagnosis.compare import Comparison, Labels
from zerodrift.diagnosis.compare import compare as compare_runs
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.held_out import HeldOut, hold_out
from zerodrift.diagnosis.referee import review_logs
from zerodrift.diagnosis.run_errors import FindUsable
from zerodrift.diagnosis.segments import MOST_SEGMENTS
from zerodrift.export.compose import predict_integer
from zerodrift.export.model_files import load_model
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import fit_config
from zerodrift.physics.model import PhysicalModel
from zerodrift.report.page import render_page
from zerodrift.report.pictures import draw_comparison
from zerodrift.report.results import CompareResult
from zerodrift.tasks.built import read_firmware, state_uncertainty
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.train.compensator import Compensator
from zerodrift.verify.summary import FirmwareSummary, StatedUncertainty

PHYSICS, NETWORK, INTEGER, C = KINDS = ("physics", "network", "integer", "c")


@dataclass(frozen=True)
class Predictor:
    """One model as a function of a run."""

    kind: str
    """physics | network | integer | c."""
    predict: Callable[[Run], Array]
    """Run -> [n, K] drift, in the outputs' units."""
    physics: PhysicalModel
    """Alone, or below the network."""
    held_out: HeldOut | None = None
    """Predictions for data left out; None: the test logs are the held-out data, where there are
    any."""
    notes: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """The kinds of the model's effects."""
        return tuple(self.physics.effects)

    @property
    def tared(self) -> bool:
        """Whether each run has an offset of its own, which is not the model's to predict."""
        return self.physics.tared

    @property
    def find_usable(self) -> FindUsable:
        """Run -> [n, K] which samples count."""
        return self.physics.find_usable


def open_predictor(kind: str | None, project: ProjectFolder) -> Predictor:
    """Return the model asked for, or the most complete one there is.

    Args:
        kind: physics | network | integer | c; None: the network if one was trained with the effects
            that zerodrift.toml has now, else physics.
        project: the project.

    Raises:
        InputError: the model was not trained or exported yet, or for other outputs or effects.
    """
    config = project.config
    if kind is None:
        compensator, why_not = _find_compensator(config, project.catalogue)
        if compensator is not None:
            return _open_network(compensator)
        return _open_physics(project, why_not)
    if kind == PHYSICS:
        return _open_physics(project)
    compensator = Compensator.load(config.build_directory, project.catalogue)
    _refuse_other(compensator, config)
    if kind == NETWORK:
        return _open_network(compensator)
    return _open_integer(kind, compensator, config)


def compare_predictor(
    predictor: Predictor, project: ProjectFolder, most: int = MOST_SEGMENTS
) -> Comparison:
    """Return the comparison of a model with the measurements.

    Args:
        predictor: the model.
        project: whose runs are compared.
        most: how many of the worst segments to keep.
    """
    units = {name: read_unit(column) for name, column in project.config.inputs.items()}
    return compare_runs(
        project.dataset,
        predictor.predict,
        held_out=predictor.held_out,
        tared=predictor.tared,
        find_usable=predictor.find_usable,
        labels=Labels(tuple(predictor.effects), units),
        most=most,
    )


@dataclass(frozen=True)
class CompareRequest:
    """What `compare` is asked."""

    project: ProjectFolder
    model: str | None = None
    """What predicts, one of `KINDS`; None: the most complete there is."""
    worst: int = MOST_SEGMENTS
    """How many of the worst segments to list."""
    html: Path | None = None
    """Where a page with the pictures is written."""


@dataclass(frozen=True)
class Compared:
    """The comparison of a model with the measurements, and further findings."""

    predictor: Predictor
    comparison: Comparison
    notes: tuple[DataNote, ...]
    """What looks wrong in the logs."""
    advice: Advice | None
    """What can be learnt from the logs; None where no output moves."""
    firmware: FirmwareSummary | None
    """The last firmware, where it is current."""
    firmware_note: str
    stated: Mapping[str, StatedUncertainty] | None = None
    """The uncertainty of compensated values, by that firmware."""

    def summarise(self) -> CompareResult:
        """Return it as the command prints it."""
        return CompareResult(
            **vars(self.comparison.summarise()),
            model=self.predictor.kind,
            notes=self.notes,
            advice=self.advice.summarise() if self.advice is not None else None,
            chip_error=self.firmware.chip_error if self.firmware is not None else None,
            warnings=self.firmware.warnings if self.firmware is not None else None,
            uncertainty=self.stated,
        )


def compare(request: CompareRequest, progress: Progress = SILENT) -> Compared:
    """Compare a project's model with its measurements.

    Raises:
        InputError: the model was not trained or exported yet, or the page cannot be written.
    """
    config, dataset = open_project(request.project, progress)
    progress("fitting")
    predictor = open_predictor(request.model, request.project)
    progress("comparing")
    comparison = compare_predictor(predictor, request.project, request.worst)
    progress("looking at what the logs can teach")
    advice = advise(config, dataset)
    firmware, _, note = read_firmware(config)
    if request.html is not None:
        pictures = draw_comparison(dataset, predictor.predict, comparison)
        page = render_page(f"{config.sensor_name}: model against measurements", pictures)
        write_text(request.html, page, config.directory)
    return Compared(
        predictor,
        comparison,
        review_logs(config, dataset),
        advice,
        firmware,
        note,
        state_uncertainty(config, firmware),
    )


def _open_physics(project: ProjectFolder, notes: tuple[str, ...] = ()) -> Predictor:
    model = fit_config(project.config, project.dataset, project.catalogue)
    held_out = hold_out(model, project.dataset)
    return Predictor(PHYSICS, model.predict, model, held_out, (*notes, *model.notes))


def _find_compensator(
    config: Config, catalogue: Catalogue
) -> tuple[Compensator | None, tuple[str, ...]]:
    """Return the trained compensator with a network, or None and why there is none to use."""
    is_there = (config.build_directory / "compensator.json").exists()
    if config.network.kind == "none" or not is_there:
        return None, ()
    try:
        compensator = Compensator.load(config.build_directory, catalogue)
        _refuse_other(compensator, config)
    except InputError as error:
        return None, (f"the trained network is not used: {error}",)
    return (compensator if compensator.network is not None else None), ()


def _refuse_other(compensator: Compensator, config: Config) -> None:
    """Refuse a compensator whose outputs or effects are not those of zerodrift.toml."""
    build = config.build_directory / "compensator.json"
    outputs = tuple(output.name for output in config.outputs)
    if compensator.outputs != outputs:
        raise InputError(
            f"{build}: was trained for the outputs {', '.join(compensator.outputs)}; {config.path} "
            f"has {', '.join(outputs)}. Run `zerodrift train`."
        )
    trained = sorted(
        (f.kind, f.term.signal, sorted((k, f.term.values[k]) for k in f.term.held))
        for f in compensator.physics.terms
    )
    wanted = sorted(
        (e.kind, e.options.get("signal", ""), sorted(e.held.items())) for e in config.effects
    )
    if [t[:2] for t in trained] != [w[:2] for w in wanted] or any(
        not set(w[2]) <= set(t[2]) for t, w in zip(trained, wanted, strict=True)
    ):
        raise InputError(
            f"{build}: was trained with the effects {', '.join(t[0] for t in trained) or 'none'}; "
            f"{config.path} has {', '.join(w[0] for w in wanted) or 'none'}, or holds other "
            "values. Run `zerodrift train`."
        )


def _open_network(compensator: Compensator) -> Predictor:
    return Predictor(
        NETWORK,
        compensator.predict,
        compensator.physics,
        notes=compensator.notes,
    )


def _open_integer(kind: str, compensator: Compensator, config: Config) -> Predictor:
    """Return the integer model, computed by its reference in Python or by its C on this host.

    Where coefficients lie in a block it is what the program computes with the unit's block.
    """
    # what builds firmware loads onnxruntime: 50 MB of address space, of which `--help` has 700
    from zerodrift.c_runtime.host import HostModel
    from zerodrift.codegen.generate import generate
    from zerodrift.tasks.deployed_block import find_deployed_block
    from zerodrift.verify.errors_told import predict_by_c

    model = load_model(config.build_directory / "model.json")
    block = find_deployed_block(config)
    notes = () if block is None else (block.note,)
    model = model if block is None else block.model
    physics = compensator.physics
    if kind == INTEGER:
        return Predictor(INTEGER, lambda run: predict_integer(model, run), physics, notes=notes)
    with tempfile.TemporaryDirectory(prefix="zerodrift-") as scratch:
        host = HostModel(model, generate(model), Path(scratch), observe=False)
    return Predictor(C, lambda run: predict_by_c(host, run), physics, notes=notes)
