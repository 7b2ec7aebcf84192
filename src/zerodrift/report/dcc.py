"""The datasheet's figures as a digital calibration certificate: XML of PTB's schema, DCC 3.3.0.

Quantities are D-SI 2.2: value, unit, expanded uncertainty with k = 2. A figure that the logs do not
tell is a result with its reason in the place of a quantity. The certificate is not signed and holds
no date but those of `[calibration]`: the same files give the same bytes.

Source: https://ptb.de/dcc, https://ptb.de/si.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from xml.etree import ElementTree

from zerodrift import __version__
from zerodrift.base.calibration_config import CalibrationConfig, Contact
from zerodrift.base.errors import InputError
from zerodrift.report.datasheet import AFTER, BEFORE, UNCERTAINTY, DatasheetRow
from zerodrift.report.findings import Findings

# Units in D-SI, the notation of digital calibration certificates: mN is `\milli\newton`.
#
# Source: SmartCom D-SI, https://doi.org/10.5281/zenodo.3522631; SI Brochure, 9th edition.

BASES = {
    **{"m": "metre", "g": "gram", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole"},
    **{"cd": "candela", "N": "newton", "Pa": "pascal", "J": "joule", "W": "watt", "V": "volt"},
    **{"ohm": "ohm", "Ω": "ohm", "F": "farad", "C": "coulomb", "H": "henry", "T": "tesla"},
    **{"Wb": "weber", "S": "siemens", "Hz": "hertz", "lx": "lux", "lux": "lux", "lm": "lumen"},
    **{"rad": "radian", "deg": "degree", "°": "degree", "degC": "degreecelsius"},
    **{"°C": "degreecelsius", "bar": "bar", "t": "tonne", "L": "litre", "l": "litre"},
    **{"min": "minute", "h": "hour", "%": "percent", "ppm": "ppm", "1": "one"},
    **{"strain": "one", "LSB": "one", "counts": "one"},
}
PREFIXES = {
    **{"p": "pico", "n": "nano", "u": "micro", "µ": "micro", "μ": "micro", "m": "milli"},
    **{"c": "centi", "d": "deci", "h": "hecto", "k": "kilo", "M": "mega", "G": "giga"},
}
PREFIXED = {"m", "g", "s", "A", "K", "mol", "N", "Pa", "J", "W", "V", "ohm", "Ω", "F", "C", "H"}
PREFIXED |= {"T", "Wb", "S", "Hz", "rad", "bar", "L", "l", "strain"}
LATE = {"²": "2", "³": "3"}


def write_unit(unit: str, known: Mapping[str, str] | None = None) -> str:
    """Return a unit in D-SI.

    Args:
        unit: as an output has it: products by ` `, `*` or `·`, one `/`, exponents as `m2` or
            `m^2`, a prefix before a symbol.
        known: further units, in D-SI already.

    Raises:
        InputError: the unit is not known.
    """
    if known and unit in known:
        return known[unit]
    over, *under = unit.strip().split("/")
    parts = [(part, 1) for part in _split(over)] + [(p, -1) for one in under for p in _split(one)]
    written = [_write_factor(part, sign) for part, sign in parts]
    if len(under) > 1 or not written or None in written:
        raise InputError(
            f"unit '{unit}' is not known in D-SI; expected one such as N, mV, Nm or m/s2. State "
            f"what it is: [calibration.units] \"{unit}\" = '\\newton' (in D-SI)."
        )
    return "".join(one for one in written if one is not None)


def _split(text: str) -> list[str]:
    bare = "".join(f"^{LATE[c]}" if c in LATE else c for c in text)
    parts = [part for part in re.split(r"[\s*·.()]+", bare) if part]
    return [inner for part in parts for inner in _split_torque(part)]


def _split_torque(part: str) -> list[str]:
    """Return the factors of a symbol: Nm, mNm and kNm are written without a sign."""
    match = re.fullmatch(r"([munkM]?N)(m{1,2})", part)
    return [match.group(1), match.group(2)] if match else [part]


def _write_factor(part: str, sign: int) -> str | None:
    match = re.fullmatch(r"(.*?)\^?(-?[1-9])?", part)
    symbol, exponent = (match.group(1), int(match.group(2) or 1)) if match else ("", 1)
    if part in BASES:  # also 1 itself
        symbol, exponent = part, 1
    power = sign * exponent
    named = _name_symbol(symbol)
    if named is None:
        return None
    return named if power == 1 else f"{named}\\tothe{{{power}}}"


def _name_symbol(symbol: str) -> str | None:
    if symbol == "kg":
        return "\\kilogram"
    if symbol in BASES:
        return f"\\{BASES[symbol]}"
    if symbol[:1] in PREFIXES and symbol[1:] in PREFIXED:
        return f"\\{PREFIXES[symbol[0]]}\\{BASES[symbol[1:]]}"
    return None


# The datasheet's figures as a digital calibration certificate: XML of PTB's schema, DCC 3.3.0.

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
XSI = "http://www.w3.org/2001/XMLSchema-instance"
SCHEMA_VERSION = "3.3.0"
LOCATION = f"{DCC} https://ptb.de/dcc/v{SCHEMA_VERSION}/dcc.xsd"
COVERAGE_FACTOR, COVERAGE_PROBABILITY = 2.0, 0.95
RELATIVE = {
    "%FS": r"\percent",
    "%FS/10 K": r"\percent\deca\kelvin\tothe{-1}",
    "% of reading/10 K": r"\percent\deca\kelvin\tothe{-1}",
    "% of load": r"\percent",
}
"""The datasheet's own units in D-SI; 10 K is a \\deca\\kelvin, so values stay what they are."""
GUM = (
    "The expanded uncertainty is the standard uncertainty times the coverage factor k = 2, which "
    "for a normal distribution covers about 95 %. Standard uncertainties come from how runs differ."
)
MADE_UP = (
    "The logs behind these results are SIMULATED: this certificate speaks of no sensor that exists."
)


