"""All that the commands say about a project, gathered once: what report and page show."""

import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift import __version__
from zerodrift.app.commands.built import read_firmware, read_kept
from zerodrift.app.commands.compare import describe_patterns, explain_figures
from zerodrift.app.commands.diagnose import explain_verdict
from zerodrift.app.commands.effects import describe_effect
from zerodrift.app.commands.history import describe_steps
from zerodrift.app.commands.predictors import PHYSICS, compare_predictor, open_predictor
from zerodrift.app.commands.project import open_project
from zerodrift.app.commands.revise import open_history
from zerodrift.app.commands.verdict import explain_others, find_verdict, list_commands, tell_steps
from zerodrift.base.config import Config, EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.sealed import render_sealed
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.advice import advise
from zerodrift.diagnosis.history import list_steps
from zerodrift.diagnosis.revision import describe_coefficients, describe_parameters
from zerodrift.diagnosis.run_errors import collect_errors
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.fit import fit_config
from zerodrift.physics.model import PhysicalModel
from zerodrift.report.findings import Findings, trace_runs

Array = NDArray[np.float64]
Say = Callable[[str], None]

DIAGNOSIS = "diagnosis.json"
"""In build/: the last diagnosis, with the mark of what it was made from."""
DIAGNOSIS_FORMAT = 3
SIMULATED_FILES = ("truth.json", "twin.json")
PACKAGES = ("numpy", "scipy", "polars", "torch", "onnx", "onnxruntime", "plotly")


def survey_project(
    directory: Path,
    *,
    skip_invalid: bool = False,
    wants_diagnosis: bool = True,
    say: Say = lambda _: None,
) -> Findings:
    """Return what `compare`, `diagnose`, `history`, `firmware` and `export` say about a project.

    The diagnosis is kept in build/ and taken from there while configuration and logs are the same.

    Args:
        directory: of zerodrift.toml.
        skip_invalid: drop invalid rows of the logs.
        wants_diagnosis: whether to diagnose where no diagnosis of these logs is kept.
        say: is told what is being done.

    Raises:
        InputError: as the commands do.
    """
    say("reading logs")
    config, dataset = open_project(directory, skip_invalid)
    catalogue = load_catalogue(config.plugin_files)
    say("fitting")
    predictor = open_predictor(None, config, dataset, catalogue)
    say("comparing")
    comparison = compare_predictor(predictor, config, dataset)
    runs = [*dataset.train, *dataset.test]
    held_out = comparison.method.predictions
    predictions = {
        run.name: held_out[run.name] if run.name in held_out else predictor.predict(run)
        for run in runs
    }
    errors = collect_errors(runs, predictions, comparison.tared, comparison.find_usable)
    provenance = trace_provenance(config, dataset)
    diagnosis = diagnose_once(config, dataset, catalogue, provenance["mark"], wants_diagnosis, say)
    say("looking at the firmware")
    firmware, certificate, note = read_firmware(config)
    _, entries = open_history(config)
    model = _find_model(predictor.kind, config, dataset, catalogue)
    advice = advise(config, dataset)
    titles = {effect.kind: effect.title for effect in catalogue.listed()}
    told = {
        "compare": {
            "model": predictor.kind,
            **comparison.to_dict(),
            "advice": advice.to_dict() if advice is not None else None,
        },
        "compare_sentences": explain_figures(comparison),
        "patterns": describe_patterns(comparison),
        "diagnose": diagnosis["diagnosis"] if diagnosis else None,
        "diagnose_sentences": diagnosis["sentences"] if diagnosis else [],
        "history": {"steps": describe_steps(list_steps(entries))},
        "model": describe_model(model),
        "firmware": firmware,
        "certificate": certificate,
        "firmware_note": note,
        "titles": titles,
        "catalogue": {effect.kind: describe_effect(effect) for effect in catalogue.listed()},
        "provenance": provenance,
        "notes": list(dict.fromkeys((*dataset.notes, *predictor.notes))),
        "skip_invalid": skip_invalid,
    }
    return Findings(
        sensor=config.sensor_name,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        simulated=is_simulated(config),
        told=told,
        traces=trace_runs(
            errors, [run.name for run in comparison.runs if run.held_out is not None]
        ),
    )


def is_simulated(config: Config) -> bool:
    """Return whether a project says of itself that its logs were simulated."""
    head = config.path.read_text(encoding="utf-8-sig").split("[", 1)[0]
    return "SIMULATED" in head or any(
        (config.directory / name).exists() for name in SIMULATED_FILES
    )


def _find_model(kind: str, config: Config, dataset: Dataset, catalogue: Catalogue) -> PhysicalModel:
    """Return the physical model behind the predictions."""
    if kind == PHYSICS:
        return fit_config(config, dataset, catalogue)
    from zerodrift.train.compensator import Compensator

    return Compensator.load(config.build_directory, catalogue).physics


