"""What the page runs in separate processes: survey, diagnosis, and the firmware's C for the page.

python -m zerodrift.workbench.worker survey|diagnose|chip PROJECT RESULT [--skip-invalid]
                                     [--sensor NAME]

All write into the directory RESULT and report by an event when a file there is complete.
"""

import json
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.progress import SILENT, Lines, Progress
from zerodrift.base.records import to_json
from zerodrift.c_runtime.wasm import build_wasm
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.export.compose import count_elapsed, encode_inputs
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.report.findings import save_findings
from zerodrift.tasks.apply import FLAG_NAMES
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.tasks.survey import (
    SurveyRequest,
    diagnose_once,
    list_contributions,
    survey,
    trace_provenance,
)
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
from zerodrift.workbench.jobs import (
    CHIP_READY,
    DIAGNOSED,
    DIAGNOSIS,
    EVENT_MARK,
    PREVIEWED,
    SENSOR,
    SKIP_INVALID,
    SURVEYED,
    name_preview,
)

PREVIEWS = 4
MOST_STEPS = 50_000
"""Of a run: the reference takes some 0.2 ms for each."""
AT_ONCE = 2048
"""Steps between two reports of progress."""

Answers = tuple[NDArray[np.int32], NDArray[np.uint32]]


def look(project: ProjectFolder, result: Path, progress: Progress) -> None:
    """Write the findings, with the diagnosis where one for these logs is kept."""
    wanted = SurveyRequest(project, wants_diagnosis=False, wants_advice=False)
    findings = survey(wanted, progress)
    progress("writing")
    save_findings(findings, result)
    _tell(SURVEYED)


def diagnose(project: ProjectFolder, result: Path, progress: Progress) -> None:
    """Write the diagnosis, and then the curves of the effects that it names."""
    config, dataset = open_project(project, progress)
    catalogue = project.catalogue
    mark = trace_provenance(config, dataset).mark
    found = diagnose_once(config, dataset, catalogue, mark, True, progress)
    text = json.dumps(to_json(found), ensure_ascii=False, allow_nan=False)
    (result / DIAGNOSIS).write_text(text, encoding="utf-8")
    _tell(DIAGNOSED)
    if found is None:
        return
    if hasattr(os, "nice"):  # not on Windows
        os.nice(10)  # the verdict is on the page; what is drawn with it comes before further curves
    for told in list_contributions(config, dataset, catalogue, found.diagnosis, PREVIEWS, progress):
        for run, curve in told.curves.items():
            np.save(name_preview(result, told.effect, run), curve, allow_pickle=False)
        _tell(PREVIEWED)


def chip(project: ProjectFolder, result: Path, progress: Progress) -> None:
    """Write the firmware's C as WebAssembly, the runs, and the reference's answers."""
    prepare_chip(project, result, progress)
    _tell(CHIP_READY)


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
) -> tuple[list[tuple[ReplayRun, Array]], list[CodeArray]]:
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


def _tell(event: str) -> None:
    print(f"{EVENT_MARK}{event}", flush=True)


def main() -> None:
    """Do what the arguments say; a user's error is one message on stderr."""
    what, directory, result = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    options = sys.argv[4:]
    sensor = options[options.index(SENSOR) + 1] if SENSOR in options else None
    project = ProjectFolder(directory, sensor, SKIP_INVALID in options)
    try:
        do = {"survey": look, "diagnose": diagnose, "chip": chip}[what]
        do(project, result, Progress(Lines()))
    except ZerodriftError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except OSError as error:
        print(f"error: {error.filename or directory}: {error.strerror}.", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
