"""`propose --write`: a file is written once, may be asked for again, and is never replaced."""

import pytest

from tests.faults.projects import prepare_formula
from zerodrift.diagnosis.formula.proposal import is_proposed

pytestmark = pytest.mark.long


def test_the_same_command_given_again_finds_its_own_file(tmp_path, zerodrift):
    project = tmp_path / "project"
    prepare_formula(project, None)
    file = project / "my_effect.py"
    command = ("propose", "-C", project, "--no-black-box", "--write", file)
    told = zerodrift(*command)
    assert told.code == 0, told.err
    text = file.read_text(encoding="utf-8")
    assert is_proposed(text)
    again = zerodrift(*command)
    assert again.code == 0, again.err
    assert file.read_text(encoding="utf-8") == text
    file.write_text(text + "\n# mine\n", encoding="utf-8")
    third = zerodrift(*command)
    assert third.code == 2 and "holds another formula" in third.err
    assert "formulas were tried" in third.out
    assert file.read_text(encoding="utf-8") == text + "\n# mine\n"
    assert sorted(path.name for path in project.glob("*.py")) == ["my_effect.py"]


def test_a_file_of_somebody_else_is_refused_before_the_search(tmp_path, zerodrift):
    file = tmp_path / "mine.py"
    for content in (b"import numpy\n", b"\xff\xfe"):
        file.write_bytes(content)
        told = zerodrift("propose", "-C", tmp_path, "--write", file)
        assert told.code == 2 and "is there already" in told.err
        assert file.read_bytes() == content
