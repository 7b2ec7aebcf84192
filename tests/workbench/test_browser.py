"""The loop as a user walks it, in Chromium."""

import json
import re
import shutil
from urllib.parse import urlsplit

import pytest
from tests.workbench.conftest import serve
from tests.workbench.test_workplace import run_command, settle

DRAWN = "#main .js-plotly-plot .scatterlayer .trace"


def open_page(page, bench):
    page.goto(bench.url)
    page.wait_for_selector(DRAWN)
    page.wait_for_selector("#verdict-sentence")


def choose(page, dropdown, value):
    """Choose in a dropdown by keyboard alone."""
    page.locator(f"#{dropdown}").focus()
    page.keyboard.press("Enter")
    page.keyboard.type(value)
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")


def wait_for_job(page):
    page.wait_for_function("document.getElementById('job').textContent === ''", timeout=120_000)


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
    assert "The model lacks thermal_lag" in page.inner_text("#verdict-sentence")
    assert page.inner_text("#add") == "Add thermal_lag"
    keep(page, "1_named")

    page.wait_for_function("document.getElementById('job').textContent === ''")
    _, told = run_command(copy, "add", "thermal_lag", "--json")
    page.locator("#add").focus()
    page.keyboard.press("Enter")
    page.wait_for_selector("#revision table")
    rows = {row[0]: row for row in read_numbers(page, "#revision")}
    for name, after in told["after"]["rmse_heldout"].items():
        before = told["before"]["rmse_heldout"][name]
        assert rows[name][2:4] == [f"{before:.4g}", f"{after:.4g}"]
        assert float(rows[name][3]) < float(rows[name][2])
    assert project.toml.read_bytes() == (copy / "zerodrift.toml").read_bytes()
    page.wait_for_selector("#staircase .js-plotly-plot")
    page.wait_for_function(
        "document.getElementById('verdict-sentence')?.textContent.startsWith('Nothing is missing')"
    )
    wait_for_job(page)
    keep(page, "2_added")
    _, diagnosed = run_command(copy, "diagnose", "--json")
    assert f"{diagnosed['floor_ratio_before']:.2f} times" in page.inner_text("#verdict-sentence")

    page.click("#undo")
    page.wait_for_function(
        "document.getElementById('verdict-sentence')?.textContent.includes('thermal_lag')"
    )
    assert "lacks thermal_lag" in page.inner_text("#verdict-sentence")
    assert "thermal_lag" not in project.toml.read_text()
    assert page.wrong == []
    asked = {urlsplit(url).netloc for url in page.asked if url.startswith(("http", "ws"))}
    assert asked == {f"127.0.0.1:{bench.port}"}


@pytest.mark.slow
def test_zoom_shows_more_of_less(page, bench):
    open_page(page, bench)
    settle(bench.place)
    read = (
        "() => { const x = document.querySelector('#main .js-plotly-plot').calcdata[0];"
        " return [x.length, x[0].x, x[x.length - 1].x]; }"
    )
    count, first, last = page.evaluate(read)
    middle, reach = (first + last) / 2, (last - first) / 20
    page.evaluate(
        "([a, b]) => Plotly.relayout(document.querySelector('#main .js-plotly-plot'),"
        " {'xaxis2.range[0]': a, 'xaxis2.range[1]': b})",
        [middle - reach, middle + reach],
    )
    page.wait_for_function(
        f"() => {{ const x = document.querySelector('#main .js-plotly-plot').calcdata[0];"
        f" return x[0].x > {first} && x[x.length - 1].x < {last}; }}"
    )
    _, low, high = page.evaluate(read)
    assert low >= middle - 1.2 * reach
    assert high <= middle + 1.2 * reach
    assert count > 0


@pytest.mark.slow
def test_effect_is_drawn_over_what_is_left_and_explained(page, bench, keep):
    open_page(page, bench)
    settle(bench.place)
    page.wait_for_timeout(1500)
    choose(page, "ghost", "thermal_lag")
    page.wait_for_function(
        "document.querySelector('#main .legend')?.textContent.includes('would look like')"
    )
    text = page.inner_text("#effect-told")
    assert "this one is missing" in text
    assert "To provoke it" in text
    page.click("#main-details summary")
    page.wait_for_selector("#main-table table")
    keep(page, "3_ghost")


