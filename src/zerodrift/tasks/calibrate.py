"""`calibrate`: the calibration matrix from converter codes and test weights."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from zerodrift.base.arrays import Array
from zerodrift.base.config import load_config
from zerodrift.base.csv_text import mark_frame
from zerodrift.base.errors import InputError, nearest
from zerodrift.base.files import show_path
from zerodrift.base.journal import write_all
from zerodrift.base.progress import SILENT, Progress
from zerodrift.calibration.files import (
    render_header,
    render_json,
    render_toml,
    summarise_calibration,
)
from zerodrift.calibration.matrix import CalibrationMatrix, fit_calibration
from zerodrift.dataset.checks import (
    explain_invalid_row,
    find_invalid_rows,
    locate_row,
    widen_plausible,
)
from zerodrift.dataset.selectors import list_files
from zerodrift.dataset.tables import Source, open_source, read_table
from zerodrift.report.results import CalibrateResult
from zerodrift.tasks.project import ProjectFolder

# Calibration logs: converter codes and reference loads of one log, checked.

CODE_COLUMNS = tuple(f"adc_{number}" for number in range(1, 7))
REFERENCE_PREFIX = "ref_"
TEMPERATURE = "temperature_degC"
CONVERTER_BITS = (8, 10, 12, 14, 16, 18, 20, 24)
LONGEST_STUCK = 20
"""Equal extreme codes in a row, in a column that otherwise moves, are a rail."""


@dataclass(frozen=True)
class CalibrationLog:
    """One calibration log."""

    label: str
    """How messages name the file."""
    codes: Array
    """[n, C] converter codes."""
    loads: Array
    """[n, K] reference loads, each in its own unit."""
    temperature_degC: Array | None
    """[n]; None when the log has no such column."""
    dropped: int
    """Rows that held no numbers and were left out."""


def list_references(source: Source) -> tuple[str, ...]:
    """Return the columns of a log whose names begin with `ref_`."""
    return tuple(name for name in source.names if name.startswith(REFERENCE_PREFIX))


def read_calibration_log(
    path: Path,
    label: str,
    code_columns: Sequence[str],
    references: Sequence[str],
    skip_invalid: bool = False,
) -> CalibrationLog:
    """Read and check one calibration log.

    Args:
        path: the log, CSV or Parquet.
        label: how messages name it.
        code_columns: the converter's columns.
        references: the columns of the reference loads.
        skip_invalid: leave out rows that hold no numbers instead of raising.

    Raises:
        InputError: a column is missing, holds no numbers, never moves, or sits at a rail.
    """
    source = open_source(path, label, {})
    for name in code_columns:
        if name not in source.names:
            raise InputError(_explain_missing(source, name))
    needed = dict.fromkeys(code_columns, "--adc") | dict.fromkeys(references, "--reference")
    temperature = TEMPERATURE if TEMPERATURE in source.names else None
    if temperature is not None:
        needed[temperature] = "the temperature"
    table = read_table(source, needed, run_column=False)
    temperatures = {} if temperature is None else {temperature: widen_plausible(None)}
    invalid = find_invalid_rows(table, temperatures)
    dropped = 0
    if invalid is not None:
        dropped = int(invalid.sum())
        if not skip_invalid or dropped == len(table):
            raise explain_invalid_row(table, invalid, temperatures)
        table.take(~invalid)
    codes = np.stack([table.columns[name] for name in code_columns], axis=1)
    for name, column in zip(code_columns, codes.T, strict=True):
        row = find_saturated_row(column)
        if row is not None:
            place = locate_row(source, table.position(row))
            count = int(np.sum(column == column[row]))
            raise InputError(
                f"{place.text}: {name} is saturated at {column[row]:.0f} ({count} of "
                f"{column.size} rows); expected codes within the converter's range. Use lighter "
                "weights or less gain, or leave these rows out."
            )
    return CalibrationLog(
        label=label,
        codes=codes,
        loads=np.stack([table.columns[name] for name in references], axis=1),
        temperature_degC=None if temperature is None else table.columns[temperature],
        dropped=dropped,
    )


def _explain_missing(source: Source, name: str) -> str:
    names = [known for known in source.names if not known.startswith("\0")]
    place = f"{source.label}:1" if source.is_csv else source.label
    return (
        f"{place}: there is no column '{name}'{nearest(name, names) or '.'} Found: "
        f"{', '.join(names[:16])}{', ...' if len(names) > 16 else ''}; expected the converter's "
        f"codes in {', '.join(CODE_COLUMNS)}, or the columns named by --adc."
    )


def find_saturated_row(codes: Array) -> int | None:
    """Return the first row at which a column of codes [n] sits at a rail; None = nowhere.

    A rail is an end of a converter's range of 8 to 24 bits that the column never passes, met more
    than once in a row, or an extreme code that stands for `LONGEST_STUCK` rows in a column that
    moves from row to row elsewhere.
    """
    if codes.size < 2:
        return None
    for extreme, is_high in ((codes.max(), True), (codes.min(), False)):
        at = codes == extreme
        longest, begin = _find_longest(at)
        ends = {2.0**bits - 1.0 for bits in CONVERTER_BITS} if is_high else {0.0}
        ends |= {2.0 ** (b - 1) - 1.0 if is_high else -(2.0 ** (b - 1)) for b in CONVERTER_BITS}
        moves = float(np.mean(np.diff(codes) != 0)) > 0.3
        if (longest > 1 and float(extreme) in ends and codes.max() > codes.min()) or (
            moves and longest >= LONGEST_STUCK
        ):
            return begin
    return None


def _find_longest(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> tuple[int, int]:
    """Return the length and the first row of the longest stretch of true values."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    longest = int(np.argmax(ends - begins))
    return int(ends[longest] - begins[longest]), int(begins[longest])


# `calibrate`: the calibration matrix from converter codes and test weights.

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
    first = open_source(paths[0], show_path(paths[0], directory), {})
    chosen = request.references or list_references(first)
    if not chosen:
        raise InputError(
            f"{first.label}:1: no column begins with ref_; expected the loads of the test weights "
            "such as ref_Fz_N. Name them by --reference."
        )
    read = []
    for path in paths:
        progress(f"reading {path.name} ...")
        label = show_path(path, directory)
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
    written = tuple(show_path(target, directory) for target in texts)
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
        label = show_path(path, directory)
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
