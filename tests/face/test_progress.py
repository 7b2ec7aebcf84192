"""Where progress goes: nowhere on a pipe, text in a notebook's cell, lines for a program."""

import io
import sys
from types import ModuleType, SimpleNamespace

import pytest

from zerodrift.base.progress import PROGRESS_LINES, Stage, is_watched
from zerodrift.cli.console import show_progress


class Handle:
    def __init__(self) -> None:
        self.shown: list[str] = []

    def update(self, data: dict[str, str], raw: bool) -> None:
        assert raw
        self.shown.append(data["text/plain"])


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> Handle:
    """Stand in for IPython in a kernel."""
    handle = Handle()
    ipython, display = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: SimpleNamespace(kernel=1)  # type: ignore[attr-defined]
    display.display = lambda *_, **__: handle  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    monkeypatch.setattr("zerodrift.base.progress.NOTEBOOK_SECONDS", 0.0)
    return handle


def test_a_notebook_shows_it_in_the_cell_and_takes_it_away(notebook: Handle) -> None:
    with show_progress("reading") as say:
        say("computing")
        with say.measure("training") as report:
            report(Stage(0.25, "GRU"))
    assert notebook.shown == ["reading", "computing", "training, 25 %: GRU", ""]


def test_a_pipe_gets_none_whatever_colour_is_forced(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert not is_watched()
    with show_progress("reading") as say:
        say("computing")
        with say.measure("training") as report:
            report(Stage(0.25, "GRU"))
    told = capsys.readouterr()
    assert told.out == "" and told.err == ""
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: True))
    assert is_watched()


def test_a_program_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROGRESS_LINES, "1")
    monkeypatch.setattr(sys, "stderr", told := io.StringIO())
    with show_progress("reading") as say:
        say("computing")
        with say.count("sensors") as report:
            report(1, 3, "1 kept")
    lines = told.getvalue().splitlines()
    assert lines == [
        f"progress: {text}" for text in ("reading", "computing", "1 of 3 sensors 1 kept")
    ]
