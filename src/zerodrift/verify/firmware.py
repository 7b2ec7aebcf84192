"""The second half of `firmware`: quantize, generate, check bit for bit, measure the errors,
write."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift.base.arrays import Mask
from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError
from zerodrift.base.files import list_own, refuse_foreign
from zerodrift.base.journal import write_all
from zerodrift.base.lock import make_scratch
from zerodrift.base.records import to_dict
from zerodrift.blocks.block import BlockNotes
from zerodrift.blocks.design import FILE_NAME as DESIGN
from zerodrift.blocks.design import load_design, make_design
from zerodrift.blocks.editions import FILE_NAME as UNITS
from zerodrift.blocks.editions import Edition, number_block, render_units
from zerodrift.blocks.files import BLOCK, BLOCK_FILES, render_block
from zerodrift.c_runtime.compilers import find_compiler
from zerodrift.c_runtime.footprint import Footprint, measure_footprint
from zerodrift.c_runtime.host import HostModel, render_sources, write_sources
from zerodrift.codegen.application import render_dbc
from zerodrift.codegen.generate import (
    GeneratedCode,
    generate,
    generate_design,
    generate_unit,
)
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.baselines import fit_constant
from zerodrift.export.compose import (
    calibrate,
    compose_integer_model,
    compose_quantized,
    encode_inputs,
)
from zerodrift.export.error_bound import ErrorBound, bound_errors
from zerodrift.export.fine_tune import load_or_tune
from zerodrift.export.float_model import FloatModel
from zerodrift.export.golden import GoldenVectors, compute_golden
from zerodrift.export.integer_model import FORCED, IntegerModel
from zerodrift.export.integer_onnx import build_integer_onnx
from zerodrift.export.quantize import Quantized
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.physics.summary import ModelSummary
from zerodrift.verify.certificate import FILE_NAME as CERTIFICATE
from zerodrift.verify.certificate import certify, certify_design
from zerodrift.verify.chip_check import ChipCheck, check_chip
from zerodrift.verify.chip_error import ChipReplay, ErrorBudget, measure_budget
from zerodrift.verify.errors_told import OutputError, tell_errors
from zerodrift.verify.firmware_check import FirmwareCheck, check_firmware
from zerodrift.verify.gate import GateVerdict, judge_firmware
from zerodrift.verify.left_out import LeftOut
from zerodrift.verify.manifest import FILE_NAME as MANIFEST
from zerodrift.verify.manifest import write_manifest
from zerodrift.verify.summary import Statement
from zerodrift.verify.vectors import draw_golden, draw_sequences

if TYPE_CHECKING:
    from zerodrift.verify.checkers import CertificateOutcome

Progress = Callable[[str], None]

LEAST_VECTORS = 100_000
"""Steps compared at least; the logs are part of them."""
LONGEST_LOG_STEPS = 20_000
CORE = "cortex-m4"
IN_A_BLOCK = "the numbers lie in a block, and the check of this bound reads those of the C"
"""Why nothing is proven of the distance from the float model."""
MODEL, EFFECTS = "model.json", "effects.json"
"""In the firmware's folder: the integer model, and its effects in words."""


@dataclass(frozen=True)
class Firmware:
    """The firmware that was built, with its checks and errors."""

    model: IntegerModel
    code: GeneratedCode
    check: FirmwareCheck
    errors: tuple[OutputError, ...]
    untuned: tuple[OutputError, ...]
    """The same with 8-bit weights that are only rounded, not fine-tuned; empty for 16-bit ones."""
    budget: ErrorBudget
    """Which operations the integer model's error comes from, and how it goes on in time."""
    error_runs: tuple[str, ...]
    """Runs behind the errors."""
    held_out: bool
    """Whether none of those runs was trained on."""
    tared: bool
    """Whether each run's own offset was taken off the errors."""
    footprint: Footprint
    chip: ChipCheck | None
    """On the emulated core; None where unicorn is not installed."""
    certificate: "CertificateOutcome"
    """Result of the independent check of the certificate."""
    bound: ErrorBound
    """Proven bound on the distance of the answers from the float model's, where there is one."""
    gate: GateVerdict
    """Whether the firmware is good enough on held-out runs."""
    replay: ChipReplay
    """The runs that were judged, with the answers of chip and float model."""
    forced: tuple[str, ...]
    """Reasons of the gate that `--force` has overridden."""
    files: tuple[Path, ...]
    """Written beside the C; empty where the gate refused."""


@dataclass(frozen=True)
class GateRequest:
    """What the gate weighs beside the firmware itself."""

    left_out: LeftOut | None = None
    """Without test runs, predictions for runs by models that did not learn from them."""
    against: tuple[Statement, ...] = ()
    """What was found against the logs, before the gate is asked."""
    force: bool = False
    """Write what is refused, and mark the C with it."""


