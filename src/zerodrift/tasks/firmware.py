"""`firmware`: logs in, or a network from elsewhere; host-checked C out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift.base.arrays import Array
from zerodrift.base.config import FILE_NAME, Config, parse_config
from zerodrift.base.errors import InputError
from zerodrift.base.files import show_path
from zerodrift.base.journal import change_together, write_all
from zerodrift.base.progress import SILENT, Progress, Stage
from zerodrift.base.records import render_sealed, to_dict
from zerodrift.blocks.files import BLOCK
from zerodrift.c_runtime.host import render_sources
from zerodrift.dataset.guess import guess_project
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.selectors import expand_selectors, list_files, order_path
from zerodrift.export.compose import describe_compensator, describe_imported
from zerodrift.export.error_bound import ErrorBound, round_up
from zerodrift.export.float_model import FloatModel
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.onnx_reader import read_imported
from zerodrift.field.registry import find_editions
from zerodrift.fleet.sensors import load_unit
from zerodrift.tasks.built import FIRMWARE
from zerodrift.tasks.init import write_config
from zerodrift.tasks.project import (
    ProjectFolder,
    hold_own,
    open_project,
    place_firmware,
    refuse_shared_program,
)
from zerodrift.tasks.train import refuse_wrong_data, train_project
from zerodrift.tasks.trust import remember_code
from zerodrift.train.compensator import Compensator
from zerodrift.train.prepare import Handling
from zerodrift.train.refits import Original
from zerodrift.verify.errors_told import summarise_conversions
from zerodrift.verify.firmware import Firmware, GateRequest, build_firmware
from zerodrift.verify.left_out import LeftOut, choose_judge, leave_out, leave_out_together
from zerodrift.verify.summary import (
    REFUSED,
    BudgetSummary,
    Claims,
    ErrorCauses,
    FirmwareSummary,
    NodeShare,
    ProvenError,
    Refusal,
    StackSummary,
    StageErrors,
    TimeShare,
)
from zerodrift.verify.uncertainty import FILE_NAME as UNCERTAINTY
from zerodrift.verify.uncertainty import measure_firmware

if TYPE_CHECKING:
    pass


# A network from elsewhere, in an ONNX file, as the compensator of a project.


@dataclass(frozen=True)
class OnnxRequest:
    """Which network is imported, and how it is to be read."""

    path: Path
    calibrate: tuple[Path, ...] = ()
    """The logs that set the ranges of the integers; none: [logs] train."""
    features: tuple[str, ...] = ()
    """The network's inputs in order, of temperature and [inputs]; none: as its file says."""
    memory: str | int | None = None
    """Carry the state ("stream"), or windows of so many samples; None: as its file says."""
    output: str | None = None
    """The graph output to take; None: its only one."""


def open_import(
    request: OnnxRequest, project: ProjectFolder
) -> tuple[Config, Dataset, FloatModel, list[str]]:
    """Return the project, its logs, the network as a float model, and notes for the user.

    Without a zerodrift.toml the project is guessed from the logs, as `init` does.

    Raises:
        InputError: the network, the project or a log cannot be read, or they do not fit together.
    """
    imported = read_imported(request.path, request.output)
    config, notes = _open_config(request.calibrate, project.directory, project.sensor)
    dataset = load_dataset(config, project.skip_invalid)
    model, more = describe_imported(
        imported, config, dataset.train, request.features, request.memory
    )
    if config.effects or config.network.kind != "none":
        notes.append(
            "the network of the file is the whole compensator; the effects and [network] of"
            f" {config.path.name} are not part of it."
        )
    if dataset.test:
        notes.append("the file does not say whether its network was trained on the test logs.")
    return config, dataset, model, notes + more


def _open_config(
    calibrate: Sequence[Path], directory: Path, sensor: str | None
) -> tuple[Config, list[str]]:
    logs = [path.absolute() for path in _find_logs(calibrate, directory)]
    for path in logs:
        if not path.is_file():
            raise InputError(
                f"--calibrate: {path}: there is no such log; expected a CSV or Parquet file, or a"
                " folder of them."
            )
    selectors = [str(path) for path in logs]
    if sensor is None and not (directory / FILE_NAME).exists():
        if not logs:
            raise InputError(
                f"{directory / FILE_NAME}: there is no such file, and no logs by --calibrate;"
                " expected one or the other. `zerodrift init LOG...` writes the file."
            )
        guess = guess_project(logs)
        text = write_config(guess, {"train": selectors, "test": [], "dwell": []})
        config = parse_config(text, (directory / FILE_NAME).absolute())
        outputs = ", ".join(f"{o.name} in {o.unit}" for o in config.outputs)
        notes = [f"no {FILE_NAME}: outputs ({outputs}) and inputs are guessed from the logs"]
        return replace(config, effects=()), notes + [f"check: {check}" for check in guess.checks]
    config = load_unit(directory, sensor)
    if not logs:
        return config, []
    config = replace(config, train_logs=tuple(selectors))
    tested = {selection.path.resolve() for selection in expand_selectors(config, "test")}
    if tested & {path.resolve() for path in logs}:
        note = "the test logs are among those calibrated on; errors are those of the latter"
        return replace(config, test_logs=()), [note]
    return config, []


