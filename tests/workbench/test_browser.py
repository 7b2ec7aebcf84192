"""The loop as a user walks it, in Chromium."""

import itertools
import json
import re
import shutil
import threading
import time
from urllib.parse import urlsplit

import pytest
from tests.loop.conftest import write_project
from tests.workbench.conftest import serve
from tests.workbench.pages import DRAWN, open_page, tells, wait_for_job
from tests.workbench.test_workplace import run_command, settle, use_effect

from zerodrift.workbench import views
from zerodrift.workbench.chart import MOVES

expect = pytest.importorskip(
    "playwright.sync_api", reason="Playwright is not installed; `make setup-browser` does it"
).expect
expect.set_options(timeout=120_000)


def choose(page, name, value):
    """Choose in a list by keyboard alone, as soon as there is such a choice."""
    chosen = page.locator(f"#{name}")
    expect(chosen.locator(f"option[value='{value}']")).to_be_attached()
    chosen.focus()
    page.keyboard.press("Home")
    for _ in range(chosen.locator("option").count()):
        if chosen.input_value() == value:
            return
        page.keyboard.press("ArrowDown")
    expect(chosen).to_have_value(value)


def drop(page, name, text, size=None):
    """Drop a file on the page; `size` is what it claims to have."""
    page.evaluate(
        """([name, text, size]) => {
          const file = new File([text], name);
          if (size !== null) { Object.defineProperty(file, 'size', { value: size }); }
          const event = new Event('drop', { bubbles: true, cancelable: true });
          event.dataTransfer = { files: [file] };
          document.getElementById('drop').dispatchEvent(event);
        }""",
        [name, text, size],
    )


def wait_until(is_so):
    """Wait for something on the server's side."""
    deadline = time.monotonic() + 120.0
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def dismiss(page):
    page.click("#dismiss")
    expect(page.locator("#message-box")).to_be_hidden()


def read_numbers(page, selector):
    """Return a table's rows as the page shows them."""
    return page.eval_on_selector_all(
        f"{selector} tbody tr",
        "rows => rows.map(row => Array.from(row.cells).map(cell => cell.textContent))",
    )


def test_loop_in_the_browser(page, bench, project, tmp_path, keep):
    copy = tmp_path / "copy"
    shutil.copytree(project.directory, copy)
    open_page(page, bench)
    tells(page, "The model lacks thermal_lag")
    expect(page.locator("#adds button.primary")).to_have_text("Add thermal_lag")
    wait_for_job(page, bench)
    keep(page, "1_named")

    _, told = run_command(copy, "add", "thermal_lag", "--json")
    page.locator("#adds button").first.focus()
    page.keyboard.press("Enter")
    page.wait_for_selector("#revision table")
    rows = {row[0]: row for row in read_numbers(page, "#revision")}
    for name, after in told["after"]["rmse_heldout"].items():
        before = told["before"]["rmse_heldout"][name]
        assert rows[name][2:4] == [f"{before:.4g}", f"{after:.4g}"]
        assert float(rows[name][3]) < float(rows[name][2])
    assert project.toml.read_bytes() == (copy / "zerodrift.toml").read_bytes()
    page.wait_for_selector("#staircase .picture svg")
    expect(page.locator("#verdict-sentence")).to_have_text(re.compile("^Nothing is missing"))
    wait_for_job(page, bench)
    keep(page, "2_added")
    _, diagnosed = run_command(copy, "diagnose", "--json")
    tells(page, f"{diagnosed['floor_ratio_before']:.2f} times")

    page.click("#actions summary")
    page.click("#undo")
    tells(page, "lacks thermal_lag")
    assert "thermal_lag" not in project.toml.read_text()
    assert page.wrong == []
    asked = {urlsplit(url).netloc for url in page.asked if url.startswith(("http", "ws"))}
    assert asked == {f"127.0.0.1:{bench.port}"}


def read_window(page):
    """Return from and to of what the chart shows, in seconds."""
    told = page.locator("#main").get_attribute("data-drawn").split()
    return float(told[-2]), float(told[-1])


def drag(page, low, high, *, pane=0):
    """Drag over a share of the time axis."""
    box = page.locator("#main svg").bounding_box()
    first, last = 62.0, 0.6 * box["width"] - 12.0
    y = box["y"] + 60.0 + 150.0 * pane
    page.mouse.move(box["x"] + first + low * (last - first), y)
    page.mouse.down()
    page.mouse.move(box["x"] + first + high * (last - first), y, steps=5)
    page.mouse.up()


