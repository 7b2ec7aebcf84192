"""`zerodrift calibrate`: the calibration matrix from converter codes and test weights."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click

from zerodrift.base.csv_text import mark_frame
from zerodrift.base.errors import InputError
from zerodrift.base.journal import settle_project, write_all
from zerodrift.calibration.matrix import CalibrationMatrix
from zerodrift.cli.common import (
    directory_option,
    json_option,
    packed,
    print_notes,
    print_result,
    skip_invalid_option,
)

SUFFIXES = (".toml", ".json", ".h")


def find_logs(names: Sequence[str], directory: Path) -> list[Path]:
    """Return the logs of these names, which are files, folders or globs below the directory.

    Raises:
        InputError: a name matches no file.
    """
    from zerodrift.dataset.selectors import list_files

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


def print_calibration(fitted: CalibrationMatrix) -> None:
    """Print matrix, residuals and condition number as tables."""
    from zerodrift.calibration.files import split_output
    from zerodrift.calibration.summary import summarise_calibration
    from zerodrift.cli.console import open_console, open_table

    console = open_console()
    told = summarise_calibration(fitted)
    table = open_table("Matrix, unit per code", ["output", "unit"], [*told.features, "offset"])
    for k, name in enumerate(fitted.outputs):
        entries = [f"{value:.4e}" for value in fitted.matrix[k].tolist()]
        table.add_row(*split_output(name), *entries, f"{fitted.offset[k]:.4g}")
    console.print(table)
    console.print("The offset belongs to codes at " + ", ".join(f"{c:g}" for c in told.center))
    columns = ["RMSE", "% of span", "largest", "span"]
    columns += ["RMSE held out"] if fitted.held_out is not None else []
    table = open_table("Residuals", ["output", "unit"], columns)
    for k, name in enumerate(fitted.outputs):
        row = [
            f"{fitted.rmse[k]:.4g}",
            f"{100.0 * fitted.rmse[k] / fitted.span[k]:.3f}",
            f"{fitted.largest[k]:.4g}",
            f"{fitted.span[k]:.4g}",
        ]
        if fitted.held_out is not None:
            row.append(f"{fitted.held_out[k]:.4g}")
        table.add_row(*split_output(name), *row)
    console.print(table)
    console.print(
        f"Condition number of the matrix {fitted.condition:.1f}, of the loads "
        f"{fitted.load_condition:.1f}; {fitted.rows} rows."
    )


def read_full_scale(directory: Path) -> dict[str, float]:
    """Return the full scale of every measured column, where the directory is a project."""
    from zerodrift.base.config import load_config

    if not (directory / "zerodrift.toml").exists():
        return {}
    return {output.measured: output.full_scale for output in load_config(directory).outputs}


def render_as(fitted: CalibrationMatrix, path: Path, name: str, directory: Path) -> str:
    """Return a calibration in the format that a file's suffix names."""
    from zerodrift.calibration.files import render_header, render_json, render_toml

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
    import numpy as np
    import polars as pl

    from zerodrift.dataset.checks import explain_invalid_row, find_invalid_rows
    from zerodrift.dataset.codes import find_saturated_row
    from zerodrift.dataset.tables import open_source, read_table

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


@dataclass(frozen=True)
class CalibrateOptions:
    """The options of `calibrate`: what is read, fitted and written."""

    logs: tuple[str, ...]
    channels: tuple[str, ...]
    references: tuple[str, ...]
    squares: bool
    offset_per_log: bool
    files: tuple[Path, ...]
    name: str
    targets: tuple[str, ...]
    out: Path | None
    force: bool


