"""`zerodrift workbench`: the loop in a browser, on this machine alone."""

import contextlib
import webbrowser
from pathlib import Path

import click

from zerodrift.commands.common import directory_option, skip_invalid_option
from zerodrift.errors import InputError


@click.command()
@directory_option
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port (default: any that is free)."
)
@click.option("--no-browser", is_flag=True, help="Print the address only; open no browser.")
@skip_invalid_option
def command(directory: Path, port: int, no_browser: bool, skip_invalid: bool) -> None:
    """Open a page on DIR: measurement, model and residual, the verdict, Add, Undo, firmware.

    The page runs the commands of this command line and shows what they print. It is served on
    127.0.0.1 to whoever has the token in its address; nothing leaves this machine. Without a
    zerodrift.toml in DIR it begins a new project from logs, or a simulated one to practise on.
    """
    try:
        from zerodrift.workbench.server import Workbench
    except ModuleNotFoundError as error:
        raise InputError(
            f"the workbench needs the package '{error.name}'; install it with: pip install dash"
        ) from error
    bench = Workbench(directory, port, skip_invalid=skip_invalid)
    click.echo(f"Workbench on {bench.place.directory}: {bench.url}")
    click.echo("Ctrl-C ends it.")
    if not no_browser:
        webbrowser.open(bench.url)
    with contextlib.suppress(KeyboardInterrupt):
        bench.serve()
    bench.close()
    click.echo("ended")
