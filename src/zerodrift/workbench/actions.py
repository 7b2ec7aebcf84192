"""What the page's buttons do: each runs a command, as a user would type it."""

from collections.abc import Callable, Mapping

from zerodrift.base.errors import InputError
from zerodrift.workbench.recordings import COMPARE, DISMISS, RECOVER, USE
from zerodrift.workbench.uploads import list_logs
from zerodrift.workbench.workplace import Workplace

PRACTICE_EFFECT = "zero_tempco"
MOST_DIGITS = 9
APPLIED = "applied"
"""Folder for what `apply` writes from the page."""
PLANNED = "plan.csv"
"""In build/: the programme, its protocols beside it."""
PLAN_BUDGET_S = 30
TITLES = {
    "propose": "Looking for a formula",
    "plan": "Planning the next experiment",
    "train": "Training",
    "firmware": "Building firmware",
    "verify": "Verifying",
    "report": "Writing the report",
}

RECORDED = {
    COMPARE: ("", ""),
    DISMISS: ("", ""),
    USE: ("--use", "Adding the recorded log"),
    RECOVER: ("--recover", "Finishing the recorded log"),
}
"""Button of a recording -> option of `record`, and what is then being done."""


def find_form(place: Workplace, kind: str) -> list[str]:
    """Return the options with which the diagnosis proposed an effect; none for another one."""
    explained = place.findings.diagnosed if place.findings else None
    if explained is None:
        return []
    commands = (explained.command, *(other.command for other in explained.thermometers))
    return next((list(c.options) for c in commands if c is not None and c.kind == kind), [])


def add(place: Workplace, kind: str, *, force: bool) -> None:
    """Add an effect, in the form in which the diagnosis found it."""
    options = [*find_form(place, kind), *(["--force"] if force else [])]
    place.run("add", f"Adding {kind}", ["add", kind, "--json", *options])


def press(place: Workplace, button: str, chosen: Mapping[str, object]) -> None:
    """Do what a button says.

    Args:
        place: the project.
        button: which one.
        chosen: of the page at that moment: `effect` on the button or in the list of those that can
            be added (on a recording's button its log), `present` in the list of those in the model,
            and `force` where an effect is to be kept whether it helps or not.

    Raises:
        InputError: there is no such button.
    """
    effect, present = chosen.get("effect"), chosen.get("present")
    force = bool(chosen.get("force"))
    simple: dict[str, Callable[[], object]] = {
        "undo": place.undo,
        "redo": place.redo,
        "look": place.look,
        "chip": place.load_chip,
        "cancel": place.cancel,
        "dismiss": place.dismiss,
        "begin": lambda: begin(place),
        "practise": lambda: practise(place),
    }
    if button in ("add", "add-chosen"):
        if not effect:
            place.tell("Choose an effect to add.", is_error=False)
        else:
            add(place, str(effect), force=force)
    elif button == "remove":
        if not present:
            place.tell("Choose the effect to remove.", is_error=False)
        else:
            kind, _, signal = str(present).partition("[")
            options = ["--set", f"signal={signal.rstrip(']')}"] if signal else []
            place.run("remove", f"Removing {present}", ["remove", kind, "--json", *options])
    elif button == "restore":
        step = str(chosen.get("step", ""))
        place.restore(int(step) if step.isdigit() and len(step) < MOST_DIGITS else -1)
    elif button == "apply":
        apply(place)
    elif button in RECORDED:
        follow_recording(place, button, str(effect or ""))
    elif button in TITLES:
        place.run(button, TITLES[button], [button, "--json", *list_options(place, button)])
    elif button in simple:
        simple[button]()
    else:
        known = ("add", "add-chosen", "remove", "restore", "apply", *RECORDED, *TITLES, *simple)
        expected = ", ".join(known)
        raise InputError(f"{button!r}: is no button of the page; expected one of {expected}.")


def follow_recording(place: Workplace, button: str, file: str) -> None:
    """Do what a button of a recording says.

    Raises:
        InputError: the page shows no recording of that log.
    """
    place.recordings.check(file)
    if button == COMPARE:
        place.look()
    elif button == DISMISS:
        place.forget_recording(file)
    else:
        option, title = RECORDED[button]
        place.run(button, title, ["record", option, file])


def list_options(place: Workplace, button: str) -> list[str]:
    """Return what the page asks of a command beside its result."""
    if button == "plan":
        file = place.directory / "build" / PLANNED
        return ["--budget", str(PLAN_BUDGET_S), "--out", str(file)]
    return ["--no-diagnose"] if button == "report" else []


def apply(place: Workplace) -> None:
    """Run the finished model over the test logs, or those it learnt from, as the chip would."""
    findings = place.findings
    files = findings.provenance.files if findings is not None else ()
    logs = [f.file for f in files if f.use == "test"] or [f.file for f in files if "train" in f.use]
    if not logs:
        place.tell("There is no log to apply the model to.", is_error=False)
        return
    paths = [str(place.directory / log) for log in logs]
    out = str(place.directory / "build" / APPLIED)
    place.run("apply", "Applying the model", ["apply", *paths, "--out", out, "--json"])


def begin(place: Workplace) -> None:
    """Begin a project from the logs in the directory."""
    logs = [str(place.directory / name) for name in list_logs(place.directory)]
    place.run("init", "Guessing columns", ["init", *logs, "--json"])


def practise(place: Workplace) -> None:
    """Begin a project from simulated logs with something hidden in them."""
    told = ["--told", PRACTICE_EFFECT, "--mystery", "1", "--seed", str(draw_seed())]
    place.run("twin", "Simulating a sensor", ["twin", *told, "--json"])


def draw_seed() -> int:
    """Return a random seed for a practice case."""
    import secrets

    return secrets.randbelow(1_000_000)
