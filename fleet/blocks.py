"""One program for a fleet and a block for each unit, from the units' integer models."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import CheckError
from zerodrift.base.files import make_directory
from zerodrift.base.journal import write_all
from zerodrift.base.ownership import MANIFEST, list_own, refuse_foreign, render_manifest
from zerodrift.blocks.block import BlockNotes, encode
from zerodrift.blocks.design import FILE_NAME, PROGRAM, BlockDesign, load_design, make_design
from zerodrift.blocks.files import refuse_same_serials, render_block
from zerodrift.c_runtime.host import HostModel, render_sources
from zerodrift.codegen.generate import GeneratedCode, compute_answers, generate_design
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.fleet.design import Design
from zerodrift.fleet.result import SensorOutcome
from zerodrift.verify.certificate import FILE_NAME as CERTIFICATE
from zerodrift.verify.certificate import certify_design
from zerodrift.verify.firmware import recheck
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

BLOCKS = "blocks"
"""Folder of the blocks, below that of the C."""
RANDOM_STEPS = 2000
"""Drawn inputs over which each unit's block is held against the reference, from rest and cold."""


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


def write_blocks(design: Design, outcomes: Sequence[SensorOutcome]) -> FleetBlocks:
    """Write one program and a block for each unit that has a result, all of them checked.

    A program that lies there already is kept; units that do not fit it have no block.

    Args:
        design: of the fleet.
        outcomes: of its units; those that the gate refused, or that failed, have no block.

    Raises:
        CheckError: the units have no common design, or the certificate does not hold.
        InputError: two units have the same serial, or a file that zerodrift did not write is there.
    """
    own = {
        outcome.sensor: load_model(design.build_folder(outcome.sensor) / "model.json")
        for outcome in outcomes
        if outcome.result is not None and (outcome.result.forced or not outcome.result.refused)
    }
    if not own:
        raise CheckError("no unit has a result, so that there is no design to make of them")
    refuse_same_serials((f"unit {sensor}", sensor) for sensor in own)
    folder = design.config.firmware_out / PROGRAM
    kept = folder / FILE_NAME
    common = load_design(kept) if kept.is_file() else make_design(list(own.values()))
    code = generate_design(common)
    blocks: dict[str, bytes] = {}
    refused: dict[str, str] = {}
    vectors, size, units = 0, 0, []
    with tempfile.TemporaryDirectory(prefix="zerodrift-blocks-") as scratch:
        host = HostModel(common.model, code, Path(scratch) / "host", observe=False)
        certificate = certify_design(common, code)
        recheck(code, certificate, Path(scratch))
        for sensor, model in own.items():
            try:
                unit = common.fit(model)
                content = encode(common, unit, _note(design, sensor), compute_answers(common, unit))
                vectors += check_block(host, unit, content)
            except CheckError as error:
                refused[sensor] = str(error)
                continue
            units.append(sensor)
            size = len(content)
            blocks |= render_block(common, content, sensor, design.config.block.address)
    files: dict[Path, bytes | None] = {}
    for place, contents in (
        (folder, _render(common, code, certificate)),
        (design.config.firmware_out / BLOCKS, blocks),
    ):
        files |= _list_files(place, contents, common.identity)
    write_all(design.directory, files)
    return FleetBlocks(common.identity, size, tuple(units), vectors, refused)


def _note(design: Design, sensor: str) -> BlockNotes:
    return BlockNotes(sensor, design.config.block.calibrated, design.config.block.number)


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


def check_block(host: HostModel, model: IntegerModel, content: bytes) -> int:
    """Return the steps at which program and block gave the bits of a unit's reference.

    Raises:
        CheckError: the chip's test refuses the block, its self-test fails, or a bit differs.
    """
    if (wrong := host.use_block(content)) or (wrong := host.selftest()):
        raise CheckError(f"the program refuses its block ({wrong}). Nothing written for this unit.")
    host.model = model
    vectors = 0
    for number, codes in enumerate(draw_sequences(model, RANDOM_STEPS).values()):
        check = check_host(host, codes, settled=number % 2 == 0)
        if check.mismatch is not None:
            raise CheckError(
                f"program and block differ from the reference: {check.mismatch}. Nothing written"
                " for this unit."
            )
        vectors += len(codes)
    return vectors
