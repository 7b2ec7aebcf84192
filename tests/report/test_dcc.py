"""The digital calibration certificate holds the datasheet's figures, in the schema's form.

No package ships PTB's schema files, so the check against them runs where `ZERODRIFT_DCC_SCHEMAS`
names a folder with dcc.xsd (3.3.0), SI_Format.xsd (2.2), quantityKind.xsd and
xmldsig-core-schema.xsd. What stands here without them: units by PTB's own library, order and values
by hand.
"""

import json
import os
from dataclasses import replace
from datetime import date
from pathlib import Path
from xml.etree import ElementTree

import pytest
from tests.report.conftest import make_findings
from tests.report.test_datasheet import TELL, make_runs

from zerodrift.base.calibration_config import (
    CalibratedItem,
    CalibrationConfig,
    Contact,
    ResponsiblePerson,
    WorkingStandard,
    list_missing,
    name_unit,
)
from zerodrift.base.config import parse_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.units import PLAIN_UNITS, UNITS
from zerodrift.report.datasheet import UNCERTAINTY, DatasheetRow, measure_datasheet
from zerodrift.report.dcc import (
    RELATIVE,
    CertifiedSensor,
    describe_sensor,
    render_certificate,
    write_unit,
)

NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
SCHEMAS = os.environ.get("ZERODRIFT_DCC_SCHEMAS")
NOT_SI = ("psi", "degF")
TABLE = """
[calibration]
identifier = "2026-0042"
begin = 2026-11-02
end = 2026-11-03
valid_until = 2027-11-03
[calibration.laboratory]
name = "Kraftlabor"
code = "D-K-00000-01-00"
city = "Musterstadt"
country = "DE"
[calibration.customer]
name = "Kunde"
city = "Wien"
country = "AT"
[calibration.item]
serial = "0815"
[[calibration.persons]]
name = "M. Muster"
signs = true
[[calibration.standards]]
name = "transfer standard"
serial = "17"
certificate = "C-1"
"""
ABOUT = CertifiedSensor("cell", "0.1.0", False, (-10.0, 60.0), {"Fz": (500.0, "N")})
FULL = CalibrationConfig(
    Contact("Lab", "Bonn", "DE", "D-K-1", "a@b.de", "+49 1", "Weg", "1", "53111"),
    Contact("Customer", "Wien", "AT"),
    CalibratedItem("cell", "maker", "model 1", "0815"),
    (ResponsiblePerson("M. Muster", "head", True), ResponsiblePerson("A. Other")),
    (WorkingStandard("standard", "17", "maker", "model", "C-1"),),
    "2026-0042",
    date(2026, 11, 2),
    date(2026, 11, 3),
    date(2026, 11, 4),
    "laboratory",
    date(2027, 11, 3),
    {"widget": r"\one"},
)


def measure():
    rows = measure_datasheet(make_runs(), TELL)
    told = DatasheetRow(UNCERTAINTY, "Fz", "N", "stated", None, (1.25e-05, None))
    return [*(row for row in rows if row.quantity != UNCERTAINTY), told]


def read_values(text):
    """Return name of the result -> side -> value, unit and expanded uncertainty."""
    found = {}
    for result in ElementTree.fromstring(text).iterfind(".//dcc:result", NAMES):
        name = result.findtext("dcc:name/dcc:content", namespaces=NAMES)
        for quantity in result.iterfind("dcc:data/dcc:quantity", NAMES):
            real = quantity.find("si:real", NAMES)
            if real is not None:
                expanded = real.findtext(".//si:valueExpandedMU", namespaces=NAMES)
                found.setdefault(name, {})[quantity.get("refType")] = (
                    float(real.findtext("si:value", namespaces=NAMES)),
                    real.findtext("si:unit", namespaces=NAMES),
                    None if expanded is None else float(expanded),
                )
    return found


def test_values_are_the_datasheets_with_k_2():
    rows = measure()
    found = read_values(render_certificate(rows, ABOUT, FULL))
    count = 0
    for row in rows:
        for side in ("before", "after"):
            pair = getattr(row, side)
            if pair is None:
                assert f"zerodrift_{side}" not in found.get(f"Fz: {row.quantity}", {})
                continue
            value, unit, expanded = found[f"Fz: {row.quantity}"][f"zerodrift_{side}"]
            assert value == pair[0]
            assert expanded == (None if pair[1] is None else 2.0 * pair[1])
            assert unit == RELATIVE.get(row.unit, r"\newton")
            count += 1
    assert count == 9


