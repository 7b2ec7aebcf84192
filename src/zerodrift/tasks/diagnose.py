"""Finds what a model lacks, in the same way for `diagnose`, the report and the page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import Config, EffectConfig
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.progress import SILENT, Progress
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.advice import Advice, advise
from zerodrift.diagnosis.changes import AddCommand, extend_model, propose_command
from zerodrift.diagnosis.course import (
    RepeatedDiagnosis,
    describe_bad_run,
    describe_unseen,
    diagnose_until_done,
)
from zerodrift.diagnosis.diagnose import diagnose as diagnose_once
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.drivers import OtherThermometer, try_thermometers
from zerodrift.diagnosis.plain_errors import tell_plain_errors
from zerodrift.diagnosis.referee import review_logs
from zerodrift.diagnosis.revision import list_needless
from zerodrift.diagnosis.summary import AdviceSummary
from zerodrift.fleet.evidence import find_differences, look_at_unit, pool_units
from zerodrift.fleet.joint_summary import FleetDiagnosis, summarise_joint
from zerodrift.fleet.sensors import configure_sensor, find_sensors
from zerodrift.physics.catalogue import Catalogue
from zerodrift.report.results import (
    AddedEffect,
    DiagnoseResult,
    DiagnosisStep,
    ThermometerSummary,
)
from zerodrift.tasks.project import ProjectFolder, is_fleet, open_project
from zerodrift.tasks.trust import require_trust


@dataclass(frozen=True)
class Verdict:
    """A diagnosis with the further checks that were made."""

    diagnosis: Diagnosis
    """The last one; its remarks mention bad runs and test logs far from the floor."""
    others: tuple[OtherThermometer, ...]
    """Further thermometers that the drift follows, where no effect of the catalogue explains it."""
    course: RepeatedDiagnosis | None
    """The steps that led here, where effects were added until nothing was missing."""

    @property
    def steps(self) -> tuple[Diagnosis, ...]:
        """All diagnoses, the last one last."""
        before = () if self.course is None else self.course.steps[:-1]
        return (*before, self.diagnosis)


@dataclass(frozen=True)
class DiagnoseRequest:
    """What `diagnose` is asked."""

    project: ProjectFolder
    """A fleet's, without a unit: all units speak together."""
    auto: bool = False
    """Whether to add what is missing, without writing it, and diagnose again until nothing is."""


@dataclass(frozen=True)
class Diagnosed:
    """What a model lacks, with the commands that follow from it and what the logs can teach."""

    verdict: Verdict
    commands: tuple[AddCommand | None, ...]
    """For each step, the command that adds the effect it names."""
    advice: Advice | None
    """None where no output moves."""

    def summarise(self, directory: Path) -> DiagnoseResult:
        """Return it as the command prints it, for a project as the user gave it."""
        verdict, advice = self.verdict, None if self.advice is None else self.advice.summarise()
        steps = tuple(
            DiagnosisStep(**vars(step), command=_write(command, directory))
            for step, command in zip(verdict.steps, self.commands, strict=True)
        )
        command = self.commands[-1]
        told = summarise_diagnosis(verdict.diagnosis, command, verdict.others, advice, directory)
        if verdict.course is None:
            return told
        added = tuple(
            AddedEffect(step.effect, step.parameters, step.command)
            for step in steps
            if step.effect is not None
        )
        return replace(told, added=added, steps=steps, drop=verdict.course.drop)


def diagnose(request: DiagnoseRequest, progress: Progress = SILENT) -> Diagnosed | FleetDiagnosis:
    """Return which effect a model lacks, or the design of a fleet.

    Raises:
        InputError: a log is missing or wrong, or a whole fleet is to be diagnosed by itself.
    """
    project = request.project
    if project.sensor is None and is_fleet(project.config):
        if request.auto:
            raise InputError(
                "diagnose --auto: found a fleet; expected one model. Name a unit by --sensor, or"
                " leave --auto out to see what all units lack."
            )
        return _diagnose_fleet(project, progress)
    config, dataset = open_project(project, progress)
    verdict = find_verdict(config, dataset, project.catalogue, auto=request.auto, say=progress)
    progress("looking at what the logs can teach")
    effects = config.effects if verdict.course is None else verdict.course.effects
    commands = list_commands(config.effects, verdict.steps, project.catalogue)
    return Diagnosed(verdict, tuple(commands), advise(config, dataset, effects))


