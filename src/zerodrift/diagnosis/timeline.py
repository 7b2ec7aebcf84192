"""The steps of the history that undo and redo lead to, found from the history alone."""

from collections.abc import Sequence
from dataclasses import dataclass

from zerodrift.diagnosis.history import Step


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
