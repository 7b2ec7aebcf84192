"""The pictures of the loop: a simulated sensor whose lag the model does not know, and then does."""

import tempfile
from functools import cache
from pathlib import Path

from click.testing import CliRunner

from zerodrift.cli.main import cli
from zerodrift.diagnosis.drivers import TEMPERATURE, DriftDriver
from zerodrift.report.cause import DRIFT, LEFT, CauseView, draw_cause, list_channels, read_driven
from zerodrift.report.pictures import draw_ranking, draw_stairs
from zerodrift.report.svg import Picture
from zerodrift.report.window import Window
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.tasks.survey import SurveyRequest, list_contributions, survey

TWIN = ("twin", "--runs", "6", "--told", "zero_tempco", "--hidden", "thermal_lag", "--seed", "3")
SIMULATED = "Simulated: `zerodrift " + " ".join(TWIN) + "`."
OUTPUT = "Fz"


@cache
def draw_example() -> dict[str, tuple[Picture, str]]:
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
    trace, driver = before.find_trace(worst.run), DriftDriver(TEMPERATURE)
    curve = curves[worst.run][before.outputs.index(OUTPUT)]
    panes = (DRIFT, LEFT, driver.key)
    view = CauseView(trace, OUTPUT, Window(worst.run), panes, driver, effect, curve)
    shown = draw_cause(
        view, before.comparison, list_channels(before), lambda d: read_driven(before, trace, d)
    )
    return {
        "run": (
            shown.picture,
            f"Measurement, model and what is left of one run, and what {effect} would explain of "
            f"it. {SIMULATED}",
        ),
        "candidates": (
            draw_ranking(diagnosis),
            f"What each effect that the model lacks leaves of the held-out error. {SIMULATED}",
        ),
        "staircase": (
            draw_stairs(steps),
            f"The held-out error of each output before and after `add {effect}`. {SIMULATED}",
        ),
    }


def _run(*arguments: str) -> None:
    """Run a command; a failure stops the build."""
    result = CliRunner().invoke(cli, list(arguments))
    if result.exit_code != 0:
        raise RuntimeError(f"zerodrift {' '.join(arguments)}: {result.output}{result.exception}")
