"""Models and C from stored float parameters are those of the day they were stored, to the byte."""

import json
from pathlib import Path

import pytest

from tests.frozen.projects import EXPECTED, NAMES, digest, render_texts, write_project


@pytest.mark.spread(3, "name", NAMES)
def test_stored_parameters_give_the_same_bytes(name: str, tmp_path: Path) -> None:
    expected = json.loads(EXPECTED.read_text("utf-8"))[name]
    texts = render_texts(name, write_project(name, tmp_path / name))
    assert {part: digest(text) for part, text in texts.items()} == expected
