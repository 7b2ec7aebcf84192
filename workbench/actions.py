"""What the page's buttons do: each runs a command, as a user would type it."""

import shlex
from typing import Any

from dash import ctx, no_update

from zerodrift.workbench.uploads import list_logs
from zerodrift.workbench.workplace import Workplace

PRACTICE_EFFECT = "zero_tempco"
TITLES = {
    "train": "Training",
    "firmware": "Building firmware",
    "verify": "Verifying",
    "report": "Writing the report",
}


def find_form(place: Workplace, kind: str) -> list[str]:
    """Return the options with which the diagnosis proposed an effect; none for another one."""
    told = (place.findings.told.get("diagnose") if place.findings else None) or {}
    commands = [told.get("command"), *(t["command"] for t in told.get("thermometers", ()))]
    for command in commands:
        words = shlex.split(command or "")
        if words[2:3] == [kind]:
            return words[3:]
    return []


def add(place: Workplace, kind: str, *, force: bool) -> None:
    """Add an effect, in the form in which the diagnosis found it."""
    options = [*find_form(place, kind), *(["--force"] if force else [])]
    place.run("add", f"Adding {kind}", ["add", kind, "--json", *options])


def press(
    place: Workplace, effect: str | None, present: str | None, force: list[str] | None
) -> Any:
    """Do what a button says.

    Args:
        place: the project.
        effect: chosen among those that can be added.
        present: chosen among those in the model.
        force: holds a word where an effect is to be kept whether it helps or not.
    """
    button = ctx.triggered_id
    if not ctx.triggered or not ctx.triggered[0]["value"]:
        return no_update
    if isinstance(button, dict):
        add(place, button["effect"], force=bool(force))
    elif button == "add-chosen":
        if not effect:
            place.tell("Choose an effect to add.", is_error=False)
        else:
            add(place, effect, force=bool(force))
    elif button == "remove":
        if not present:
            place.tell("Choose the effect to remove.", is_error=False)
        else:
            kind, _, signal = present.partition("[")
            options = ["--set", f"signal={signal.rstrip(']')}"] if signal else []
            place.run("remove", f"Removing {present}", ["remove", kind, "--json", *options])
    elif button in ("undo", "look", "cancel", "dismiss"):
        {
            "undo": place.undo,
            "look": place.look,
            "cancel": place.cancel,
            "dismiss": place.dismiss,
        }[button]()
    else:
        options = ["--no-diagnose"] if button == "report" else []
        place.run(button, TITLES[button], [button, "--json", *options])
    return no_update


def begin(place: Workplace) -> Any:
    """Begin a project: from the logs in the directory, or from simulated ones."""
    if not ctx.triggered or not ctx.triggered[0]["value"]:
        return no_update
    if ctx.triggered_id == "begin":
        logs = [str(place.directory / name) for name in list_logs(place.directory)]
        place.run("init", "Guessing columns", ["init", *logs, "--json"])
    else:
        told = ["--told", PRACTICE_EFFECT, "--mystery", "1", "--seed", str(draw_seed())]
        place.run("twin", "Simulating a sensor", ["twin", *told, "--json"])
    return no_update


def draw_seed() -> int:
    """Return a seed that nobody knows, for a practice case."""
    import secrets

    return secrets.randbelow(1_000_000)
