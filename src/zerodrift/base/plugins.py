"""Parts that installed packages add by entry points; one that cannot be loaded is missing alone."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from zerodrift.base.terminal import tell

EFFECTS, FORMATS, IMPORTERS, CORES, COMMANDS, REPORT = (
    f"zerodrift.{part}"
    for part in ("effects", "formats", "importers", "cores", "commands", "report")
)
"""Groups of entry points; docs/how-to/write-a-plugin.md says what each one's objects are."""

T = TypeVar("T")


def list_points(group: str) -> list[EntryPoint]:
    """Return the entry points of a group that installed packages declare, by name."""
    return sorted(entry_points(group=group), key=lambda point: point.name)


@cache
def load_parts(group: str, kind: type[T]) -> tuple[T, ...]:
    """Return what the entry points of a group hold.

    What cannot be loaded, or is something else, is left out; stderr says so, once.

    Args:
        group: one of this module's groups.
        kind: what each entry point must hold.
    """
    parts = []
    for point in list_points(group):
        try:
            part = point.load()
            if not isinstance(part, kind):
                raise TypeError(f"holds a {type(part).__name__}, expected {kind.__name__}")
        except Exception as error:  # noqa: BLE001 - whatever a stranger's import raises
            tell_missing(point, error)
        else:
            parts.append(part)
    return tuple(parts)


def tell_missing(point: EntryPoint, error: BaseException) -> None:
    """Say on stderr that a part of an installed package is missing, and why."""
    package = f" of {point.dist.name}" if point.dist is not None else ""
    tell(
        f"the plug-in '{point.name}'{package} ({point.group}, {point.value}) is left out:"
        f" {type(error).__name__}: {error}. Mend or uninstall that package."
    )
