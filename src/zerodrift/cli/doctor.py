"""`zerodrift doctor`: what this machine has and lacks."""

from pathlib import Path

import click

from zerodrift.cli.common import directory_option, json_option, print_result
from zerodrift.cli.console import open_console, open_table


@click.command()
@directory_option
@json_option
def command(directory: Path, as_json: bool) -> None:
    """List what this machine has: packages, compilers, emulators, programs; the project's state.

    Changes nothing. Exit code 1 where firmware cannot be built and checked on this machine.
    """
    from zerodrift.base.config import FILE_NAME, load_config
    from zerodrift.base.errors import CheckError
    from zerodrift.report.results import DoctorResult
    from zerodrift.verify.machine import examine_machine, examine_project

    machine = examine_machine()
    items = machine.items
    if (directory / FILE_NAME).is_file():
        config = load_config(directory)
        items += examine_project(directory, (config.build_directory, config.firmware_out))
    if as_json:
        print_result(DoctorResult(machine.can_check, tuple(items)))
    else:
        console = open_console()
        for group in dict.fromkeys(item.group for item in items):
            table = open_table("", (group, "found", "what for, or what to do"), ())
            for item in items:
                if item.group == group:
                    table.add_row(item.name, item.state, item.use)
            console.print(table)
    if not machine.can_check:
        raise CheckError(
            "firmware cannot be built and checked here: expected a host compiler, ziglang and"
            " unicorn. Install what is missing above."
        )
    if not as_json:
        click.echo("firmware can be built here, and checked on the host and on emulated cores")
