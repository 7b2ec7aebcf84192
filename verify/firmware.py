"""The main job's second half: quantize, generate, check bit for bit, tell the errors, write."""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from zerodrift.c_runtime.footprint import Footprint, measure_footprint
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.config import Config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.export.compose import compose_integer_model, encode_inputs
from zerodrift.export.compose_import import ImportedCompensator, compose_imported_model
from zerodrift.export.golden import compute_golden
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.integer_onnx import save_integer_onnx
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.train.compensator import Compensator
from zerodrift.verify.errors_told import OutputError, tell_errors
from zerodrift.verify.firmware_check import FirmwareCheck, check_firmware
from zerodrift.verify.vectors import draw_sequences

Progress = Callable[[str], None]

LEAST_VECTORS = 100_000
"""Steps compared at least; the logs are part of them."""
LONGEST_LOG_STEPS = 20_000
GOLDEN_STEPS = 2000
CORE = "cortex-m4"


@dataclass(frozen=True)
class Firmware:
    """What was built and what is known about it."""

    model: IntegerModel
    code: GeneratedCode
    check: FirmwareCheck
    errors: tuple[OutputError, ...]
    error_runs: tuple[str, ...]
    """Runs behind the errors."""
    held_out: bool
    """Whether none of those runs was trained on."""
    tared: bool
    """Whether each run's own offset was taken off the errors."""
    footprint: Footprint
    files: tuple[Path, ...]


def build_firmware(
    config: Config,
    dataset: Dataset,
    compensator: Compensator | ImportedCompensator,
    progress: Progress = lambda _: None,
) -> Firmware:
    """Build the firmware of a trained compensator and write it, if and only if all bits agree.

    Args:
        config: the project; says where the C goes.
        dataset: its logs; the test runs are the held-out ones.
        compensator: the trained model, or a network from an ONNX file.
        progress: is told what is being done.

    Raises:
        CheckError: no safe format, or the C differs from the reference; nothing is written then.
    """
    progress("quantizing")
    if isinstance(compensator, ImportedCompensator):
        model = compose_imported_model(compensator, config, dataset)
    else:
        model = compose_integer_model(compensator, config, dataset)
    code = generate(model)
    sequences = list_sequences(model, dataset)
    build = config.build_directory
    build.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".firmware-", dir=build) as scratch:
        check = check_firmware(model, code, sequences, Path(scratch), progress).require()
        progress("measuring errors and sizes")
        runs = dataset.test or dataset.train
        errors = tell_errors(compensator, check.host, runs)
        footprint = measure_footprint(code, CORE)
    progress("writing")
    golden = compute_golden(model, next(iter(sequences.values()))[:GOLDEN_STEPS])
    files = write_artefacts(config, model, code)
    golden.save(build / "golden.npz")
    return Firmware(
        model=model,
        code=code,
        check=check,
        errors=errors,
        error_runs=tuple(run.name for run in runs),
        held_out=bool(dataset.test),
        tared=compensator.tared,
        footprint=footprint,
        files=files,
    )


def list_sequences(model: IntegerModel, dataset: Dataset) -> dict[str, CodeArray]:
    """Return the check's inputs: every log's codes, then random ones up to LEAST_VECTORS steps."""
    runs: tuple[Run, ...] = (*dataset.test, *dataset.train, *dataset.dwell)
    sequences = {f"log {r.name}": encode_inputs(model, r)[:LONGEST_LOG_STEPS] for r in runs}
    covered = sum(len(codes) for codes in sequences.values())
    return sequences | draw_sequences(model, max(LEAST_VECTORS - covered, 5000))


def write_artefacts(config: Config, model: IntegerModel, code: GeneratedCode) -> tuple[Path, ...]:
    """Write model and C, each file atomically; return the C files.

    Files are written beside their place first, so that a full disk leaves the old ones.
    """
    out = config.firmware_out
    out.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=".staging-", dir=out))
    try:
        staged = write_sources(code, staging)
        files = tuple(path.replace(out / path.name) for path in staged)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    model.save(config.build_directory / "model.json")
    save_integer_onnx(model, config.build_directory / "integer.onnx")
    return files
