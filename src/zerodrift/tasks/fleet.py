"""`fleet`: hundreds of sensors of one design, each to checked C, and the yield."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import load_config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.progress import SILENT, Progress
from zerodrift.dataset.chip_codes import DESIGN_FORMAT, list_unstated, require_design_lsb
from zerodrift.field.registry import FILE_NAME, Registry, open_registry
from zerodrift.fleet.blocks import FleetBlocks, NoProgramError, write_blocks
from zerodrift.fleet.parcels import at_hand
from zerodrift.fleet.report import (
    ERROR,
    FAIL,
    FleetReport,
    judge_fleet,
    summarise_report,
    write_report,
)
from zerodrift.fleet.result import SensorOutcome, SensorResult
from zerodrift.fleet.run import (
    Executor,
    FleetProgress,
    OverRay,
    Processes,
    Serial,
    import_ray,
    run_fleet,
)
from zerodrift.fleet.sensors import Design, configure_sensor
from zerodrift.fleet.summary import BlocksSummary, FleetSummary
from zerodrift.tasks.project import ProjectFolder, hold_own, place_firmware
from zerodrift.verify.manifest import hash_logs

# What a fleet's run adds to the registry: each unit's calibration, its logs and its block.


def enter_fleet(design: Design, outcomes: Sequence[SensorOutcome]) -> None:
    """Enter the units that went through into the registry beside zerodrift.toml, if there is one.

    A unit without firmware, or whose firmware was refused, has no calibration to enter.

    Raises:
        InputError: the registry cannot be written, or a unit is of another design there.
    """
    path = design.directory / FILE_NAME
    if not path.is_file():
        return
    with open_registry(path) as registry:
        known = {(unit.serial, unit.model_hash) for unit in registry.list_units()}
        for outcome in outcomes:
            result = outcome.result
            if result is None or not result.model_hash or (result.refused and not result.forced):
                continue
            if (outcome.sensor, result.model_hash) not in known:
                _enter_calibration(registry, design, outcome.sensor, result)
            if outcome.tried is not None and outcome.tried.content:
                registry.add_block(outcome.sensor, outcome.tried.content, result.model_hash)


def _enter_calibration(
    registry: Registry, design: Design, sensor: str, result: SensorResult
) -> None:
    with at_hand(design, sensor) as near:
        logs = hash_logs(configure_sensor(near.config, sensor))
    registry.add_calibration(
        sensor,
        design.config.sensor_name,
        result.model_hash,
        tuple((sha256, name) for name, sha256 in logs.items()),
    )


# `fleet`: hundreds of sensors of one design, each to checked C, and the yield.

DEVICES = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class FleetRequest:
    """How a fleet is worked on."""

    project: ProjectFolder
    jobs: int | None = None
    """Processes on this machine; None: one per core, 1 with a GPU."""
    batch: int | None = None
    """Sensors that are compiled, and trained, together; None: as many as are worth it."""
    with_firmware: bool = True
    """Generate and check each sensor's C."""
    force: bool = False
    """Write what the gate refuses."""
    fresh: bool = False
    """Compute every sensor anew, kept results too."""
    device: str = "auto"
    """What trains the networks, one of `DEVICES`."""
    over_ray: bool = False
    """Work over Ray instead of `jobs` alone."""
    ray_address: str | None = None
    """Of a running cluster."""
    uncertainty: bool = True
    """Fit each sensor again without some of its runs, for the uncertainty."""
    out: Path | None = None
    """The firmware folder, in place of that of `[firmware] out`."""


@dataclass(frozen=True)
class FleetOutcome:
    """A fleet that was worked on."""

    result: FleetSummary
    report: FleetReport
    files: tuple[Path, ...]
    blocks: FleetBlocks | None
    """With `[firmware] coefficients = "block"`: the one program, and each unit's block."""
    no_program: NoProgramError | None
    """Why there is no such program."""

    @property
    def fails(self) -> bool:
        """Whether a sensor has no result, is refused and not forced, or exceeds a limit."""
        refused = self.blocks is not None and bool(self.blocks.refused)
        return bool(self.report.count(ERROR) or self.report.count(FAIL) or refused)