def test_what_logs_do_not_tell_is_a_result_without_a_number():
    rows = measure_datasheet(make_runs(loaded=False), TELL)
    text = render_certificate(rows, ABOUT, FULL)
    assert text.count("<dcc:noQuantity>") == sum(r.before is r.after is None for r in rows) == 4
    assert "no load that moves" in text


def test_simulated_logs_say_so_in_the_certificate():
    assert "SIMULATED" not in render_certificate(measure(), ABOUT, FULL)
    assert "SIMULATED" in render_certificate(measure(), replace(ABOUT, simulated=True), FULL)


@pytest.mark.parametrize("unit", sorted({*PLAIN_UNITS, *UNITS.values()} - set(NOT_SI)))
def test_every_unit_of_logs_is_one_of_d_si(unit):
    dsi_unit = pytest.importorskip("dsi_unit", reason="no dsiunits: `make setup`")
    assert dsi_unit.DsiUnit(_known(unit)).valid


def _known(unit):
    return r"\one" if unit in ("ppb", "mps2") else write_unit(unit)


@pytest.mark.parametrize(
    ("unit", "written"),
    [
        ("N", r"\newton"),
        ("mV", r"\milli\volt"),
        ("mNm", r"\milli\newton\metre"),
        ("N·m", r"\newton\metre"),
        ("kg", r"\kilogram"),
        ("min", r"\minute"),
        ("ms", r"\milli\second"),
        ("m/s2", r"\metre\second\tothe{-2}"),
        ("m/s²", r"\metre\second\tothe{-2}"),
        ("N/(m K)", r"\newton\metre\tothe{-1}\kelvin\tothe{-1}"),
        ("widget", r"\one"),
    ],
)
def test_units_are_written_by_their_names(unit, written):
    assert write_unit(unit, {"widget": r"\one"}) == written


@pytest.mark.parametrize("unit", ["psi", "furlong", "N/m/s", "/"])
def test_an_unknown_unit_is_refused_with_what_to_do(unit):
    with pytest.raises(InputError, match=r"\[calibration.units\]"):
        write_unit(unit)


def test_relative_units_are_those_of_the_datasheet():
    dsi_unit = pytest.importorskip("dsi_unit", reason="no dsiunits: `make setup`")
    assert {row.unit for row in measure()} == {*RELATIVE, "N"}
    for unit in RELATIVE.values():
        assert dsi_unit.DsiUnit(unit).valid
    ten, one = (dsi_unit.DsiUnit(u) for u in (RELATIVE["%FS/10 K"], r"\percent\kelvin\tothe{-1}"))
    # 1 %/K is 10 %/(10 K).
    assert ten.get_scale_factor(one) == 10.0


def test_a_control_character_is_refused():
    with pytest.raises(InputError, match="XML"):
        render_certificate(measure(), replace(ABOUT, sensor="a\x01"), replace(FULL, item=ITEM))


ITEM = CalibratedItem(serial="0815")


@pytest.mark.skipif(not SCHEMAS, reason="ZERODRIFT_DCC_SCHEMAS names no folder of PTB's schema")
@pytest.mark.parametrize("full", [True, False])
def test_certificate_is_valid_against_the_schema(full):
    etree = pytest.importorskip("lxml.etree", reason="no lxml: `make setup-formats`")
    folder = Path(SCHEMAS)

    class Local(etree.Resolver):
        def resolve(self, url, _, context):
            return self.resolve_filename(str(folder / url.rpartition("/")[2]), context)

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Local())
    schema = etree.XMLSchema(etree.parse(str(folder / "dcc.xsd"), parser))
    least = replace(
        FULL,
        laboratory=Contact("Lab", "Bonn", "DE"),
        item=ITEM,
        persons=FULL.persons[1:],
        standards=(WorkingStandard("standard", "17"),),
        issued=None,
        valid_until=None,
    )
    rows = measure() if full else measure_datasheet(make_runs(loaded=False, runs=1), TELL)
    text = render_certificate(
        rows, replace(ABOUT, simulated=full), FULL if full else least
    ).encode()
    assert schema.validate(etree.fromstring(text)), schema.error_log
    for wrong in (b"<dcc:respPersons>", b"<si:unit>", b"<dcc:coreData>"):
        broken = text.replace(wrong, wrong.replace(b":", b":x")).replace(
            wrong.replace(b"<", b"</"), wrong.replace(b"<", b"</").replace(b":", b":x")
        )
        assert not schema.validate(etree.fromstring(broken))