def describe_model(model: PhysicalModel) -> dict[str, Any]:
    """Return the effects with parameters, intervals and coefficients, ready for JSON."""
    terms = []
    for fitted in model.terms:
        parameters = describe_parameters(fitted)
        for name, told in parameters.items():
            interval = fitted.intervals.get(name)
            known = interval is not None and all(np.isfinite(interval))
            told["interval"] = [float(end) for end in interval or ()] if known else None
        terms.append(
            {
                "name": fitted.term.name,
                "kind": fitted.kind,
                "title": fitted.term.effect.title,
                "equation": fitted.term.effect.equation,
                "parameters": parameters,
                "coefficients": describe_coefficients(model, fitted),
            }
        )
    return {
        "terms": terms,
        "reference_temperature_degC": model.reference_temperature_degC,
        "notes": list(model.notes),
    }


def trace_provenance(config: Config, dataset: Dataset) -> dict[str, Any]:
    """Return the files that went in with their hashes, the versions, and one mark of all files."""
    uses: dict[Path, str] = {config.path: "configuration"}
    uses |= dict.fromkeys(config.plugin_files, "own effects")
    for use, runs in (("train", dataset.train), ("test", dataset.test), ("dwell", dataset.dwell)):
        for run in runs:
            known = uses.get(run.source)
            uses[run.source] = use if known in (None, use) else f"{known}, {use}"
    files = []
    for path, use in uses.items():
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        inside = path.is_relative_to(config.directory)
        name = path.relative_to(config.directory).as_posix() if inside else path.name
        files.append({"file": name, "use": use, "sha256": digest})
    versions = {"zerodrift": __version__}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    body = json.dumps([[f["file"], f["sha256"]] for f in files] + [__version__])
    return {
        "files": files,
        "versions": versions,
        "mark": hashlib.sha256(body.encode()).hexdigest(),
    }


def diagnose_once(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    mark: str,
    wanted: bool,
    say: Say = lambda _: None,
) -> dict[str, Any] | None:
    """Return the JSON and sentences of `diagnose`: those kept in build/ if the mark is the same.

    A new diagnosis is kept, where build/ can be written to.
    """
    path = config.build_directory / DIAGNOSIS
    kept = read_kept(path)
    if kept is not None and (kept.get("format"), kept.get("mark")) == (DIAGNOSIS_FORMAT, mark):
        return kept
    if not wanted:
        return None
    verdict = find_verdict(
        config, dataset, catalogue, say=lambda words: say(f"diagnosing: {words}")
    )
    commands = list_commands(config.effects, verdict.steps, catalogue, Path())
    (told,) = tell_steps(verdict, commands, Path())
    sentences = explain_verdict(verdict.diagnosis, commands[-1], catalogue)
    found = {
        "format": DIAGNOSIS_FORMAT,
        "mark": mark,
        "diagnosis": told,
        "sentences": [*sentences, *explain_others(told)],
    }
    # A project that can only be read, or is being changed, is diagnosed anew each time.
    with suppress(InputError):
        write_all(config.directory, {path: render_sealed(found)}, patient=False)
    return found


def preview_effects(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    diagnosed: Mapping[str, Any],
    most: int,
    say: Say = lambda _: None,
) -> dict[str, dict[str, Array]]:
    """Return what the likeliest candidates would explain of what is left, if they were added.

    Args:
        config: the project.
        dataset: its runs.
        catalogue: the known effects.
        diagnosed: the JSON of `diagnose`.
        most: how many candidates.
        say: is told what is being done.

    Returns:
        Effect -> run -> [K, n], the prediction with the effect less that without it, each run's
        mean taken off where logs are tared.
    """
    now = fit_config(config, dataset, catalogue)
    runs = [*dataset.train, *dataset.test]
    before = {run.name: now.predict(run) for run in runs}
    kinds = [effect.kind for effect in config.effects]
    previews: dict[str, dict[str, Array]] = {}
    wanted = [c for c in diagnosed["candidates"] if c["effect"] not in kinds]
    for candidate in wanted[:most]:
        effect = catalogue[candidate["effect"]]
        say(f"drawing {effect.kind}")
        held = {
            p.name: candidate["parameters"][p.name]
            for p in effect.parameters
            if p.choices and p.name in candidate["parameters"]
        }
        changed = replace(config, effects=(*config.effects, EffectConfig(effect.kind, held)))
        try:
            model = fit_config(changed, dataset, catalogue)
        except InputError:
            continue  # not every candidate can stand beside the others
        gains: dict[str, list[Array]] = {}
        for run in runs:
            gains.setdefault(run.group, []).append(model.predict(run) - before[run.name])
        joined = {group: np.concatenate(parts).T for group, parts in gains.items()}
        tared = model.tared or now.tared
        previews[effect.kind] = {
            group: curve - curve.mean(axis=1, keepdims=True) if tared else curve
            for group, curve in joined.items()
        }
    return previews


def describe_survey(findings: Findings) -> Mapping[str, Any]:
    """Return the JSON of the survey, with which `report --json` ends."""
    return {"sensor": findings.sensor, "simulated": findings.simulated, **findings.told}
