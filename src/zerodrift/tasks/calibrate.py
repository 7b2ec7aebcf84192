"""`calibrate`: the calibration matrix from converter codes and test weights."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from zerodrift.base.config import load_config
from zerodrift.base.csv_text import mark_frame
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.progress import SILENT, Progress
from zerodrift.calibration.files import (
    render_header,
    render_json,
    render_toml,
    summarise_calibration,
)
from zerodrift.calibration.matrix import CalibrationMatrix, fit_calibration
from zerodrift.dataset.checks import explain_invalid_row, find_invalid_rows
from zerodrift.dataset.codes import (
    CODE_COLUMNS,
    find_saturated_row,
    list_references,
    read_calibration_log,
)
from zerodrift.dataset.selectors import list_files
from zerodrift.dataset.tables import open_source, read_table
from zerodrift.report.results import CalibrateResult
from zerodrift.tasks.project import ProjectFolder

SUFFIXES = (".toml", ".json", ".h")


@dataclass(frozen=True)
class CalibrateRequest:
    """What is read, fitted and written; files are seen from the project's folder."""

    project: ProjectFolder
    """Need not hold a zerodrift.toml."""
    logs: tuple[str, ...]
    """Files, folders or globs."""
    channels: tuple[str, ...] = ()
    """Columns of converter codes; none: adc_1 to adc_6."""
    references: tuple[str, ...] = ()
    """Columns of reference loads; none: all that begin with ref_."""
    squares: bool = False
    """Use the squares of the codes too."""
    offset_per_log: bool = False
    """Give every log an offset of its own."""
    files: tuple[Path, ...] = ()
    """Files to be written, of the formats in `SUFFIXES`."""
    name: str = "sensor"
    """Prefix of the names in a header."""
    targets: tuple[str, ...] = ()
    """Further logs, whose codes are turned into loads."""
    out: Path | None = None
    """Directory for those."""
    force: bool = False
    """Overwrite logs there."""


@dataclass(frozen=True)
class CalibrateOutcome:
    """A calibration that was fitted and written."""

    result: CalibrateResult
    fitted: CalibrationMatrix


def calibrate(request: CalibrateRequest, progress: Progress = SILENT) -> CalibrateOutcome:
    """Find the matrix that turns converter codes into loads, by least squares.

    Raises:
        InputError: a log cannot be read, the weights leave a direction out, or a file is in the
            way.
    """
    if bool(request.targets) != (request.out is not None):
        raise InputError("calibrate: --apply and --out belong together; give both or neither.")
    for file in request.files:
        if file.suffix.lower() not in SUFFIXES:
            raise InputError(f"{file}: expected a name that ends in {', '.join(SUFFIXES)}.")
    channels = request.channels or CODE_COLUMNS
    directory = request.project.directory
    paths = find_logs(request.logs, directory)
    first = open_source(paths[0], _label(paths[0], directory), {})
    chosen = request.references or list_references(first)
    if not chosen:
        raise InputError(
            f"{first.label}:1: no column begins with ref_; expected the loads of the test weights "
            "such as ref_Fz_N. Name them by --reference."
        )
    read = []
    for path in paths:
        progress(f"reading {path.name} ...")
        label = _label(path, directory)
        read.append(
            read_calibration_log(path, label, channels, chosen, request.project.skip_invalid)
        )
    progress("fitting ...")
    fitted = fit_calibration(
        [log.codes for log in read],
        [log.loads for log in read],
        channels,
        [column.removeprefix("ref_") for column in chosen],
        squares=request.squares,
        offset_per_log=request.offset_per_log,
        temperatures=[log.temperature_degC for log in read],
    )
    progress("writing ...")
    texts = {
        directory / file: render_as(fitted, file, request.name, directory) for file in request.files
    }
    notes = [f"{log.label}: dropped {log.dropped} row(s)" for log in read if log.dropped]
    notes += fitted.notes
    if request.out is not None:
        applied, clipped = render_applied(fitted, find_logs(request.targets, directory), directory)
        notes += clipped
        there = [file for file in applied if (directory / request.out / file).exists()]
        if there and not request.force:
            raise InputError(
                f"{directory / request.out / there[0]}: exists already; name another directory"
                " by --out, or overwrite with --force."
            )
        texts |= {directory / request.out / file: text for file, text in applied.items()}
    write_all(directory, {target: text.encode() for target, text in texts.items()})
    told = replace(summarise_calibration(fitted), notes=tuple(notes))
    written = tuple(_label(target, directory) for target in texts)
    return CalibrateOutcome(CalibrateResult(**vars(told), files=written), fitted)


