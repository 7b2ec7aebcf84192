"""The `[calibration]` table of zerodrift.toml: who calibrated what, when, and against what."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date, datetime

from zerodrift.base.errors import InputError
from zerodrift.base.toml_table import TomlTable

CALIBRATION_KEYS = (
    *("identifier", "begin", "end", "issued", "location", "valid_until"),
    *("laboratory", "customer", "item", "persons", "standards", "units"),
)
CONTACT_KEYS = ("name", "email", "phone", "street", "number", "post_code", "city", "country")
ITEM_KEYS = ("name", "manufacturer", "model", "serial")
PERSON_KEYS = ("name", "role", "signs")
STANDARD_KEYS = ("name", "manufacturer", "model", "serial", "certificate")
LOCATIONS = ("laboratory", "customer", "laboratoryBranch", "customerBranch", "other")


@dataclass(frozen=True)
class Contact:
    """A laboratory or a customer."""

    name: str
    city: str
    country: str
    """ISO 3166-1: two capital letters."""
    code: str = ""
    """Of a laboratory: its accreditation."""
    email: str = ""
    phone: str = ""
    street: str = ""
    number: str = ""
    post_code: str = ""


@dataclass(frozen=True)
class CalibratedItem:
    """The sensor, as its label names it."""

    name: str = ""
    manufacturer: str = ""
    model: str = ""
    serial: str = ""


@dataclass(frozen=True)
class ResponsiblePerson:
    """Who answers for the certificate."""

    name: str
    role: str = ""
    signs: bool = False
    """Whether this person signs first."""


@dataclass(frozen=True)
class WorkingStandard:
    """What the sensor was compared with."""

    name: str
    serial: str
    manufacturer: str = ""
    model: str = ""
    certificate: str = ""
    """Number of the standard's own certificate."""


@dataclass(frozen=True)
class CalibrationConfig:
    """`[calibration]`; only a certificate needs it, and says what of it is missing."""

    laboratory: Contact | None = None
    customer: Contact | None = None
    item: CalibratedItem = CalibratedItem()
    persons: tuple[ResponsiblePerson, ...] = ()
    standards: tuple[WorkingStandard, ...] = ()
    identifier: str = ""
    """Of the certificate, unique."""
    begin: date | None = None
    end: date | None = None
    issued: date | None = None
    location: str = LOCATIONS[0]
    valid_until: date | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    """Unit as the outputs have it -> the same in D-SI, for units that are not known."""


def read_calibration(table: TomlTable) -> CalibrationConfig:
    """Return the checked `[calibration]` table; empty where the file has none.

    Raises:
        InputError: an unknown key, a value of the wrong type, or an end before the begin.
    """
    table.refuse_unknown(CALIBRATION_KEYS)
    item = table.table("item", ITEM_KEYS, optional=True)
    units = table.table("units", None, optional=True)
    config = CalibrationConfig(
        laboratory=_read_contact(table, "laboratory", (*CONTACT_KEYS, "code")),
        customer=_read_contact(table, "customer", CONTACT_KEYS),
        item=CalibratedItem(**{key: _read_text(item, key) for key in item.values}),
        persons=tuple(
            ResponsiblePerson(_read_text(one, "name"), _read_option(one, "role"), one.flag("signs"))
            for one in _list_tables(table, "persons", PERSON_KEYS)
        ),
        standards=tuple(
            WorkingStandard(
                _read_text(one, "name"),
                _read_text(one, "serial"),
                *(_read_option(one, key) for key in ("manufacturer", "model", "certificate")),
            )
            for one in _list_tables(table, "standards", STANDARD_KEYS)
        ),
        identifier=_read_option(table, "identifier"),
        begin=_read_date(table, "begin"),
        end=_read_date(table, "end"),
        issued=_read_date(table, "issued"),
        location=table.choice("location", LOCATIONS, LOCATIONS[0]),
        valid_until=_read_date(table, "valid_until"),
        units={name: _read_text(units, name) for name in units.values},
    )
    if config.begin is not None and config.end is not None and config.end < config.begin:
        raise table.expect("end", f"a date that is not before begin, {config.begin}")
    return config


def list_missing(config: CalibrationConfig) -> list[str]:
    """Return what a certificate needs and `[calibration]` does not hold, as a user writes it."""
    held = {
        '`identifier = "..."`': config.identifier,
        "`begin = 2026-01-31`": config.begin,
        "`end = 2026-01-31`": config.end,
        "`[calibration.laboratory]` (name, city, country)": config.laboratory,
        "`[calibration.customer]` (name, city, country)": config.customer,
        "`[calibration.item]` serial": config.item.serial,
        "`[[calibration.persons]]` (name)": config.persons,
        "`[[calibration.standards]]` (name, serial)": config.standards,
    }
    return [key for key, value in held.items() if not value]


def name_unit(config: CalibrationConfig, sensor: str | None) -> CalibrationConfig:
    """Return the table for a unit of a fleet: its name is serial number and ends the identifier.

    Args:
        config: the table that all units share.
        sensor: the unit; None: the project is no fleet's.
    """
    if sensor is None:
        return config
    identifier = f"{config.identifier}-{sensor}" if config.identifier else ""
    return replace(config, identifier=identifier, item=replace(config.item, serial=sensor))


def _read_contact(table: TomlTable, key: str, known: tuple[str, ...]) -> Contact | None:
    if key not in table.values:
        return None
    one = table.table(key, known)
    name, city, country = (_read_text(one, part) for part in ("name", "city", "country"))
    if not re.fullmatch("[A-Z]{2}", country):
        raise one.expect("country", "a country by ISO 3166-1, two capital letters such as DE")
    others = ("code", "email", "phone", "street", "number", "post_code")
    return Contact(name, city, country, *(_read_option(one, part) for part in others))


def _list_tables(table: TomlTable, key: str, known: tuple[str, ...]) -> list[TomlTable]:
    found = table.values.get(key, [])
    if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
        raise table.expect(key, f"tables, each written [[calibration.{key}]]")
    tables = [
        TomlTable(table.file, table.lines, (*table.key, key, number), one)
        for number, one in enumerate(found)
    ]
    for one in tables:
        one.refuse_unknown(known)
    return tables


def _read_text(table: TomlTable, key: str) -> str:
    """Return a text in one line, refusing what no XML file can hold."""
    text = " ".join(table.text(key).split())
    if not text.isprintable():
        raise table.expect(key, "text without control characters")
    return text


def _read_option(table: TomlTable, key: str) -> str:
    return _read_text(table, key) if key in table.values else ""


def _read_date(table: TomlTable, key: str) -> date | None:
    value = table.values.get(key)
    if value is None:
        return None
    if isinstance(value, datetime) or not isinstance(value, date):
        raise table.expect(key, "a date without quotes, such as 2026-01-31")
    return value


def require_complete(config: CalibrationConfig, place: str) -> None:
    """Refuse a `[calibration]` that does not suffice for a certificate.

    Args:
        config: the table.
        place: of the table, for the message.

    Raises:
        InputError: naming all that is missing.
    """
    missing = list_missing(config)
    if missing:
        raise InputError(
            f"{place}: [calibration] lacks {', '.join(missing)}; expected who calibrated which "
            "sensor, when, for whom and against what. Add it, or leave --dcc out."
        )
