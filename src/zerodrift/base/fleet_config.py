"""The `[fleet]` table of zerodrift.toml, and what `[firmware]` says of a design's blocks."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from pathlib import PurePosixPath

from zerodrift.base.errors import nearest
from zerodrift.base.toml_table import TomlTable

# The keys of `[firmware]` on where a program's coefficients are, and on the block's fields.

BLOCK_KEYS = ("coefficients", "serial", "calibrated", "sequence", "block_address")
PLACES = ("constants", "block")


@dataclass(frozen=True)
class BlockConfig:
    """`[firmware]`: constants of the program, or a block of one program for all units."""

    coefficients: str = "constants"
    """constants | block."""
    serial: str = ""
    """Of the unit, up to 24 bytes; empty: the sensor's name, in a fleet each unit's."""
    calibrated: date = date(1970, 1, 1)
    """Date of the calibration that changes a unit's numbers; 1970-01-01 where none is stated."""
    sequence: int = 0
    """Of a unit's next block; 0: counted from those that it has had."""
    address: int = 0
    """Address of the block in flash, for the HEX file."""

    @property
    def in_block(self) -> bool:
        """Whether the numbers lie in a block."""
        return self.coefficients == "block"

    @property
    def number(self) -> int:
        """The least sequence of a next block: the stated one, or the date as days since 1970."""
        return self.sequence or max((self.calibrated - date(1970, 1, 1)).days, 1)


def read_block_config(firmware: TomlTable) -> BlockConfig:
    """Return the keys of `[firmware]` on blocks.

    Raises:
        InputError: a value of the wrong type or range.
    """
    own = BlockConfig(coefficients=firmware.choice("coefficients", PLACES, "constants"))
    serial = firmware.text("serial") if "serial" in firmware.values else ""
    if len(serial.encode()) > 24:
        raise firmware.expect("serial", "a serial number of up to 24 bytes")
    calibrated = own.calibrated
    if "calibrated" in firmware.values:
        told = firmware.values["calibrated"]
        try:
            calibrated = told if type(told) is date else date.fromisoformat(str(told))
        except ValueError:
            raise firmware.expect("calibrated", "a date, as 2026-03-01") from None
        if calibrated < own.calibrated:
            raise firmware.expect("calibrated", "a date from 1970 on")
    sequence = firmware.integer("sequence", 1, 2**32 - 1) if "sequence" in firmware.values else 0
    address = 0
    if "block_address" in firmware.values:
        address = firmware.integer("block_address", 0, 2**32 - 1)
        if address % 8:
            raise firmware.expect("block_address", "an address that 8 divides")
    return BlockConfig(own.coefficients, serial, calibrated, sequence, address)


# The `[fleet]` table of zerodrift.toml: the folders of the sensors of a design, and limits.

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
