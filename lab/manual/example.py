"""The pictures of the loop: a simulated sensor whose lag the model does not know, and then does."""

import tempfile
from functools import cache
from pathlib import Path

import plotly.graph_objects as go
from click.testing import CliRunner

from zerodrift.cli.main import cli
from zerodrift.report.figures import Window, draw_candidates, draw_run, draw_staircase
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.tasks.survey import SurveyRequest, list_contributions, survey

TWIN = ("twin", "--runs", "6", "--told", "zero_tempco", "--hidden", "thermal_lag", "--seed", "3")
SIMULATED = "Simulated: `zerodrift " + " ".join(TWIN) + "`."
OUTPUT = "Fz"


@cache
def draw_example() -> dict[str, tuple[go.Figure, str]]:
    """Return the pictures by name, each with its caption."""
    from zerodrift.physics.catalogue import load_catalogue

    with tempfile.TemporaryDirectory(prefix="zerodrift-manual-") as name:
        directory = Path(name) / "sensor"
        _run(*TWIN, "-C", str(directory))
        before = survey(SurveyRequest(ProjectFolder(directory)))
        assert before.diagnosed is not None
        diagnosis = before.diagnosed.diagnosis
        assert diagnosis.effect is not None
        config, dataset = open_project(ProjectFolder(directory))
        (told,) = list_contributions(config, dataset, load_catalogue(), diagnosis, 1)
        effect, curves = told.effect, told.curves
        worst = next(s for s in before.comparison.worst if s.output == OUTPUT)
        _run("add", diagnosis.effect, "--json", "-C", str(directory))
        steps = survey(SurveyRequest(ProjectFolder(directory), wants_diagnosis=False)).steps
    k = before.outputs.index(OUTPUT)
    run = draw_run(
        before.find_trace(worst.run),
        before.comparison,
        OUTPUT,
        Window(worst.run),
        ghost=curves[worst.run][k],
        ghost_name=effect,
    )
    return {
        "run": (
            run,
            f"Measurement, model and what is left of one run, and what {effect} would explain of "
            f"it. {SIMULATED}",
        ),
        "candidates": (
            draw_candidates(diagnosis),
            f"What each effect that the model lacks leaves of the held-out error. {SIMULATED}",
        ),
        "staircase": (
            draw_staircase(steps),
            f"The held-out error of each output before and after `add {effect}`. {SIMULATED}",
        ),
    }


def _run(*arguments: str) -> None:
    """Run a command; a failure stops the build."""
    result = CliRunner().invoke(cli, list(arguments))
    if result.exit_code != 0:
        raise RuntimeError(f"zerodrift {' '.join(arguments)}: {result.output}{result.exception}")
