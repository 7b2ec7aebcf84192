"""What `add` and `remove` share: writing a change, and printing it."""

import os
from collections.abc import Callable
from pathlib import Path

from zerodrift.base.config import Config, EffectConfig, parse_config
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.toml_edit import add_effect, add_plugin, remove_effect, set_parameters
from zerodrift.cli.console import open_console, open_table
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.changes import (
    ADD,
    CHANGE,
    name_effect,
    propose_forms,
    propose_removal,
)
from zerodrift.diagnosis.history import FILE_NAME, Entry, load_history, record, render_history
from zerodrift.diagnosis.revision import Revision, revise, revise_best, summarise_revision
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.summary import describe_coefficients, describe_parameters


def read_text(path: Path) -> str:
    """Return the text of zerodrift.toml with its own line ends.

    Raises:
        InputError: it may not be written; found out before anything is computed.
    """
    if not path.stat().st_mode & 0o222 or not os.access(path, os.W_OK):
        raise InputError(
            f"{path}: is read-only; expected a file that may be edited. Make it writable "
            "(chmod u+w), or edit the effects by hand."
        )
    return path.read_bytes().decode("utf-8")


def open_history(config: Config) -> tuple[Path, tuple[Entry, ...]]:
    """Return the path of the project's history, and its entries.

    Raises:
        InputError: the history is damaged.
    """
    path = config.build_directory / FILE_NAME
    return path, load_history(path)


def write_revision(config: Config, before: str, text: str, revision: Revision) -> None:
    """Write zerodrift.toml and append to the history, both or neither.

    Args:
        config: the project.
        before: the text of zerodrift.toml that the revision was computed from.
        text: its new text.
        revision: the change and its errors.

    Raises:
        InputError: one of them cannot be written, or zerodrift.toml was edited meanwhile; neither
            is changed.
    """
    # The edited text must describe the fitted effects, not only parse.
    written = [
        (e.kind, dict(e.held), dict(e.options)) for e in parse_config(text, config.path).effects
    ]
    wanted = [(e.kind, dict(e.held), dict(e.options)) for e in revision.change.effects]
    if written != wanted:
        raise InputError(
            f"{config.path}: its layout is not understood well enough to edit it; expected "
            "[[effect]] tables with one key to a line. Edit the effects by hand."
        )
    if read_text(config.path) != before:
        raise InputError(
            f"{config.path}: was edited while this command computed; expected it to stay as it was"
            " read. Nothing was written; run the command again."
        )
    path, entries = open_history(config)
    history = render_history([*entries, record(revision, config.effects)])
    write_all(config.directory, {path: history, config.path: text.encode()})


