"""`zerodrift apply`: the finished model over any log, as the chip would."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.app.commands.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    skip_invalid_option,
)
from zerodrift.app.commands.console import open_console, open_table, show_progress
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json

if TYPE_CHECKING:
    from zerodrift.app.apply import PredictFloat
    from zerodrift.base.config import Config
    from zerodrift.export.integer_model import IntegerModel
    from zerodrift.report.results import ApplyResult
    from zerodrift.verify.uncertainty import Uncertainty

KINDS = INTEGER, FLOAT = ("integer", "float")


@click.command()
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@directory_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    metavar="FILE",
    help="File, .csv or .parquet, or a directory for several logs (default: LOG_compensated beside "
    "you, in the log's own format).",
)
@click.option(
    "--model",
    "kind",
    type=click.Choice(KINDS),
    default=INTEGER,
    show_default=True,
    help="The chip's integers, or the float model they were made from.",
)
@json_option
@skip_invalid_option
def command(
    logs: tuple[Path, ...],
    directory: Path,
    out: Path | None,
    kind: str,
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Run the model of the last `firmware` over LOG... and write what it gives for every row.

    Each output gains OUTPUT_drift, OUTPUT_compensated (measured less drift) and OUTPUT_uncertainty
    (expanded, k = 2), in its unit; `flags` are the chip's. A log needs no reference. Rows without a
    reading are given to the chip as such.
    """
    from zerodrift.app.apply import apply_model, choose_file
    from zerodrift.base.config import load_config
    from zerodrift.export.model_files import load_model
    from zerodrift.report.results import ApplyResult

    config = load_config(directory)
    model = load_model(config.build_directory / "model.json")
    _refuse_other(config, model)
    uncertainty, why = read_uncertainty(config, model)
    notes = ([why] if why else []) + _list_stale(config)
    pairs = [(log, choose_file(log, out, len(logs) > 1)) for log in logs]
    _refuse_same(pairs)
    predict = _open_float(config) if kind == FLOAT else None
    with show_progress("applying") as say:
        applied = apply_model(
            config,
            model,
            pairs,
            uncertainty=uncertainty,
            predict_float=predict,
            skip_invalid=skip_invalid,
            say=say,
        )
    told = ApplyResult(kind, model.hash, tuple(applied), tuple(notes))
    if as_json:
        print_result(told)
        return
    print_notes((*told.notes, *(note for log in applied for note in log.notes)))
    _print(told)


def read_uncertainty(config: "Config", model: "IntegerModel") -> tuple["Uncertainty | None", str]:
    """Return the uncertainty of a model, or None and why there is none."""
    from zerodrift.app.commands.built import read_kept
    from zerodrift.verify.uncertainty import FILE_NAME, Uncertainty

    path = config.build_directory / FILE_NAME
    kept = read_kept(path)
    if kept is not None:
        try:
            found = from_json(Uncertainty, kept)
        except ValueError:
            found = None
        if found is not None and found.model_hash == model.hash:
            return found, ""
    if path.exists():
        return None, (
            f"no uncertainty is stated: {path.name} in build/ is damaged, or of another model; "
            "`zerodrift firmware` writes it again"
        )
    return None, (
        "no uncertainty is stated: it comes from models that leave a training run out, which "
        "`zerodrift firmware` fits for effects and lag bank, not for other networks"
    )


def _list_stale(config: "Config") -> list[str]:
    """Return what has changed since the firmware was built."""
    from zerodrift.verify.manifest import check_manifest

    check = check_manifest(config)
    return [finding.text for finding in check.findings]


def _refuse_other(config: "Config", model: "IntegerModel") -> None:
    names = tuple(output.name for output in model.outputs)
    wanted = tuple(output.name for output in config.outputs)
    if names != wanted:
        raise InputError(
            f"{config.build_directory / 'model.json'}: has the outputs {', '.join(names)}; "
            f"{config.path} has {', '.join(wanted)}. Run `zerodrift firmware`."
        )


def _refuse_same(pairs: list[tuple[Path, Path]]) -> None:
    """Refuse to write over a log, over another's answer, or over what is no answer."""
    from zerodrift.app.apply import FLAGS

    taken: dict[Path, Path] = {}
    logs = {log.resolve() for log, _ in pairs}
    for log, out in pairs:
        place = out.resolve()
        if place in logs:
            raise InputError(f"{out}: is a log itself; expected another file. Name it by --out.")
        if place in taken:
            raise InputError(
                f"{out}: would hold {taken[place]} and {log}; expected a file for each. Apply the "
                "model to one at a time, with --out."
            )
        taken[place] = log
        if out.exists() and FLAGS.encode() not in out.read_bytes()[:65536]:
            head_only = out.suffix.lower() in (".csv", ".tsv", ".txt")
            if head_only:
                raise InputError(
                    f"{out}: is there and was not written by `zerodrift apply`; expected a new "
                    "file. Move it, or name another by --out."
                )


def _open_float(config: "Config") -> "PredictFloat":
    """Return the float model's prediction, loads as the chip knows them."""
    from zerodrift.app.commands.project import open_project
    from zerodrift.export.compose import describe_compensator
    from zerodrift.physics.catalogue import load_catalogue
    from zerodrift.train.compensator import Compensator

    _, dataset = open_project(config.directory)
    compensator = Compensator.load(config.build_directory, load_catalogue(config.plugin_files))
    return describe_compensator(compensator, config, dataset.train).predict_on_chip


def _print(told: "ApplyResult") -> None:
    console = open_console()
    for log in told.logs:
        table = open_table(
            f"{log.log}: {log.rows} rows, {log.steps} steps",
            ("output", "unit"),
            ("RMS drift", "largest drift", "uncertainty (k = 2)"),
        )
        for name, output in log.outputs.items():
            expanded = "-" if output.uncertainty is None else f"{output.uncertainty:.2g}"
            table.add_row(
                name,
                output.unit,
                f"{output.rms_drift:.4g}",
                f"{output.largest_drift:.4g}",
                expanded,
            )
        console.print(table)
        for text, count in log.flags.items():
            console.print(f"flag at {count} of {log.steps} steps: {text}")
        console.print(f"wrote {log.file}")
