"""`doctor`: what this machine has and lacks."""

from pathlib import Path

from zerodrift.base.config import FILE_NAME, load_config
from zerodrift.report.results import DoctorResult
from zerodrift.verify.machine import examine_machine, examine_project


def examine(directory: Path) -> DoctorResult:
    """Return what this machine has, and where a project lies in the directory, its state.

    Raises:
        InputError: its zerodrift.toml is wrong.
    """
    machine = examine_machine()
    items = machine.items
    if (directory / FILE_NAME).is_file():
        config = load_config(directory)
        items += examine_project(directory, (config.build_directory, config.firmware_out))
    return DoctorResult(machine.can_check, tuple(items))
