"""What tests in Chromium do with a page; Playwright is imported when it is used."""

from importlib import import_module

from tests.workbench.test_workplace import settle

DRAWN = "#main .sheet svg .line"
"""The chart, drawn and listening."""


def expect(what):
    """Return what waits for a place in the page to be as it should."""
    told = import_module("playwright.sync_api").expect
    told.set_options(timeout=120_000)
    return told(what)


def open_page(page, bench):
    page.goto(bench.url)
    page.wait_for_selector(DRAWN)
    page.wait_for_selector("#verdict-sentence")


def wait_for_job(page, bench):
    """Wait until nothing runs, and the page has heard of it."""
    settle(bench.place)
    with page.expect_response(
        lambda answer: '"tick.n_intervals"' in (answer.request.post_data or "")
    ):
        pass
    expect(page.locator("#job")).to_have_text("")


def tells(page, words, where="#verdict-sentence"):
    """Wait until the page says so."""
    expect(page.locator(where)).to_contain_text(words)
