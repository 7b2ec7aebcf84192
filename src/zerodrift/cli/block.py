"""`zerodrift block`: what a unit's block holds."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.cli.common import json_option, print_result
from zerodrift.cli.console import open_console, open_table

if TYPE_CHECKING:
    from zerodrift.blocks.design import BlockDesign
    from zerodrift.report.results import ShownBlock

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
    from zerodrift.blocks.design import load_design
    from zerodrift.blocks.files import refuse_same_serials
    from zerodrift.report.results import BlockResult

    design = load_design(design_file) if design_file is not None else None
    shown = tuple(_read(file, design) for file in files)
    refuse_same_serials((block.file, block.serial) for block in shown)
    if as_json:
        print_result(BlockResult(shown))
        return
    for block in shown:
        _print(block)


def _read(file: Path, design: "BlockDesign | None") -> "ShownBlock":
    from zerodrift.blocks.block import decode, decode_header
    from zerodrift.blocks.files import find_design_file, read_block_file
    from zerodrift.report.results import ShownBlock

    known = design if design is not None else find_design_file(file)
    content = read_block_file(file, known)
    header = decode_header(content, str(file))
    fields: dict[str, tuple[int, ...]] = {}
    if known is not None:
        numbers = decode(known, content, str(file)).numbers
        fields = {name: tuple(found.ravel().tolist()) for name, found in numbers.items()}
    return ShownBlock(
        file=str(file),
        serial=header.serial,
        design=f"{header.design:08x}{header.design_2:08x}",
        calibrated=header.notes.calibrated.isoformat(),
        sequence=header.sequence,
        bytes=header.size,
        crc=header.crc,
        known_design=known is not None,
        fields=fields,
    )


def _print(block: "ShownBlock") -> None:
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