def build_firmware(
    config: Config,
    dataset: Dataset,
    described: FloatModel,
    progress: Progress = lambda _: None,
    *,
    gate_request: GateRequest = GateRequest(),
    network: tuple[Path, ...] = (),
    editions: Mapping[str, tuple[Edition, ...]] | None = None,
) -> Firmware:
    """Build the firmware of a float model and write it, if all bits agree and the gate lets
    it pass.

    Args:
        config: the project; says where the C goes.
        dataset: its logs; the test runs are the held-out ones.
        described: the float model.
        progress: called with a description of each stage of the work.
        gate_request: what the gate weighs beside the firmware, and whether it decides.
        network: the ONNX file that the network comes from.
        editions: serial number -> blocks of that unit so far; a sequence follows from them.

    Returns:
        What was built; without files where the gate refused.

    Raises:
        CheckError: no safe format, the C differs from the reference, or the certificate does not
            hold; nothing is written then.
    """
    progress("quantizing")
    quantized, rounded = _compose(config, dataset, described, progress)
    model, code = make_code(config, quantized.model, editions or {})
    sequences = list_sequences(model, dataset)
    with make_scratch(config.directory) as scratch:
        check = check_firmware(model, code, sequences, scratch, progress).require()
        progress(f"running on an emulated {CORE}")
        chip = check_chip(CORE, code, check.host, sequences, scratch / "chip")
        progress("measuring errors and sizes")
        runs = dataset.test or dataset.train
        gate, replay = judge_firmware(described, check.host, dataset, gate_request.left_out)
        gate = replace(gate, refused=(*gate_request.against, *gate.refused))
        forced = tuple(statement.text for statement in gate.refused) if gate_request.force else ()
        if forced:
            model, code = _mark_forced(model, code, "\n".join(forced))
        mean = fit_constant(dataset, tared=described.tared)
        constant = mean.held_out if dataset.test else mean.fitted
        errors = tell_errors(described, check.host, runs, constant)
        untuned: tuple[OutputError, ...] = ()
        if rounded is not None:
            host = HostModel(rounded, generate(rounded), scratch / "rounded")
            untuned = tell_errors(described, host, runs, constant)
        calibration = calibrate(described, dataset.train)
        plain_runs, plain = find_plain(replay, dataset)
        budget = measure_budget(described, calibration, check.observed, plain_runs, plain=plain)
        footprint = measure_footprint(code, CORE)
        progress("proving how far the chip can be from the float model")
        bound = bound_errors(quantized) if code.design is None else ErrorBound((), IN_A_BLOCK)
        progress("checking the certificate")
        certificate, outcome, bound = certify_checked(model, code, bound, scratch)
    files: tuple[Path, ...] = ()
    if gate.passes or gate_request.force:
        progress("writing")
        golden = compute_golden(model, draw_golden(model, next(iter(sequences.values()))))
        files = write_artefacts(
            config,
            model,
            code,
            certificate,
            golden,
            effects=described.effects,
            forced=forced,
            network=network,
        )
    return Firmware(
        model=model,
        code=code,
        check=check,
        errors=errors,
        untuned=untuned,
        budget=budget,
        error_runs=tuple(run.name for run in runs),
        held_out=bool(dataset.test),
        tared=described.tared,
        footprint=footprint,
        chip=chip,
        certificate=outcome,
        bound=bound,
        gate=gate,
        replay=replay,
        forced=forced,
        files=files,
    )


def make_code(
    config: Config, own: IntegerModel, editions: Mapping[str, tuple[Edition, ...]]
) -> tuple[IntegerModel, GeneratedCode]:
    """Return a project's integer model and its C, with the numbers where `[firmware]` puts them.

    A design that lies in the folder of the C is kept, so that the program stays what it is.

    Args:
        config: the project.
        own: its integer model, in the format of its own.
        editions: serial number -> blocks of that unit so far.

    Raises:
        CheckError: the model cannot stand in a block, or does not fit the design that is there.
        InputError: the design's file is damaged, or the sequence that is stated was given before.
    """
    if not config.block.in_block:
        return own, generate(own)
    path = config.firmware_out / DESIGN
    design = load_design(path) if path.is_file() else make_design([own])
    model = design.fit(own)
    serial = config.block.serial or config.sensor_name
    code = generate_unit(design, model, BlockNotes(serial, config.block.calibrated, 1))
    block = number_block(code.block, editions.get(serial, ()), config.block)
    return model, generate_design(design, block)


def _mark_forced(
    model: IntegerModel, code: GeneratedCode, why: str
) -> tuple[IntegerModel, GeneratedCode]:
    """Return a model and its C with what the gate found against them."""
    model = replace(model, notes={**model.notes, FORCED: why})
    if code.design is None:
        return model, generate(model)
    told = replace(code.design.model, notes={**code.design.model.notes, FORCED: why})
    return model, generate_design(replace(code.design, model=told), code.block)


def find_plain(
    replay: ChipReplay, dataset: Dataset
) -> tuple[tuple[Run, ...], tuple[Mask, ...] | None]:
    """Return the runs, and rows of them, on which nothing but rounding costs anything."""
    plain = replay.list_plain_rows()
    if any(mask.any() for mask in plain):
        return tuple(replayed.run for replayed in replay.runs), plain
    return dataset.train, None  # which is inside by definition


