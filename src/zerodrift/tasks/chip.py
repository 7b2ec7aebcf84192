"""What the page replays: the firmware's C as WebAssembly, runs, and the reference's answers."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.progress import SILENT, Progress
from zerodrift.c_runtime.wasm import build_wasm
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.export.compose import count_elapsed, encode_inputs
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.tasks.applied_rows import FLAG_NAMES
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.verify.replay import read_code
from zerodrift.workbench.chip import (
    MODEL,
    PageReplay,
    ReplayFlag,
    ReplayOutput,
    ReplayRun,
    list_read,
    write_replay,
)

MOST_STEPS = 50_000
"""Of a run: the reference takes some 0.2 ms for each."""
AT_ONCE = 2048
"""Steps between two reports of progress."""

Answers = tuple[NDArray[np.int32], NDArray[np.uint32]]


def prepare_chip(project: ProjectFolder, result: Path, progress: Progress = SILENT) -> None:
    """Write into `result` what the page needs to run the C of a project's, or a unit's, firmware.

    Raises:
        InputError: there is no firmware or no compiler, or a log cannot be read.
        CheckError: the C does not compile.
    """
    config, dataset = open_project(project, progress)
    path = config.build_directory / MODEL
    model = load_model(path)
    progress("compiling to WebAssembly")
    code = read_code(model, config.firmware_out)
    wasm = build_wasm(code)
    notes: list[str] = []
    runs, codes = _encode(config, model, dataset, notes)
    answers = answer_by_reference(model, codes, [run.elapsed for run, _ in runs], progress)
    replay = PageReplay(
        prefix=code.prefix,
        model_hash=model.hash,
        columns=model.columns,
        code_bytes=np.dtype(model.code_type).itemsize,
        period_s=model.sample_period_s,
        wasm_bytes=len(wasm),
        outputs=tuple(ReplayOutput(o.name, o.unit, o.lsb_per_unit) for o in model.outputs),
        flags=tuple(ReplayFlag(bit, words) for bit, words in FLAG_NAMES.items()),
        runs=tuple(run for run, _ in runs),
        reads=list_read(config, model),
        notes=tuple(notes),
    )
    progress("writing")
    shutil.copyfile(path, result / MODEL)
    told = zip(codes, answers, runs, strict=True)
    write_replay(result, replay, wasm, [(c, *a, measured) for c, a, (_, measured) in told])


def _encode(
    config: Config, model: IntegerModel, dataset: Dataset, notes: list[str]
) -> tuple[list[tuple[ReplayRun, NDArray[np.float64]]], list[CodeArray]]:
    """Return the runs with what was measured, those held out first, and their codes."""
    found, codes = [], []
    tests = {run.name for run in dataset.test}
    for run in (*dataset.test, *(r for r in dataset.train if r.name not in tests)):
        part = run.take(slice(0, MOST_STEPS))
        try:
            given = encode_inputs(model, part).astype(model.code_type)
        except InputError as error:
            notes.append(f"{run.name} is left out: {error}")
            continue
        found.append((_describe(model, run, len(part), run.name in tests), part.measured))
        codes.append(given)
        if len(part) < len(run):
            notes.append(f"{run.name}: its first {len(part)} steps of {len(run)}")
    if not found:
        raise InputError(f"{config.path}: no run can be replayed. {' '.join(notes)}")
    return found, codes


def _describe(model: IntegerModel, run: Run, steps: int, held_out: bool) -> ReplayRun:
    return ReplayRun(run.name, held_out, steps, len(run), count_elapsed(model, run))


def answer_by_reference(
    model: IntegerModel,
    codes: Sequence[CodeArray],
    elapsed: Sequence[int],
    progress: Progress = SILENT,
) -> list[Answers]:
    """Return the integer reference's drift [n, K] and flags [n] of several runs, all at once.

    Args:
        model: the integer model.
        codes: of each run [n, C], begun at rest.
        elapsed: of each run the steps since power-on at its first.
        progress: is told how far it is.
    """
    reference, longest = Reference(model), max(map(len, codes))
    firsts = [
        reference.start(own[:1].astype(np.int64), settled=True, elapsed=steps)
        for own, steps in zip(codes, elapsed, strict=True)
    ]
    state = firsts[0].unpack(np.concatenate([first.pack() for first in firsts]))
    drift = np.empty((len(codes), longest, len(model.outputs)), dtype=np.int32)
    flags = np.empty((len(codes), longest), dtype=np.uint32)
    for start in range(0, longest, AT_ONCE):
        progress(f"asking the reference: step {start} of {longest}")
        stop = min(start + AT_ONCE, longest)
        # What lies beyond a run's end is its last row again, and is not kept.
        at = np.arange(start, stop)
        rows = np.stack([own[np.minimum(at, len(own) - 1)] for own in codes])
        told = reference.run(rows, state=state)
        drift[:, start:stop], flags[:, start:stop], state = told.drift, told.flags, told.state
    return [(drift[i, : len(own)], flags[i, : len(own)]) for i, own in enumerate(codes)]
