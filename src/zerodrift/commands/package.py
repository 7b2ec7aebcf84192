"""`zerodrift package`: the model as a package of a build system."""

import shutil
import tempfile
from pathlib import Path

import click

from zerodrift.commands.common import directory_option, json_option, print_json


@click.command()
@click.argument("kind", type=click.Choice(["cmake", "zephyr", "arduino", "platformio"]))
@directory_option
@json_option
def command(kind: str, directory: Path, as_json: bool) -> None:
    """Write the model as a package into <out>/packages/KIND, in place of what lies there.

    Takes build/model.json, which `zerodrift firmware` writes once every compared bit is equal.
    """
    from zerodrift.c_runtime.compilers import RUNTIME_FILES
    from zerodrift.codegen.packages import render_package
    from zerodrift.commands.firmware import show_path
    from zerodrift.config import load_config
    from zerodrift.export.integer_model import load_model

    config = load_config(directory)
    model = load_model(config.build_directory / "model.json")
    runtime = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    files = render_package(kind, model, runtime)
    place = config.firmware_out / "packages" / kind
    place.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=".staging-", dir=place.parent))
    try:
        for name, text in files.items():
            path = staging / "new" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        if place.exists():
            place.replace(staging / "old")
        (staging / "new").replace(place)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    shown = show_path(place, config.directory)
    written = [f"{shown}/{name}" for name in sorted(files)]
    if as_json:
        print_json({"package": kind, "model_hash": model.hash, "files": written})
        return
    click.echo("wrote " + ", ".join(written))
