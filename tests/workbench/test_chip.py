"""The firmware's own C in the page: replayed beside the reference, and fed by a live sensor."""

import re

import numpy as np
import pytest
from tests.workbench.conftest import serve
from tests.workbench.pages import open_page, tells, wait_for_job

from zerodrift.c_runtime.compilers import find_compiler
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.model_files import load_model

playwright = pytest.importorskip(
    "playwright.sync_api", reason="Playwright is not installed; `make setup-browser` does it"
)
expect = playwright.expect
expect.set_options(timeout=120_000)

HEADER = "time_s,temperature_degC,Fz_N,Mx_Nm"
SERIAL = """
  const listeners = [];
  const port = {
    open: async (options) => { window.opened = options; },
    close: async () => { window.closed = true; },
    readable: new ReadableStream({ start: (own) => { window.sensor = own; } }),
  };
  Object.defineProperty(navigator, "serial", { value: { requestPort: async () => port } });
  window.send = (text) => window.sensor.enqueue(new TextEncoder().encode(text));
"""
"""Stands for a serial port; a browser without a person to choose one has none."""


def count(page):
    return int(page.inner_text("#chip-steps").replace(",", "").replace("–", "0"))


def wait_to_the_end(page, steps):
    expect(page.locator("#chip-steps")).to_have_text(f"{steps:,}")


@pytest.mark.slow
def test_c_is_brought_into_the_page_and_equals_the_reference(page, built, keep):
    with serve(built.directory) as bench:
        open_page(page, bench)
        wait_for_job(page, bench)
        page.locator("#load-chip").focus()
        page.keyboard.press("Enter")
        tells(page, "self-test passed", "#chip-says")
        steps = bench.place.chip.runs[0].steps
        assert steps == 900
        page.locator("#chip-speed").focus()
        page.keyboard.press("End")
        page.locator("#chip-play").focus()
        page.keyboard.press("Enter")
        wait_to_the_end(page, steps)
        assert page.inner_text("#chip-differ") == "0 LSB"
        tells(page, "in 900 of 900 steps", "#chip-differ-words")
        # The values shown are those of the same C on this machine.
        model = load_model(built.directory / "build" / "model.json")
        content = (bench.place.chip_folder / "run_0.bin").read_bytes()
        codes = np.frombuffer(content[-steps * 2 * model.columns :], "<i2").reshape(steps, -1)
        with_host = HostModel(
            model, generate(model), bench.place.chip_folder / "host", find_compiler(), observe=False
        )
        trace = with_host.run(codes)
        wanted = trace.drift[-1, 0] / model.outputs[0].lsb_per_unit
        assert float(page.inner_text("#chip-drift")) == pytest.approx(wanted, rel=1e-5)
        assert page.inner_text("#chip-flags") == str(trace.flags[-1])
        page.locator("#chip-section").screenshot(path=keep_beside(keep, page, "12_chip"))
    assert page.wrong == []


def keep_beside(keep, page, name):
    """Return where a picture of a part is kept; the whole page is kept too."""
    from tests.workbench.conftest import SCREENSHOTS

    keep(page, f"{name}_page")
    return str(SCREENSHOTS / f"{name}.png")


@pytest.mark.slow
def test_position_goes_there_and_back_by_keyboard(page, chip):
    open_page(page, chip)
    tells(page, "self-test passed", "#chip-says")
    page.locator("#chip-position").focus()
    page.keyboard.press("End")
    wait_to_the_end(page, 900)
    page.keyboard.press("ArrowLeft")
    wait_to_the_end(page, 899)
    tells(page, "in 899 of 899 steps", "#chip-differ-words")
    page.locator("#chip-again").press("Enter")
    wait_to_the_end(page, 0)
    page.locator("#chip-output").select_option("1")
    tells(page, "drift of Mx, Nm", "#chip-drift-words")
    assert page.wrong == []


@pytest.mark.slow
def test_speed_is_kept_and_pause_holds(page, chip):
    open_page(page, chip)
    tells(page, "self-test passed", "#chip-says")
    page.locator("#chip-speed").focus()
    page.keyboard.press("Home")
    tells(page, "1.0 steps a second", "#chip-speed-told")
    page.locator("#chip-play").press("Enter")
    expect(page.locator("#chip-steps")).to_have_text("1")
    page.locator("#chip-play").press("Enter")
    expect(page.locator("#chip-play")).to_have_text("Play")
    assert 0 < count(page) < 10