def find_logs(names: Sequence[str], directory: Path) -> list[Path]:
    """Return the logs of these names, which are files, folders or globs below the directory.

    Raises:
        InputError: a name matches no file.
    """
    found: list[Path] = []
    for name in names:
        path = directory / name
        if path.is_dir():
            matches = list_files(path)
        elif path.exists():
            matches = [path]
        else:
            matches = sorted(directory.glob(name)) if not Path(name).is_absolute() else []
        if not matches:
            raise InputError(
                f"{path}: no file matches; expected a log, a folder of logs or a glob such as "
                "'adc/weights_*.csv'."
            )
        found += [match for match in matches if match not in found]
    return found


def _label(path: Path, directory: Path) -> str:
    return str(path.relative_to(directory)) if path.is_relative_to(directory) else str(path)


def read_full_scale(directory: Path) -> dict[str, float]:
    """Return the full scale of every measured column, where the directory is a project."""

    if not (directory / "zerodrift.toml").exists():
        return {}
    return {output.measured: output.full_scale for output in load_config(directory).outputs}


def render_as(fitted: CalibrationMatrix, path: Path, name: str, directory: Path) -> str:
    """Return a calibration in the format that a file's suffix names."""

    suffix = path.suffix.lower()
    if suffix == ".toml":
        return render_toml(fitted)
    if suffix == ".json":
        return render_json(fitted)
    if suffix == ".h":
        return render_header(fitted, name, read_full_scale(directory))
    raise InputError(f"{path}: expected a name that ends in {', '.join(SUFFIXES)}.")


def render_applied(
    fitted: CalibrationMatrix, paths: Sequence[Path], directory: Path
) -> tuple[dict[str, str], list[str]]:
    """Return logs with loads in place of codes, by file name, and notes on codes at a rail."""
    texts: dict[str, str] = {}
    notes = []
    for path in paths:
        label = _label(path, directory)
        source = open_source(path, label, {})
        table = read_table(source, dict.fromkeys(fitted.channels, "--adc"), run_column=False)
        invalid = find_invalid_rows(table, {})
        if invalid is not None:
            raise explain_invalid_row(table, invalid, {})
        codes = np.stack([table.columns[name] for name in fitted.channels], axis=1)
        for name, column in zip(fitted.channels, codes.T, strict=True):
            if find_saturated_row(column) is not None:
                notes.append(f"{label}: {name} sits at a rail; the loads there are clipped")
        loads = fitted.apply(codes)
        frame = source.scan().drop("_row").collect()
        names = [name for name in frame.columns if name not in fitted.channels]
        place = next(k for k, name in enumerate(frame.columns) if name in fitted.channels)
        if clash := [name for name in fitted.outputs if name in names]:
            raise InputError(
                f"{label}:1: the log holds '{clash[0]}' beside the codes already; expected codes "
                "and references alone. Take the column out, or use the log as it is."
            )
        added = [
            pl.Series(name, np.round(loads[:, k], 4) + 0.0) for k, name in enumerate(fitted.outputs)
        ]
        kept = frame.select(names)
        before = sum(name not in fitted.channels for name in frame.columns[:place])
        columns = kept.get_columns()
        whole = pl.DataFrame([*columns[:before], *added, *columns[before:]])
        texts[f"{path.stem}.csv"] = mark_frame(whole).write_csv()
    return texts, notes
