"""One program for a fleet and a block for each unit, from the units' integer models."""

import hashlib
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.files import MANIFEST, list_own, make_directory, refuse_foreign, render_manifest
from zerodrift.base.journal import write_all
from zerodrift.blocks.design import FILE_NAME, PROGRAM, BlockDesign, load_design, make_design
from zerodrift.blocks.editions import FILE_NAME as UNITS
from zerodrift.blocks.editions import number_block, render_units
from zerodrift.blocks.files import refuse_same_serials, render_block
from zerodrift.c_runtime.host import HostModel, render_sources
from zerodrift.codegen.generate import GeneratedCode, generate_design
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.field.registry import find_editions
from zerodrift.fleet.block_work import BlockRun, SharedProgram
from zerodrift.fleet.result import SensorOutcome, TriedBlock
from zerodrift.fleet.run import Executor, FleetProgress, cut_batches
from zerodrift.fleet.sensors import Design
from zerodrift.fleet.work import MODEL
from zerodrift.verify.certificate import FILE_NAME as CERTIFICATE
from zerodrift.verify.certificate import certify_design
from zerodrift.verify.firmware import recheck

BLOCKS = "blocks"
"""Folder of the blocks, below that of the C."""


@dataclass(frozen=True)
class FleetBlocks:
    """What was written."""

    program: str
    """The design's identity."""
    bytes: int
    """Of each block."""
    units: tuple[str, ...]
    """That have a block."""
    vectors: int
    """Steps at which program and block gave the reference's bits."""
    refused: Mapping[str, str]
    """Units without a block, and why."""


class NoProgramError(CheckError):
    """The units have no design in common, or none of them may have a block."""

    def __init__(self, message: str, outcomes: Iterable[SensorOutcome]) -> None:
        """Take why, and what is known of the units."""
        super().__init__(message)
        self.outcomes = tuple(outcomes)


def write_blocks(
    design: Design,
    executor: Executor,
    outcomes: Sequence[SensorOutcome],
    *,
    jobs: int = 1,
    batch: int | None = None,
    report: Callable[[FleetProgress], None] = lambda _: None,
) -> tuple[tuple[SensorOutcome, ...], FleetBlocks]:
    """Write one program and a block for each unit that passes in it; return what became of them.

    Each unit's program and block are compared with its reference, and the gate judges them, in the
    executor's processes. A program that lies there already is kept, and units that do not fit it
    have no block. A new one is made of the units that pass; those that the gate refused in a design
    of all units are tried again in that of the others.

    Args:
        design: of the fleet.
        executor: where blocks are tried.
        outcomes: of the units, from the first pass.
        jobs: processes that want work at the same time.
        batch: units in a batch; by default as many as are worth it.
        report: called whenever a batch is done.

    Raises:
        NoProgramError: the units have no common design, or none passes.
        CheckError: the certificate does not hold, or the executor was lost.
        InputError: two units have the same serial, or a file that zerodrift did not write is there.
    """
    found = {outcome.sensor: outcome for outcome in outcomes}
    own = {
        sensor: outcome.model or load_model(design.build_folder(sensor) / MODEL)
        for sensor, outcome in found.items()
        if outcome.result is not None
    }
    refuse_same_serials((f"unit {sensor}", sensor) for sensor in own)
    folder = design.config.firmware_out / PROGRAM
    kept = folder / FILE_NAME
    members = own
    editions = find_editions(design.directory, (_find_block(design, sensor) for sensor in own))
    with tempfile.TemporaryDirectory(prefix="zerodrift-blocks-") as scratch:
        common: BlockDesign | None = None
        while True:
            earlier, common = common, _find_common(kept, members, found)
            if earlier is not None and earlier.identity == common.identity:
                break
            place = Path(scratch) / common.identity
            code = generate_design(common)
            host = HostModel(common.model, code, place, observe=False)
            certificate = certify_design(common, code)
            recheck(code, certificate, place)
            run = BlockRun(design, SharedProgram(common, code, host.library), editions)
            left = [s for s in own if not _is_kept(run, found[s])]
            found |= {s: _keep(run, found[s]) for s in own if s not in left}
            found |= _try(run, executor, cut_batches(left, jobs, batch), found, report)
            passing = {s: own[s] for s in own if _has_block(found[s])}
            if earlier is not None or kept.is_file() or passing.keys() == members.keys():
                break
            members = passing
    blocks: dict[str, bytes] = {}
    tried = {s: o.tried for s in own if (o := found[s]).tried is not None}
    for sensor, block in tried.items():
        if block.content:
            blocks |= render_block(common, block.content, sensor, design.config.block.address)
    files: dict[Path, bytes | None] = {}
    for place, contents in (
        (folder, _render(common, code, certificate)),
        (design.config.firmware_out / BLOCKS, blocks),
    ):
        files |= _list_files(place, contents, common.identity)
    written = [block.content for block in tried.values() if block.content]
    files[design.directory / UNITS] = render_units(design.directory, written)
    write_all(design.directory, files)
    results = [r for s in own if _has_block(found[s]) and (r := found[s].result) is not None]
    return tuple(found.values()), FleetBlocks(
        common.identity,
        max(map(len, written), default=0),
        tuple(result.sensor for result in results),
        sum(result.vectors for result in results),
        {sensor: block.why_none for sensor, block in tried.items() if block.why_none},
    )


