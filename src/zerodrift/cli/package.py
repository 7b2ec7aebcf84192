"""`zerodrift package`: the model as a package of a build system."""

from pathlib import Path

import click

from zerodrift.cli.common import directory_option, json_option, print_result, sensor_option
from zerodrift.cli.console import show_progress
from zerodrift.tasks.package import KINDS, PackageRequest, write_package
from zerodrift.tasks.project import ProjectFolder


@click.command()
@click.argument("kind", type=click.Choice(KINDS))
@directory_option
@sensor_option
@json_option
def command(kind: str, directory: Path, sensor: str | None, as_json: bool) -> None:
    """Write the model as a package into <out>/packages/KIND, in place of the one that lies there.

    Files that zerodrift did not write stay, and are never replaced.

    Takes the C and its runtime as they lie in the firmware folder, which `zerodrift firmware`
    writes once every compared bit is equal. Exit code 1: a file of it was changed or is missing, or
    it is stale.
    """
    request = PackageRequest(ProjectFolder(directory, sensor), kind)
    with show_progress() as progress:
        found = write_package(request, progress)
    if as_json:
        print_result(found.result)
        return
    tops = sorted({f"{name.split('/')[0]}/" if "/" in name else name for name in found.names})
    click.echo(f"wrote {found.folder}: {len(found.names)} files in {', '.join(tops)}")
