"""The pages on where logs come from say what the commands print; their logs are made here."""

import importlib.util
import re
from pathlib import Path

import pytest
from tests.loop.test_tutorial import check_page, tutorial

NEEDS = {"from-ros-2": "mcap_ros2", "from-px4-and-ardupilot": "pyulog"}
PAGES = {path.stem: path for path in tutorial.list_worlds()}


def test_there_is_a_page_for_each_world() -> None:
    assert list(PAGES) == [
        "from-a-data-logger",
        "from-a-production-rig",
        "from-lab-instruments",
        "from-px4-and-ardupilot",
        "from-ros-2",
    ]
    for path in PAGES.values():
        text = path.read_text(encoding="utf-8")
        assert "simulated" in text and "error: something" not in text


def test_ci_runs_the_sessions() -> None:
    """`make test` leaves them out, as they train and build; a step of their own runs them."""
    root = Path(__file__).parents[2]
    ci = (root / ".ci" / "run").read_text("utf-8")
    assert re.search(r"^step worlds .*-- make test-worlds$", ci, re.MULTILINE)
    rule = (root / "Makefile").read_text("utf-8").partition("\ntest-worlds:")[2]
    assert "tests/loop/test_worlds.py" in rule.partition("\n\n")[0] and "not slow" not in rule[:200]


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_page_prints_what_it_says(name: str) -> None:
    if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None:
        pytest.skip(f"{NEEDS[name]} is not installed: `make setup-formats`")
    check_page(PAGES[name])
