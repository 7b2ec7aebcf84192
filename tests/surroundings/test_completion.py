"""A shell that asks for completions gets them and nothing else."""

import pytest
from tests.surroundings.conftest import Run

pytestmark = pytest.mark.long


def test_commands_are_completed(run: Run) -> None:
    asked = {"_ZERODRIFT_COMPLETE": "bash_complete", "COMP_WORDS": "x fi", "COMP_CWORD": "1"}
    done = run(environment=asked, without=("PYTEST_CURRENT_TEST",))
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert done.stdout.split() == ["plain,firmware"]
