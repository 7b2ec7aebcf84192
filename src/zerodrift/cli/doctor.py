"""`zerodrift doctor`: what this machine has and lacks."""

from pathlib import Path

import click

from zerodrift.base.errors import CheckError
from zerodrift.cli.common import directory_option, json_option, print_result
from zerodrift.cli.console import open_console, open_table
from zerodrift.tasks.doctor import examine


@click.command()
@directory_option
@json_option
def command(directory: Path, as_json: bool) -> None:
    """List what this machine has: packages, compilers, emulators, programs; the project's state.

    Changes nothing. Exit code 1 where firmware cannot be built and checked on this machine.
    """
    found = examine(directory)
    if as_json:
        print_result(found)
    else:
        console = open_console()
        for group in dict.fromkeys(item.group for item in found.items):
            table = open_table("", (group, "found", "what for, or what to do"), ())
            for item in found.items:
                if item.group == group:
                    table.add_row(item.name, item.state, item.use)
            console.print(table)
    if not found.can_check:
        raise CheckError(
            "firmware cannot be built and checked here: expected a host compiler, ziglang and"
            " unicorn. Install what is missing above."
        )
    if not as_json:
        click.echo("firmware can be built here, and checked on the host and on emulated cores")
