"""What changes the model: an effect more, one less, or a step of the history again."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from zerodrift.base.config import Config, EffectConfig, parse_config
from zerodrift.base.errors import InputError
from zerodrift.base.journal import hold_project, write_all, write_text
from zerodrift.base.progress import SILENT, Progress
from zerodrift.base.toml_edit import add_effect, add_plugin, remove_effect, set_parameters
from zerodrift.diagnosis.changes import ADD, CHANGE, propose_forms, propose_removal
from zerodrift.diagnosis.history import (
    FILE_NAME,
    Entry,
    Step,
    list_settings,
    list_steps,
    load_history,
    record,
    record_restored,
    render_history,
)
from zerodrift.diagnosis.revision import Revision, revise, revise_best, summarise_revision
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.report.page import render_page
from zerodrift.report.pictures import draw_stairs
from zerodrift.report.results import AddResult, HistoryResult, RemoveResult
from zerodrift.tasks.project import ProjectFolder, hold_own, open_project, tell_design
from zerodrift.tasks.trust import remember

SUFFIX = ".py"
"""Of a file of effects that stands in the place of an effect: `add my_effect.py`."""
LAYOUT = (
    "its layout is not understood well enough to edit it; expected [[effect]] tables with one key"
    " to a line. Edit the effects by hand."
)


@dataclass(frozen=True)
class AddRequest:
    """Which effect the model is to have."""

    project: ProjectFolder
    effect: str
    """Its name, or a file of one effect."""
    held: Mapping[str, float] = field(default_factory=dict)
    """Parameter -> the value it is held at."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Such as the thermometer that it follows, `signal`."""
    force: bool = False
    """Keep it even if runs left out are not predicted better."""


@dataclass(frozen=True)
class RemoveRequest:
    """Which effect the model is to have no more."""

    project: ProjectFolder
    effect: str
    signal: str = ""
    """Of which thermometer, where the model has it for several."""


@dataclass(frozen=True)
class AddOutcome:
    """A change of the model by one effect more, kept or not."""

    result: AddResult
    revision: Revision
    notes: tuple[str, ...]


@dataclass(frozen=True)
class RemoveOutcome:
    """A change of the model by one effect less."""

    result: RemoveResult
    revision: Revision
    notes: tuple[str, ...]


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
        raise InputError(f"{config.path}: {LAYOUT}")
    if read_text(config.path) != before:
        raise InputError(
            f"{config.path}: was edited while this command computed; expected it to stay as it was"
            " read. Nothing was written; run the command again."
        )
    path, entries = open_history(config)
    history = render_history([*entries, record(revision, config.effects)])
    write_all(config.directory, {path: history, config.path: text.encode()})


def add(request: AddRequest, progress: Progress = SILENT) -> AddOutcome:
    """Add an effect to zerodrift.toml where that helps, and refit all effects together.

    Raises:
        InputError: the effect is unknown, cannot be fitted, or is in the model already and no
            richer form of it helps.
    """
    project = request.project
    with hold_own(project.directory):
        config, dataset = open_project(project, progress)
        config, catalogue, kind = open_effect(config, request.effect)
        wanted = EffectConfig(kind, dict(request.held), dict(request.options))
        changes = propose_forms(config, dataset, catalogue, wanted)
        text = text_with_files = read_text(config.path)
        for file in config.plugin_files[len(parse_config(text, config.path).plugin_files) :]:
            home = config.path.parent
            name = (file.relative_to(home) if file.is_relative_to(home) else file).as_posix()
            text_with_files = add_plugin(text_with_files, name, path=config.path)
        texts_after = [
            add_effect(text_with_files, kind, c.effect.held, wanted.options, path=config.path)
            if c.action == ADD
            else set_parameters(text_with_files, c.place, c.effect.held, path=config.path)
            for c in changes
        ]
        open_history(config)
        progress(f"fitting without and with {kind}")
        revision = revise_best(config, dataset, catalogue, changes)
        is_richer = revision.change.action == CHANGE and not wanted.held
        if is_richer and not revision.helps and not request.force:
            raise InputError(
                f"{config.path}: effect '{kind}' is in the model already, and no richer form of it"
                f" helps: {revision.reason}. Expected one that is not; `zerodrift diagnose` names"
                " what is missing."
            )
        is_kept = revision.helps or request.force
        if is_kept:
            write_revision(config, text, texts_after[changes.index(revision.change)], revision)
    result = AddResult(**vars(summarise_revision(revision)), added=is_kept)
    design = tell_design(config, project.sensor) if is_kept else ()
    return AddOutcome(result, revision, (*dataset.notes, *design))


def remove(request: RemoveRequest, progress: Progress = SILENT) -> RemoveOutcome:
    """Remove an effect from zerodrift.toml, and refit the others together.

    Raises:
        InputError: the model has no such effect, or has it for several thermometers.
    """
    project = request.project
    with hold_own(project.directory):
        config, dataset = open_project(project, progress)
        change = propose_removal(config, request.effect, request.signal)
        text = read_text(config.path)
        text_after = remove_effect(text, change.place, path=config.path)
        open_history(config)
        progress(f"fitting with and without {request.effect}")
        revision = revise(config, dataset, project.catalogue, change)
        write_revision(config, text, text_after, revision)
    result = RemoveResult(**vars(summarise_revision(revision)))
    return RemoveOutcome(result, revision, (*dataset.notes, *tell_design(config, project.sensor)))


