"""What `apply` needs: a project's finished model, and the files that it may write."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl
from polars.exceptions import PolarsError

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.progress import SILENT, Progress
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.selectors import CSV_SUFFIXES, PARQUET_SUFFIXES
from zerodrift.export.compose import describe_compensator
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.report.results import ApplyResult
from zerodrift.tasks.applied_rows import FLAGS
from zerodrift.tasks.apply import PredictFloat, apply_model
from zerodrift.tasks.built import read_uncertainty
from zerodrift.tasks.deployed_block import find_deployed_block
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.tasks.trust import require_trust
from zerodrift.train.compensator import DESCRIPTION, Compensator
from zerodrift.train.prepare import mark_inputs
from zerodrift.verify.manifest import check_manifest
from zerodrift.verify.uncertainty import Uncertainty

KINDS = INTEGER, FLOAT = ("integer", "float")


@dataclass(frozen=True)
class ApplyRequest:
    """Which logs the model is applied to."""

    project: ProjectFolder
    logs: tuple[Path, ...]
    out: Path | None = None
    """File, or a directory for several logs; None: LOG_compensated in the current directory."""
    kind: str = INTEGER
    """integer | float."""
    block: Path | None = None
    """The block on the unit; None: as the registry says, else the one written last."""


@dataclass(frozen=True)
class AppliedModel:
    """The model of the last `firmware`, or what the unit's chip computes with its block."""

    model: IntegerModel
    uncertainty: Uncertainty | None
    predict_float: PredictFloat | None
    """The float model's prediction, where it was asked for."""
    notes: tuple[str, ...]
    """Why there is no uncertainty, what has changed since the firmware was built, which block."""


def apply_to_logs(request: ApplyRequest, progress: Progress = SILENT) -> ApplyResult:
    """Run the model of the last `firmware` over logs, and write what it gives for every row.

    Raises:
        InputError: no firmware was built, a log cannot be read, or a file would be overwritten.
    """
    project = request.project
    config = project.config
    several = len(request.logs) > 1
    pairs = [(log, choose_file(log, request.out, several)) for log in request.logs]
    refuse_taken(pairs)
    whole = ProjectFolder(project.directory, project.sensor)  # no row of its own logs is left out
    opened = open_applied(
        config,
        request.kind,
        load_logs=lambda: open_project(whole, progress)[1],
        block=request.block,
        progress=progress,
    )
    progress("applying")
    applied = apply_model(
        config,
        opened.model,
        pairs,
        uncertainty=opened.uncertainty,
        predict_float=opened.predict_float,
        skip_invalid=project.skip_invalid,
        say=progress,
    )
    stated = opened.uncertainty.state() if opened.uncertainty is not None else None
    return ApplyResult(request.kind, opened.model.hash, tuple(applied), opened.notes, stated)


