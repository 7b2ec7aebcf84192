"""`zerodrift firmware --onnx`: a network from elsewhere as the compensator of a project."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

from zerodrift.tasks.imported import OnnxRequest

Result = TypeVar("Result")


def onnx_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """Add `--onnx` and its further options, passed on as `onnx: OnnxRequest | None`."""
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
        onnx = None
        if onnx_path is not None:
            names = tuple(name.strip() for name in features.split(",")) if features else ()
            logs = (*calibrate, *more_logs)
            onnx = OnnxRequest(onnx_path, logs, names, _read_memory(memory), output)
        return function(onnx=onnx, **others)

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
