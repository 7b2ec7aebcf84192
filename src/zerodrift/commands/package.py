"""`zerodrift package`: the model as a package of a build system."""

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import click

from zerodrift.commands.common import directory_option, json_option, print_json
from zerodrift.files import make_directory, telling_of_writes


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
    make_directory(place.parent)
    with telling_of_writes(place):
        replace_folder(place, files)
    shown = show_path(place, config.directory)
    written = [f"{shown}/{name}" for name in sorted(files)]
    if as_json:
        print_json({"package": kind, "model_hash": model.hash, "files": written})
        return
    click.echo("wrote " + ", ".join(written))


def replace_folder(place: Path, files: Mapping[str, str]) -> None:
    """Put a folder with these files in the place of the one that lies there, whole or not at all.

    Args:
        place: the folder; the one above it exists.
        files: name below the folder -> text.
    """
    staging = Path(tempfile.mkdtemp(prefix=".staging-", dir=place.parent))
    old, new = staging / "old", staging / "new"
    try:
        for name, text in files.items():
            path = new / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        if place.exists():
            place.replace(old)
        new.replace(place)
    finally:
        if old.exists() and not place.exists():
            old.replace(place)
        shutil.rmtree(staging, ignore_errors=True)
