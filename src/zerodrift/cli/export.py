"""`zerodrift export`: the trained compensator as float ONNX, integer model and golden vectors."""

import click

from zerodrift.cli.common import (
    as_request,
    directory_option,
    json_option,
    print_result,
    sensor_option,
    skip_invalid_option,
)
from zerodrift.cli.console import show_progress
from zerodrift.tasks.export import ExportRequest, export


@click.command()
@directory_option
@sensor_option
@json_option
@skip_invalid_option
@click.option("--force", is_flag=True, help="Export from logs in which wrong data are found.")
@as_request(ExportRequest)
def command(request: ExportRequest, as_json: bool) -> None:
    """Write build/: network.onnx (float), model.json, integer.onnx, golden.npz, certificate.json.

    The integer model is proven free of overflow for every input, or refused with the reason.
    Logs that hold wrong data stop it before anything is fitted: exit code 1.
    """
    with show_progress() as progress:
        found = export(request, progress)
    if as_json:
        print_result(found)
        return
    click.echo(
        f"model {found.model_hash[:12]}: {found.bounds_proven} bounds proven for every input"
    )
    click.echo("wrote " + ", ".join(found.files))