def calibrate_fleet(request: FleetRequest, progress: Progress = SILENT) -> FleetOutcome:
    """Calibrate all sensors of one design: fit, train, generate, check, and judge.

    Raises:
        CheckError: the check of the program for all fails.
        InputError: the design is wrong, or no sensor is found.
    """
    directory = request.project.directory
    with hold_own(directory):
        config = place_firmware(load_config(directory), request.out)
        place = choose_device(request.device, config.network.kind != "none")
        jobs = request.jobs or (1 if place != "cpu" else os.cpu_count() or 1)
        design = Design(
            config,
            request.with_firmware,
            request.project.skip_invalid,
            place,
            request.force,
            request.uncertainty,
        )
        executor: Executor
        if request.over_ray or request.ray_address:
            import_ray()
            executor = OverRay(request.ray_address, jobs)
        else:
            executor = Processes(jobs) if jobs > 1 else Serial()
        for name in list_unstated(config):
            if config.format >= DESIGN_FORMAT:
                require_design_lsb(config, name)
            progress.note(
                f"the codes of '{name}' follow from each unit's own logs, so that one may be"
                " worth something else from unit to unit; `zerodrift init --upgrade` writes down"
                " one for all"
            )
        reached: FleetProgress | None = None
        blocks, no_program = None, None

        def tell(p: FleetProgress) -> None:
            nonlocal reached
            reached = p
            told = [f"{p.kept} kept"] * bool(p.kept) + [f"{p.failed} failed"] * bool(p.failed)
            count(p.done, p.total, ", ".join(told))

        size = request.batch
        try:
            with (
                progress.count("sensors") as count,
                _open_spool(design) as design,
                closing(executor),
            ):
                outcomes = run_fleet(
                    design, executor, jobs=jobs, batch=size, fresh=request.fresh, report=tell
                )
                if design.in_block:
                    try:
                        outcomes, blocks = write_blocks(
                            design, executor, outcomes, jobs=jobs, batch=size, report=tell
                        )
                    except NoProgramError as error:
                        outcomes, no_program = error.outcomes, error
        except (KeyboardInterrupt, CheckError):
            progress.tell(_explain_stop(reached))
            raise
        if no_program is None:
            enter_fleet(design, outcomes)
        report = judge_fleet(design, outcomes)
        files = tuple(write_report(design, report))
    result = summarise_report(report)
    if blocks is not None:
        told = BlocksSummary(
            blocks.program, blocks.bytes, len(blocks.units), blocks.vectors, blocks.refused
        )
        result = replace(result, blocks=told)
    return FleetOutcome(result, report, files, blocks, no_program)


def _explain_stop(p: FleetProgress | None) -> str:
    """Return what is kept, and how to go on."""
    if p is None:
        return "stopped before the first sensor was done"
    return (
        f"stopped: {p.done - p.failed} of {p.total} sensors are done and kept; the same command"
        " goes on with the others"
    )


def choose_device(device: str, needed: bool) -> str:
    """Return where networks are trained.

    Raises:
        InputError: a GPU is asked for and PyTorch has none.
    """
    if not needed or device == "cpu":
        return "cpu"
    import torch  # takes seconds to be loaded

    there = torch.cuda.is_available()
    if device == "cuda" and not there:
        raise InputError(
            "--device cuda: PyTorch finds no GPU here; expected one. Leave the option out to train"
            " on the CPU."
        )
    return "cuda" if there else "cpu"


@contextmanager
def _open_spool(design: Design) -> Iterator[Design]:
    """Yield the design with a folder for what its second pass needs, where it has one."""
    if not design.in_block:
        yield design
        return
    with tempfile.TemporaryDirectory(prefix="zerodrift-fleet-") as folder:
        yield replace(design, spool=Path(folder))