def wait_for_window(page, is_so, button=None):
    """Wait until the chart shows such a part.

    A button is pressed by the keyboard, and again if it was drawn anew under the finger: the page
    may still be taking in what the last job found.
    """
    deadline = time.monotonic() + 60.0
    for tick in itertools.count():
        if button is not None and tick % 100 == 0:
            button.focus()
            page.keyboard.press("Enter")
        if is_so(*read_window(page)):
            return
        assert time.monotonic() < deadline, read_window(page)
        page.wait_for_timeout(50)


@pytest.mark.slow
def test_marked_stretch_lights_up_everywhere_and_is_zoomed_to(page, bench, keep):
    open_page(page, bench)
    wait_for_job(page, bench)
    first, last = read_window(page)
    drag(page, 0.4, 0.6)
    panes = page.locator("#main .head:visible").count()
    assert page.locator("#main .over .mark").count() == panes >= 4
    lit = page.locator("#main .over .lit").get_attribute("d")
    assert lit.count("M") > 20
    keep(page, "10_marked")
    page.click("#to-mark")
    wait_for_window(page, lambda low, high: low > first and high < last)
    low, high = read_window(page)
    assert low == pytest.approx(first + 0.4 * (last - first), abs=0.02 * (last - first))
    assert high == pytest.approx(first + 0.6 * (last - first), abs=0.02 * (last - first))
    assert page.locator("#main .over .lit").count() == 0  # nothing lies over what is zoomed to
    assert page.locator("#to-mark").is_disabled()
    page.dblclick("#main svg", position={"x": 300, "y": 80})
    wait_for_window(page, lambda low, high: (low, high) == (first, last))


@pytest.mark.slow
def test_points_marked_in_the_scatter_light_up_in_the_panes(page, bench):
    open_page(page, bench)
    wait_for_job(page, bench)
    box = page.locator("#main svg").bounding_box()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 60.0)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.95 * box["width"], box["y"] + box["height"] - 60.0, steps=4)
    page.mouse.up()
    assert page.locator("#main .over .lines").get_attribute("d").count("M") > 20


@pytest.mark.slow
def test_cursor_reads_every_pane_with_its_unit(page, bench):
    open_page(page, bench)
    wait_for_job(page, bench)
    box = page.locator("#main svg").bounding_box()
    page.mouse.move(box["x"] + 200.0, box["y"] + 80.0)
    expect(page.locator("#main .readout")).to_be_visible()
    text = page.inner_text("#main .readout")
    unit = bench.place.findings.units[0]
    for words in ("time", "min", "drift as measured", "model", "what is left", "degC", unit):
        assert words in text
    # The same sample, read from the findings.
    left = float(re.search(r"what is left\s+(\S+)", text).group(1).replace("−", "-"))
    shown = page.locator("#output").input_value()
    trace = bench.place.findings.find_trace(page.locator("#run").input_value())
    errors = trace.error[bench.place.findings.outputs.index(shown)]
    assert min(abs(errors - left)) <= 1e-4 * max(abs(errors))
    page.locator("#main").focus()
    for _ in range(3):
        page.keyboard.press("Shift+ArrowRight")
    assert page.locator("#main .over .mark").count() >= 4
    page.keyboard.press("Escape")
    assert page.locator("#main .over .mark").count() == 0


@pytest.mark.slow
def test_any_channel_goes_into_any_pane_and_to_the_scatter(page, bench):
    open_page(page, bench)
    wait_for_job(page, bench)
    page.locator("#main .head").nth(3).select_option("value:60:load Fz")
    tells(page, "load Fz", "#main .sheet svg")
    page.locator("#against").select_option("rate:60:temperature")
    tells(page, "rate of temperature, K/min", "#main .sheet svg")
    assert page.wrong == []


@pytest.mark.slow
def test_effect_is_drawn_over_what_is_left_and_explained(page, bench, keep):
    open_page(page, bench)
    settle(bench.place)
    choose(page, "ghost", "thermal_lag")
    tells(page, "thermal_lag would explain", "#main .sheet svg")
    page.click("#actions summary")
    choose(page, "effect", "thermal_gradient")
    tells(page, "provoke", "#effect-told")
    tells(page, "Not it:", "#effect-told")
    page.click("#main-details summary")
    page.wait_for_selector("#main-table table")
    keep(page, "3_ghost")