@pytest.mark.slow
def test_errors_are_messages_and_the_page_lives_on(page, bench, project, keep):
    open_page(page, bench)
    settle(bench.place)
    moved = project.directory.parent / "moved"
    shutil.move(project.directory / "logs", moved)
    page.wait_for_selector("#message-box.error")
    assert "logs" in page.inner_text("#message")
    keep(page, "4_log_deleted")
    page.click("#dismiss")
    page.wait_for_selector("#message-box", state="hidden")
    shutil.move(moved, project.directory / "logs")
    page.wait_for_function(
        "document.getElementById('message').textContent.includes('changed outside')"
    )
    wait_for_job(page)
    assert "lacks thermal_lag" in page.inner_text("#verdict-sentence")
    project.toml.write_text(project.toml.read_text().replace("[sensor]", "[senser]"))
    page.wait_for_selector("#message-box.error")
    assert "zerodrift.toml:" in page.inner_text("#message")
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
            page.wait_for_function(
                f"document.getElementById('logs-there').textContent.includes('run_{number}.csv')"
            )
        keep(page, "5_new_project")
        page.click("#begin")
        page.wait_for_selector(DRAWN)
        assert "Fz" in page.inner_text("#errors")
        assert "temperature temperature_degC; Fz in N: Fz_N" in page.inner_text("#message")
        text = (directory / "zerodrift.toml").read_text()
        assert 'measured = "Fz_N"' in text
        wait_for_job(page)
    assert page.wrong == []


def test_bad_file_is_a_message(page, tmp_path):
    directory = tmp_path / "new"
    (directory / "logs").mkdir(parents=True)
    (directory / "logs" / "bad.csv").write_text("this is,no log\n1,2\n")
    with serve(directory) as bench:
        page.goto(bench.url)
        page.wait_for_selector("#begin")
        page.click("#begin")
        page.wait_for_selector("#message-box.error")
        assert "bad.csv" in page.inner_text("#message")
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
        wait_for_job(page)
        choose(page, "guess-choice", "creep")
        keep(page, "6_guess")
        page.click("#tell")
        page.wait_for_selector("#verdict-sentence")
        assert "You guessed creep" in page.inner_text("#guess-told")
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
        page.wait_for_function(
            f"document.getElementById('outcome').textContent.includes({json.dumps(words)})",
            timeout=300_000,
        )
        wait_for_job(page)
    page.wait_for_selector("#firmware-told .table table")
    told = json.loads((project.directory / "build" / "firmware.json").read_text())
    assert f"{told['flash_bytes']} B" in page.inner_text("#firmware-told")
    keep(page, "7_firmware")
    with page.context.expect_page() as opened:
        page.click("#outcome a")
    opened.value.wait_for_selector("figure .plot .plotly")
    assert "The model lacks thermal_lag" in opened.value.inner_text("#verdict")


@pytest.mark.slow
def test_page_is_dark_where_the_reader_wants_it(browser, bench, keep):
    window = browser.new_page(color_scheme="dark", viewport={"width": 1360, "height": 1000})
    window.set_default_timeout(60_000)
    open_page(window, bench)
    ground = window.evaluate("getComputedStyle(document.body).backgroundColor")
    assert sum(int(part) for part in re.findall(r"\d+", ground)[:3]) < 150
    ink = window.eval_on_selector(
        "#main .xtick text, #main .x2tick text", "t => getComputedStyle(t).fill"
    )
    assert sum(int(part) for part in re.findall(r"\d+", ink)[:3]) > 450
    keep(window, "8_dark")
    window.click("#theme")
    assert "Dark page" in window.inner_text("#theme")
    window.close()


@pytest.mark.slow
def test_everything_that_can_be_used_has_a_name_and_takes_the_keyboard(page, bench):
    open_page(page, bench)
    wait_for_job(page)
    unnamed = page.evaluate(
        "() => Array.from(document.querySelectorAll('#bench button, #bench input, #bench summary'))"
        ".filter(e => e.offsetParent !== null)"
        ".filter(e => !(e.textContent.trim() || e.getAttribute('aria-label') || e.labels?.length"
        " || e.closest('label')))"
        ".map(e => e.outerHTML.slice(0, 200))"
    )
    assert unnamed == []
    page.evaluate("document.activeElement.blur()")
    reached = set()
    for _ in range(150):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id"))
    named = ("theme", "effect", "look", "output", "run", "ghost", "main-summary", "present")
    wanted = {*named, "add", "remove", "train", "firmware", "verify", "report"}
    assert wanted - reached == set()