def open_applied(
    config: Config,
    kind: str = INTEGER,
    *,
    load_logs: Callable[[], Dataset],
    block: Path | None = None,
    progress: Progress = SILENT,
) -> AppliedModel:
    """Return the model of a project's last `firmware`; of a block design, with the unit's block.

    Args:
        config: the project.
        kind: integer | float.
        load_logs: returns the project's logs, which the float model needs.
        block: the block on the unit; None: as the registry says, else the one written last.
        progress: asks whether the project's effects may be run, which the float model needs.

    Raises:
        InputError: no firmware was built yet, it or the float model has other outputs, there is no
            such block, or `kind` is neither.
    """
    if kind not in KINDS:
        raise InputError(f"model = {kind!r}: expected one of {', '.join(KINDS)}.")
    if kind == FLOAT and block is not None:
        raise InputError(
            f"{block}: the float model takes no block; expected --model {INTEGER}, or no --block."
        )
    model = load_model(config.build_directory / "model.json")
    refuse_other(config, model, str(config.build_directory / "model.json"))
    uncertainty, why = read_uncertainty(config, model.hash)
    notes = [*([why] if why else []), *(f.text for f in check_manifest(config).findings)]
    predict = None
    if kind == FLOAT:
        require_trust(config.plugin_files, config.directory, progress)
        dataset = load_logs()
        catalogue = load_catalogue(config.plugin_files)
        trained = Compensator.load(config.build_directory, catalogue)
        if trained.physics.outputs != tuple(output.name for output in config.outputs):
            raise InputError(
                f"{config.build_directory / DESCRIPTION}: has the outputs"
                f" {', '.join(trained.physics.outputs)}; {config.path} has"
                f" {', '.join(output.name for output in config.outputs)}: it is another project's."
                " Run `zerodrift train`."
            )
        if trained.trained_from != mark_inputs(config, dataset):
            notes.append(
                f"{config.build_directory / DESCRIPTION}: was not trained from these logs and this"
                f" {config.path.name}, but from others; the float model may be another than the"
                " firmware's. `zerodrift train` trains it anew"
            )
        predict = describe_compensator(trained, config, dataset.train).predict_on_chip
    else:
        on_chip = find_deployed_block(config, block)
        if on_chip is not None:
            model = on_chip.model
            refuse_other(config, model, str(block or on_chip.note))
            notes.append(on_chip.note)
    return AppliedModel(model, uncertainty, predict, tuple(notes))


def load_nothing() -> Dataset:
    """Take the place of a project's logs, which the integer model does not need."""
    raise AssertionError("the integer model needs no logs")


def refuse_other(config: Config, model: IntegerModel, where: str) -> None:
    """Refuse a model of other outputs than the project's.

    Raises:
        InputError: names where it comes from.
    """
    names = tuple(output.name for output in model.outputs)
    wanted = tuple(output.name for output in config.outputs)
    if names != wanted:
        raise InputError(
            f"{where}: has the outputs {', '.join(names)}; {config.path} has {', '.join(wanted)}."
            " Run `zerodrift firmware`, or name the block of this sensor."
        )


def choose_file(log: Path, out: Path | None, several: bool) -> Path:
    """Return the file that a log's answer is written to.

    Args:
        log: the log.
        out: what the user named: a file, or a directory.
        several: whether there are more logs.

    Raises:
        InputError: one file is named for several logs, or its suffix belongs to no known format.
    """
    written = (*CSV_SUFFIXES, *PARQUET_SUFFIXES)
    suffix = log.suffix if log.suffix.lower() in written else ".csv"
    name = f"{log.stem}_compensated{suffix}"
    if out is None:
        return Path(name)
    if out.is_dir():
        return out / name
    if several:
        raise InputError(
            f"--out {out}: is no directory; expected one, as there are several logs. Make it first."
        )
    if out.suffix.lower() not in written:
        raise InputError(
            f"--out {out}: '{out.suffix}' stands for no format; expected .csv, .tsv or .parquet."
        )
    return out


def refuse_taken(pairs: Sequence[tuple[Path, Path]]) -> None:
    """Refuse to overwrite a log, another log's answer, or a file that `apply` did not write.

    Args:
        pairs: (log, file to be written).

    Raises:
        InputError: a file would be overwritten.
    """
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
        if out.exists() and FLAGS not in _name_columns(out):
            raise InputError(
                f"{out}: is there and was not written by `zerodrift apply`; expected a new file. "
                "Move it, or name another by --out."
            )


def _name_columns(path: Path) -> list[str]:
    """Return the columns of a file as `apply` writes them; none where it is no such file."""
    try:
        if path.suffix.lower() in PARQUET_SUFFIXES:
            return list(pl.read_parquet_schema(path))
        separator = "\t" if path.suffix.lower() == ".tsv" else ","
        head = pl.read_csv(path, separator=separator, n_rows=0, infer_schema=False)
        return head.columns
    except (PolarsError, OSError, UnicodeDecodeError):
        return []