@pytest.mark.slow
def test_answer_that_comes_late_takes_back_no_choice(page, bench, project, monkeypatch):
    """While the server is asked what there is to choose, the user chooses."""
    open_page(page, bench)
    wait_for_job(page, bench)
    page.click("#actions summary")
    asked, may_answer, list_choices = threading.Event(), threading.Event(), views.list_choices

    def answer_late(*arguments):
        told = list_choices(*arguments)
        asked.set()
        assert may_answer.wait(120.0)
        return told

    monkeypatch.setattr(views, "list_choices", answer_late)
    shown = page.locator("#run").input_value()
    other = next(t.run for t in bench.place.findings.traces if t.run != shown)
    bench.place.previews = ()
    bench.place.tell("What was drawn is gone for a moment.", is_error=False)
    assert asked.wait(120.0)
    choose(page, "run", other)
    choose(page, "ghost", "thermal_lag")
    choose(page, "effect", "thermal_gradient")
    monkeypatch.setattr(views, "list_choices", list_choices)
    may_answer.set()
    expect(page.locator("#ghost option[value='thermal_lag']")).not_to_be_attached()
    assert page.locator("#run").input_value() == other
    assert page.locator("#effect").input_value() == "thermal_gradient"
    tells(page, "provoke", "#effect-told")

    bench.place.previews = ("thermal_lag",)
    bench.place.tell("There it is again.", is_error=False)
    expect(page.locator("#ghost")).to_have_value("thermal_lag")
    tells(page, "thermal_lag would explain", "#main .sheet svg")


@pytest.mark.slow
def test_add_pressed_while_the_page_is_drawn_anew_is_done(page, bench, project, monkeypatch):
    open_page(page, bench)
    wait_for_job(page, bench)
    asked, may_answer, show_top = threading.Event(), threading.Event(), views.show_top

    def answer_late(*arguments):
        told = show_top(*arguments)
        asked.set()
        assert may_answer.wait(120.0)
        return told

    monkeypatch.setattr(views, "show_top", answer_late)
    bench.place.tell("Draw it anew.", is_error=False)
    assert asked.wait(120.0)
    page.locator("#adds button.primary").press("Enter")
    may_answer.set()
    page.wait_for_selector("#revision table")
    assert 'kind = "thermal_lag"' in project.toml.read_text()


@pytest.mark.slow
def test_each_look_alike_can_be_added(page, tmp_path, keep):
    directory = tmp_path / "alike"
    directory.mkdir()
    # A lag of a few seconds is a delay, is a share of the rate: nothing here tells them apart.
    project = write_project(directory, runs=8, tau_s=3.0)
    with serve(directory) as bench:
        open_page(page, bench)
        tells(page, "these logs cannot tell which")
        buttons = page.locator("#adds button").all_inner_texts()
        assert buttons[0] == "Add thermal_lag"
        assert "Add look-alike clock_delay" in buttons
        wait_for_job(page, bench)
        keep(page, "9_look_alikes")
        page.click("text=Add look-alike clock_delay")
        page.wait_for_selector("#revision table")
        tells(page, "Added clock_delay", "#revision")
        wait_for_job(page, bench)
    assert 'kind = "clock_delay"' in project.toml.read_text()
    assert page.wrong == []


@pytest.mark.slow
def test_worst_segment_is_gone_to_and_walked_away_from_by_keyboard(page, bench):
    open_page(page, bench)
    wait_for_job(page, bench)
    segment = bench.place.findings.comparison.worst[-1]
    whole = bench.place.findings.find_trace(segment.run).time_s[-1]
    wait_for_window(
        page,
        lambda low, high: low <= segment.from_s < segment.to_s <= high < low + 0.9 * whole,
        page.locator(".segments button").last,
    )
    assert page.locator("#output").input_value() == segment.output
    assert page.locator("#run").input_value() == segment.run
    assert page.locator("#main .over .mark").count() >= 4
    wait_for_window(page, lambda low, high: low == 0.0 and high > 890.0, page.locator("#whole"))


