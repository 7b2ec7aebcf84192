"""A served page on a small project with a hidden lag, and a browser to look at it with."""

import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.loop.conftest import Project, write_project

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

SCREENSHOTS = Path(__file__).parents[2] / "build" / "screenshots"


@pytest.fixture(autouse=True)
def _addresses_of_their_own(tmp_path_factory: pytest.TempPathFactory, monkeypatch: Any) -> None:
    """Keep the pages' addresses out of the user's own folder."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """Return a project of five runs and a dwell, whose model lacks a lag."""
    directory = tmp_path / "cell"
    directory.mkdir()
    return write_project(directory)


@contextmanager
def serve(directory: Path) -> Iterator[Any]:
    """Serve a page on a directory while the block runs."""
    from zerodrift.workbench.server import Workbench

    bench = Workbench(directory)
    thread = threading.Thread(target=bench.serve, daemon=True)
    thread.start()
    try:
        yield bench
    finally:
        bench.stop()
        thread.join(10.0)


@pytest.fixture
def bench(project: Project) -> Iterator[Any]:
    """Return a page that is served on the project."""
    with serve(project.directory) as served:
        yield served


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Return Chromium, driven by Playwright."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="Playwright is not installed; `make setup-browser` does it"
    )
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("there is no Chromium; `make setup-browser` installs it")
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=path, args=options)
        yield chromium
        chromium.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """Return a window that remembers requests, errors and what the console said."""
    window = browser.new_page(viewport={"width": 1360, "height": 1000})
    window.set_default_timeout(60_000)
    window.asked, window.wrong = [], []
    window.on("request", lambda request: window.asked.append(request.url))
    window.on("pageerror", lambda error: window.wrong.append(str(error)))
    window.on(
        "console", lambda told: window.wrong.append(told.text) if told.type == "error" else None
    )
    yield window
    window.close()


@pytest.fixture
def keep() -> Any:
    """Return a function that keeps a picture of the page for people to look at."""

    def take(window: Any, name: str) -> None:
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        window.screenshot(path=str(SCREENSHOTS / f"{name}.png"), full_page=True)

    return take


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """Return a project with firmware; nothing changes it."""
    from tests.workbench.test_workplace import run_command

    directory = tmp_path_factory.mktemp("built") / "cell"
    directory.mkdir()
    project = write_project(directory, runs=3)
    assert run_command(directory, "firmware", "--json")[0] == 0
    return project


@pytest.fixture(scope="module")
def chip(built: Project, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Return a page whose firmware's own C is ready; nothing changes it for good."""
    from tests.workbench.test_workplace import settle

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        with serve(built.directory) as served:
            settle(served.place)
            served.place.load_chip()
            settle(served.place)
            assert served.place.chip is not None, served.place.message
            yield served
