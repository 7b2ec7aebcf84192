"""A small project with a hidden lag, and what the commands find about it."""

from pathlib import Path

import numpy as np
import pytest
from tests.loop.conftest import Project, write_project

from zerodrift.diagnosis.summary import ComparisonSummary, OutputSummary, WorstSegment
from zerodrift.physics.summary import ModelSummary
from zerodrift.report.findings import Findings, Provenance, Trace
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.survey import SurveyRequest, survey


@pytest.fixture(scope="session")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Project, Findings]:
    """Return a project of five runs, and its findings; neither is to be changed."""
    project = write_project(tmp_path_factory.mktemp("surveyed"))
    return project, survey(SurveyRequest(ProjectFolder(project.directory)))


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
        np.zeros((0, 2), dtype=np.int64),
    )


def make_findings(**changes) -> Findings:
    """Return findings of one output that hold nothing but what is given."""
    empty = {
        "sensor": "cell",
        "outputs": ("Fz",),
        "units": ("N",),
        "full_scale": (200.0,),
        "simulated": False,
        "predictor": "physics",
        "comparison": make_comparison(),
        "advice": None,
        "comparison_sentences": (),
        "patterns": (),
        "diagnosed": None,
        "steps": (),
        "model": ModelSummary((), 25.0, ()),
        "firmware": None,
        "certificate": None,
        "firmware_note": "",
        "catalogue": {},
        "provenance": Provenance((), {}, ""),
        "notes": (),
        "skip_invalid": False,
        "traces": (),
    }
    return Findings(**{**empty, **changes})


def make_comparison(worst: tuple[WorstSegment, ...] = (), full_scale: float = 200.0):
    """Return what `compare` would say of one output, Fz in N."""
    output = OutputSummary("N", full_scale, 5.0, 1.0, None, 1.0, 2.0, 0.5, 1.0, 0.1, 0.9, 0.0)
    return ComparisonSummary(
        {"Fz": output}, {}, worst, (), (), "leave one run out", "dwell", False, 0.0
    )
