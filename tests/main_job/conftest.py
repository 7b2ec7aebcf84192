"""A small simulated project, trained once for all tests of the main job."""

import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.projects import render_toml

from zerodrift.base.errors import ZerodriftError
from zerodrift.cli.main import cli
from zerodrift_lab.twin import Recipe, parse_choice, simulate, write_logs

TOML = render_toml("""\
[logs]
train = ["logs/train_*.csv"]
test = ["logs/test_*.csv"]

[[effect]]
kind = "zero_tempco"

[network]
kind = "gru"
hidden = 5
memory = {memory}
form = "{form}"
epochs = {epochs}
starts = 1

[quantization]
weights = "{weights}"

[firmware]
out = "firmware"
""")


def write_project(
    directory: Path,
    logs: Path,
    memory: str = '"stream"',
    form: str = "reset_after",
    weights: str = "int16",
    epochs: int = 6,
) -> Path:
    """Write a project that shares `logs`; return its directory."""
    directory.mkdir(parents=True, exist_ok=True)
    text = TOML.format(memory=memory, form=form, weights=weights, epochs=epochs)
    (directory / "zerodrift.toml").write_text(text)
    shutil.copytree(logs, directory / "logs")
    return directory


def invoke(*arguments: str) -> Result:
    """Run the command line as `main` does and return the result with its exit code."""
    result = CliRunner().invoke(cli, list(arguments))
    if isinstance(result.exception, ZerodriftError):
        result.exit_code = result.exception.exit_code
    return result


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four simulated runs of the sensor with a hidden lag."""
    raw = tmp_path_factory.mktemp("raw")
    recipe = Recipe(seed=3, hidden=(parse_choice("thermal_lag"),))
    write_logs(simulate(recipe), raw)
    source = sorted((raw / "logs").glob("*.csv"))
    runs = {path: path.read_text().splitlines(keepends=True)[:1800] for path in source}
    column = next(iter(runs.values()))[0].split(",").index("temperature_degC")

    def measure_span(lines: list[str]) -> float:
        values = [float(line.split(",")[column]) for line in lines[1:]]
        return max(values) - min(values)

    # The test run stays within the temperatures of the others: beyond them the chip holds on to
    # the calibrated range while the float model extrapolates, which is another matter.
    widest = sorted(runs.values(), key=measure_span, reverse=True)
    folder = tmp_path_factory.mktemp("project_logs")
    for name, lines in zip(("train_1", "train_2", "train_3", "test_1"), widest, strict=False):
        (folder / f"{name}.csv").write_text("".join(lines))
    return folder


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory, logs: Path) -> Path:
    """The project after `zerodrift firmware`."""
    directory = write_project(tmp_path_factory.mktemp("main_job") / "project", logs, epochs=40)
    result = invoke("firmware", "-C", str(directory), "--json")
    assert result.exit_code == 0, result.output
    (directory / "result.json").write_text(result.stdout)
    return directory
