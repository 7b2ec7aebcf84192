"""Which editions of units' blocks are known: by units.json, the registry, and the blocks there."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.blocks.editions import Edition, load_units, read_edition
from zerodrift.field.registry import FILE_NAME as REGISTRY
from zerodrift.field.registry import open_registry

Editions = Mapping[str, tuple[Edition, ...]]
"""Serial number -> editions of its blocks."""


def find_editions(directory: Path, files: Iterable[Path]) -> Editions:
    """Return the editions of all units that a project knows.

    Args:
        directory: of the project.
        files: of blocks in its firmware's folder; one that is missing or damaged tells nothing.

    Raises:
        InputError: units.json or the registry is damaged.
    """
    found: dict[str, set[Edition]] = {
        serial: {edition} for serial, edition in load_units(directory).items()
    }
    contents: list[bytes] = []
    if (directory / REGISTRY).is_file():
        with open_registry(directory / REGISTRY) as registry:
            contents += registry.list_contents()
    for path in files:
        try:
            contents.append(path.read_bytes())
        except OSError:
            continue
    for content in contents:
        try:
            serial, edition = read_edition(content, "block")
        except InputError:
            continue
        found.setdefault(serial, set()).add(edition)
    return {serial: tuple(editions) for serial, editions in found.items()}