def _find_common(
    kept: Path, members: Mapping[str, IntegerModel], found: Mapping[str, SensorOutcome]
) -> BlockDesign:
    """Return the design that lies there, or that of the units that may have a block."""
    if kept.is_file():
        return load_design(kept)
    if not members:
        message = "no unit has a result, so that there is no design to make of them"
        raise NoProgramError(message, found.values())
    try:
        return make_design(list(members.values()))
    except CheckError as error:
        raise NoProgramError(str(error), found.values()) from error


def _has_block(outcome: SensorOutcome) -> bool:
    return outcome.tried is not None and bool(outcome.tried.content)


def _is_kept(run: BlockRun, outcome: SensorOutcome) -> bool:
    """Tell whether a unit was tried in this program before, and its block lies there unchanged."""
    result = outcome.result
    if not outcome.kept or result is None or result.program != run.program.common.identity:
        return False
    if not result.block:
        return bool(result.refused)
    try:
        content = _find_block(run.design, outcome.sensor).read_bytes()
        known = run.editions.get(outcome.sensor, ())
        same = number_block(content, known, run.design.config.block) == content
    except (OSError, InputError):
        return False
    return same and hashlib.sha256(content).hexdigest() == result.block


def _keep(run: BlockRun, outcome: SensorOutcome) -> SensorOutcome:
    """Return the outcome of a unit that was tried before."""
    assert outcome.result is not None
    has_block = bool(outcome.result.block)
    content = _find_block(run.design, outcome.sensor).read_bytes() if has_block else b""
    return replace(outcome, tried=TriedBlock(content))


def _find_block(design: Design, sensor: str) -> Path:
    return design.config.firmware_out / BLOCKS / f"{sensor}.bin"


def _try(
    run: BlockRun,
    executor: Executor,
    batches: Sequence[tuple[str, ...]],
    before: Mapping[str, SensorOutcome],
    report: Callable[[FleetProgress], None],
) -> dict[str, SensorOutcome]:
    """Return the outcomes of units with program and block, and tell how far that is."""
    tried: dict[str, SensorOutcome] = {}
    kept = len(before) - sum(map(len, batches))
    failed = sum(outcome.result is None for outcome in before.values())
    if not batches:
        return tried
    with closing(executor.run(run, batches)) as found:
        for part in found:
            for outcome in part:
                was_kept = before[outcome.sensor].kept and outcome.result is not None
                tried[outcome.sensor] = replace(outcome, kept=was_kept)
            lost = failed + sum(outcome.result is None for outcome in tried.values())
            report(FleetProgress(kept + len(tried), len(before), kept, lost))
    return tried


def _render(common: BlockDesign, code: GeneratedCode, certificate: str) -> dict[str, bytes]:
    texts = {**render_sources(code), CERTIFICATE: certificate, FILE_NAME: common.to_text()}
    return {name: text.encode() for name, text in texts.items()}


def _list_files(place: Path, contents: Mapping[str, bytes], identity: str) -> dict[Path, bytes]:
    """Return files and the manifest of a folder, in which what lies there already stays listed.

    Raises:
        InputError: a file that zerodrift did not write is there.
    """
    make_directory(place)
    refuse_foreign((place / name for name in (*contents, MANIFEST)), place)
    earlier = (name for name in list_own(place) - {MANIFEST} if (place / name).is_file())
    listed = {name: (place / name).read_bytes() for name in earlier} | dict(contents)
    files = {place / name: content for name, content in contents.items()}
    return files | {place / MANIFEST: render_manifest(listed, model=identity)}
