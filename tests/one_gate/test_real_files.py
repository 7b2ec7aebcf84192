"""The labels of the real logs: each log has one."""

from pathlib import Path

import pytest
from benchmarks.one_gate.real_files import DATA, NOTHING, OPEN, PROJECTS, RIGHT, WRONG

LEFT_OUT = ("oven-controller.csv",)
"""Without times or output; `tempco.csv` beside it has what it logs."""


def test_every_project_has_a_name_a_label_and_what_is_wrong() -> None:
    assert len({project.name for project in PROJECTS}) == len(PROJECTS)
    for project in PROJECTS:
        assert project.label in (RIGHT, WRONG, OPEN, NOTHING)
        assert bool(project.words) == (project.label == WRONG)
        assert project.why or project.label == RIGHT


def test_every_log_is_in_a_project() -> None:
    if not DATA.is_dir():
        pytest.skip("../shared/data is not at hand")
    taken: set[Path] = set()
    for project in PROJECTS:
        for source, _ in project.logs:
            path = DATA / source
            assert path.exists(), source
            taken |= set(path.rglob("*.csv")) if path.is_dir() else {path}
    logs = {path for path in DATA.rglob("*.csv") if path.name not in LEFT_OUT}
    assert not logs - taken