@dataclass(frozen=True)
class CertifiedSensor:
    """What a certificate states beside `[calibration]`."""

    sensor: str
    version: str
    """Of zerodrift."""
    simulated: bool
    temperature_degC: tuple[float, float]
    """The range over which the logs go."""
    full_scale: Mapping[str, tuple[float, str]]
    """Output -> full scale and its unit."""


def describe_sensor(findings: Findings) -> CertifiedSensor:
    """Return what a certificate states of the sensor beside `[calibration]`."""
    ends = [(t.temperature_degC.min(), t.temperature_degC.max()) for t in findings.traces]
    return CertifiedSensor(
        findings.sensor,
        __version__,
        findings.simulated,
        (float(min(low for low, _ in ends)), float(max(high for _, high in ends))),
        {name: (told.full_scale, told.unit) for name, told in findings.comparison.outputs.items()},
    )


def render_certificate(
    rows: Sequence[DatasheetRow], about: CertifiedSensor, calibration: CalibrationConfig
) -> str:
    """Return the certificate's XML.

    Args:
        rows: the datasheet's figures.
        about: the sensor.
        calibration: `[calibration]`, complete.

    Raises:
        InputError: a unit is not known in D-SI, or a text cannot stand in XML.
    """
    root = ElementTree.Element(f"{{{DCC}}}digitalCalibrationCertificate")
    root.set("schemaVersion", SCHEMA_VERSION)
    root.set(f"{{{XSI}}}schemaLocation", LOCATION)
    _write_administration(_add(root, "administrativeData"), about, calibration)
    results = _add(root, "measurementResults")
    measured = _add(results, "measurementResult")
    _name(measured, "Drift before and after compensation")
    method = _add(_add(measured, "usedMethods"), "usedMethod")
    method.set("refType", "basic_uncertainty")
    _name(method, "Expanded uncertainty")
    _describe(method, GUM)
    _add(method, "norm", "JCGM 100:2008")
    _write_standards(measured, calibration)
    _write_range(measured, about)
    results = _add(measured, "results")
    for row in rows:
        _write_result(_add(results, "result"), row, about, calibration.units)
    for prefix, space in (("dcc", DCC), ("si", SI), ("xsi", XSI)):
        ElementTree.register_namespace(prefix, space)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n"


def _add(
    parent: ElementTree.Element, name: str, text: str | None = None, space: str = DCC
) -> ElementTree.Element:
    one = ElementTree.SubElement(parent, f"{{{space}}}{name}")
    if text is not None:
        line = " ".join(text.split())
        if not line.isprintable():
            raise InputError(f"{line!r}: holds a character that XML cannot; take it out.")
        one.text = line
    return one


def _name(parent: ElementTree.Element, text: str, element: str = "name") -> None:
    _add(_add(parent, element), "content", text).set("lang", "en")


def _describe(parent: ElementTree.Element, text: str) -> None:
    _name(parent, text, "description")


def _write_date(parent: ElementTree.Element, name: str, value: date | None) -> None:
    if value is not None:
        _add(parent, name, value.isoformat())


def _write_administration(
    parent: ElementTree.Element, about: CertifiedSensor, calibration: CalibrationConfig
) -> None:
    assert calibration.laboratory is not None
    assert calibration.customer is not None
    software = _add(_add(parent, "dccSoftware"), "software")
    _name(software, "zerodrift")
    _add(software, "release", about.version)
    _add(software, "type", "application")
    core = _add(parent, "coreData")
    _add(core, "countryCodeISO3166_1", calibration.laboratory.country)
    _add(core, "usedLangCodeISO639_1", "en")
    _add(core, "mandatoryLangCodeISO639_1", "en")
    _add(core, "uniqueIdentifier", calibration.identifier)
    _write_date(core, "beginPerformanceDate", calibration.begin)
    _write_date(core, "endPerformanceDate", calibration.end)
    _add(core, "performanceLocation", calibration.location)
    _write_date(core, "issueDate", calibration.issued)
    item = _add(_add(parent, "items"), "item")
    _name(item, calibration.item.name or about.sensor)
    _write_maker(item, calibration.item.manufacturer, calibration.item.model)
    _identify(item, {"Serial no.": calibration.item.serial})
    laboratory = _add(parent, "calibrationLaboratory")
    if calibration.laboratory.code:
        _add(laboratory, "calibrationLaboratoryCode", calibration.laboratory.code)
    _write_contact(_add(laboratory, "contact"), calibration.laboratory)
    persons = _add(parent, "respPersons")
    for person in calibration.persons:
        one = _add(persons, "respPerson")
        _name(_add(one, "person"), person.name)
        if person.role:
            _add(one, "role", person.role)
        if person.signs:
            _add(one, "mainSigner", "true")
    _write_contact(_add(parent, "customer"), calibration.customer)
    _write_statements(parent, about, calibration)