def open_effect(config: Config, named: str) -> tuple[Config, Catalogue, str]:
    """Return the project, its known effects, and the name of the one that is meant.

    Of a file it is the one that the file declares, and the project is one that has the file among
    its own; `zerodrift.toml` is not changed by this.

    Args:
        config: the project.
        named: an effect, or a file of effects, seen from the current directory or the project's.

    Raises:
        InputError: there is no such file, it cannot be run, or it declares several effects.
    """
    if not named.endswith(SUFFIX):
        return config, load_catalogue(config.plugin_files), named
    file = next((p for p in (Path(named), config.directory / named) if p.is_file()), None)
    if file is None:
        raise InputError(
            f"{named}: there is no such file of effects, here or beside {config.path}. `zerodrift"
            f" propose --write {Path(named).name}` writes a formula as one."
        )
    known = next((p for p in config.plugin_files if p.resolve() == file.resolve()), None)
    place = config.path.parent / _name_in_project(config, file) if known is None else known
    if known is None:
        config = replace(config, plugin_files=(*config.plugin_files, place))
    catalogue = load_catalogue(config.plugin_files)
    declared = [effect.kind for effect in catalogue.listed() if effect.file == str(place)]
    if len(declared) != 1:
        raise InputError(
            f"{named}: declares {len(declared)} effects, {', '.join(declared)}; expected one, as"
            " one is added at a time. Name the file under [plugins] files, then add them by name."
        )
    remember((file,))
    return config, catalogue, declared[0]


def _name_in_project(config: Config, file: Path) -> str:
    """Return how zerodrift.toml names a file: seen from there if it lies below, else whole."""
    whole, home = file.resolve(), config.directory.resolve()
    return (whole.relative_to(home) if whole.is_relative_to(home) else whole).as_posix()


@dataclass(frozen=True)
class HistoryRequest:
    """What is to be done with the staircase of errors beside showing it."""

    project: ProjectFolder
    restore: int | None = None
    """The step whose effects are written back into zerodrift.toml."""
    html: Path | None = None
    """Where a page with the picture is written."""


@dataclass(frozen=True)
class HistoryOutcome:
    """The staircase of errors so far."""

    steps: tuple[Step, ...]
    path: Path
    """Of the history."""
    restored: str
    """What became of `restore`, in words; "" where it was not asked for."""
    notes: tuple[str, ...]

    @property
    def result(self) -> HistoryResult:
        """As the command prints it."""
        return HistoryResult(tuple(step.summarise() for step in self.steps))


def show_history(request: HistoryRequest) -> HistoryOutcome:
    """Return every effect that was added or removed, with the errors it brought.

    Raises:
        InputError: the history is damaged, or the step cannot be restored.
    """
    config, directory = request.project.config, request.project.directory
    restored = ""
    if request.restore is not None:
        with hold_project(directory):
            restored = _restore_step(config, request.restore)
    path, entries = open_history(config)
    steps = list_steps(entries)
    if request.html is not None:
        title = f"{config.sensor_name}: history of the model"
        reasons = [f"{step.label}: {step.reason}" for step in steps if step.reason]
        write_text(request.html, render_page(title, [draw_stairs(steps)], reasons), directory)
    notes = tell_design(config, request.project.sensor) if restored else ()
    return HistoryOutcome(steps, path, restored, notes)


def _restore_step(config: Config, number: int) -> str:
    """Write the effects of a step into zerodrift.toml and append an entry to the history; return a
    sentence on it.

    Raises:
        InputError: there is no such step, it kept no settings, or the file cannot be edited.
    """
    path, entries = open_history(config)
    steps = list_steps(entries)
    if number >= len(steps):
        known = f"steps 0 to {len(steps) - 1}" if steps else "none yet"
        raise InputError(
            f"--restore {number}: there is no such step in {path} ({known}); expected one that "
            "`zerodrift history` lists."
        )
    step = steps[number]
    if step.effects and not step.settings:
        raise InputError(
            f"--restore {number}: step '{step.label}' was made by hand or by an older version, "
            f"which kept no settings; expected a step that has them. Its effects were "
            f"{', '.join(step.effects)}: write them into {config.path} by hand."
        )
    before = text = read_text(config.path)
    # Effects that the step has too stay as they are written, comments included.
    missing = list(step.settings)
    for place, settings in reversed(list(enumerate(list_settings(config.effects)))):
        if settings in missing:
            missing.remove(settings)
        else:
            text = remove_effect(text, place, path=config.path)
    for effect in missing:
        text = add_effect(text, effect.kind, effect.held, effect.options, path=config.path)
    written = list(list_settings(parse_config(text, config.path).effects))
    if sorted(written, key=repr) != sorted(step.settings, key=repr):
        raise InputError(f"{config.path}: {LAYOUT}")
    if text == before:
        return (
            f"{config.path} has the effects of step {number} ({step.label}) already; nothing"
            " was written"
        )
    entry = record_restored(steps, number, config.effects)
    write_all(
        config.directory, {path: render_history([*entries, entry]), config.path: text.encode()}
    )
    return (
        f"restored the effects of step {number} ({step.label}); `zerodrift firmware` trains with"
        " them"
    )
