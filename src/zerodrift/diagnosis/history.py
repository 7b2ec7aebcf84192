"""The history of a model: every effect added or removed, with the held-out errors it brought.

`build/history.json` is only ever appended to. It holds no dates, so that the same steps on the same
logs give the same bytes.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, read_sealed, render_sealed, to_dict
from zerodrift.diagnosis.changes import name_effect
from zerodrift.diagnosis.held_out import LEAVE_ONE_RUN_OUT
from zerodrift.diagnosis.revision import Revision, summarise_revision
from zerodrift.diagnosis.summary import StepSummary, sort_errors
from zerodrift.physics.summary import FittedParameter

FORMAT = 2
UNSEALED = 1
"""Format of files without a hash, which earlier versions wrote."""
FILE_NAME = "history.json"
SAME = 1e-3
"""Relative difference of errors below which a step continues where the last one ended."""

SIGNS = {"add": "+", "change": "~", "remove": "-"}
RESTORE = "restore"

Errors = Mapping[str, float]
"""Output -> held-out RMSE in its unit."""


@dataclass(frozen=True)
class Stored:
    """Errors as they stand in the file."""

    rmse_heldout: Errors
    """Measured as the entry's `held_out` says."""


@dataclass(frozen=True)
class EffectSettings:
    """One `[[effect]]` of zerodrift.toml, to be written again."""

    kind: str
    held: Mapping[str, float] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)


def list_settings(effects: Sequence[EffectConfig]) -> tuple[EffectSettings, ...]:
    """Return what zerodrift.toml says of the effects."""
    return tuple(EffectSettings(e.kind, dict(e.held), dict(e.options)) for e in effects)


@dataclass(frozen=True)
class Entry:
    """One change of the model."""

    action: str
    """add | change | remove | restore."""
    effect: str
    """With its thermometer where it is not the chip's: `thermal_lag[body_temperature]`."""
    effects_before: tuple[str, ...]
    effects: tuple[str, ...]
    """All effects after the change."""
    before: Stored
    after: Stored
    noise_floor: Errors
    noise_floor_source: str
    units: Mapping[str, str]
    held_out: str
    """test logs | leave one run out | blocks of one run."""
    tared: bool
    """Whether each run's own offset is taken off the errors."""
    helps: bool
    reason: str
    parameters: Mapping[str, FittedParameter] = field(default_factory=dict)
    """Of the effect that was added, as in `add --json`."""
    settings_before: tuple[EffectSettings, ...] = ()
    settings: tuple[EffectSettings, ...] = ()
    """What zerodrift.toml says of each effect after the change; older entries have neither."""


@dataclass(frozen=True)
class Step:
    """One stair of the staircase: a state of the model and its held-out errors."""

    label: str
    """start, `+ creep`, `~ creep` for other values, `- creep`, or what no command did."""
    errors: Errors
    noise_floor: Errors
    units: Mapping[str, str]
    effects: tuple[str, ...]
    reason: str
    held_out: str = LEAVE_ONE_RUN_OUT
    """How the errors were measured: test logs | leave one run out | blocks of one run."""
    settings: tuple[EffectSettings, ...] = ()
    """What zerodrift.toml said of each effect; empty where it was not kept."""
    is_return: bool = False
    """Whether it is a return to an earlier step (`history --restore`)."""

    def ratio(self) -> float | None:
        """Return the error over the floor, root mean square over the outputs; None without one."""
        ratios = [
            (self.errors[name] / floor) ** 2
            for name, floor in self.noise_floor.items()
            if floor > 0.0 and name in self.errors
        ]
        return (sum(ratios) / len(ratios)) ** 0.5 if ratios else None

    def summarise(self) -> StepSummary:
        """Return the step as the command prints it."""
        errors = sort_errors(self.held_out, self.errors)
        return StepSummary(
            step=self.label,
            effects=self.effects,
            rmse_left_out=errors.rmse_left_out,
            rmse_test=errors.rmse_test,
            noise_floor=self.noise_floor,
            units=self.units,
            ratio_to_floor=self.ratio(),
            reason=self.reason,
        )


def record(revision: Revision, before: Sequence[EffectConfig]) -> Entry:
    """Return the entry of a change.

    Args:
        revision: the change, computed.
        before: the effects of zerodrift.toml before it.
    """
    told = summarise_revision(revision)
    return Entry(
        action=revision.change.action,
        effect=name_effect(revision.change.effect),
        effects_before=tuple(fitted.term.name for fitted in revision.before.model.terms),
        effects=tuple(fitted.term.name for fitted in revision.after.model.terms),
        before=Stored((told.judged_before or told.before).rmse_heldout),
        after=Stored((told.judged_after or told.after).rmse_heldout),
        noise_floor=told.noise_floor,
        noise_floor_source=told.noise_floor_source,
        units=told.units,
        held_out=told.held_out,
        tared=told.tared,
        helps=told.helps,
        reason=told.reason,
        parameters=told.parameters,
        settings_before=list_settings(before),
        settings=list_settings(revision.change.effects),
    )


def record_restored(steps: Sequence[Step], number: int, effects: Sequence[EffectConfig]) -> Entry:
    """Return the entry of a return to an earlier step; errors are those measured then.

    Args:
        steps: the staircase so far.
        number: the step that is restored.
        effects: those of zerodrift.toml before it.
    """
    last, step = steps[-1], steps[number]
    return Entry(
        action=RESTORE,
        effect=f"as step {number}",
        effects_before=last.effects,
        effects=step.effects,
        before=Stored(last.errors),
        after=Stored(step.errors),
        noise_floor=step.noise_floor,
        noise_floor_source="",
        units=step.units,
        held_out=step.held_out,
        tared=False,
        helps=True,
        reason=f"the effects of step {number} were restored; its errors are those measured then",
        settings_before=list_settings(effects),
        settings=step.settings,
    )


