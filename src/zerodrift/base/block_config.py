"""The keys of `[firmware]` on where a program's coefficients are, and on the block's fields."""

from dataclasses import dataclass
from datetime import date

from zerodrift.base.toml_table import TomlTable

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
