"""A project writes outside its folder only where its user said so on the command line."""

from pathlib import Path

import pytest
from tests.surroundings.conftest import REST, Command, assert_one_message, write_project

from zerodrift.base.errors import InputError
from zerodrift.tasks.trust import require_place


@pytest.mark.parametrize("command", ["firmware", "fleet"])
def test_a_project_that_writes_elsewhere_is_refused(
    command: str, tmp_path: Path, zerodrift: Command
) -> None:
    project = write_project(tmp_path / "p", REST + '\n[firmware]\nout = "../elsewhere"\n')
    done = zerodrift(command, "-C", project)
    assert_one_message(done, 2, "outside the project", "--out")
    assert not (tmp_path / "elsewhere").exists()
    assert not (project / "build" / "compensator.json").exists(), "told before the training"


def test_a_link_out_of_the_project_is_refused_too(tmp_path: Path, zerodrift: Command) -> None:
    project = write_project(tmp_path / "p")
    (tmp_path / "elsewhere").mkdir()
    (project / "firmware").symlink_to(tmp_path / "elsewhere")
    assert_one_message(zerodrift("firmware", "-C", project), 2, "outside the project")
    assert not list((tmp_path / "elsewhere").iterdir())


def test_a_place_is_named_once_on_the_command_line(tmp_path: Path, zerodrift: Command) -> None:
    project = write_project(tmp_path / "p", REST + '\n[firmware]\nout = "../elsewhere"\n')
    out = tmp_path / "elsewhere"
    assert zerodrift("firmware", "-C", project, "--out", out).code == 0
    assert (out / "small.c").is_file()
    require_place(project / "../elsewhere", project)
    with pytest.raises(InputError):
        require_place(tmp_path / "another", project)
    with pytest.raises(InputError):
        require_place(out, tmp_path / "another")
