"""`zerodrift package`: the model as a package of a build system."""

from pathlib import Path

import click

from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.ownership import MANIFEST, list_own, refuse_foreign, render_manifest
from zerodrift.cli.common import (
    changes_project,
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
)

KINDS = ("cmake", "zephyr", "arduino", "platformio", "esp-idf", "pico", "python", "ros2")


@click.command()
@click.argument("kind", type=click.Choice(KINDS))
@directory_option
@sensor_option
@json_option
@changes_project
def command(kind: str, directory: Path, sensor: str | None, as_json: bool) -> None:
    """Write the model as a package into <out>/packages/KIND, in place of the one that lies there.

    Files that zerodrift did not write stay, and are never replaced.

    Takes the C and its runtime as they lie in the firmware folder, which `zerodrift firmware`
    writes once every compared bit is equal. Exit code 1: a file of it was changed or is missing, or
    it is stale.
    """
    from zerodrift.base.files import show_path
    from zerodrift.codegen.packages import render_package
    from zerodrift.export.model_files import load_model
    from zerodrift.fleet.sensors import load_unit
    from zerodrift.report.results import PackageResult
    from zerodrift.tasks.project import ProjectFolder, refuse_shared_program
    from zerodrift.tasks.trust import require_place
    from zerodrift.verify.manifest import check_manifest
    from zerodrift.verify.replay import read_code

    refuse_shared_program(ProjectFolder(directory, sensor))
    config = load_unit(directory, sensor)
    require_place(config.firmware_out, config.directory)
    check = check_manifest(config).require(f"{show_path(config.firmware_out, config.directory)}/")
    print_notes(tuple(f"not checked: {n.what}: {n.why}" for n in check.not_checked))
    model = load_model(config.build_directory / "model.json")
    code = read_code(model, config.firmware_out)
    if code.design is not None:
        raise InputError(
            "a program that takes its coefficients from a block has no package yet: where the"
            " block lies in flash is the application's to say. Add the files of"
            f" {show_path(config.firmware_out, config.directory)}/ to your build, or set [firmware]"
            ' coefficients = "constants".'
        )
    files = render_package(kind, model, code, code.runtime or {})
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
        print_result(PackageResult(kind, model.hash, tuple(written)))
        return
    tops = sorted({f"{name.split('/')[0]}/" if "/" in name else name for name in contents})
    click.echo(f"wrote {shown}: {len(contents)} files in {', '.join(tops)}")
