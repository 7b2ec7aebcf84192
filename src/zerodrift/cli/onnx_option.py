"""`zerodrift firmware --onnx`: a network from elsewhere as the compensator of a project."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from zerodrift.base.errors import InputError

if TYPE_CHECKING:
    from zerodrift.base.config import Config
    from zerodrift.dataset.runs import Dataset
    from zerodrift.export.float_model import FloatModel

Result = TypeVar("Result")


@dataclass(frozen=True)
class OnnxRequest:
    """The options that belong to `--onnx`."""

    path: Path | None
    calibrate: tuple[Path, ...] = ()
    features: tuple[str, ...] = ()
    memory: str | int | None = None
    output: str | None = None

    def __bool__(self) -> bool:
        """Whether a network is to be imported."""
        return self.path is not None


def onnx_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """Add `--onnx` and its further options, passed on as `request: OnnxRequest`."""
    options = (
        click.argument("more_logs", nargs=-1, type=click.Path(path_type=Path), metavar="[LOG...]"),
        click.option(
            "--onnx",
            "onnx_path",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="Take the network of this ONNX file instead of training one.",
        ),
        click.option(
            "--calibrate",
            type=click.Path(path_type=Path),
            multiple=True,
            metavar="LOG...",
            help="With --onnx: the logs that set the ranges (default: [logs] train).",
        ),
        click.option(
            "--features",
            metavar="NAME,...",
            help="With --onnx: the network's inputs in order, of temperature and [inputs].",
        ),
        click.option(
            "--memory",
            metavar="stream|N",
            help="With --onnx: carry the state, or windows of N samples (default: as the file).",
        ),
        click.option("--output", metavar="NAME", help="With --onnx: the graph output to take."),
    )

    def wrapper(
        more_logs: tuple[Path, ...],
        onnx_path: Path | None,
        calibrate: tuple[Path, ...],
        features: str | None,
        memory: str | None,
        output: str | None,
        **others: object,
    ) -> Result:
        if more_logs and not calibrate:
            raise click.UsageError(f"unexpected '{more_logs[0]}'; logs follow --calibrate")
        given = (calibrate, features, memory, output)
        if onnx_path is None and any(option for option in given):
            raise click.UsageError("--calibrate, --features, --memory and --output go with --onnx")
        request = OnnxRequest(
            path=onnx_path,
            calibrate=(*calibrate, *more_logs),
            features=tuple(name.strip() for name in features.split(",")) if features else (),
            memory=_read_memory(memory),
            output=output,
        )
        return function(request=request, **others)

    wrapper.__doc__ = function.__doc__
    wrapper.__name__ = function.__name__
    wrapper.__click_params__ = getattr(function, "__click_params__", [])  # type: ignore[attr-defined]
    for option in reversed(options):
        wrapper = option(wrapper)
    return wrapper


def _read_memory(memory: str | None) -> str | int | None:
    if memory is None or memory == "stream":
        return memory
    if not memory.isdigit() or int(memory) < 1:
        raise click.BadParameter(
            f"'{memory}'; expected 'stream', or the number of samples of a window", None, None
        )
    return int(memory)


def open_import(
    request: OnnxRequest, directory: Path, skip_invalid: bool, sensor: str | None = None
) -> tuple["Config", "Dataset", "FloatModel", list[str]]:
    """Return the project, its logs, the network as a float model, and notes for the user.

    Without a zerodrift.toml the project is guessed from the logs, as `init` does.

    Raises:
        InputError: the network, the project or a log cannot be read, or they do not fit together.
    """
    from zerodrift.dataset.load import load_dataset
    from zerodrift.export.compose_import import describe_imported
    from zerodrift.export.onnx_reader import read_imported

    assert request.path is not None
    imported = read_imported(request.path, request.output)
    config, notes = _open_config(request.calibrate, directory, sensor)
    dataset = load_dataset(config, skip_invalid)
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
) -> tuple["Config", list[str]]:
    from zerodrift.base.config import FILE_NAME, parse_config
    from zerodrift.cli.init import find_logs
    from zerodrift.dataset.guess import guess_project
    from zerodrift.dataset.selectors import expand_selectors
    from zerodrift.tasks.init_toml import write_config
    from zerodrift.tasks.project import open_config

    logs = [path.absolute() for path in find_logs(calibrate, directory)]
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
    config = open_config(directory, sensor)
    if not logs:
        return config, []
    config = replace(config, train_logs=tuple(selectors))
    tested = {selection.path.resolve() for selection in expand_selectors(config, "test")}
    if tested & {path.resolve() for path in logs}:
        note = "the test logs are among those calibrated on; errors are those of the latter"
        return replace(config, test_logs=()), [note]
    return config, []
