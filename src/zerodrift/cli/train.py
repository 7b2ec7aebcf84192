"""`zerodrift train`: fits the effects, then trains the network on the rest of the drift."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.cli.common import (
    changes_project,
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from zerodrift.train.scores import Scores


@click.command("train")
@directory_option
@sensor_option
@json_option
@skip_invalid_option
@click.option("--epochs", type=click.IntRange(min=1), help="Instead of [network] epochs.")
@click.option("--starts", type=click.IntRange(min=1), help="Instead of [network] starts.")
@click.option(
    "--resume/--fresh",
    default=True,
    help="Take up an interrupted training (default), or begin again.",
)
@click.option("--force", is_flag=True, help="Train on logs in which wrong data are found.")
@changes_project
def command(
    directory: Path,
    sensor: str | None,
    as_json: bool,
    skip_invalid: bool,
    epochs: int | None,
    starts: int | None,
    resume: bool,
    force: bool,
) -> None:
    """Fit the effects of zerodrift.toml, then train the network on what they leave.

    Writes build/compensator.json and build/network.onnx; of a unit of a fleet, those in
    build/fleet/NAME/. An interrupted training is taken up again by the next call, with the same
    result to the bit. Logs that hold wrong data stop it before anything is fitted: exit code 1.
    """
    from zerodrift.cli.console import open_console, print_advice
    from zerodrift.diagnosis.advice import advise
    from zerodrift.report.results import TrainResult
    from zerodrift.tasks.project import open_project, print_choice, refuse_wrong_data
    from zerodrift.train.progress import show_progress
    from zerodrift.train.summary import summarise_training
    from zerodrift.train.training import list_checkpoints
    from zerodrift.verify.network_choice import train_or_choose

    config, dataset = open_project(directory, skip_invalid, sensor)
    refuse_wrong_data(config, dataset, force=force, as_json=as_json)
    with show_progress("training") as report:
        chosen = train_or_choose(
            config, dataset, epochs=epochs, starts=starts, resume=resume, report=report
        )
    trained = chosen.trained
    trained.compensator.save(
        config.directory, config.build_directory, done_with=list_checkpoints(config)
    )
    advice = advise(config, dataset)
    if as_json:
        told = summarise_training(trained.compensator, trained.scores)
        print_result(
            TrainResult(
                **vars(told),
                advice=advice.summarise() if advice is not None else None,
                choice=chosen.choice,
                contracting=trained.contracting,
            )
        )
    else:
        if chosen.choice is not None:
            print_choice(chosen.choice, open_console())
        _print_table(trained.scores)
        print_advice(advice, open_console())
        print_notes((*dataset.notes, *trained.compensator.notes))


def _print_table(scores: "Scores") -> None:
    """Print the errors, held-out ones last since they are the ones to trust."""
    from zerodrift.cli.console import open_console, open_table

    stages = [
        f"{use}\n{stage}"
        for use in ("in-sample", "held out")
        for stage in ("raw", "physics", "network")
    ]
    table = open_table("RMSE, in the unit and in % of full scale", ("output",), stages)
    for k, name in enumerate(scores.outputs):
        cells = [
            _format(values, k, scores.full_scale[k])
            for errors in (scores.in_sample, scores.held_out)
            for values in (errors.uncompensated, errors.physics, errors.compensated)
        ]
        table.add_row(f"{name} [{scores.units[k]}]", *cells)
    console = open_console()
    console.print(table)
    console.print(scores.explanation)


def _format(values: "NDArray[np.float64]", k: int, full_scale: float) -> str:
    value = float(values[k])
    if not math.isfinite(value):
        return "-"
    return f"{value:.4g}\n{100.0 * value / full_scale:.3g} %"
