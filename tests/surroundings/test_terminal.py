"""No control character of any file reaches the terminal, whoever prints it."""

import io
import json
import re
import sys
from pathlib import Path

import pytest
from tests.surroundings.conftest import OUTPUT, Command, write_project

from zerodrift.base.terminal import GuardedStream, escape_controls, open_terminal

EVIL = "\x1b]0;title\x07\x1b[2J\x9b31m\x7f\u202egnp"
"""Sets a title, clears the screen, colours by C1, deletes, and writes from right to left."""
OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


@pytest.fixture
def evil(tmp_path: Path) -> Path:
    """Return a project with control characters in a unit, an output, a column and a file."""
    quoted = json.dumps(EVIL).replace("\x7f", "\\u007f")
    output = OUTPUT.replace('unit = "N"', f"unit = {quoted}").replace(
        "[outputs.y]", f"[outputs.{quoted}]"
    )
    project = write_project(tmp_path / "p", output=output)
    log = project / "logs/run0.csv"
    head, *rows = log.read_text().splitlines()
    header = "\x1b[2J\x9b31m\x07"
    log.write_text("\n".join([f"{head},{header}", *(f"{row},1" for row in rows)]) + "\n")
    return project


@pytest.mark.parametrize("command", ["compare", "train", "firmware", "diagnose", "report"])
def test_no_command_hands_control_characters_on(
    command: str, evil: Path, zerodrift: Command
) -> None:
    done = zerodrift(command, "-C", evil)
    assert not OBEYED.search(done.out + done.err)
    assert "Traceback" not in done.err


def test_json_is_json_all_the_same(evil: Path, zerodrift: Command) -> None:
    done = zerodrift("compare", "-C", evil, "--json")
    assert done.code == 0, done.err
    assert not OBEYED.search(done.out)
    (name,) = json.loads(done.out)["outputs"]
    assert name == EVIL


def test_init_shows_a_header_of_control_characters_written_out(
    evil: Path, zerodrift: Command
) -> None:
    (evil / "zerodrift.toml").unlink()
    done = zerodrift("init", evil / "logs/run0.csv", "-C", evil)
    assert not OBEYED.search(done.out + done.err)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\tb\nc\r\nd", "a\tb\nc\r\nd"),
        ("over\rwritten", "over\\rwritten"),
        ("\x1b[31mred", "\\x1b[31mred"),
        ("\x9b31m", "\\x9b31m"),
        ("\u202eab", "\\u202eab"),
        ("°C µm ä 日本", "°C µm ä 日本"),
    ],
)
def test_control_characters_are_written_out(text: str, shown: str) -> None:
    assert escape_controls(text) == shown


def test_richs_own_sequences_stay_and_those_of_texts_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    from rich.table import Table

    raw = Terminal()
    monkeypatch.setattr(sys, "stdout", GuardedStream(raw))
    monkeypatch.setenv("TERM", "xterm-256color")
    console = open_terminal(width=80)
    table = Table("head", title="title", title_style="bold")
    table.add_row("\x1b[2Jcell")
    console.print(table)
    print("\x1b[2Jline")
    told = raw.getvalue()
    assert "\x1b[1mtitle" in told.replace(" ", "") or "\x1b[1m" in told
    assert "\x1b[2J" not in told and told.count("\\x1b[2J") == 2


def test_a_guarded_stream_has_no_way_round() -> None:
    guarded = GuardedStream(io.TextIOWrapper(io.BytesIO()))
    assert not hasattr(guarded, "buffer")
    assert guarded.write("\x1b") == 1