@pytest.mark.slow
def test_what_hangs_is_cancelled_from_the_page_and_its_verdict_stays(page, bench, project):
    open_page(page, bench)
    wait_for_job(page, bench)
    before = project.toml.read_text()
    use_effect(project, "return ()", extra="import time\ntime.sleep(600)")
    tells(page, "Looking at", "#job")
    page.locator("#cancel").press("Enter")
    wait_for_job(page, bench)
    tells(page, "lacks thermal_lag")
    hung = bench.place.job
    project.toml.write_text(before)
    wait_until(lambda: bench.place.job is not hung)
    wait_for_job(page, bench)
    tells(page, "lacks thermal_lag")
    assert page.wrong == []


@pytest.mark.slow
def test_errors_are_messages_and_the_page_lives_on(page, bench, project, keep):
    open_page(page, bench)
    settle(bench.place)
    moved = project.directory.parent / "moved"
    shutil.move(project.directory / "logs", moved)
    page.wait_for_selector("#message-box.error")
    tells(page, "logs", "#message")
    keep(page, "4_log_deleted")
    dismiss(page)
    shutil.move(moved, project.directory / "logs")
    tells(page, "changed outside", "#message")
    wait_for_job(page, bench)
    tells(page, "lacks thermal_lag")
    project.toml.write_text(project.toml.read_text().replace("[sensor]", "[senser]"))
    page.wait_for_selector("#message-box.error")
    tells(page, "zerodrift.toml:", "#message")
    dismiss(page)
    project.toml.write_text(project.toml.read_text().replace("[senser]", "[sensor]"))
    use_effect(project, "raise ZeroDivisionError('mine')")
    tells(page, "mine", "#message")
    assert "Traceback" not in page.inner_text("#message")
    assert page.is_visible("#verdict")
    assert page.wrong == []


@pytest.mark.slow
def test_new_project_from_a_chosen_log(page, project, tmp_path, keep):
    directory = tmp_path / "new"
    directory.mkdir()
    log = project.directory / "logs" / "run_0.csv"
    with serve(directory) as bench:
        page.goto(bench.url)
        page.wait_for_selector("#choose")
        for number in range(3):
            with page.expect_file_chooser() as chooser:
                page.click("#choose")
            chooser.value.set_files(
                [{"name": f"run_{number}.csv", "mimeType": "text/csv", "buffer": log.read_bytes()}]
            )
            tells(page, f"run_{number}.csv", "#logs-there")
        drop(page, "run_3.csv", log.read_text())
        tells(page, "run_3.csv", "#logs-there")
        keep(page, "5_new_project")
        drop(page, "huge.csv", "", size=2 << 30)
        page.wait_for_selector("#message-box.error")
        tells(page, "huge.csv: is 2.1 GB", "#message")
        dismiss(page)
        page.click("#begin")
        page.wait_for_selector(DRAWN)
        page.wait_for_selector("#errors table")
        tells(page, "Fz", "#errors")
        tells(page, "temperature temperature_degC; Fz in N: Fz_N", "#message")
        text = (directory / "zerodrift.toml").read_text()
        assert 'measured = "Fz_N"' in text
        wait_for_job(page, bench)
    # What is too large is refused by its size alone, which the console tells of as well.
    assert len(page.wrong) == 1
    assert "400 (BAD REQUEST)" in page.wrong[0]


def test_bad_file_is_a_message(page, tmp_path):
    directory = tmp_path / "new"
    (directory / "logs").mkdir(parents=True)
    (directory / "logs" / "bad.csv").write_text("this is,no log\n1,2\n")
    with serve(directory) as bench:
        page.goto(bench.url)
        page.wait_for_selector("#begin")
        page.click("#begin")
        page.wait_for_selector("#message-box.error")
        tells(page, "bad.csv", "#message")
        assert not (directory / "zerodrift.toml").exists()
        assert page.is_visible("#begin")


@pytest.mark.slow
def test_practice_case_asks_for_a_guess_first(page, tmp_path, keep):
    directory = tmp_path / "practice"
    directory.mkdir()
    with serve(directory) as bench:
        page.goto(bench.url)
        page.click("#practise")
        page.wait_for_selector(DRAWN, timeout=120_000)
        page.wait_for_selector("#tell")
        assert page.query_selector("#verdict-sentence") is None
        assert "simulated data" in page.inner_text("#kicker").lower()
        wait_for_job(page, bench)
        choose(page, "guess-choice", "creep")
        keep(page, "6_guess")
        page.click("#tell")
        page.wait_for_selector("#verdict-sentence")
        tells(page, "You guessed creep", "#guess-told")
    assert page.wrong == []