def add_to_project(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    wanted: EffectConfig,
    *,
    force: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[Revision, bool]:
    """Add an effect to zerodrift.toml where that helps; return the change, and whether it is kept.

    Args:
        config: the project; files of effects that zerodrift.toml does not name yet come with it.
        dataset: its runs.
        catalogue: the known effects.
        wanted: the effect, with its held parameters.
        force: keep it even if runs left out are not predicted better.
        say: called with a description of each stage of the work.

    Raises:
        InputError: the effect is unknown, cannot be fitted, or is in the model already and no
            richer form of it helps.
    """
    changes = propose_forms(config, dataset, catalogue, wanted)
    text = text_with_files = read_text(config.path)
    for file in config.plugin_files[len(parse_config(text, config.path).plugin_files) :]:
        home = config.path.parent
        name = (file.relative_to(home) if file.is_relative_to(home) else file).as_posix()
        text_with_files = add_plugin(text_with_files, name, path=config.path)
    texts_after = [
        add_effect(text_with_files, wanted.kind, c.effect.held, wanted.options, path=config.path)
        if c.action == ADD
        else set_parameters(text_with_files, c.place, c.effect.held, path=config.path)
        for c in changes
    ]
    open_history(config)
    say(f"fitting without and with {wanted.kind}")
    revision = revise_best(config, dataset, catalogue, changes)
    text_after = texts_after[changes.index(revision.change)]
    is_richer = revision.change.action == CHANGE and not wanted.held
    if is_richer and not revision.helps and not force:
        raise InputError(
            f"{config.path}: effect '{wanted.kind}' is in the model already, and no richer form of "
            f"it helps: {revision.reason}. Expected one that is not; `zerodrift diagnose` names "
            "what is missing."
        )
    is_kept = revision.helps or force
    if is_kept:
        write_revision(config, text, text_after, revision)
    return revision, is_kept


def remove_from_project(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    effect: str,
    signal: str = "",
    say: Callable[[str], None] = lambda _: None,
) -> Revision:
    """Remove an effect from zerodrift.toml and return the change of the errors.

    Raises:
        InputError: the model has no such effect, or has it for several thermometers.
    """
    change = propose_removal(config, effect, signal)
    text = read_text(config.path)
    text_after = remove_effect(text, change.place, path=config.path)
    open_history(config)
    say(f"fitting with and without {effect}")
    revision = revise(config, dataset, catalogue, change)
    write_revision(config, text, text_after, revision)
    return revision


def print_revision(revision: Revision) -> None:
    """Print the errors before and after, and the fitted parameters."""
    console = open_console()
    model = revision.after.model
    table = open_table(
        f"Held-out RMSE ({revision.after.held_out.method})",
        ("output", "unit"),
        ("before", "after", "after/before", "noise floor", "x floor"),
    )
    for k, name in enumerate(model.outputs):
        before, after = float(revision.before.rmse[k]), float(revision.after.rmse[k])
        floor = float(revision.floor.rms[k])
        table.add_row(
            name,
            model.units[k],
            f"{before:.4g}",
            f"{after:.4g}",
            f"{after / before:.3f}" if before > 0.0 else "-",
            f"{floor:.4g}",
            f"{after / floor:.2f}" if floor > 0.0 else "-",
        )
    console.print(table)
    notes = [revision.after.held_out.explain(), revision.floor.explain()]
    if revision.before.has_outliers:
        pairs = zip(
            model.outputs,
            model.units,
            revision.before.steady_rmse,
            revision.after.steady_rmse,
            strict=True,
        )
        told = ", ".join(f"{n} {one:.4g} to {two:.4g} {unit}" for n, unit, one, two in pairs)
        notes.append(f"the table's errors are those of all rows; without outliers: {told}")
    summary = summarise_revision(revision)
    if (tested := summary.explain_test()) is not None:
        notes.append(tested)
    anew = summary.explain_offsets()
    if anew is not None:
        notes.append(anew)
    elif revision.tared:
        notes.append("each run's own offset is taken off, as the logs are zeroed one by one")
    for note in notes:
        console.print(f"{note[0].upper()}{note[1:]}.")
    _print_parameters(revision)
    for note in model.notes:
        console.print(f"note: {note}.")


def _print_parameters(revision: Revision) -> None:
    """Print the parameters of all effects, and the coefficients of the new one."""
    console = open_console()
    model = revision.after.model
    table = open_table("Parameters", ("effect", "parameter", "unit", ""), ("value", "std error"))
    for fitted in model.terms:
        for name, told in describe_parameters(fitted).items():
            remark = "held" if told.held else "at its bound" if told.at_bound else ""
            table.add_row(
                fitted.term.name,
                name,
                told.unit,
                remark,
                f"{told.value:.4g}",
                _write_error(told.std_error),
            )
    if table.row_count:
        console.print(table)
    term = revision.term
    rows = describe_coefficients(model, term) if term is not None else []
    if not rows:
        return
    table = open_table(
        f"Coefficients of {name_effect(revision.change.effect)}",
        ("feature", "output", "unit"),
        ("value", "std error"),
    )
    for row in rows:
        table.add_row(
            row.feature,
            row.output,
            row.unit,
            f"{row.value:.4g}",
            _write_error(row.std_error),
        )
    console.print(table)


def _write_error(error: float | None) -> str:
    """Return a standard error; a dash where there is none."""
    return "-" if error is None else f"{error:.2g}"