def _find_logs(logs: Sequence[Path], directory: Path) -> list[Path]:
    """Return the files named, and those of each directory named, sorted by name."""
    paths: list[Path] = []
    for log in logs:
        place = log if log.exists() else directory / log
        found = list_files(place)
        if not found:
            raise InputError(f"{place}: holds no log; expected CSV or Parquet files.")
        paths += found
    return sorted(set(paths), key=lambda path: order_path(path, directory))


# `firmware`: logs in, or a network from elsewhere; host-checked C out.

NO_TRAINING = (
    "no uncertainty is stated: it comes from models that left a training run out, and a network"
    " from an ONNX file cannot be trained again here"
)


@dataclass(frozen=True)
class FirmwareRequest:
    """What firmware is wanted, and where."""

    project: ProjectFolder
    force: bool = False
    """Write what the gate, or the referee of the logs, refuses; header and manifest say so."""
    uncertainty: bool = True
    """Fit, or train, again without some of the training runs, for the uncertainty."""
    out: Path | None = None
    """The firmware folder, in place of that of `[firmware] out`."""
    onnx: OnnxRequest | None = None
    """A network from elsewhere, in place of one that is trained."""


@dataclass(frozen=True)
class FirmwareOutcome:
    """Firmware that was built and, unless the gate refused it, written."""

    result: FirmwareSummary
    firmware: Firmware
    config: Config

    @property
    def refusal(self) -> str:
        """Why the gate refuses it; empty where it was written."""
        return "" if self.firmware.files else self.firmware.gate.explain()


def make_firmware(request: FirmwareRequest, progress: Progress = SILENT) -> FirmwareOutcome:
    """Train if needed, quantize, generate C, check it, and write it if the gate accepts it.

    Raises:
        CheckError: a bit differs, a claim of the certificate does not hold, or the logs are wrong
            and nobody said to go on.
        InputError: zerodrift.toml, a log or the ONNX file is missing or wrong.
    """
    project, onnx = request.project, request.onnx
    refuse_shared_program(project)
    import_module("zerodrift.verify.checkers")  # told before anything is trained
    with hold_own(project.directory):
        notes: list[str] = []
        described = None
        if onnx is not None:
            config, dataset, described, notes = open_import(onnx, project)
        else:
            config, dataset = open_project(project, progress)
        for note in (*dataset.notes, *notes):
            progress.note(note)
        config = place_firmware(config, request.out)
        against = refuse_wrong_data(config, dataset, force=request.force, keep=True)
        left, why = None, NO_TRAINING
        if described is None:
            compensator = train_project(config, dataset, progress)
            described = describe_compensator(compensator, config, dataset.train)
            left, why = leave_runs_out(config, dataset, compensator, request.uncertainty, progress)
        if why:
            progress.note(why)
        with change_together(config.directory):
            progress("quantizing")
            firmware = build_firmware(
                config,
                dataset,
                described,
                progress,
                gate_request=GateRequest(choose_judge(left, dataset), against, request.force),
                network=(onnx.path.absolute(),) if onnx is not None else (),
                editions=find_editions(config.directory, (config.firmware_out / f"{BLOCK}.bin",)),
            )
            result = summarise(firmware, config.directory)
            keep(result, config)
            if firmware.files:
                remember_code(render_sources(firmware.code))
                stated = None if why else left
                keep_uncertainty(firmware, config, dataset, described, stated)
    return FirmwareOutcome(result, firmware, config)


def leave_runs_out(
    config: Config,
    dataset: Dataset,
    compensator: Compensator,
    wanted: bool = True,
    progress: Progress = SILENT,
) -> tuple[LeftOut | None, str]:
    """Return predictions for training runs by models that did not learn from them.

    Networks are trained again without a part of the runs each, all of them in parallel; finished
    parts stay in build/ and are not repeated.

    Args:
        config: the project.
        dataset: its runs.
        compensator: trained on all training runs.
        wanted: False: only models that are quick to fit are fitted again, for the gate.
        progress: is told how far it is.

    Returns:
        The predictions, and why no uncertainty is to be stated by them; empty where one is.
    """
    if not wanted:
        quick = leave_out(config, dataset, compensator)
        return quick, "no uncertainty is stated, as --no-uncertainty asks"
    with progress.measure("leaving runs out") as report:
        report(Stage(0.0, "fitting physics"))
        handling = Handling(folder=config.build_directory, report=report)
        (found,) = leave_out_together([Original(config, dataset, compensator)], handling)
    if isinstance(found, InputError):
        return None, f"no uncertainty is stated: {found}"
    return found, ""


