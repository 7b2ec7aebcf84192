"""`zerodrift workbench`: the loop in a browser, on this machine alone."""

import contextlib
import signal
import threading
import webbrowser
from pathlib import Path
from types import FrameType

import click

from zerodrift.base.config import FILE_NAME, load_config
from zerodrift.base.errors import InputError
from zerodrift.base.extras import PAGE, WORKBENCH, require
from zerodrift.cli.common import (
    directory_option,
    sensor_option,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import show_progress
from zerodrift.fleet.sensors import load_unit
from zerodrift.tasks.trust import require_trust


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
    require(PAGE, "zerodrift workbench")
    require(WORKBENCH, "zerodrift workbench")
    from zerodrift.workbench.early import EarlyPage
    from zerodrift.workbench.events import SKIP_INVALID
    from zerodrift.workbench.hold import hold_directory, release_directory

    if sensor is not None:
        load_unit(directory, sensor)
    with show_progress() as progress:
        require_trust(_list_plugins(directory), directory, progress)
    # Refused before a page is promised; the page itself holds the directory from then on.
    release_directory(hold_directory(directory.resolve()))
    early = EarlyPage(directory, port, sensor)
    early.begin(*([SKIP_INVALID] if skip_invalid else []))
    click.echo(f"Workbench on {directory.resolve()}: {early.url}")
    click.echo("Ctrl-C ends it.")
    if not no_browser:
        webbrowser.open(early.url)
    interrupted = threading.Event()

    def interrupt(number: int, frame: FrameType | None) -> None:
        interrupted.set()
        signal.default_int_handler(number, frame)

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, interrupt)
    with contextlib.suppress(KeyboardInterrupt):
        from zerodrift.workbench.server import Workbench  # takes seconds; the first page is there

        bench = Workbench(directory, skip_invalid=skip_invalid, sensor=sensor, early=early)
        with contextlib.suppress(KeyboardInterrupt):
            bench.serve(interrupted)
        bench.close()
    early.close()
    click.echo("ended")


def _list_plugins(directory: Path) -> tuple[Path, ...]:
    """Return the project's files of effects; none where zerodrift.toml is wrong, as the page
    shows."""
    try:
        return load_config(directory).plugin_files if (directory / FILE_NAME).is_file() else ()
    except InputError:
        return ()