@click.command()
@click.argument("logs", nargs=-1, required=True)
@directory_option
@click.option(
    "--adc",
    "channels",
    multiple=True,
    help="Column of converter codes; repeat it [default: adc_1 to adc_6].",
)
@click.option(
    "--reference",
    "references",
    multiple=True,
    help="Column of a reference load; repeat it [default: all that begin with ref_].",
)
@click.option("--squares", is_flag=True, help="Use the squares of the codes too (6 x 12).")
@click.option(
    "--offset-per-log", is_flag=True, help="Give every log an offset of its own: zeros that moved."
)
@click.option(
    "--write",
    "files",
    multiple=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the calibration to FILE.toml, FILE.json or FILE.h; repeat it.",
)
@click.option("--name", default="sensor", show_default=True, help="Prefix of the names in FILE.h.")
@click.option(
    "--apply",
    "targets",
    multiple=True,
    metavar="LOG|DIR",
    help="Turn the codes of further logs into loads; repeat it.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=None,
    help="Directory for the logs of --apply.",
)
@click.option("--force", is_flag=True, help="Overwrite logs in the directory of --out.")
@skip_invalid_option
@json_option
@packed(CalibrateOptions)
def command(directory: Path, skip_invalid: bool, as_json: bool, options: CalibrateOptions) -> None:
    """Find the matrix that turns converter codes into loads, by least squares.

    LOGS hold converter codes (adc_1 to adc_6) and the loads of test weights (ref_Fx_N and so on).
    A set of weights that leaves a direction out is refused, and the direction named.
    """
    from zerodrift.calibration.matrix import fit_calibration
    from zerodrift.calibration.summary import summarise_calibration
    from zerodrift.cli.console import show_progress
    from zerodrift.dataset.codes import (
        CODE_COLUMNS,
        list_references,
        read_calibration_log,
    )
    from zerodrift.dataset.tables import open_source
    from zerodrift.report.results import CalibrateResult

    if bool(options.targets) != (options.out is not None):
        raise InputError("calibrate: --apply and --out belong together; give both or neither.")
    for file in options.files:
        if file.suffix.lower() not in SUFFIXES:
            raise InputError(f"{file}: expected a name that ends in {', '.join(SUFFIXES)}.")
    channels = options.channels or CODE_COLUMNS
    settle_project(directory)
    paths = find_logs(options.logs, directory)
    first = open_source(paths[0], _label(paths[0], directory), {})
    chosen = options.references or list_references(first)
    if not chosen:
        raise InputError(
            f"{first.label}:1: no column begins with ref_; expected the loads of the test weights "
            "such as ref_Fz_N. Name them by --reference."
        )
    with show_progress("reading ...") as tell:
        read = []
        for path in paths:
            tell(f"reading {path.name} ...")
            label = _label(path, directory)
            read.append(read_calibration_log(path, label, channels, chosen, skip_invalid))
        tell("fitting ...")
        fitted = fit_calibration(
            [log.codes for log in read],
            [log.loads for log in read],
            channels,
            [column.removeprefix("ref_") for column in chosen],
            squares=options.squares,
            offset_per_log=options.offset_per_log,
            temperatures=[log.temperature_degC for log in read],
        )
        tell("writing ...")
        texts = {
            directory / file: render_as(fitted, file, options.name, directory)
            for file in options.files
        }
        notes = [f"{log.label}: dropped {log.dropped} row(s)" for log in read if log.dropped]
        notes += fitted.notes
        if options.out is not None:
            applied, clipped = render_applied(
                fitted, find_logs(options.targets, directory), directory
            )
            notes += clipped
            there = [file for file in applied if (directory / options.out / file).exists()]
            if there and not options.force:
                raise InputError(
                    f"{directory / options.out / there[0]}: exists already; name another directory"
                    " by --out, or overwrite with --force."
                )
            texts |= {directory / options.out / file: text for file, text in applied.items()}
        write_all(directory, {target: text.encode() for target, text in texts.items()})
    print_notes(tuple(notes))
    written = [_label(target, directory) for target in texts]
    if as_json:
        told = replace(summarise_calibration(fitted), notes=tuple(notes))
        print_result(CalibrateResult(**vars(told), files=tuple(written)))
        return
    print_calibration(fitted)
    for label in written:
        click.echo(f"wrote {label}")
    if not options.files:
        click.echo("Keep it with --write calibration.toml (or .json, .h).")