@pytest.mark.slow
def test_one_other_bit_is_seen(page, chip):
    """The reference's answer of step 500 gets another lowest bit."""
    path = chip.place.chip_folder / "run_0.bin"
    whole = path.read_bytes()
    content, outputs = bytearray(whole), len(chip.place.chip.outputs)
    content[8 * 900 * outputs + 4 * 500 * outputs] ^= 1
    path.write_bytes(bytes(content))
    try:
        open_page(page, chip)
        tells(page, "self-test passed", "#chip-says")
        page.locator("#chip-position").focus()
        page.keyboard.press("End")
        expect(page.locator("#chip-differ")).to_have_text("DIFFERENT")
        tells(page, "1 step differs, by up to 1 LSB; the first is step 500", "#chip-differ-words")
    finally:
        path.write_bytes(whole)


@pytest.mark.slow
def test_live_lines_run_through_the_c(page, chip, keep):
    page.add_init_script(SERIAL)
    open_page(page, chip)
    tells(page, "self-test passed", "#chip-says")
    page.locator("#chip-live").press("Enter")
    tells(page, "waiting for lines with temperature_degC", "#chip-says")
    assert page.evaluate("window.opened.baudRate") == 115200
    rows = [f"{t},{25 + 0.05 * t},{3.0 + 0.01 * t},{-0.1}" for t in range(120)]
    text = "\n".join(["# boot", HEADER, *rows])
    for start in range(0, len(text), 700):  # cut anywhere, as a port cuts them
        page.evaluate("(part) => window.send(part)", text[start : start + 700])
    wait_to_the_end(page, 119)  # the last has no end of line yet
    page.evaluate("window.send('\\n')")
    wait_to_the_end(page, 120)
    assert page.inner_text("#chip-differ") == "0 LSB"
    tells(page, "in 120 of 120 steps", "#chip-differ-words")
    tells(page, "measured 4.19", "#chip-compensated-words")
    page.locator("#chip-section").screenshot(path=keep_beside(keep, page, "13_chip_live"))
    rows = [f"{120 + 0.1 * k:.1f},31,{4.2},{-0.1}" for k in range(1)]
    page.evaluate("(text) => window.send(text)", "\n".join(rows) + "\n")
    wait_to_the_end(page, 121)
    page.evaluate("window.send('119,x,3,4\\n')")
    tells(page, "1 lines were no rows", "#chip-says")
    page.evaluate("window.send('{\"humidity\": 3}\\n')")
    tells(page, "the model reads temperature_degC, too", "#chip-says")
    expect(page.locator("#chip-live")).to_have_text("Feed a live sensor")


@pytest.mark.slow
def test_without_web_serial_there_is_no_button(page, chip):
    page.add_init_script("delete Navigator.prototype.serial")
    open_page(page, chip)
    tells(page, "self-test passed", "#chip-says")
    assert page.locator("#chip-live").count() == 0
    assert page.locator("#chip-baud").count() == 0


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (390, "dark"), (1360, "dark")])
def test_panel_fits_and_follows_the_theme(page, chip, keep, width, scheme):
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    open_page(page, chip)
    tells(page, "self-test passed", "#chip-says")
    page.locator("#chip-position").focus()
    page.keyboard.press("End")
    wait_to_the_end(page, 900)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    ink = page.locator("#chip-figure text").first.evaluate("t => getComputedStyle(t).fill")
    bright = sum(int(part) for part in re.findall(r"\d+", ink)[:3])
    assert bright > 450 if scheme == "dark" else bright < 350
    name = f"14_chip_{width}_{scheme}"
    page.locator("#chip-section").screenshot(path=keep_beside(keep, page, name))
    unnamed = page.evaluate(
        "() => Array.from(document.querySelectorAll('#chip button, #chip input, #chip select'))"
        ".filter(e => !(e.textContent.trim() && e.tagName === 'BUTTON') && !e.labels?.length)"
        ".map(e => e.outerHTML)"
    )
    assert unnamed == []
