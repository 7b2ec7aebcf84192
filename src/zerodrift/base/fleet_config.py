"""The `[fleet]` table of zerodrift.toml: the folders of the sensors of a design, and limits."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from zerodrift.base.errors import nearest
from zerodrift.base.toml_table import TomlTable

URL = "://"
"""Within a selector that names logs elsewhere, which `zerodrift fleet` fetches."""
PLACEHOLDER = "{sensor}"
"""Stands for a sensor's name in `[fleet] folder` and in the selectors of `[logs]`."""
SHARED_RUNTIME = "runtime"
"""Beside the folders of a fleet's units: the C that all of them share."""
FLEET_KEYS = ("folder", "limits", "ratio_limit", "outlier_z")
OUTLIER_Z = 5.0
"""Robust z-score from which a sensor is an outlier: beyond it lies one value in two million of a
normal distribution, and a fleet has tens of thousands of values."""
BRACES = re.compile(r"\{[^{}]*\}?|\}")


@dataclass(frozen=True)
class FleetConfig:
    """`[fleet]`: one design, many sensors."""

    folder: str = ""
    """Folder of each sensor, with `{sensor}`; the selectors of [logs] are then relative to it."""
    limits: Mapping[str, float] = field(default_factory=dict)
    """Output -> largest held-out RMSE of a sensor that passes, in the output's unit."""
    ratio_limit: float | None = None
    """Largest held-out RMSE over noise floor, of every output; None = not judged."""
    outlier_z: float = OUTLIER_Z


def read_fleet(table: TomlTable, outputs: tuple[str, ...]) -> FleetConfig:
    """Return the checked `[fleet]` table; its defaults where the file has none.

    Args:
        table: the table, possibly empty.
        outputs: the names that limits may have.

    Raises:
        InputError: an unknown key or output, or a value of the wrong type or range.
    """
    table.refuse_unknown(FLEET_KEYS)
    folder = ""
    if "folder" in table.values:
        folder = table.text("folder").rstrip("/")
        odd = [part for part in BRACES.findall(folder) if part != PLACEHOLDER]
        if odd:
            raise table.expect("folder", f"{PLACEHOLDER} as the only text in braces, not {odd[0]}")
        if PLACEHOLDER not in folder:
            raise table.expect(
                "folder",
                f'a path with {PLACEHOLDER} for the sensor\'s name, as "fleet/{PLACEHOLDER}"',
            )
        if "#" in folder or "@" in PurePosixPath(folder).name:
            raise table.expect(
                "folder", "a folder; runs and parts belong to the selectors of [logs]"
            )
    limits_table = table.table("limits", None, optional=True)
    for name in limits_table.values:
        if name not in outputs:
            raise limits_table.error(
                name,
                f"[fleet.limits] {name} is no output{nearest(name, outputs) or '.'} Expected one"
                f" of {', '.join(outputs)}.",
            )
    return FleetConfig(
        folder=folder,
        limits={name: limits_table.positive(name) for name in limits_table.values},
        ratio_limit=table.positive("ratio_limit") if "ratio_limit" in table.values else None,
        outlier_z=table.positive("outlier_z") if "outlier_z" in table.values else OUTLIER_Z,
    )