def load_history(path: Path) -> tuple[Entry, ...]:
    """Return the entries of a history file; none where there is no file yet.

    Raises:
        InputError: the file is damaged; it is not touched.
    """
    if not path.exists():
        return ()
    try:
        text = path.read_bytes()
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise _explain_damage(f"{path}:{error.lineno}", f"is not JSON ({error.msg})") from error
    except (OSError, ValueError, RecursionError) as error:
        raise _explain_damage(str(path), f"cannot be read ({error})") from error
    if not isinstance(content, dict) or content.get("format") not in (FORMAT, UNSEALED):
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise _explain_damage(str(path), f"is of format {found!r}, expected {FORMAT}")
    if content.get("format") == FORMAT:
        try:
            read_sealed(text)
        except ValueError as error:
            raise _explain_damage(str(path), f"cannot be believed: {error}") from error
    entries = content.get("entries")
    if not isinstance(entries, list):
        raise _explain_damage(str(path), "has no list of entries")
    return tuple(_read_entry(path, number, entry) for number, entry in enumerate(entries, 1))


def _read_entry(path: Path, number: int, entry: object) -> Entry:
    try:
        read = from_json(Entry, entry)
    except ValueError as error:
        raise _explain_damage(f"{path}: entry {number}", f"is damaged ({error})") from error
    if read.before.rmse_heldout.keys() != read.after.rmse_heldout.keys():
        what = "is damaged (rmse_heldout before and after are of other outputs)"
        raise _explain_damage(f"{path}: entry {number}", what)
    return read


def _explain_damage(where: str, what: str) -> InputError:
    return InputError(
        f"{where}: {what}; expected the history that `zerodrift add` writes. Restore the file, or "
        "move it away to begin a new history."
    )


def render_history(entries: Sequence[Entry]) -> bytes:
    """Return a history file."""
    return render_sealed({"format": FORMAT, "entries": [to_dict(entry) for entry in entries]})


def list_steps(entries: Sequence[Entry]) -> tuple[Step, ...]:
    """Return the staircase: the start, each change, and what happened without a command."""
    steps: list[Step] = []
    tared = False
    for entry in entries:
        if not steps or not _continues(steps[-1], entry):
            label, reason = "start", ""
            if steps:
                label = "by hand"
                reason = "the logs or settings changed"
                if set(entry.effects_before) != set(steps[-1].effects):
                    reason = "zerodrift.toml was edited"
                elif entry.held_out != steps[-1].held_out:
                    reason = f"from here on errors are of another kind: {entry.held_out}"
                    label = "same model"
                elif entry.tared != tared:
                    reason = "from here on each run's own offset " + (
                        "is taken off" if entry.tared else "counts"
                    )
                    label = "same model"
            steps.append(
                Step(
                    label,
                    entry.before.rmse_heldout,
                    entry.noise_floor,
                    entry.units,
                    entry.effects_before,
                    reason,
                    entry.held_out,
                    entry.settings_before,
                )
            )
        tared = entry.tared
        sign = SIGNS.get(entry.action, "?")
        label = entry.effect if entry.action == RESTORE else f"{sign} {entry.effect}"
        steps.append(
            Step(
                label,
                entry.after.rmse_heldout,
                entry.noise_floor,
                entry.units,
                entry.effects,
                entry.reason,
                entry.held_out,
                entry.settings,
                entry.action == RESTORE,
            )
        )
    return tuple(steps)


def _continues(step: Step, entry: Entry) -> bool:
    """Return whether an entry begins where the last step ended."""
    before = entry.before.rmse_heldout
    return (
        step.errors.keys() == before.keys()
        and set(step.effects) == set(entry.effects_before)
        and all(
            abs(before[name] - error) <= SAME * max(abs(error), 1e-300)
            for name, error in step.errors.items()
        )
    )


# The steps of the history that undo and redo lead to, found from the history alone.


@dataclass(frozen=True)
class Timeline:
    """Where a project stands in its history."""

    current: int | None
    """The step whose effects the model has; None without a history."""
    undo: int | None
    """The step before the last change that was not taken back; None where there is none."""
    redo: int | None
    """The step that the last undo left; None where nothing was undone since the last change."""


def find_timeline(steps: Sequence[Step]) -> Timeline:
    """Return where undo and redo lead.

    A return to the step before counts as an undo, one to the step that an undo left as a redo; any
    other return is a change like the others, which can be undone.
    """
    path: list[int] = []
    left: list[int] = []
    for number, step in enumerate(steps):
        if step.is_return and len(path) > 1 and steps[path[-2]].settings == step.settings:
            left.append(path.pop())
        elif step.is_return and left and steps[left[-1]].settings == step.settings:
            path.append(left.pop())
        else:
            path.append(number)
            left = []
    kept = [number for number in path[-2:-1] if _can_be_restored(steps[number])]
    return Timeline(
        path[-1] if path else None,
        kept[0] if kept else None,
        left[-1] if left else None,
    )


def _can_be_restored(step: Step) -> bool:
    return bool(step.settings) or not step.effects
