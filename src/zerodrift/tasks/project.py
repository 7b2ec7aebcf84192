"""A project as the tasks open it: configuration, logs, effects."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import InputError
from zerodrift.base.fleet_config import PLACEHOLDER
from zerodrift.base.journal import hold_project
from zerodrift.base.progress import SILENT, Progress
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.fleet.sensors import load_unit
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.tasks.trust import claim, require_place, require_trust


@dataclass(frozen=True)
class ProjectFolder:
    """Which project, or unit of a fleet, a request is for; what is read of it is read once."""

    directory: Path = Path()
    """Of zerodrift.toml."""
    sensor: str | None = None
    """A unit of a fleet; None: the project has one sensor, or all units are meant."""
    skip_invalid: bool = False
    """Drop invalid rows of the logs instead of refusing them."""

    @cached_property
    def config(self) -> Config:
        """The configuration of the project, or of its unit.

        Raises:
            InputError: zerodrift.toml is missing or wrong, or has no such unit.
        """
        return load_unit(self.directory, self.sensor)

    @cached_property
    def catalogue(self) -> Catalogue:
        """The effects there are, those of `[plugins] files` with them, which are run for it."""
        return load_catalogue(self.config.plugin_files)

    @cached_property
    def dataset(self) -> Dataset:
        """The logs.

        Raises:
            InputError: one is missing or wrong.
        """
        try:
            return load_dataset(self.config, self.skip_invalid)
        except InputError as error:
            if self.sensor is None and is_fleet(self.config):
                raise InputError(
                    f"{error} This project is a fleet: --sensor NAME works on one unit of it,"
                    " `zerodrift fleet` on all."
                ) from error
            raise


def open_project(project: ProjectFolder, progress: Progress = SILENT) -> tuple[Config, Dataset]:
    """Return a project's configuration and logs, or those of one unit of a fleet.

    Raises:
        InputError: zerodrift.toml or a log is missing or wrong, or the project brings files of
            effects that the user does not agree to run.
    """
    progress("reading logs")
    require_trust(project.config.plugin_files, project.directory, progress)
    return project.config, project.dataset


@contextmanager
def hold_own(directory: Path) -> Iterator[None]:
    """Lock a project against other writers for as long as the block runs.

    What changes a project is its author's: it counts as this user's own (`zerodrift.tasks.trust`).
    """
    with hold_project(directory):
        claim(directory)
        yield


def refuse_shared_program(project: ProjectFolder) -> None:
    """Refuse a request for one unit's own C where all units of a fleet share one program.

    Raises:
        InputError: `[firmware] coefficients = "block"`, and a unit was named.
    """
    if project.sensor is None:
        return
    config = load_config(project.directory)
    if config.block.in_block:
        raise InputError(
            f"--sensor {project.sensor}: {config.path} has coefficients in a block, so that no unit"
            " has C of its own; expected the fleet as a whole. `zerodrift fleet` builds and checks"
            " program and blocks, and computes only what has changed; `zerodrift block show FILE`"
            " prints what a unit's block holds."
        )


def place_firmware(config: Config, out: Path | None) -> Config:
    """Return a configuration whose firmware goes where the user says.

    Raises:
        InputError: it goes outside the project, and the user never said so.
    """
    if out is not None:
        config = replace(config, firmware_out=out)
    require_place(config.firmware_out, config.directory, out)
    return config


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
