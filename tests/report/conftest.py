"""A small project with a hidden lag, and what the commands find about it."""

from pathlib import Path

import numpy as np
import pytest
from tests.loop.conftest import Project, write_project

from zerodrift.app.commands.survey import survey_project
from zerodrift.report.findings import Findings, Trace


@pytest.fixture(scope="session")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Project, Findings]:
    """Return a project of five runs, and its findings; neither is to be changed."""
    project = write_project(tmp_path_factory.mktemp("surveyed"))
    return project, survey_project(project.directory)


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """Return a project of one's own."""
    return write_project(tmp_path, runs=3)


def make_trace(
    drift: np.ndarray,
    error: np.ndarray,
    *,
    temperature: np.ndarray,
    load: np.ndarray,
    name: str = "run",
    held_out: bool = True,
) -> Trace:
    """Return a trace of one output at one sample a second."""
    from zerodrift.report.findings import measure_rate

    time_s = np.arange(drift.size, dtype=np.float64)
    return Trace(
        name,
        held_out,
        1.0,
        time_s,
        temperature,
        measure_rate(time_s, temperature, 1.0),
        load[None],
        drift[None],
        error[None],
        np.zeros(1),
    )
