"""Opens a project for a command: example logs, configuration, dataset, trained compensator."""

from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.fleet_config import PLACEHOLDER
from zerodrift.base.journal import write_all
from zerodrift.base.records import to_dict
from zerodrift.base.sealed import render_sealed
from zerodrift.dataset.runs import Dataset
from zerodrift.tasks.trust import require_trust

if TYPE_CHECKING:
    from rich.console import Console

    from zerodrift.train.compensator import Compensator
    from zerodrift.train.summary import NetworkChoice
    from zerodrift.verify.summary import Statement


def open_config(directory: Path, sensor: str | None = None) -> Config:
    """Return a project's configuration, or that of one unit of a fleet.

    Raises:
        InputError: zerodrift.toml is missing or wrong, or has no such unit.
    """
    from zerodrift.fleet.sensors import load_unit

    return load_unit(directory, sensor)


def refuse_shared_program(directory: Path, sensor: str | None) -> None:
    """Refuse a request for one unit's own C where all units of a fleet share one program.

    Raises:
        InputError: `[firmware] coefficients = "block"`, and a unit was named.
    """
    if sensor is None:
        return
    config = load_config(directory)
    if config.block.in_block:
        raise InputError(
            f"--sensor {sensor}: {config.path} has coefficients in a block, so that no unit has C"
            " of its own; expected the fleet as a whole. `zerodrift fleet` builds and checks"
            " program and blocks, and computes only what has changed; `zerodrift block show FILE`"
            " prints what a unit's block holds."
        )


def open_project(
    directory: Path, skip_invalid: bool = False, sensor: str | None = None
) -> tuple[Config, Dataset]:
    """Return a project's configuration and logs, or those of one unit of a fleet.

    Raises:
        InputError: zerodrift.toml or a log is missing or wrong, or the project brings files of
            effects that the user does not agree to run.
    """
    from zerodrift.dataset.load import load_dataset

    config = open_config(directory, sensor)
    require_trust(config.plugin_files, directory)
    try:
        return config, load_dataset(config, skip_invalid)
    except InputError as error:
        if sensor is None and is_fleet(config):
            raise InputError(
                f"{error} This project is a fleet: --sensor NAME works on one unit of it,"
                " `zerodrift fleet` on all."
            ) from error
        raise


def is_fleet(config: Config) -> bool:
    """Return whether `[fleet]` or `[logs]` name the folders of many sensors of one design."""
    return bool(config.fleet.folder) or any(PLACEHOLDER in log for log in config.train_logs)


def tell_design(config: Config, sensor: str | None) -> tuple[str, ...]:
    """Return the note that a change made for one unit changes the design that all units share."""
    if sensor is None:
        return ()
    return (
        f"{config.path.name} is the design of all units; this change was judged on {sensor} alone,"
        " and `zerodrift fleet` fits the others anew",
    )


def refuse_wrong_data(
    config: Config,
    dataset: Dataset,
    *,
    force: bool = False,
    as_json: bool = False,
    keep: bool = False,
) -> "tuple[Statement, ...]":
    """Stop at wrong data, before anything is fitted; with `force`, return what was found.

    Args:
        config: the project.
        dataset: its logs.
        force: go on all the same.
        as_json: print what stops it as JSON too.
        keep: keep what stops a firmware in build/, for the report.

    Raises:
        CheckError: the logs are wrong, and zerodrift.toml does not accept it.
        InputError: `[logs] accept` names what is not there.
    """
    from zerodrift.cli.common import print_result
    from zerodrift.diagnosis.referee import explain_refusals, find_refusals
    from zerodrift.verify.summary import REFUSED, LogsRefused, Refusal, state_notes

    notes = find_refusals(config, dataset, one_of_many=is_fleet(config))
    refused = state_notes(notes)
    if not notes or force:
        return refused
    if keep:
        refusal = render_sealed(to_dict(Refusal(model_hash="", refused=refused)))
        write_all(config.directory, {config.build_directory / REFUSED: refusal})
    if as_json:
        print_result(LogsRefused(refused=refused))
    raise CheckError(
        f"{explain_refusals(notes, config)}\nNothing was written. `--force` goes on all the same, "
        "and header and manifest say so."
    )


def train_project(config: Config, dataset: Dataset, console: "Console") -> "Compensator":
    """Return the project's compensator: that in build/ if configuration and logs are the same."""
    from zerodrift.physics.catalogue import load_catalogue
    from zerodrift.train.compensator import DESCRIPTION, Compensator
    from zerodrift.train.prepare import mark_inputs
    from zerodrift.train.progress import show_progress
    from zerodrift.train.training import list_checkpoints
    from zerodrift.verify.network_choice import train_or_choose

    catalogue = load_catalogue(config.plugin_files)
    mark = mark_inputs(config, dataset)
    try:
        kept = Compensator.load(config.build_directory, catalogue)
        if kept.trained_from == mark:
            console.print("the logs and the model are those of the last training; not repeated")
            return kept
        console.print("the logs or the model have changed since the last training; trained again")
    except InputError as error:
        if (config.build_directory / DESCRIPTION).exists():
            console.print(f"note: {error} It is trained again now.", markup=False)
    config.build_directory.mkdir(parents=True, exist_ok=True)
    with show_progress("training") as report:
        chosen = train_or_choose(config, dataset, catalogue=catalogue, report=report)
    if chosen.choice is not None:
        print_choice(chosen.choice, console)
    chosen.trained.compensator.save(
        config.directory, config.build_directory, done_with=list_checkpoints(config)
    )
    return chosen.trained.compensator


def print_choice(choice: "NetworkChoice", console: "Console") -> None:
    """Print the networks that `[network] kind = "auto"` tried, and its choice."""
    from zerodrift.cli.console import open_table
    from zerodrift.verify.network_choice import tabulate

    heads, rows = tabulate(choice)
    title = f"RMSE on runs left out, and a step on {choice.core}"
    table = open_table(title, ("network",), heads)
    for row in rows:
        table.add_row(*row)
    console.print(table)
    console.print(
        f"{choice.taken} is taken: the cheapest of those within 5 % of the best."
        f" {choice.explanation}"
    )
