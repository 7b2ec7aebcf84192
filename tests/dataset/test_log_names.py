"""Which files count as logs is said once, and nothing that a glob matches is lost in silence."""

from pathlib import Path

import pytest
from tests.surroundings.conftest import REST, Command, write_project

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.selectors import expand_selectors, list_suffixes
from zerodrift.fleet.sensors import guess_folder
from zerodrift.tasks.calibrate import find_logs
from zerodrift.workbench.uploads import list_logs


@pytest.mark.parametrize("suffix", list_suffixes())
def test_a_log_of_any_kind_is_one_everywhere(suffix: str, tmp_path: Path) -> None:
    folder = tmp_path / "units/SN1"
    folder.mkdir(parents=True)
    (folder / f"log{suffix}").touch()
    assert guess_folder(tmp_path) == ("units", ("SN1",))
    assert find_logs(["units/SN1"], tmp_path) == [folder / f"log{suffix}"]
    assert list_logs(folder) == [f"log{suffix}"]


def test_a_folder_that_is_called_like_a_log_is_told(tmp_path: Path, zerodrift: Command) -> None:
    project = write_project(tmp_path / "p", REST.replace("run[0-2].csv", "*.csv"))
    (project / "logs/run9.csv").mkdir()
    done = zerodrift("compare", "-C", project)
    assert done.code == 2 and "run9.csv, of which nothing would be read" in done.err


def test_a_folder_of_logs_beside_files_is_told(tmp_path: Path) -> None:
    project = write_project(tmp_path / "p", REST.replace("run[0-2].csv", "*"))
    (project / "logs/second").mkdir()
    (project / "logs/second/a.csv").touch()
    with pytest.raises(InputError, match="second, of which nothing would be read"):
        expand_selectors(load_config(project), "train")


def test_a_recursive_glob_loses_nothing_and_a_folder_without_logs_is_none(tmp_path: Path) -> None:
    project = write_project(tmp_path / "p", REST.replace("run[0-2].csv", "**"))
    (project / "logs/notes").mkdir()
    (project / "logs/second").mkdir()
    (project / "logs/second/a.csv").touch()
    found = expand_selectors(load_config(project), "train")
    assert [one.path.name for one in found][-1] == "a.csv" and len(found) == 5
