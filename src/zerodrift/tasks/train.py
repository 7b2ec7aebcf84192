"""Training a project: `train`, and what everything that is made of the compensator begins with."""

from dataclasses import dataclass

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.journal import write_all
from zerodrift.base.progress import SILENT, Progress, Stage
from zerodrift.base.records import render_sealed, to_dict
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.advice import Advice, advise
from zerodrift.diagnosis.referee import explain_refusals, find_refusals
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.report.results import TrainResult
from zerodrift.tasks.project import ProjectFolder, hold_own, is_fleet, open_project
from zerodrift.train.compensator import DESCRIPTION, Compensator
from zerodrift.train.prepare import mark_inputs
from zerodrift.train.scores import Scores
from zerodrift.train.summary import summarise_training
from zerodrift.train.training import list_checkpoints
from zerodrift.verify.network_choice import Chosen, train_or_choose
from zerodrift.verify.summary import REFUSED, LogsRefused, Refusal, Statement, state_notes


@dataclass(frozen=True)
class TrainRequest:
    """What is to be trained, and how."""

    project: ProjectFolder
    epochs: int | None = None
    """Instead of [network] epochs."""
    starts: int | None = None
    """Instead of [network] starts."""
    resume: bool = True
    """Take up an interrupted training."""
    force: bool = False
    """Train on logs in which wrong data are found."""


@dataclass(frozen=True)
class TrainOutcome:
    """What was trained."""

    result: TrainResult
    scores: Scores
    advice: Advice | None
    """What can be learnt from the logs."""
    notes: tuple[str, ...]


def train(request: TrainRequest, progress: Progress = SILENT) -> TrainOutcome:
    """Fit the effects, then train the network on what they leave; write both to build/.

    Raises:
        CheckError: the logs are wrong, and nobody said to go on.
        InputError: zerodrift.toml or a log is missing or wrong.
    """
    with hold_own(request.project.directory):
        config, dataset = open_project(request.project, progress)
        refuse_wrong_data(config, dataset, force=request.force)
        chosen = _train(config, dataset, progress, request)
    trained, advice = chosen.trained, advise(config, dataset)
    told = summarise_training(trained.compensator, trained.scores)
    result = TrainResult(
        **vars(told),
        advice=None if advice is None else advice.summarise(),
        choice=chosen.choice,
        contracting=trained.contracting,
    )
    notes = (*dataset.notes, *trained.compensator.notes)
    return TrainOutcome(result, trained.scores, advice, notes)


def refuse_wrong_data(
    config: Config, dataset: Dataset, *, force: bool = False, keep: bool = False
) -> tuple[Statement, ...]:
    """Stop at wrong data, before anything is fitted; with `force`, return what was found.

    Args:
        config: the project.
        dataset: its logs.
        force: go on all the same.
        keep: keep what stops a firmware in build/, for the report.

    Raises:
        CheckError: the logs are wrong, and zerodrift.toml does not accept it; `LogsRefused` is its
            result.
        InputError: `[logs] accept` names what is not there.
    """
    notes = find_refusals(config, dataset, one_of_many=is_fleet(config))
    refused = state_notes(notes)
    if not notes or force:
        return refused
    if keep:
        refusal = render_sealed(to_dict(Refusal(model_hash="", refused=refused)))
        write_all(config.directory, {config.build_directory / REFUSED: refusal})
    raise CheckError(
        f"{explain_refusals(notes, config)}\nNothing was written. `--force` goes on all the same, "
        "and header and manifest say so.",
        LogsRefused(refused=refused),
    )


def train_project(config: Config, dataset: Dataset, progress: Progress = SILENT) -> Compensator:
    """Return the project's compensator: that in build/ if configuration and logs are the same."""
    catalogue = load_catalogue(config.plugin_files)
    mark = mark_inputs(config, dataset)
    try:
        kept = Compensator.load(config.build_directory, catalogue)
        if kept.trained_from == mark:
            progress.tell("the logs and the model are those of the last training; not repeated")
            return kept
        progress.tell("the logs or the model have changed since the last training; trained again")
    except InputError as error:
        if (config.build_directory / DESCRIPTION).exists():
            progress.note(f"{error} It is trained again now.")
    chosen = _train(config, dataset, progress)
    if chosen.choice is not None:
        progress.show(chosen.choice)
    return chosen.trained.compensator


def _train(
    config: Config, dataset: Dataset, progress: Progress, request: TrainRequest | None = None
) -> Chosen:
    """Return what was trained, which is then in build/."""
    config.build_directory.mkdir(parents=True, exist_ok=True)
    with progress.measure("training") as report:
        report(Stage(0.0, "fitting physics"))
        chosen = train_or_choose(
            config,
            dataset,
            epochs=request.epochs if request else None,
            starts=request.starts if request else None,
            resume=request.resume if request else True,
            report=report,
        )
    chosen.trained.compensator.save(
        config.directory, config.build_directory, done_with=list_checkpoints(config)
    )
    return chosen
