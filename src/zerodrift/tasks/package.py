"""`package`: the model as a package of a build system."""

from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.files import MANIFEST, list_own, refuse_foreign, render_manifest, show_path
from zerodrift.base.journal import write_all
from zerodrift.base.progress import SILENT, Progress
from zerodrift.codegen.packages import render_package
from zerodrift.export.model_files import load_model
from zerodrift.report.results import PackageResult
from zerodrift.tasks.project import ProjectFolder, hold_own, refuse_shared_program
from zerodrift.tasks.trust import require_place
from zerodrift.verify.manifest import check_manifest
from zerodrift.verify.replay import read_code

KINDS = ("cmake", "zephyr", "arduino", "platformio", "esp-idf", "pico", "python", "ros2")


@dataclass(frozen=True)
class PackageRequest:
    """Which package is wanted."""

    project: ProjectFolder
    kind: str
    """One of `KINDS`."""


@dataclass(frozen=True)
class PackageOutcome:
    """A package that was written."""

    result: PackageResult
    folder: str
    """Seen from the project."""
    names: tuple[str, ...]
    """Its files, seen from the folder."""


def write_package(request: PackageRequest, progress: Progress = SILENT) -> PackageOutcome:
    """Write the C of the firmware folder as a package, in place of the one that lies there.

    Raises:
        CheckError: a file of the firmware was changed or is missing, or it is stale.
        InputError: no firmware was built, or files that zerodrift did not write are in the way.
    """
    kind, project = request.kind, request.project
    with hold_own(project.directory):
        refuse_shared_program(project)
        config = project.config
        require_place(config.firmware_out, config.directory)
        shown = show_path(config.firmware_out, config.directory)
        for one in check_manifest(config).require(f"{shown}/").not_checked:
            progress.note(f"not checked: {one.what}: {one.why}")
        model = load_model(config.build_directory / "model.json")
        code = read_code(model, config.firmware_out)
        if code.design is not None:
            raise InputError(
                "a program that takes its coefficients from a block has no package yet: where the"
                f" block lies in flash is the application's to say. Add the files of {shown}/ to"
                ' your build, or set [firmware] coefficients = "constants".'
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
    folder, names = show_path(place, config.directory), tuple(sorted(contents))
    written = tuple(f"{folder}/{name}" for name in names)
    return PackageOutcome(PackageResult(kind, model.hash, written), folder, names)