def test_the_table_is_read_and_complete(project):
    config = parse_config(project.toml.read_text() + TABLE, project.toml).calibration
    assert list_missing(config) == []
    assert config.laboratory == Contact("Kraftlabor", "Musterstadt", "DE", "D-K-00000-01-00")
    assert (config.begin, config.valid_until) == (date(2026, 11, 2), date(2027, 11, 3))
    assert config.persons == (ResponsiblePerson("M. Muster", signs=True),)
    assert config.standards == (WorkingStandard("transfer standard", "17", certificate="C-1"),)
    unit = name_unit(config, "s7")
    assert (unit.identifier, unit.item.serial) == ("2026-0042-s7", "s7")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('country = "DE"', 'country = "Germany"', "ISO 3166-1"),
        ("end = 2026-11-03", "end = 2026-11-01", "not before begin"),
        ("end = 2026-11-03", 'end = "2026-11-03"', "a date without quotes"),
        ("signs = true", "sign = true", "signs"),
        ('serial = "17"', "", "serial is missing"),
        ('name = "Kunde"', r'name = "K\u0001"', "control characters"),
        ("[[calibration.persons]]", "[calibration.persons]", "[[calibration.persons]]"),
        ('identifier = "2026', 'identifer = "2026', "identifier"),
    ],
)
def test_a_wrong_value_is_named_with_its_line(project, old, new, told):
    assert old in TABLE
    text = project.toml.read_text() + TABLE.replace(old, new)
    with pytest.raises(InputError) as refused:
        parse_config(text, project.toml)
    assert told in str(refused.value)
    assert str(refused.value).startswith(f"{project.toml}:")


def test_a_missing_laboratory_is_one_error_and_nothing_is_written(project, zerodrift):
    target = project.directory / "dcc.xml"
    laboratory = TABLE[TABLE.index("[calibration.laboratory]") : TABLE.index("[calibration.cust")]
    text = project.toml.read_text()
    project.toml.write_text(text + TABLE.replace(laboratory, ""))
    done = zerodrift("report", "-C", project.directory, "--no-diagnose", "--dcc", target)
    assert done.code == 2
    assert "[calibration] lacks `[calibration.laboratory]` (name, city, country);" in done.err
    assert "persons" not in done.err
    project.toml.write_text(text)
    done = zerodrift("report", "-C", project.directory, "--no-diagnose", "--dcc", target)
    assert done.code == 2
    assert all(key in done.err for key in ("laboratory", "persons", "standards", "serial"))
    assert not target.exists()
    assert not (project.directory / "report.html").exists()


def test_the_command_writes_what_the_datasheet_says(project, zerodrift):
    project.toml.write_text(project.toml.read_text() + TABLE)
    target = project.directory / "dcc.xml"
    words = ("report", "-C", project.directory, "--no-diagnose", "--dcc", target)
    done = zerodrift(*words, "--datasheet", "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert str(target) in told["files"]
    found = read_values(target.read_text())
    rows = [row for row in told["datasheet"] if row["before"] is not None]
    assert rows
    for row in rows:
        value, _, expanded = found[f"{row['output']}: {row['quantity']}"]["zerodrift_before"]
        assert value == row["before"][0]
        assert expanded == (None if row["before"][1] is None else 2.0 * row["before"][1])
    first = target.read_bytes()
    assert zerodrift(*words).code == 0
    assert target.read_bytes() == first


def test_what_is_known_of_the_sensor_comes_from_the_findings():
    findings = make_findings(traces=tuple(make_runs(runs=2)))
    about = describe_sensor(findings)
    lowest = min(trace.temperature_degC.min() for trace in findings.traces)
    assert about.temperature_degC[0] == lowest
    assert about.full_scale == {"Fz": (200.0, "N")}
