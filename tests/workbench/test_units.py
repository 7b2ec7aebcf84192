"""The registry's units on the page: the terminal's words, live, by keyboard, wide and narrow."""

import json
from importlib import import_module

import pytest
from click.testing import CliRunner
from tests.field.conftest import make_bare_block
from tests.workbench.conftest import serve
from tests.workbench.pages import expect, open_page, wait_for_job

from zerodrift.cli.main import cli
from zerodrift.field.registry import FILE_NAME, open_registry
from zerodrift.workbench.units import list_serials, show_history, show_units
from zerodrift.workbench.watch import UnitsWatch

pytestmark = pytest.mark.long

STEP = "recalibrate SN2: the zero of Fz moved by 3.1 N at once, 2026-11-20 04:00 UTC"
SAME = "nothing has changed"


def fill(directory):
    """Make a registry of four units: one not watched, one sound, two with an alarm."""
    with open_registry(directory / FILE_NAME, make=True) as registry:
        for number in range(4):
            registry.add_unit(f"SN{number}", "cell")
        registry.add_calibration("SN2", "cell", "c" * 64, (("d" * 64, "chamber.csv"),))
        registry.load_block("SN2", registry.add_block("SN2", make_bare_block("SN2")))
        for serial in ("SN1", "SN2", "SN3"):
            registry.add_logs(serial, ((serial[-1] * 64, f"field_{serial}.csv"),))
            registry.add_finding(serial, "Fz", "sound", SAME)
            registry.add_finding(serial, "Mx", "sound", SAME)
        registry.add_finding("SN2", "Fz", "step", STEP)
        registry.add_finding("SN3", "Fz", "other unit", "check SN3; this looks like SN1")
        return registry.tell_history("SN2")


def list_rows(parts):
    """Return the cells of a part's tables."""
    return [
        json.loads(p.children[1].to_plotly_json()["props"]["data-table"])["rows"] for p in parts
    ]


def test_units_are_told_in_the_words_of_the_terminal(tmp_path):
    events = fill(tmp_path)
    seen = UnitsWatch(tmp_path).look()
    count, alarms, table = show_units(seen)
    assert count.children == "4 units: 2 with an alarm, 1 not watched, 1 sound."
    assert [card.children[0].children for card in alarms.children] == ["SN2", "SN3"]
    assert STEP in str(alarms.children[0]) and "field_SN2.csv" in str(alarms.children[0])
    (rows,) = list_rows([table])
    assert [row[0] for row in rows] == ["SN2", "SN3", "SN0", "SN1"]
    listed = CliRunner().invoke(cli, ["registry", "list", "-C", str(tmp_path)]).stdout
    told = {line.split()[0]: line for line in listed.splitlines() if line.startswith("  SN")}
    for serial, state, *_ in rows:
        assert state in told[serial]
    last = next(event.at for event in events if event.kind == "loaded")
    assert rows[0][5] in told["SN2"] and rows[0][6] == last[:16].replace("T", " ")
    assert json.loads(list_serials(seen, None))["first"] == "SN2"
    assert json.loads(list_serials(seen, "SN1"))["first"] == "SN1"


def test_history_of_a_unit_has_its_logs_by_hash_apart(tmp_path):
    events = fill(tmp_path)
    unit = UnitsWatch(tmp_path).look().standings[2]
    said, happened, logs = show_history(unit, events, "SN2")
    assert STEP in str(said.children[0]) and SAME in str(said.children[1])
    (rows,) = list_rows([happened])
    assert [row[1] for row in rows] == ["added", "calibrated", "block", "loaded", *["finding"] * 3]
    assert logs.children[0].children == "Logs of SN2 by hash: 2"
    (entered,) = list_rows([logs])
    assert {row[2] for row in entered} == {
        f"calibration: chamber.csv {'d' * 12}",
        f"monitor: field_SN2.csv {'2' * 12}",
    }