@pytest.mark.slow
def test_train_firmware_verify_and_report_from_the_page(page, bench, project, keep):
    open_page(page, bench)
    settle(bench.place)
    for button, words in (
        ("train", "Trained without a network"),
        ("firmware", "Built: flash"),
        ("verify", "equal in every bit"),
        ("report", "open report.html"),
    ):
        page.click(f"#{button}")
        expect(page.locator("#outcome")).to_contain_text(words, timeout=300_000)
        wait_for_job(page, bench)
    page.wait_for_selector("#firmware-told .table table")
    told = json.loads((project.directory / "build" / "firmware.json").read_text())
    tells(page, f"{told['flash_bytes']} B", "#firmware-told")
    keep(page, "7_firmware")
    with page.context.expect_page() as opened:
        page.click("#outcome a")
    opened.value.wait_for_selector("#verdict")
    assert "The model lacks thermal_lag" in opened.value.inner_text("#verdict")


@pytest.mark.slow
def test_page_is_dark_where_the_reader_wants_it(page, bench, keep):
    page.emulate_media(color_scheme="dark")
    open_page(page, bench)
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert sum(int(part) for part in re.findall(r"\d+", ground)[:3]) < 150
    # In one step: a chart that is drawn anew leaves a text behind that has no style any more.
    ink = page.evaluate("getComputedStyle(document.querySelector('#main .sheet svg text')).fill")
    assert sum(int(part) for part in re.findall(r"\d+", ink)[:3]) > 450
    keep(page, "8_dark")
    page.click("#theme")
    tells(page, "Dark page", "#theme")


@pytest.mark.slow
def test_everything_that_can_be_used_has_a_name_and_takes_the_keyboard(page, bench):
    open_page(page, bench)
    wait_for_job(page, bench)
    unnamed = page.evaluate(
        "() => Array.from(document.querySelectorAll('#bench button, #bench input, #bench summary'))"
        ".filter(e => e.offsetParent !== null)"
        ".filter(e => !(e.textContent.trim() || e.getAttribute('aria-label') || e.labels?.length"
        " || e.closest('label')))"
        ".map(e => e.outerHTML.slice(0, 200))"
    )
    assert unnamed == []
    page.eval_on_selector_all("#bench details", "all => all.forEach((one) => { one.open = true; })")
    page.evaluate("document.activeElement.blur()")
    reached = set()
    for _ in range(150):
        page.keyboard.press("Tab")
        reached.add(
            page.evaluate(
                "(e => e.id || e.dataset.press || e.dataset.choose)(document.activeElement)"
            )
        )
    assert "add" in reached
    assert any('"from_s"' in (name or "") for name in reached)
    named = ("theme", "effect", "look", "output", "run", "ghost", "main-summary", "present")
    wanted = {
        *named,
        "main",
        "against",
        *MOVES,
        "add-chosen",
        "remove",
        "train",
        "firmware",
        "verify",
        "report",
    }
    assert wanted - reached == set()


@pytest.mark.slow
def test_dead_server_is_told_and_the_tab_finds_the_restarted_one(page, project):
    with serve(project.directory) as first:
        open_page(page, first)
        settle(first.place)
        url = first.url
    expect(page.locator("#gone")).to_contain_text("not running any more")
    with serve(project.directory) as second:
        assert second.url == url
        expect(page.locator("#gone")).to_have_count(0)
        page.wait_for_selector("#verdict-sentence")
        settle(second.place)


@pytest.mark.slow
def test_what_is_being_recomputed_is_greyed_at_once_and_its_buttons_are_gone(page, bench):
    open_page(page, bench)
    wait_for_job(page, bench)
    page.locator("#adds button.primary").click()
    style = "getComputedStyle(document.querySelector('#verdict')).opacity"
    page.wait_for_function(f"() => Number({style}) < 0.6", timeout=1000)
    expect(page.locator("#adds button.primary")).to_have_count(0)
    page.wait_for_selector("#revision table")
    tells(page, "Nothing is missing")
    wait_for_job(page, bench)
    page.wait_for_function(f"() => Number({style}) > 0.9")
    page.locator(".timeline button").first.click()
    tells(page, "lacks thermal_lag")
    wait_for_job(page, bench)


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1440])
def test_nothing_is_wider_than_the_window(page, bench, keep, width):
    page.set_viewport_size({"width": width, "height": 900})
    open_page(page, bench)
    wait_for_job(page, bench)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    keep(page, f"11_width_{width}")
