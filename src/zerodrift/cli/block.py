"""`zerodrift block`: what a unit's block holds."""

from pathlib import Path

import click

from zerodrift.cli.common import json_option, print_result
from zerodrift.cli.console import open_console, open_table
from zerodrift.report.results import ShownBlock
from zerodrift.tasks.block import show_blocks

SHOWN = 6
"""Numbers of a field that the terminal shows; `--json` gives all."""


@click.group()
def command() -> None:
    """What a unit's block of coefficients holds, and whether it is sound."""


@command.command("show")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option(
    "--design",
    "design_file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=None,
    metavar="FILE",
    help="The design.json of the blocks (default: beside FILE, or one or two folders above).",
)
@json_option
def show(files: tuple[Path, ...], design_file: Path | None, as_json: bool) -> None:
    """Show blocks (.bin, .hex or .json), and refuse any that no chip would take.

    Refused are blocks that were cut, damaged, made for another program or in another format, or
    hold a number for which nothing is proven; and two blocks with the same serial number.
    """
    found = show_blocks(files, design_file)
    if as_json:
        print_result(found)
        return
    for block in found.blocks:
        _print(block)


def _print(block: ShownBlock) -> None:
    console = open_console()
    table = open_table(block.file, ("", ""), ())
    for name, text in (
        ("serial", block.serial),
        ("calibrated", block.calibrated),
        ("sequence", str(block.sequence)),
        ("design", block.design),
        ("bytes", str(block.bytes)),
        ("CRC-32", f"{block.crc:08x}"),
    ):
        table.add_row(name, text)
    console.print(table)
    if not block.known_design:
        console.print("No design.json beside it or above: the numbers were not looked at.")
        return
    table = open_table("Numbers, each within the design's set", ("field", "numbers"), ())
    for name, numbers in block.fields.items():
        more = f" ... {len(numbers)} in all" if len(numbers) > SHOWN else ""
        table.add_row(name, ", ".join(map(str, numbers[:SHOWN])) + more)
    console.print(table)