def test_a_page_without_units_says_how_they_get_there(tmp_path):
    watch = UnitsWatch(tmp_path)
    (told,) = show_units(watch.look())
    assert "zerodrift registry init" in str(told)
    assert watch.mark() == "none; none"
    with open_registry(tmp_path / FILE_NAME, make=True):
        pass
    (told,) = show_units(watch.look())
    assert "has no units" in str(told) and "zerodrift registry add SERIAL" in str(told)
    (tmp_path / FILE_NAME).write_bytes(b"no database at all" * 99)
    (told,) = show_units(watch.look())
    assert "is damaged, or no registry" in told.children


def test_what_another_program_writes_changes_the_mark_though_it_is_still_open(tmp_path):
    fill(tmp_path)
    watch = UnitsWatch(tmp_path)
    before = watch.mark()
    assert len(watch.look().standings) == 4
    assert watch.mark() == before  # to read is no change
    with open_registry(tmp_path / FILE_NAME) as registry:
        registry.add_unit("SN4", "cell")
        assert watch.mark() != before
        assert len(watch.look().standings) == 5
    mark = watch.mark()
    assert mark != before and len(watch.look().standings) == 5 and watch.mark() == mark


def test_units_in_the_browser(page, project, keep):
    fill(project.directory)
    with serve(project.directory) as bench:
        open_page(page, bench)
        wait_for_job(page, bench)
        expect(page.locator("#units .standing")).to_contain_text("4 units: 2 with an alarm")
        expect(page.locator("#unit")).to_have_value("SN2")
        expect(page.locator("#unit-told")).to_contain_text(STEP)
        button = page.locator("[data-unit='SN3']")
        button.focus()
        page.keyboard.press("Enter")
        expect(page.locator("#unit-told")).to_contain_text("this looks like SN1")
        assert page.evaluate("document.activeElement.id") == "unit"
        page.keyboard.press("Home")
        expect(page.locator("#unit-told h3")).to_contain_text("History of SN0")
        with open_registry(project.directory / FILE_NAME) as registry:
            registry.add_finding("SN0", "Fz", "ageing", "recalibrate SN0: along a line")
        expect(page.locator("#units .standing")).to_contain_text("3 with an alarm")
        expect(page.locator("#unit-told")).to_contain_text("along a line")
        assert page.locator("#unit").input_value() == "SN0"  # what was chosen stays
        for width in (1360, 390):
            page.set_viewport_size({"width": width, "height": 900})
            page.wait_for_function("document.documentElement.scrollWidth <= window.innerWidth")
            keep(page, f"units_{width}")
    assert page.wrong == []


def test_a_page_that_found_nothing_still_shows_the_units(page, project):
    fill(project.directory)
    project.toml.write_text(project.toml.read_text().replace("logs/run_*", "none_*"))
    with serve(project.directory) as bench:
        page.goto(bench.url)
        expect(page.locator("#message")).to_contain_text("none_*")
        expect(page.locator("#units .standing")).to_contain_text("4 units: 2 with an alarm")
        expect(page.locator("#unit-told")).to_contain_text(STEP)
        assert not page.is_visible("#verdict") and not page.is_visible("nav.contents")
        page.select_option("#unit", "SN1")
        expect(page.locator("#unit-told")).to_contain_text("History of SN1")


@pytest.mark.parametrize("width", [1360, 390])
def test_axe_finds_nothing_in_the_units(browser, project, width):
    pytest.importorskip("axe_playwright_python", reason="`make setup-browser` installs it")
    axe = import_module("axe_playwright_python.sync_playwright").Axe()
    fill(project.directory)
    with serve(project.directory) as bench:
        window = browser.new_page(viewport={"width": width, "height": 900})
        window.set_default_timeout(60_000)
        open_page(window, bench)
        expect(window.locator("#unit-told h3")).to_contain_text("History of SN2")
        found = axe.run(window, context={"include": ["#units-section"]}).response["violations"]
        window.close()
    assert [(one["id"], one["nodes"][0]["target"]) for one in found] == []