def _write_statements(
    parent: ElementTree.Element, about: CertifiedSensor, calibration: CalibrationConfig
) -> None:
    if not about.simulated and calibration.valid_until is None:
        return
    statements = _add(parent, "statements")
    if about.simulated:
        _name(_add(statements, "statement"), MADE_UP, "declaration")
    if calibration.valid_until is not None:
        statement = _add(statements, "statement")
        statement.set("refType", "basic_recalibration")
        _name(statement, "The sensor is to be calibrated again by this date.", "declaration")
        _write_date(statement, "date", calibration.valid_until)


def _write_contact(parent: ElementTree.Element, contact: Contact) -> None:
    _name(parent, contact.name)
    for element, text in (("eMail", contact.email), ("phone", contact.phone)):
        if text:
            _add(parent, element, text)
    location = _add(parent, "location")
    for element, text in (
        ("city", contact.city),
        ("countryCode", contact.country),
        ("postCode", contact.post_code),
        ("street", contact.street),
        ("streetNo", contact.number),
    ):
        if text:
            _add(location, element, text)


def _write_maker(parent: ElementTree.Element, manufacturer: str, model: str) -> None:
    if manufacturer:
        _name(_add(parent, "manufacturer"), manufacturer)
    if model:
        _add(parent, "model", model)


def _identify(parent: ElementTree.Element, told: Mapping[str, str]) -> None:
    identifications = _add(parent, "identifications")
    for name, value in told.items():
        if value:
            one = _add(identifications, "identification")
            _add(one, "issuer", "manufacturer" if name == "Serial no." else "calibrationLaboratory")
            _add(one, "value", value)
            _name(one, name)


def _write_standards(parent: ElementTree.Element, calibration: CalibrationConfig) -> None:
    equipment = _add(parent, "measuringEquipments")
    for standard in calibration.standards:
        one = _add(equipment, "measuringEquipment")
        one.set("refType", "basic_normalUsed")
        _name(one, standard.name)
        _write_maker(one, standard.manufacturer, standard.model)
        _identify(one, {"Serial no.": standard.serial, "Certificate no.": standard.certificate})


def _write_range(parent: ElementTree.Element, about: CertifiedSensor) -> None:
    condition = _add(_add(parent, "influenceConditions"), "influenceCondition")
    condition.set("refType", "basic_temperature")
    _name(condition, "Temperature of the sensor, by its own thermometer")
    data = _add(condition, "data")
    for name, value in zip(("lowest", "highest"), about.temperature_degC, strict=True):
        quantity = _add(data, "quantity")
        _name(quantity, name)
        _write_real(quantity, value, r"\degreecelsius")


def _write_result(
    parent: ElementTree.Element,
    row: DatasheetRow,
    about: CertifiedSensor,
    units: Mapping[str, str],
) -> None:
    _name(parent, f"{row.output}: {row.quantity}")
    scale, unit = about.full_scale[row.output]
    against = f"; full scale {scale:g} {unit}" if row.unit.startswith("%FS") else ""
    _describe(parent, f"{row.unit}; {row.note}{against}")
    data = _add(parent, "data")
    sides = {BEFORE: row.before, AFTER: row.after}
    told = {side: pair for side, pair in sides.items() if pair is not None}
    for side, (value, error) in told.items():
        quantity = _add(data, "quantity")
        quantity.set("refType", f"zerodrift_{side}")
        _name(quantity, f"{side} compensation")
        # An uncertainty that is itself the figure is a value without one of its own.
        known = None if row.quantity == UNCERTAINTY else error
        _write_real(quantity, value, RELATIVE.get(row.unit) or write_unit(row.unit, units), known)
    if not told:
        quantity = _add(data, "quantity")
        _add(_add(quantity, "noQuantity"), "content", row.note).set("lang", "en")


def _write_real(
    parent: ElementTree.Element, value: float, unit: str, error: float | None = None
) -> None:
    real = _add(parent, "real", space=SI)
    _add(real, "value", repr(float(value)), SI)
    _add(real, "unit", unit, SI)
    if error is not None:
        univariate = _add(real, "measurementUncertaintyUnivariate", space=SI)
        expanded = _add(univariate, "expandedMU", space=SI)
        _add(expanded, "valueExpandedMU", repr(COVERAGE_FACTOR * error), SI)
        _add(expanded, "coverageFactor", repr(COVERAGE_FACTOR), SI)
        _add(expanded, "coverageProbability", repr(COVERAGE_PROBABILITY), SI)
