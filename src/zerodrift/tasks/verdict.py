"""Finds the verdict, in the same way for `diagnose`, the report and the page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.bad_runs import describe_bad_run
from zerodrift.diagnosis.changes import AddCommand, extend_model, propose_command
from zerodrift.diagnosis.course import RepeatedDiagnosis, diagnose_until_done
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.explained import Sentence
from zerodrift.diagnosis.plain_errors import tell_plain_errors
from zerodrift.diagnosis.referee import review_logs
from zerodrift.diagnosis.revision import list_needless
from zerodrift.diagnosis.summary import AdviceSummary
from zerodrift.diagnosis.thermometers import OtherThermometer, try_thermometers
from zerodrift.diagnosis.unseen import describe_unseen
from zerodrift.physics.catalogue import Catalogue
from zerodrift.report.results import (
    AddedEffect,
    DiagnoseResult,
    DiagnosisStep,
    ThermometerSummary,
)


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


def find_verdict(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    *,
    auto: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Verdict:
    """Return what a model lacks, with remarks.

    Args:
        config: the project.
        dataset: its runs.
        catalogue: the known effects.
        auto: whether to add what is missing and diagnose again until nothing is.
        say: called with a description of each stage of the work.
    """

    def advance(kind: str) -> None:
        say(f"tried {kind}")

    course = diagnose_until_done(config.effects, dataset, catalogue, advance) if auto else None
    if course is None:
        effects, diagnosis = config.effects, diagnose(config.effects, dataset, catalogue, advance)
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


def summarise_verdict(
    verdict: Verdict,
    commands: Sequence[AddCommand | None],
    advice: AdviceSummary | None,
    directory: Path,
) -> DiagnoseResult:
    """Return the verdict as the command prints it.

    Args:
        verdict: the verdict.
        commands: for each step, the command that adds the effect it names.
        advice: what can be learnt from the logs.
        directory: of the project, as the user gave it.
    """
    steps = tuple(
        DiagnosisStep(**vars(step), command=_write(command, directory))
        for step, command in zip(verdict.steps, commands, strict=True)
    )
    told = summarise_diagnosis(verdict.diagnosis, commands[-1], verdict.others, advice, directory)
    if verdict.course is None:
        return told
    added = tuple(
        AddedEffect(step.effect, step.parameters, step.command)
        for step in steps
        if step.effect is not None
    )
    return replace(told, added=added, steps=steps, drop=verdict.course.drop)


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


def explain_others(others: Sequence[OtherThermometer], directory: Path) -> list[Sentence]:
    """Return a sentence on each other thermometer that the drift follows."""
    return [
        Sentence(
            f"The drift follows another thermometer, {other.signal}: {other.reason}. "
            f"To add it: {other.command.write(directory)}"
        )
        for other in others
    ]


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