def _compose(
    config: Config,
    dataset: Dataset,
    described: FloatModel,
    progress: Progress,
) -> tuple[Quantized, IntegerModel | None]:
    """Return the integer model and, where it was fine-tuned, what only rounding would give."""
    tuned = load_or_tune(described, config, dataset.train, progress)
    quantized = compose_quantized(tuned, config, dataset)
    if tuned is described:
        return quantized, None
    return quantized, compose_integer_model(described, config, dataset)


def certify_checked(
    model: IntegerModel, code: GeneratedCode, bound: ErrorBound, scratch: Path
) -> tuple[str, "CertificateOutcome", ErrorBound]:
    """Return the certificate, what the independent check says of it, and the error bound in it.

    A bound that the check has no rule for, or does not confirm, is not told; the rest must hold.

    Raises:
        CheckError: a claim beside the error bound does not hold.
    """
    if code.design is not None:
        certificate = certify_design(code.design, code)
        return certificate, recheck(code, certificate, scratch), bound
    certificate = certify(model, code, bound)
    try:
        return certificate, recheck(code, certificate, scratch), bound
    except CheckError as error:
        if not bound.outputs:
            raise
        unconfirmed = ErrorBound((), f"the independent check does not confirm it: {error}")
    certificate = certify(model, code, unconfirmed)
    return certificate, recheck(code, certificate, scratch), unconfirmed


def recheck(code: GeneratedCode, certificate: str, scratch: Path) -> "CertificateOutcome":
    """Return what the independent check says of a certificate and the C it is about.

    Raises:
        CheckError: a claim does not hold, or the C holds something that there is no rule for.
    """
    folder = scratch / "certified"
    folder.mkdir(exist_ok=True)
    write_sources(code, folder)
    (folder / CERTIFICATE).write_text(certificate, encoding="utf-8")
    from zerodrift.verify.checkers import check_certificate

    outcome = check_certificate(folder)
    if outcome.failures:
        raise CheckError(
            f"the certificate does not hold: {'; '.join(outcome.failures[:5])}. Nothing written."
        )
    return outcome


def list_sequences(
    model: IntegerModel, dataset: Dataset, random_steps: int | None = None
) -> dict[str, CodeArray]:
    """Return the check's inputs: every log's codes, then random ones.

    Args:
        model: says how codes look.
        dataset: the logs.
        random_steps: by default as many as make LEAST_VECTORS steps in all.
    """
    runs: tuple[Run, ...] = (*dataset.test, *dataset.train, *dataset.dwell)
    sequences = {f"log {r.name}": encode_inputs(model, r)[:LONGEST_LOG_STEPS] for r in runs}
    covered = sum(len(codes) for codes in sequences.values())
    steps = max(LEAST_VECTORS - covered, 5000) if random_steps is None else random_steps
    return sequences | draw_sequences(model, steps)


def write_artefacts(
    config: Config,
    model: IntegerModel,
    code: GeneratedCode,
    certificate: str,
    golden: GoldenVectors,
    *,
    effects: ModelSummary | None = None,
    forced: tuple[str, ...] = (),
    network: tuple[Path, ...] = (),
) -> tuple[Path, ...]:
    """Write model, C, certificate and manifest, all or none; return the files beside the C.

    They change together, whenever the process ends or the disk fails.

    Args:
        config: the project.
        model: the integer model.
        code: its C.
        certificate: its text.
        golden: its golden vectors.
        effects: its physical model in words.
        forced: what was found against this firmware and overridden; goes into the manifest.
        network: the ONNX file that the network comes from.

    Raises:
        InputError: a directory cannot be made or written, or has no room.
    """
    out, build = config.firmware_out, config.build_directory
    texts = {
        **render_sources(code),
        CERTIFICATE: certificate,
        f"{code.prefix}.dbc": render_dbc(model),
        MODEL: model.to_text(),
    }
    if effects is not None:
        texts[EFFECTS] = json.dumps(to_dict(effects), indent=1, ensure_ascii=False) + "\n"
    firmware = {name: text.encode() for name, text in texts.items()}
    if code.design is not None:
        firmware[DESIGN] = code.design.to_text().encode()
        firmware |= render_block(code.design, code.block, BLOCK, config.block.address)
    artefacts = {
        MODEL: model.to_text().encode(),
        CERTIFICATE: certificate.encode(),
        "integer.onnx": build_integer_onnx(model),
        "golden.npz": golden.to_bytes(),
    }
    compiler = find_compiler().describe()
    manifest = write_manifest(
        config, model.hash, firmware, artefacts, compiler, forced=forced, network=network
    )
    firmware[MANIFEST] = manifest.encode()
    files = {out / name: content for name, content in firmware.items()}
    refuse_foreign(files, out)
    changes: dict[Path, bytes | None] = {
        out / name: None for name in (DESIGN, *BLOCK_FILES) if name not in firmware
    }
    changes |= {
        out / name: None
        for name in list_own(out)
        if name.startswith("zd_") and name not in firmware  # of a model that included more
    }
    changes |= files | {build / name: content for name, content in artefacts.items()}
    if code.design is not None:
        changes[config.directory / UNITS] = render_units(config.directory, (code.block,))
    write_all(config.directory, changes)
    return tuple(files)
