"""A small project with its firmware, built once."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.surroundings.conftest import write_project

from zerodrift.cli.main import cli


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project of physics alone whose firmware was built; not to be changed."""
    project = write_project(tmp_path_factory.mktemp("apply") / "project")
    result = CliRunner().invoke(cli, ["firmware", "-C", str(project)])
    assert result.exit_code == 0, result.output
    return project
