"""The error bound in certificate.json as the checker reads it, by itself."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

Place = tuple[str, int]
"""A node of the C and an index in it."""


@dataclass(frozen=True)
class FloatLine:
    """A signal of the float model, and how the chip has it."""

    node: str
    index: int
    scale: Fraction
    offset: Fraction
    operation: str
    of: tuple[int, ...]
    numbers: tuple[Fraction | None, ...]

    @property
    def place(self) -> Place:
        """The integer that stands for it."""
        return self.node, self.index


@dataclass(frozen=True)
class ErrorClaim:
    """What is claimed of an output."""

    output: str
    counts_per_unit: int
    signal: int
    bound: Fraction


def read_bound(told: Mapping[str, object]) -> tuple[list[ErrorClaim], list[FloatLine]]:
    """Return the claims on the outputs, and the float model that they are about.

    Raises:
        KeyError, TypeError, ValueError: it is not built like a certificate.
    """
    claims = [_read_claim(row) for row in _rows(told, "error_bound")]
    return claims, [_read_line(row) for row in _rows(told, "float_model")]


def _rows(told: Mapping[str, object], key: str) -> list[Mapping[str, object]]:
    rows = told[key]
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise TypeError(f"{key} is no list")
    return rows


def _read_number(value: object) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r:.40} is no number")
    return Fraction(value)


def _read_whole(value: object) -> int:
    if type(value) is not int:
        raise TypeError(f"{value!r:.40} is no integer")
    return value


def _read_list(value: object) -> list[object]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r:.40} is no list")
    return value


def _read_claim(row: Mapping[str, object]) -> ErrorClaim:
    per_unit = _read_whole(row["counts_per_unit"])
    if per_unit < 1:
        raise ValueError(f"{per_unit} counts per unit")
    return ErrorClaim(
        str(row["output"]), per_unit, _read_whole(row["signal"]), _read_number(row["bound"])
    )


def _read_line(row: Mapping[str, object]) -> FloatLine:
    return FloatLine(
        str(row["node"]),
        _read_whole(row["index"]),
        _read_number(row["scale"]),
        _read_number(row["offset"]),
        str(row["operation"]),
        tuple(map(_read_whole, _read_list(row["of"]))),
        tuple(None if x is None else _read_number(x) for x in _read_list(row["numbers"])),
    )
