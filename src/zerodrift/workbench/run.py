"""The page on a project, served on this machine until it is interrupted."""

import contextlib
import signal
import threading
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from zerodrift.base.config import FILE_NAME, load_config
from zerodrift.base.errors import InputError
from zerodrift.base.extras import PAGE, require
from zerodrift.base.progress import SILENT, Progress
from zerodrift.fleet.sensors import load_unit
from zerodrift.tasks.trust import require_trust
from zerodrift.workbench.early import EarlyPage
from zerodrift.workbench.hold import hold_directory, release_directory
from zerodrift.workbench.jobs import SKIP_INVALID


@dataclass(frozen=True)
class WorkbenchRequest:
    """On which project a page is opened, and where."""

    directory: Path = Path()
    """Of zerodrift.toml, or where a project is to begin."""
    sensor: str | None = None
    """A unit of a fleet."""
    skip_invalid: bool = False
    """Drop invalid rows of the logs, in everything that reads them."""
    port: int = 0
    """0: any that is free."""
    browser: bool = True
    """Whether a browser is opened on it."""


def run_workbench(
    request: WorkbenchRequest,
    opened: Callable[[str], None] = lambda url: None,
    progress: Progress = SILENT,
) -> None:
    """Serve the page on 127.0.0.1 until Ctrl-C.

    Args:
        request: on which project.
        opened: is told the page's address once it answers.
        progress: asks the user before the project's own effects are run.

    Raises:
        InputError: another workbench is open on the directory, or there is no such unit.
    """
    require(PAGE, "zerodrift workbench")
    directory, sensor, skip_invalid = request.directory, request.sensor, request.skip_invalid
    if sensor is not None:
        load_unit(directory, sensor)
    require_trust(_list_plugins(directory), directory, progress)
    # Refused before a page is promised; the page itself holds the directory from then on.
    release_directory(hold_directory(directory.resolve()))
    early = EarlyPage(directory, request.port, sensor)
    early.begin(*([SKIP_INVALID] if skip_invalid else []))
    opened(early.url)
    if request.browser:
        webbrowser.open(early.url)
    interrupted = threading.Event()

    def interrupt(number: int, frame: FrameType | None) -> None:
        interrupted.set()
        signal.default_int_handler(number, frame)

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, interrupt)
    with contextlib.suppress(KeyboardInterrupt):
        # Dash takes seconds, and the first page is there already
        from zerodrift.workbench.server import Workbench

        bench = Workbench(directory, skip_invalid=skip_invalid, sensor=sensor, early=early)
        with contextlib.suppress(KeyboardInterrupt):
            bench.serve(interrupted)
        bench.close()
    early.close()


def _list_plugins(directory: Path) -> tuple[Path, ...]:
    """Return the project's files of effects; none where zerodrift.toml is wrong, as the page
    shows."""
    try:
        return load_config(directory).plugin_files if (directory / FILE_NAME).is_file() else ()
    except InputError:
        return ()
