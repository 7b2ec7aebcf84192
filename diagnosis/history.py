"""The history of a model: every effect added or removed, with the held-out errors it brought.

`build/history.json` is only ever appended to. It holds no dates, so that the same steps on the same
logs give the same bytes.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zerodrift.base.errors import InputError
from zerodrift.base.sealed import read_sealed, render_sealed
from zerodrift.diagnosis.changes import name_effect
from zerodrift.diagnosis.revision import Revision, describe_revision

FORMAT = 2
UNSEALED = 1
"""Format of files without a hash, which earlier versions wrote."""
FILE_NAME = "history.json"
SAME = 1e-3
"""Relative difference of errors below which a step continues where the last one ended."""

SIGNS = {"add": "+", "change": "~", "remove": "-"}

Errors = Mapping[str, float]
"""Output -> held-out RMSE in its unit."""


@dataclass(frozen=True)
class Entry:
    """One change of the model."""

    action: str
    """add | change | remove."""
    effect: str
    """With its thermometer where it is not the chip's: `thermal_lag[body_temperature]`."""
    effects: tuple[str, ...]
    """All effects after the change."""
    before: Errors
    after: Errors
    noise_floor: Errors
    noise_floor_source: str
    units: Mapping[str, str]
    held_out: str
    """test logs | leave one run out | blocks of one run."""
    helps: bool
    reason: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Of the effect that was added, as in `add --json`."""
    effects_before: tuple[str, ...] = ()
    tared: bool = False
    """Whether each run's own offset is taken off the errors."""

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as it stands in the file."""
        return {
            "action": self.action,
            "effect": self.effect,
            "effects_before": list(self.effects_before),
            "effects": list(self.effects),
            "before": {"rmse_heldout": dict(self.before)},
            "after": {"rmse_heldout": dict(self.after)},
            "noise_floor": dict(self.noise_floor),
            "noise_floor_source": self.noise_floor_source,
            "units": dict(self.units),
            "held_out": self.held_out,
            "tared": self.tared,
            "helps": self.helps,
            "reason": self.reason,
            "parameters": dict(self.parameters),
        }


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

    def ratio(self) -> float | None:
        """Return the error over the floor, root mean square over the outputs; None without one."""
        ratios = [
            (self.errors[name] / floor) ** 2
            for name, floor in self.noise_floor.items()
            if floor > 0.0 and name in self.errors
        ]
        return (sum(ratios) / len(ratios)) ** 0.5 if ratios else None


def record(revision: Revision) -> Entry:
    """Return the entry of a change."""
    told = describe_revision(revision)
    return Entry(
        action=revision.change.action,
        effect=name_effect(revision.change.effect),
        effects=tuple(fitted.term.name for fitted in revision.after.model.terms),
        before=told["before"]["rmse_heldout"],
        after=told["after"]["rmse_heldout"],
        noise_floor=told["noise_floor"],
        noise_floor_source=told["noise_floor_source"],
        units=told["units"],
        held_out=told["held_out"],
        helps=revision.helps,
        reason=revision.reason,
        parameters=told["parameters"],
        effects_before=tuple(fitted.term.name for fitted in revision.before.model.terms),
        tared=revision.tared,
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
    if content["format"] == FORMAT:
        try:
            read_sealed(text)
        except ValueError as error:
            raise _explain_damage(str(path), f"cannot be believed: {error}") from error
    entries = content.get("entries")
    if not isinstance(entries, list):
        raise _explain_damage(str(path), "has no list of entries")
    return tuple(_read_entry(path, number, entry) for number, entry in enumerate(entries, 1))


def _read_entry(path: Path, number: int, entry: Any) -> Entry:
    try:
        errors = [
            {str(name): float(value) for name, value in part.items()}
            for part in (
                entry["before"]["rmse_heldout"],
                entry["after"]["rmse_heldout"],
                entry["noise_floor"],
            )
        ]
        if errors[0].keys() != errors[1].keys():
            raise KeyError("rmse_heldout")
        return Entry(
            action=str(entry["action"]),
            effect=str(entry["effect"]),
            effects=tuple(str(name) for name in entry["effects"]),
            before=errors[0],
            after=errors[1],
            noise_floor=errors[2],
            noise_floor_source=str(entry["noise_floor_source"]),
            units={str(name): str(unit) for name, unit in entry["units"].items()},
            held_out=str(entry["held_out"]),
            helps=bool(entry["helps"]),
            reason=str(entry["reason"]),
            parameters=dict(entry["parameters"]),
            effects_before=tuple(str(name) for name in entry["effects_before"]),
            tared=bool(entry["tared"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        what = f"has no usable {error}" if isinstance(error, KeyError) else f"is damaged ({error})"
        raise _explain_damage(f"{path}: entry {number}", what) from error


def _explain_damage(where: str, what: str) -> InputError:
    return InputError(
        f"{where}: {what}; expected the history that `zerodrift add` writes. Restore the file, or "
        "move it away to begin a new history."
    )


def render_history(entries: Sequence[Entry]) -> bytes:
    """Return a history file."""
    return render_sealed({"format": FORMAT, "entries": [entry.to_dict() for entry in entries]})


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
                elif entry.tared and not tared:
                    reason = "from here on each run's own offset is taken off"
                    label = "same model"
            steps.append(
                Step(
                    label,
                    entry.before,
                    entry.noise_floor,
                    entry.units,
                    entry.effects_before,
                    reason,
                )
            )
        tared = entry.tared
        sign = SIGNS.get(entry.action, "?")
        steps.append(
            Step(
                f"{sign} {entry.effect}",
                entry.after,
                entry.noise_floor,
                entry.units,
                entry.effects,
                entry.reason,
            )
        )
    return tuple(steps)


def _continues(step: Step, entry: Entry) -> bool:
    """Return whether an entry begins where the last step ended."""
    return (
        step.errors.keys() == entry.before.keys()
        and set(step.effects) == set(entry.effects_before)
        and all(
            abs(entry.before[name] - error) <= SAME * max(abs(error), 1e-300)
            for name, error in step.errors.items()
        )
    )
