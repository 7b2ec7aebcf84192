"""`zerodrift train`: fits the effects, then trains the network on the rest of the drift."""

import math
from typing import TYPE_CHECKING

import click

from zerodrift.base.arrays import Array
from zerodrift.cli.common import (
    as_request,
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
)
from zerodrift.cli.console import (
    open_console,
    open_table,
    print_advice,
    print_choice,
    show_progress,
)
from zerodrift.tasks.train import TrainRequest, train
from zerodrift.train.scores import Scores

if TYPE_CHECKING:
    from rich.console import Console


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
@as_request(TrainRequest)
def command(request: TrainRequest, as_json: bool) -> None:
    """Fit the effects of zerodrift.toml, then train the network on what they leave.

    Writes build/compensator.json and build/network.onnx; of a unit of a fleet, those in
    build/fleet/NAME/. An interrupted training is taken up again by the next call, with the same
    result to the bit. Logs that hold wrong data stop it before anything is fitted: exit code 1.
    """
    with show_progress() as progress:
        found = train(request, progress)
    if as_json:
        print_result(found.result)
        return
    console = open_console()
    if found.result.choice is not None:
        print_choice(found.result.choice, console)
    _print_table(found.scores, console)
    print_advice(found.advice, console)
    print_notes(found.notes)


def _print_table(scores: Scores, console: "Console") -> None:
    """Print the errors, held-out ones last since they are the ones to trust."""
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
    console.print(table)
    console.print(scores.explanation)


def _format(values: Array, k: int, full_scale: float) -> str:
    value = float(values[k])
    if not math.isfinite(value):
        return "-"
    return f"{value:.4g}\n{100.0 * value / full_scale:.3g} %"
