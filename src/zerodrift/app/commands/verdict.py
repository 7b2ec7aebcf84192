"""The one road to a verdict, for `diagnose`, the report and the page alike."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.bad_runs import describe_bad_run
from zerodrift.diagnosis.changes import AddCommand, propose_command
from zerodrift.diagnosis.course import Course, diagnose_until_done, extend_model
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.explained import Sentence
from zerodrift.diagnosis.thermometers import OtherThermometer, try_thermometers
from zerodrift.diagnosis.unseen import describe_unseen
from zerodrift.physics.catalogue import Catalogue


@dataclass(frozen=True)
class Verdict:
    """A diagnosis with what was looked at beside it."""

    diagnosis: Diagnosis
    """The last one; its notes tell of bad runs and of test logs far from the floor."""
    others: tuple[OtherThermometer, ...]
    """Further thermometers that the drift follows, where the catalogue has no name for it."""
    course: Course | None
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
    """Return what a model lacks, and what to know beside it.

    Args:
        config: the project.
        dataset: its runs.
        catalogue: the known effects.
        auto: whether to add what is missing and look again until nothing is.
        say: is told what is being done.
    """

    def advance(kind: str) -> None:
        say(f"tried {kind}")

    course = diagnose_until_done(config.effects, dataset, catalogue, advance) if auto else None
    if course is None:
        effects, diagnosis = config.effects, diagnose(config.effects, dataset, catalogue, advance)
    else:
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
        diagnosis = replace(diagnosis, notes=(*diagnosis.notes, aside))
    return Verdict(diagnosis, tuple(others), course)


def tell_steps(
    verdict: Verdict, commands: Sequence[AddCommand | None], directory: Path
) -> list[dict[str, Any]]:
    """Return the JSON of each diagnosis; the last tells of other thermometers too.

    Args:
        verdict: what was found.
        commands: what adds the effect that each step names.
        directory: of the project, as the user gave it.
    """
    told = [
        tell_diagnosis(step, command, directory)
        for step, command in zip(verdict.steps, commands, strict=True)
    ]
    told[-1]["thermometers"] = tell_thermometers(verdict.others, directory)
    return told


def tell_diagnosis(
    diagnosis: Diagnosis, command: AddCommand | None, directory: Path
) -> dict[str, Any]:
    """Return the JSON of one diagnosis."""
    return {**diagnosis.to_dict(), "command": "" if command is None else command.write(directory)}


def tell_thermometers(others: Sequence[OtherThermometer], directory: Path) -> list[dict[str, Any]]:
    """Return the JSON of other thermometers that the drift follows."""
    return [
        {
            "signal": other.signal,
            "heldout_rmse_ratio": other.heldout_rmse_ratio,
            "command": other.command.write(directory),
            "reason": other.reason,
        }
        for other in others
    ]


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
        effects = extend_model(effects, catalogue, step)
    return commands