def keep_uncertainty(
    firmware: Firmware,
    config: Config,
    dataset: Dataset,
    described: FloatModel,
    left: LeftOut | None,
) -> None:
    """Write build/uncertainty.json where some model left runs out; remove it where none did."""
    path = config.build_directory / UNCERTAINTY
    if left is None:
        write_all(config.directory, {path: None})
        return
    rounding = [error.rounding for error in firmware.gate.chip_error]
    measured = measure_firmware(described, firmware.model, dataset, left, rounding, firmware.replay)
    write_all(config.directory, {path: render_sealed(to_dict(measured))})


def summarise(firmware: Firmware, directory: Path) -> FirmwareSummary:
    """Return the record that the command prints as JSON."""
    size, chip, errors = firmware.footprint, firmware.chip, firmware.errors
    untuned = {e.name: e.integer_model for e in firmware.untuned} if firmware.untuned else None
    return FirmwareSummary(
        bit_exact=firmware.check.failure is None,
        vectors=firmware.check.vectors,
        backends=(*firmware.check.backends, *([chip.core] if chip else [])),
        flash_bytes=size.flash_bytes,
        ram_bytes=size.ram_bytes,
        stack_bytes=size.stack_bytes,
        stack=StackSummary(size.compiler, tuple(size.flags), dict(size.stacks)),
        core=size.core,
        instructions_per_step={chip.core: chip.instructions_per_step} if chip else {},
        rmse=StageErrors(
            uncompensated={e.name: e.uncompensated for e in errors},
            physics={e.name: e.physics for e in errors if e.physics is not None} or None,
            float={e.name: e.float_model for e in errors},
            integer={e.name: e.integer_model for e in errors},
            integer_not_fine_tuned=untuned,
        ),
        bias={e.name: e.integer_bias for e in errors},
        rmse_integer_to_float={e.name: e.integer_to_float for e in errors},
        error_budget=summarise_budget(firmware),
        rmse_pct_fs={e.name: e.percent_of_full_scale for e in errors},
        explained={e.name: e.explained for e in errors},
        units={e.name: e.unit for e in errors},
        held_out=firmware.held_out,
        tared=firmware.tared,
        runs=tuple(firmware.error_runs),
        model_hash=firmware.model.hash,
        certificate=Claims(firmware.certificate.holds),
        gate=firmware.gate.method,
        chip_error={
            e.name: split for e, split in zip(errors, firmware.gate.chip_error, strict=True)
        },
        warnings=firmware.gate.warnings,
        refused=firmware.gate.refused,
        forced=bool(firmware.forced),
        written=bool(firmware.files),
        files=tuple(show_path(path, directory) for path in firmware.files),
        error_bound=summarise_bound(firmware.bound, firmware.model),
        conversions=summarise_conversions(firmware.model) or None,
    )


def summarise_bound(bound: ErrorBound, model: IntegerModel) -> dict[str, ProvenError]:
    """Return the proven error bound of every output."""
    if not bound.outputs:
        return {o.name: ProvenError(value=None, unit=o.unit, why=bound.why) for o in model.outputs}
    return {
        output.name: ProvenError(
            value=round_up(error.total),
            unit=output.unit,
            holds=bound.holds,
            why=bound.why,
            causes=ErrorCauses(*map(round_up, error.parts())),
        )
        for output, error in zip(model.outputs, bound.outputs, strict=True)
    }


def summarise_budget(firmware: Firmware) -> BudgetSummary:
    """Return the error by its causes."""

    def name(values: "Array") -> dict[str, float]:
        return {e.name: float(v) for e, v in zip(firmware.errors, values, strict=True)}

    budget = firmware.budget
    return BudgetSummary(
        float_to_measured={e.name: e.float_model for e in firmware.errors},
        integer_to_float=name(budget.total),
        nodes=tuple(NodeShare(n.node, n.kind, name(n.rms)) for n in budget.nodes),
        over_time=tuple(
            TimeShare(s.first_step, s.last_step, name(s.rms)) for s in budget.over_time
        ),
    )


def keep(result: FirmwareSummary, config: Config) -> None:
    """Write the result to build/, for the report.

    For firmware that was written, the command's JSON goes to firmware.json. For refused firmware
    the gate's reasons go to refused.json; firmware.json keeps the JSON of the last one written.
    """
    build = config.build_directory
    if result.written:
        files = {build / FIRMWARE: render_sealed(to_dict(result)), build / REFUSED: None}
    else:
        refusal = Refusal(model_hash=result.model_hash, refused=result.refused)
        files = {build / REFUSED: render_sealed(to_dict(refusal))}
    write_all(config.directory, files)
