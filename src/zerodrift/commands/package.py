"""`zerodrift package`: the model as a package of a build system."""

from pathlib import Path

import click

from zerodrift.commands.common import changes_project, directory_option, json_option, print_json
from zerodrift.journal import write_all
from zerodrift.ownership import MANIFEST, list_own, refuse_foreign, render_manifest


@click.command()
@click.argument("kind", type=click.Choice(["cmake", "zephyr", "arduino", "platformio"]))
@directory_option
@json_option
@changes_project
def command(kind: str, directory: Path, as_json: bool) -> None:
    """Write the model as a package into <out>/packages/KIND, in place of the one that lies there.

    Files that zerodrift did not write stay, and are never replaced.

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
    contents = {name: text.encode() for name, text in files.items()}
    contents[MANIFEST] = render_manifest(contents, package=kind, model=model.hash)
    refuse_foreign((place / name for name in contents), place)
    changes: dict[Path, bytes | None] = {
        place / name: None for name in list_own(place) if name not in contents
    }
    changes |= {place / name: content for name, content in contents.items()}
    write_all(config.directory, changes)
    shown = show_path(place, config.directory)
    written = [f"{shown}/{name}" for name in sorted(contents)]
    if as_json:
        print_json({"package": kind, "model_hash": model.hash, "files": written})
        return
    click.echo("wrote " + ", ".join(written))
