"""The formulas of conversions in certificate.json as the checker reads them, by itself."""

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal


@dataclass(frozen=True)
class ToldPiece:
    """A polynomial over a range, with a0 exp(a1 (t - a2)**2) beside it or not."""

    low: Decimal
    high: Decimal
    coefficients: tuple[Decimal, ...]
    bump: tuple[Decimal, ...]


@dataclass(frozen=True)
class ToldDivider:
    """A resistor in series with the sensor's."""

    series: Decimal
    counts: Decimal
    is_low: bool


@dataclass(frozen=True)
class ToldJunction:
    """What a code of a thermocouple's cold junction stands for."""

    input: str
    scale: Decimal
    offset: Decimal


@dataclass(frozen=True)
class ToldConversion:
    """What a raw code, or the sum with a junction's voltage, stands for."""

    input: str
    kind: str
    scale: Decimal
    offset: Decimal
    divider: ToldDivider | None = None
    points: tuple[tuple[Decimal, ...], ...] = ()
    coefficients: tuple[Decimal, ...] = ()
    pieces: tuple[ToldPiece, ...] = ()
    r25_ohm: Decimal = Decimal(0)
    beta_K: Decimal = Decimal(0)
    junction_degC: Decimal | None = None
    raw_scale: Decimal | None = None
    raw_offset: Decimal | None = None
    junction: ToldJunction | None = None


def read_told(told: object) -> dict[str, ToldConversion]:
    """Return input -> its formula, of the certificate's `conversions`.

    Raises:
        KeyError, TypeError, ValueError: it is not built like a certificate.
    """
    found = [_read_conversion(_read_object(row)) for row in _read_list(told or [])]
    return {one.input: one for one in found}


def _read_conversion(row: Mapping[str, object]) -> ToldConversion:
    def optional(key: str) -> Decimal | None:
        return None if row.get(key) is None else _read_number(row[key])

    divider, junction = row.get("divider"), row.get("junction")
    return ToldConversion(
        input=str(row["input"]),
        kind=str(row["kind"]),
        scale=_read_number(row["scale"]),
        offset=_read_number(row["offset"]),
        divider=None if divider is None else _read_divider(_read_object(divider)),
        points=tuple(_read_numbers(point) for point in _read_list(row.get("points", []))),
        coefficients=_read_numbers(row.get("coefficients", [])),
        pieces=tuple(_read_piece(_read_object(one)) for one in _read_list(row.get("pieces", []))),
        r25_ohm=optional("r25_ohm") or Decimal(0),
        beta_K=optional("beta_K") or Decimal(0),
        junction_degC=optional("junction_degC"),
        raw_scale=optional("raw_scale"),
        raw_offset=optional("raw_offset"),
        junction=None if junction is None else _read_junction(_read_object(junction)),
    )


def _read_divider(row: Mapping[str, object]) -> ToldDivider:
    ends = (_read_number(row["series_ohm"]), _read_number(row["counts"]))
    return ToldDivider(*ends, row["side"] == "low")


def _read_piece(row: Mapping[str, object]) -> ToldPiece:
    ends = (_read_number(row["low"]), _read_number(row["high"]))
    return ToldPiece(*ends, _read_numbers(row["coefficients"]), _read_numbers(row.get("bump", [])))


def _read_junction(row: Mapping[str, object]) -> ToldJunction:
    return ToldJunction(str(row["input"]), _read_number(row["scale"]), _read_number(row["offset"]))


def _read_number(value: object) -> Decimal:
    """Return a number of the certificate, exactly."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r:.40} is no number")
    return Decimal(value)


def _read_numbers(value: object) -> tuple[Decimal, ...]:
    return tuple(map(_read_number, _read_list(value)))


def _read_list(value: object) -> list[object]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r:.40} is no list")
    return value


def _read_object(value: object) -> Mapping[str, object]:
    if not isinstance(value, dict):
        raise TypeError(f"{value!r:.40} is no object")
    return value
