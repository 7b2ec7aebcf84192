"""`block show`: what units' blocks of coefficients hold, and whether they are sound."""

from collections.abc import Sequence
from pathlib import Path

from zerodrift.blocks.block import decode, decode_header
from zerodrift.blocks.design import BlockDesign, load_design
from zerodrift.blocks.files import find_design_file, read_block_file, refuse_same_serials
from zerodrift.report.results import BlockResult, ShownBlock


def show_blocks(files: Sequence[Path], design_file: Path | None = None) -> BlockResult:
    """Return what blocks hold.

    Args:
        files: .bin, .hex or .json.
        design_file: their design.json; None: beside each, or one or two folders above.

    Raises:
        InputError: no chip would take one of them, or two have the same serial number.
    """
    design = load_design(design_file) if design_file is not None else None
    shown = tuple(_read(file, design) for file in files)
    refuse_same_serials((block.file, block.serial) for block in shown)
    return BlockResult(shown)


def _read(file: Path, design: BlockDesign | None) -> ShownBlock:
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
