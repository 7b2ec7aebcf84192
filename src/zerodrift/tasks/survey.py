"""The results of all commands for a project, collected once for the report and the page."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from zerodrift import __version__
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.progress import SILENT, Progress
from zerodrift.base.records import from_json, render_sealed, to_dict
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.dataset.units import read_unit
from zerodrift.diagnosis.advice import advise
from zerodrift.diagnosis.contribution import Contribution, find_contribution, open_baseline
from zerodrift.diagnosis.diagnosis import Diagnosis, ExplainedDiagnosis
from zerodrift.diagnosis.history import list_steps
from zerodrift.diagnosis.referee import review_logs
from zerodrift.diagnosis.run_errors import collect_errors
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.description import describe_effect
from zerodrift.physics.summary import summarise_model
from zerodrift.report.findings import (
    Findings,
    LoggedInput,
    ProposedFormula,
    Provenance,
    SourceFile,
    trace_runs,
)
from zerodrift.report.results import ProposeResult
from zerodrift.report.sentences import (
    describe_patterns,
    explain_figures,
    explain_others,
    explain_verdict,
)
from zerodrift.tasks.built import read_firmware, read_kept, state_uncertainty
from zerodrift.tasks.compare import compare_predictor, open_predictor
from zerodrift.tasks.diagnose import find_verdict, list_commands
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.tasks.revise import open_history

DIAGNOSIS = "diagnosis.json"
"""In build/: the last diagnosis, with the mark of what it was made from."""
DIAGNOSIS_FORMAT = 5
PROPOSAL = "proposal.json"
"""In build/: what the last `propose` said, with the mark of what it was made from."""
PROPOSAL_FORMAT = 1
SIMULATED_FILES = ("truth.json", "twin.json")
PACKAGES = ("numpy", "scipy", "polars", "torch", "onnx", "onnxruntime")


@dataclass(frozen=True)
class SurveyRequest:
    """What is to be found out about a project."""

    project: ProjectFolder
    wants_diagnosis: bool = True
    """Whether to diagnose where no diagnosis of these logs is kept."""
    wants_contribution: bool = False
    """Whether to compute what the named effect would explain."""
    wants_advice: bool = True
    """Whether to say what the logs can teach."""


def survey(request: SurveyRequest, progress: Progress = SILENT) -> Findings:
    """Return the results of `compare`, `diagnose`, `history`, `firmware` and `export`.

    The diagnosis is kept in build/ and taken from there while configuration and logs are the same.

    Raises:
        InputError: as the commands do.
    """
    config, dataset = open_project(request.project, progress)
    catalogue = request.project.catalogue
    progress("fitting")
    predictor = open_predictor(None, request.project)
    progress("comparing")
    comparison = compare_predictor(predictor, request.project)
    runs = [*dataset.train, *dataset.test]
    held_out = comparison.method.predictions
    predictions = {
        run.name: held_out[run.name] if run.name in held_out else predictor.predict(run)
        for run in runs
    }
    errors = collect_errors(runs, predictions, comparison.tared, comparison.find_usable)
    provenance = trace_provenance(config, dataset)
    wanted = request.wants_diagnosis
    diagnosed = diagnose_once(config, dataset, catalogue, provenance.mark, wanted, progress)
    contribution = None
    if (
        request.wants_contribution
        and diagnosed is not None
        and diagnosed.diagnosis.effect is not None
    ):
        told = list_contributions(config, dataset, catalogue, diagnosed.diagnosis, 1, progress)
        contribution = next(told, None)
    inputs = list_inputs(config, runs)
    progress("looking at the firmware")
    firmware, certificate, note = read_firmware(config)
    _, entries = open_history(config)
    reviewed = review_logs(config, dataset)
    return Findings(
        sensor=config.sensor_name,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        simulated=is_simulated(config),
        predictor=predictor.kind,
        comparison=comparison.summarise(),
        advice=advise(config, dataset) if request.wants_advice else None,
        comparison_sentences=tuple(explain_figures(comparison)),
        patterns=tuple(describe_patterns(comparison)),
        diagnosed=diagnosed,
        steps=list_steps(entries),
        model=summarise_model(predictor.physics),
        firmware=firmware,
        certificate=certificate,
        firmware_note=note,
        catalogue={effect.kind: describe_effect(effect) for effect in catalogue.listed()},
        provenance=provenance,
        notes=tuple(
            dict.fromkeys(
                (
                    *(note.write() for note in reviewed),
                    *dataset.notes,
                    *predictor.notes,
                )
            )
        ),
        reviewed=reviewed,
        skip_invalid=request.project.skip_invalid,
        traces=trace_runs(
            errors,
            [run.name for run in comparison.runs if run.held_out is not None],
            [one.name for one in inputs],
        ),
        inputs=inputs,
        uncertainty=state_uncertainty(config, firmware),
        contribution=contribution,
        proposal=read_proposal(config, provenance.mark),
    )


def list_inputs(config: Config, runs: Sequence[Run]) -> tuple[LoggedInput, ...]:
    """Return the channels of [inputs] that every run has, with the units of their columns."""
    return tuple(
        LoggedInput(name, read_unit(column))
        for name, column in config.inputs.items()
        if all(name in run.inputs for run in runs)
    )


def is_simulated(config: Config) -> bool:
    """Return whether a project states that its logs were simulated."""
    head = config.path.read_text(encoding="utf-8-sig").split("[", 1)[0]
    return "SIMULATED" in head or any(
        (config.directory / name).exists() for name in SIMULATED_FILES
    )


def trace_provenance(config: Config, dataset: Dataset) -> Provenance:
    """Return the input files with their hashes, the versions, and one hash over all files."""
    uses: dict[Path, str] = {config.path: "configuration"}
    uses |= dict.fromkeys(config.plugin_files, "own effects")
    for use, runs in (("train", dataset.train), ("test", dataset.test), ("dwell", dataset.dwell)):
        for path in [path for run in runs for path in run.files or (run.source,)]:
            known = uses.get(path)
            uses[path] = use if known in (None, use) else f"{known}, {use}"
    files = []
    for path, use in uses.items():
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        inside = path.is_relative_to(config.directory)
        name = path.relative_to(config.directory).as_posix() if inside else path.name
        files.append(SourceFile(name, use, digest))
    versions = {"zerodrift": __version__}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    body = json.dumps([[f.file, f.sha256] for f in files] + [__version__])
    return Provenance(tuple(files), versions, hashlib.sha256(body.encode()).hexdigest())


def diagnose_once(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    mark: str,
    wanted: bool,
    progress: Progress = SILENT,
) -> ExplainedDiagnosis | None:
    """Return the diagnosis: the one kept in build/ if the hash of all files is the same.

    A new diagnosis is kept, where build/ can be written to.
    """
    path = config.build_directory / DIAGNOSIS
    kept = read_kept(path)
    if kept is not None and (kept.get("format"), kept.get("mark")) == (DIAGNOSIS_FORMAT, mark):
        return from_json(ExplainedDiagnosis, kept.get("diagnosed"))
    if not wanted:
        return None
    verdict = find_verdict(
        config, dataset, catalogue, say=lambda words: progress(f"diagnosing: {words}")
    )
    (command,) = list_commands(config.effects, verdict.steps, catalogue)
    sentences = explain_verdict(
        verdict.diagnosis, "" if command is None else command.write(), catalogue
    )
    others = explain_others(verdict.others, Path())
    found = ExplainedDiagnosis(verdict.diagnosis, command, verdict.others, (*sentences, *others))
    sealed = {"format": DIAGNOSIS_FORMAT, "mark": mark, "diagnosed": to_dict(found)}
    # In a read-only project, or one that is being changed, nothing is kept.
    with suppress(InputError):
        write_all(config.directory, {path: render_sealed(sealed)}, patient=False)
    return found


def keep_proposal(
    config: Config, dataset: Dataset, result: ProposeResult, sentences: Sequence[str]
) -> None:
    """Keep the result of `propose` for report and page, where build/ can be written to."""
    units = {name: error.unit for name, error in result.rmse_left_out.items()}
    told = ProposedFormula(result.formula, tuple(sentences), result.curves, units)
    mark = trace_provenance(config, dataset).mark
    sealed = {"format": PROPOSAL_FORMAT, "mark": mark, "proposal": to_dict(told)}
    path = config.build_directory / PROPOSAL
    with suppress(InputError):
        write_all(config.directory, {path: render_sealed(sealed)}, patient=False)


def read_proposal(config: Config, mark: str) -> ProposedFormula | None:
    """Return the result of `propose` for the project as it is; None where it was not run."""
    kept = read_kept(config.build_directory / PROPOSAL)
    if kept is None or (kept.get("format"), kept.get("mark")) != (PROPOSAL_FORMAT, mark):
        return None
    return from_json(ProposedFormula, kept.get("proposal"))


def list_contributions(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    diagnosis: Diagnosis,
    most: int,
    progress: Progress = SILENT,
) -> Iterator[Contribution]:
    """Yield the part of the error that each of the likeliest candidates would explain, best first.

    Args:
        config: the project.
        dataset: its runs.
        catalogue: the known effects.
        diagnosis: the verdict and its candidates.
        most: how many candidates.
        progress: is told of each stage of the work.
    """
    kinds = [effect.kind for effect in config.effects]
    wanted = [c for c in diagnosis.candidates if c.effect not in kinds]
    wanted.sort(key=lambda candidate: candidate.effect != diagnosis.effect)
    if not wanted:
        return
    baseline = open_baseline(config, dataset, catalogue)
    for candidate in wanted[:most]:
        progress(f"drawing {candidate.effect}")
        found = find_contribution(baseline, candidate.effect, candidate.parameters)
        if found is not None:
            yield found