def find_verdict(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    *,
    auto: bool = False,
    say: Callable[[str], None] = SILENT,
) -> Verdict:
    """Return what a model lacks, with remarks.

    Args:
        config: the project.
        dataset: its runs.
        catalogue: the known effects.
        auto: whether to add what is missing and diagnose again until nothing is.
        say: is told of each stage of the work.
    """

    def advance(kind: str) -> None:
        say(f"tried {kind}")

    course = diagnose_until_done(config.effects, dataset, catalogue, advance) if auto else None
    if course is None:
        effects, diagnosis = (
            config.effects,
            diagnose_once(config.effects, dataset, catalogue, advance),
        )
        say("leaving runs out")
        diagnosis = tell_plain_errors(diagnosis, effects, dataset, catalogue)
    else:
        say("leaving runs out")
        course = _tell_steps(course, config.effects, dataset, catalogue)
        effects, diagnosis = course.effects, course.steps[-1]
    aside: str | None = None
    others: list[OtherThermometer] = []
    if diagnosis.verdict == "unknown":
        say("trying other thermometers")
        others = try_thermometers(config, effects, dataset, catalogue)
        aside = describe_bad_run(effects, dataset, catalogue)
    if diagnosis.verdict == "complete":
        say("looking at the test logs")
        aside = describe_unseen(effects, dataset, catalogue)
    if aside is not None:
        diagnosis = replace(diagnosis, remarks=(*diagnosis.remarks, aside))
    if course is None:
        say("trying the model without each of its effects")
        diagnosis = replace(diagnosis, drop=list_needless(effects, dataset, catalogue))
    say("looking for wrong data")
    found = review_logs(config, dataset)
    remarks = (*(note.write() for note in found), *diagnosis.remarks)
    diagnosis = replace(diagnosis, remarks=remarks, notes=found)
    return Verdict(diagnosis, tuple(others), course)


def _tell_steps(
    course: RepeatedDiagnosis,
    effects: Sequence[EffectConfig],
    dataset: Dataset,
    catalogue: Catalogue,
) -> RepeatedDiagnosis:
    """Return the course, each step with the errors of the models that it speaks of."""
    steps = []
    for step in course.steps:
        steps.append(tell_plain_errors(step, effects, dataset, catalogue))
        if step.effect is not None:
            effects = extend_model(effects, catalogue, step.effect, step.parameters)
    return replace(course, steps=tuple(steps))


def summarise_diagnosis(
    diagnosis: Diagnosis,
    command: AddCommand | None,
    others: Sequence[OtherThermometer],
    advice: AdviceSummary | None,
    directory: Path,
) -> DiagnoseResult:
    """Return one diagnosis as the command prints it."""
    return DiagnoseResult(
        **vars(diagnosis),
        command=_write(command, directory),
        thermometers=tuple(
            ThermometerSummary(
                other.signal,
                other.rmse_left_out_ratio,
                other.command.write(directory),
                other.reason,
            )
            for other in others
        ),
        advice=advice,
    )


def _write(command: AddCommand | None, directory: Path) -> str:
    return "" if command is None else command.write(directory)


def list_commands(
    effects: Sequence[EffectConfig], steps: Sequence[Diagnosis], catalogue: Catalogue
) -> list[AddCommand | None]:
    """Return the command that adds what each step names; None where it names nothing."""
    commands: list[AddCommand | None] = []
    for step in steps:
        if step.effect is None:
            commands.append(None)
            continue
        commands.append(propose_command(effects, catalogue[step.effect], step.parameters))
        effects = extend_model(effects, catalogue, step.effect, step.parameters)
    return commands


def _diagnose_fleet(project: ProjectFolder, progress: Progress) -> FleetDiagnosis:
    """Return the diagnosis of a design from all of its units together.

    A unit whose logs cannot be read is named, and the others are examined.

    Raises:
        InputError: zerodrift.toml does not say where the units are, or none can be examined.
    """
    config = project.config
    progress("looking for units")
    require_trust(config.plugin_files, config.directory, progress)
    catalogue = project.catalogue
    names = find_sensors(config)
    units, errors = [], {}
    for number, name in enumerate(names, start=1):
        progress(f"{name}: {number} of {len(names)}")
        try:
            dataset = load_dataset(configure_sensor(config, name), project.skip_invalid)
            units.append(look_at_unit(name, dataset, catalogue, config.effects))
        except ZerodriftError as error:
            errors[name] = str(error)
    if not units:
        first = next(iter(errors.values()))
        raise InputError(f"{config.path}: no unit of {len(names)} can be examined. {first}")
    found = pool_units(units, catalogue, config.effects, progress)
    progress("looking for units that differ")
    limit = config.fleet.outlier_z
    differ = find_differences(found.units, found.missing, catalogue, config.effects, limit)
    return summarise_joint(config.sensor_name, found, differ, errors)
