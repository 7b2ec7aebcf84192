"""A network from elsewhere, in an ONNX file, as the compensator of a project."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import FILE_NAME, Config, parse_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.guess import guess_project
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.selectors import expand_selectors, list_files, order_path
from zerodrift.export.compose_import import describe_imported
from zerodrift.export.float_model import FloatModel
from zerodrift.export.onnx_reader import read_imported
from zerodrift.fleet.sensors import load_unit
from zerodrift.tasks.init_toml import write_config
from zerodrift.tasks.project import ProjectFolder


@dataclass(frozen=True)
class OnnxRequest:
    """Which network is imported, and how it is to be read."""

    path: Path
    calibrate: tuple[Path, ...] = ()
    """The logs that set the ranges of the integers; none: [logs] train."""
    features: tuple[str, ...] = ()
    """The network's inputs in order, of temperature and [inputs]; none: as its file says."""
    memory: str | int | None = None
    """Carry the state ("stream"), or windows of so many samples; None: as its file says."""
    output: str | None = None
    """The graph output to take; None: its only one."""


def open_import(
    request: OnnxRequest, project: ProjectFolder
) -> tuple[Config, Dataset, FloatModel, list[str]]:
    """Return the project, its logs, the network as a float model, and notes for the user.

    Without a zerodrift.toml the project is guessed from the logs, as `init` does.

    Raises:
        InputError: the network, the project or a log cannot be read, or they do not fit together.
    """
    imported = read_imported(request.path, request.output)
    config, notes = _open_config(request.calibrate, project.directory, project.sensor)
    dataset = load_dataset(config, project.skip_invalid)
    model, more = describe_imported(
        imported, config, dataset.train, request.features, request.memory
    )
    if config.effects or config.network.kind != "none":
        notes.append(
            "the network of the file is the whole compensator; the effects and [network] of"
            f" {config.path.name} are not part of it."
        )
    if dataset.test:
        notes.append("the file does not say whether its network was trained on the test logs.")
    return config, dataset, model, notes + more


def _open_config(
    calibrate: Sequence[Path], directory: Path, sensor: str | None
) -> tuple[Config, list[str]]:
    logs = [path.absolute() for path in _find_logs(calibrate, directory)]
    for path in logs:
        if not path.is_file():
            raise InputError(
                f"--calibrate: {path}: there is no such log; expected a CSV or Parquet file, or a"
                " folder of them."
            )
    selectors = [str(path) for path in logs]
    if sensor is None and not (directory / FILE_NAME).exists():
        if not logs:
            raise InputError(
                f"{directory / FILE_NAME}: there is no such file, and no logs by --calibrate;"
                " expected one or the other. `zerodrift init LOG...` writes the file."
            )
        guess = guess_project(logs)
        text = write_config(guess, {"train": selectors, "test": [], "dwell": []})
        config = parse_config(text, (directory / FILE_NAME).absolute())
        outputs = ", ".join(f"{o.name} in {o.unit}" for o in config.outputs)
        notes = [f"no {FILE_NAME}: outputs ({outputs}) and inputs are guessed from the logs"]
        return replace(config, effects=()), notes + [f"check: {check}" for check in guess.checks]
    config = load_unit(directory, sensor)
    if not logs:
        return config, []
    config = replace(config, train_logs=tuple(selectors))
    tested = {selection.path.resolve() for selection in expand_selectors(config, "test")}
    if tested & {path.resolve() for path in logs}:
        note = "the test logs are among those calibrated on; errors are those of the latter"
        return replace(config, test_logs=()), [note]
    return config, []


def _find_logs(logs: Sequence[Path], directory: Path) -> list[Path]:
    """Return the files named, and those of each directory named, sorted by name."""
    paths: list[Path] = []
    for log in logs:
        place = log if log.exists() else directory / log
        found = list_files(place)
        if not found:
            raise InputError(f"{place}: holds no log; expected CSV or Parquet files.")
        paths += found
    return sorted(set(paths), key=lambda path: order_path(path, directory))
