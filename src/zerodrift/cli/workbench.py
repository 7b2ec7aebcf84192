"""`zerodrift workbench`: the loop in a browser, on this machine alone."""

from pathlib import Path

import click

from zerodrift.cli.common import (
    directory_option,
    sensor_option,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import show_progress
from zerodrift.workbench.run import WorkbenchRequest, run_workbench


@click.command()
@directory_option
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port (default: any that is free)."
)
@click.option("--no-browser", is_flag=True, help="Print the address only; open no browser.")
@sensor_option
@trust_option
@skip_invalid_option
def command(
    directory: Path,
    port: int,
    no_browser: bool,
    sensor: str | None,
    skip_invalid: bool,
) -> None:
    """Open a page on DIR: measurement, model and residual, the verdict, Add, Undo, firmware.

    The page runs the commands of this command line and shows what they print. It is served on
    127.0.0.1 to whoever has the token in its address; nothing leaves this machine. Without a
    zerodrift.toml in DIR it begins a new project from logs, or a simulated one to practise on. Of a
    fleet, --sensor names the unit; what Add and Remove change is the design that all units share.
    """

    def tell(url: str) -> None:
        click.echo(f"Workbench on {directory.resolve()}: {url}")
        click.echo("Ctrl-C ends it.")

    request = WorkbenchRequest(directory, sensor, skip_invalid, port, not no_browser)
    with show_progress() as progress:
        run_workbench(request, tell, progress)
    click.echo("ended")
