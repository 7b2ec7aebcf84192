"""certificate.json as the checker reads it: by itself, as it shares no code with the writer."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """A range of integers, and what it is claimed of."""

    where: str
    low: int
    high: int


@dataclass(frozen=True)
class BoundClaim(Claim):
    """The range of a sum, and the bits of the variable that holds it."""

    bits: int


@dataclass(frozen=True)
class BlockClaim(Claim):
    """What each number of a field of a block can be, and its rows add up to."""

    row: int
    """Numbers in a row; 0: nothing is claimed of rows."""
    norm: int
    layer: tuple[int, int, int]
    """Units of a GRU no sum of which leaves 32 bits, words of its rows of features and of state."""


@dataclass(frozen=True)
class TableClaim(Claim):
    """The range of what is read of a table, and the lines that can be read."""

    lines: int


@dataclass(frozen=True)
class CertificateClaims:
    """All claims about a model and its C."""

    model: str
    """Hash of the integer model."""
    prefix: str
    files: Mapping[str, str]
    """Name -> SHA-256."""
    inputs: tuple[Claim, ...]
    """Channel and the codes that it can hold."""
    checksum: object
    """The state's field that guards it; None where there is none."""
    invariants: tuple[Claim, ...]
    tables: tuple[TableClaim, ...]
    shifts: Mapping[str, int]
    """Where -> bits."""
    bounds: tuple[BoundClaim, ...]
    blocks: tuple[BlockClaim, ...]
    """Of a design; empty where the numbers are the program's own."""


def read_claims(told: Mapping[str, object]) -> CertificateClaims:
    """Return the content of certificate.json.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: it is not built like a certificate.
    """
    rows = {name: _list_rows(told[name]) for name in ("inputs", "invariants", "tables", "bounds")}
    files = told["files"]
    if not isinstance(files, dict):
        raise TypeError("files is no object")
    return CertificateClaims(
        model=_read_text(told["model"]),
        prefix=_read_text(told["prefix"]),
        files={_read_text(name): _read_text(digest) for name, digest in files.items()},
        inputs=tuple(Claim(_read_text(c["channel"]), *_read_range(c)) for c in rows["inputs"]),
        checksum=told.get("checksum"),
        invariants=tuple(
            Claim(_read_text(c["where"]), *_read_range(c)) for c in rows["invariants"]
        ),
        tables=tuple(
            TableClaim(_read_text(c["where"]), *_read_range(c), _read_integer(c["lines"]))
            for c in rows["tables"]
        ),
        shifts={
            _read_text(c["where"]): _read_integer(c["shift"]) for c in _list_rows(told["shifts"])
        },
        bounds=tuple(
            BoundClaim(_read_text(c["where"]), *_read_range(c), _read_integer(c["bits"]))
            for c in rows["bounds"]
        ),
        blocks=tuple(
            BlockClaim(
                _read_text(c["where"]),
                *_read_range(c),
                _read_integer(c.get("row", 0)),
                _read_integer(c.get("norm", 0)),
                _read_layer(c),
            )
            for c in _list_rows(told.get("blocks", []))
        ),
    )


def _list_rows(value: object) -> list[dict[str, object]]:
    if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
        raise TypeError(f"{value!r:.40} is no list of claims")
    return value


def _read_range(row: Mapping[str, object]) -> tuple[int, int]:
    return _read_integer(row["low"]), _read_integer(row["high"])


def _read_integer(value: object) -> int:
    if type(value) is not int:
        raise TypeError(f"{value!r:.40} is no integer")
    return value


def _read_layer(row: Mapping[str, object]) -> tuple[int, int, int]:
    units, x, h = (_read_integer(row.get(name, 0)) for name in ("units", "x_pairs", "h_pairs"))
    return units, x, h


def _read_text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.40} is no text")
    return value
