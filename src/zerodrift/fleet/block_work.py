"""A few units in the one program, each with its block, in one process: bits, gate, uncertainty."""

import hashlib
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError
from zerodrift.base.records import render_sealed, to_dict
from zerodrift.blocks.block import BlockNotes, encode
from zerodrift.blocks.design import BlockDesign
from zerodrift.blocks.editions import Edition, number_block
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, compute_answers
from zerodrift.dataset.runs import Dataset
from zerodrift.export.compose import describe_compensator
from zerodrift.export.integer_model import FORCED, IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.fleet.result import (
    RESULT,
    SensorOutcome,
    SensorResult,
    TriedBlock,
    read_result,
    save_result,
)
from zerodrift.fleet.sensors import Design, configure_sensor
from zerodrift.fleet.work import (
    MODEL,
    PARAMETERS,
    Spooled,
    UnitBatch,
    add_firmware,
    check_bits,
    describe_sensor,
    refuse_unit_data,
    unspool,
)
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.train.compensator import Compensator
from zerodrift.verify.gate import judge_firmware
from zerodrift.verify.host_check import check_host
from zerodrift.verify.left_out import choose_judge
from zerodrift.verify.uncertainty import FILE_NAME as UNCERTAINTY
from zerodrift.verify.uncertainty import measure_firmware
from zerodrift.verify.vectors import draw_sequences

COLD_STEPS = 2000
"""Drawn inputs that program and block live through from cold, beside all those from rest."""


@dataclass(frozen=True)
class SharedProgram:
    """The one program of a fleet, as the processes that try blocks in it are given it."""

    common: BlockDesign
    code: GeneratedCode
    library: Path
    """Its host build; where this does not exist, as on another machine, it is built again."""


@dataclass(frozen=True)
class BlockRun:
    """The second pass over a fleet with blocks."""

    design: Design
    program: SharedProgram
    editions: Mapping[str, tuple[Edition, ...]]
    """Unit -> its blocks so far, which a block's sequence follows from."""


@dataclass(frozen=True)
class _Unit:
    """One unit that the first pass has fitted."""

    sensor: str
    config: Config
    result: SensorResult
    compensator: Compensator
    kept: Spooled
    own: IntegerModel
    """In its own format."""


def try_units(run: BlockRun, sensors: Sequence[str]) -> list[SensorOutcome]:
    """Return the outcomes of these units with program and block; each one's files are written.

    Args:
        run: what they share.
        sensors: units with a result of the first pass.
    """
    batch = UnitBatch(sensors)
    catalogue = load_catalogue(run.design.config.plugin_files)
    with tempfile.TemporaryDirectory(prefix="zerodrift-program-") as scratch:
        host = _open_host(run.program, Path(scratch))
        for sensor in sensors:
            outcome = batch.attempt(sensor, _try, run, host, sensor, catalogue)
            if outcome is not None:
                batch.outcomes[sensor] = outcome
    return batch.list()


def _open_host(program: SharedProgram, scratch: Path) -> HostModel:
    model, prefix = program.common.model, program.code.prefix
    if program.library.is_file():
        return HostModel.attach(model, prefix, program.library, "", observe=False)
    return HostModel(model, program.code, scratch, observe=False)


def _load(design: Design, sensor: str, catalogue: Catalogue) -> _Unit:
    folder = design.build_folder(sensor)
    config = configure_sensor(design.config, sensor)
    result = read_result((folder / RESULT).read_bytes())
    compensator = Compensator.load(folder, catalogue)
    kept = unspool(design, config, sensor, compensator, result.mark)
    own = kept.model or load_model(folder / MODEL)
    return _Unit(sensor, config, result, compensator, kept, own)


def _try(run: BlockRun, host: HostModel, sensor: str, catalogue: Catalogue) -> SensorOutcome:
    """Return a unit's outcome: compared bit for bit, judged by the gate, and written."""
    design, common = run.design, run.program.common
    unit = _load(design, sensor, catalogue)
    tried = replace(unit.result, program=common.identity)
    try:
        fitted = common.fit(unit.own)
    except CheckError as error:
        result = save_result(design.build_folder(unit.sensor), design.directory, tried, {})
        return SensorOutcome(unit.sensor, result, tried=TriedBlock(why_none=str(error)))
    notes = BlockNotes(sensor, design.config.block.calibrated, 1)  # the name is the serial number
    unnumbered = encode(common, fitted, notes, compute_answers(common, fitted))
    content = number_block(unnumbered, run.editions.get(sensor, ()), design.config.block)
    kept = unit.kept
    tried = replace(tried, vectors=compare_block(host, fitted, content, kept.dataset))
    judge = choose_judge(kept.left_out, kept.dataset)
    place = design.place(unit.config, unit.sensor)
    described = describe_compensator(unit.compensator, place, kept.dataset.train)
    verdict, replay = judge_firmware(described, host, kept.dataset, judge)
    against = refuse_unit_data(design, unit.config, kept.dataset)
    verdict = replace(verdict, refused=(*against, *verdict.refused))
    refused = tuple(statement.text for statement in verdict.refused)
    is_written = verdict.passes or design.force
    tried = replace(
        tried,
        outputs=add_firmware(tried.outputs, unit.compensator, kept.dataset, replay),
        refused=refused,
        forced=not verdict.passes and design.force,
        warnings=tuple(statement.text for statement in verdict.warnings),
        block=hashlib.sha256(content).hexdigest() if is_written else "",
    )
    files: dict[str, bytes] = {}
    described_unit = describe_sensor(design, tried, unit.compensator.physics)
    files[PARAMETERS] = (json.dumps(to_dict(described_unit), indent=1) + "\n").encode()
    if tried.forced:
        forced = replace(unit.own, notes={**unit.own.notes, FORCED: "\n".join(refused)})
        files[MODEL] = forced.to_text().encode()
    if is_written and kept.left_out is not None and design.uncertainty:
        rounding = [error.rounding for error in verdict.chip_error]
        measured = measure_firmware(
            described,
            unit.own,
            kept.dataset,
            kept.left_out,
            rounding,
            replay,
            [output.noise_floor for output in tried.outputs.values()],
        )
        files[UNCERTAINTY] = render_sealed(to_dict(measured))
    folder = design.build_folder(unit.sensor)
    contents = {folder / name: file for name, file in files.items()}
    result = save_result(folder, design.directory, tried, contents)
    block = TriedBlock(content) if is_written else TriedBlock()
    return SensorOutcome(unit.sensor, result, tried=block)


def compare_block(host: HostModel, fitted: IntegerModel, content: bytes, dataset: Dataset) -> int:
    """Return the steps at which program and block gave the bits of a unit's reference.

    Args:
        host: the program as it is flashed.
        fitted: the unit's model in the program's format.
        content: its block.
        dataset: its logs, all of which are gone through, and drawn inputs from rest and from cold.

    Raises:
        CheckError: the chip's test refuses the block, its self-test fails, or a bit differs.
    """
    if (wrong := host.use_block(content)) or (wrong := host.selftest()):
        raise CheckError(f"the program refuses its block ({wrong}). Nothing written for this unit.")
    host.model = fitted
    vectors = check_bits(host, dataset)
    codes = np.concatenate(list(draw_sequences(fitted, COLD_STEPS).values()))
    check = check_host(host, codes, settled=False)
    if check.mismatch is not None:
        raise CheckError(
            f"program and block differ from the reference: {check.mismatch}. Nothing written for"
            " this unit."
        )
    return vectors + check.steps
