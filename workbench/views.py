"""What the page shows at a moment: one function for each group of its parts."""

from collections.abc import Sequence
from typing import Any

from dash import ctx, html, no_update

from zerodrift.workbench import panels, verdicts
from zerodrift.workbench.uploads import list_logs
from zerodrift.workbench.workplace import Workplace

NOTHING = "nothing is missing"
PREDICTORS = {"physics": "the effects alone"}


def poll(place: Workplace, version: int) -> tuple[Any, str, bool]:
    """Return the version if there is something new to show, and how the job stands."""
    place.poll()
    told = place.describe()
    job = told["job"]
    words = ""
    if job is not None:
        words = f"{job['title']}: {job['progress'] or 'starting'} ({job['seconds']} s)"
    return (told["version"] if told["version"] != version else no_update), words, job is None


def show_frame(place: Workplace) -> tuple[Any, ...]:
    """Return the start page where there is no project, and the message."""
    is_new = not place.has_project and place.findings is None
    start: list[Any] = []
    if is_new:
        logs = list_logs(place.directory)
        start = [html.Main(panels.show_start(logs, str(place.directory)))]
    elif place.findings is None:
        start = [html.Main(panels.show_waiting(place.directory.name, is_busy=place.busy))]
    message = place.message
    text = message.text if message is not None else ""
    kind = "message error" if message is not None and message.is_error else "message"
    return start, not start, place.findings is None, text, message is None, kind


def hides(place: Workplace, told: bool | None) -> bool:
    """Return whether the verdict waits for a guess."""
    return place.is_practice and not told and not place.undo_stack and place.revision is None


def show_top(place: Workplace, told: bool | None, guess: str | None) -> tuple[Any, ...]:
    """Return the head of the page: the verdict, and what can be done about it."""
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 11)
    waits = hides(place, told)
    kind, parts = verdicts.show_verdict(findings, diagnosing=place.diagnosing, hides=waits)
    addable = verdicts.list_addable(findings)
    badge = [html.Span("Simulated data", className="badge")] if findings.simulated else []
    compared = findings.told["compare"]
    effects = ", ".join(compared["effects"]) or "a constant only"
    guessed = ""
    diagnosed = findings.told["diagnose"]
    if told and guess and diagnosed is not None:
        named = addable or [NOTHING if diagnosed["verdict"] == "complete" else "unknown"]
        guessed = f"You guessed {guess}: {'so does the diagnosis' if guess in named else 'not so'}."
    model = PREDICTORS.get(compared["model"], f"effects and network ({compared['model']})")
    return (
        ["Workbench ", *badge],
        findings.sensor,
        f"Effects in the model: {effects}. What is left is what {model} leave.",
        kind,
        parts,
        not waits,
        [NOTHING, *findings.told["catalogue"]],
        guessed,
        waits,
        verdicts.show_adds(findings),
        not place.undo_stack,
    )


def list_choices(place: Workplace, told: bool | None, *now: Any) -> tuple[Any, ...]:
    """Return what can be chosen; what was chosen stays chosen as long as it is there.

    What stays is not sent: this answer may be older than what the user chose meanwhile.
    """
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 10)
    output, run, ghost, effect, present = now
    compared = findings.told["compare"]
    runs = [
        {"label": t.run + ("" if t.held_out else " (learnt from)"), "value": t.run}
        for t in findings.traces
    ]
    names = [trace.run for trace in findings.traces]
    worst = compared["worst"][0] if compared["worst"] else None
    ghosts = [] if hides(place, told) else list(place.previews)
    kinds = [term["name"] for term in findings.told["model"]["terms"]]
    others = list(findings.told["catalogue"])
    return (
        list(findings.outputs),
        _keep(output, findings.outputs, worst["output"] if worst else findings.outputs[0]),
        runs,
        _keep(run, names, worst["run"] if worst else names[0]),
        ghosts,
        _keep(ghost, ghosts),
        others,
        _keep(effect, others),
        kinds,
        _keep(present, kinds),
    )


def _keep(value: str | None, choices: Sequence[str], otherwise: str | None = None) -> Any:
    """Return what to choose where what is chosen is not there any more."""
    return no_update if value in choices or value == otherwise else otherwise


def show_sections(place: Workplace, told: bool | None) -> tuple[Any, ...]:
    """Return the sections below the chart."""
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 9)
    candidates: Any = html.P("Guess first.", className="note")
    if not hides(place, told):
        candidates = verdicts.show_candidates(findings, place.previews)
    revision, outcome = place.revision, place.outcome
    return (
        panels.show_revision(revision) if revision is not None else [],
        revision is None,
        panels.show_tiles(findings),
        candidates,
        panels.show_staircase(findings),
        panels.show_errors(findings),
        panels.show_model(findings),
        panels.show_outcome(outcome) if outcome is not None else [],
        panels.show_firmware(findings),
    )


def tell_effect(place: Workplace, effect: str | None, told: bool | None) -> tuple[Any, bool]:
    """Return all that is known about the effect that was chosen in the list of effects."""
    findings = place.findings
    if findings is None or effect is None or hides(place, told):
        return [], True
    parts = verdicts.show_effect(findings, effect)
    return [html.H3(effect), *parts], not parts


def choose_ghost() -> Any:
    """Return the effect whose button was pressed, to be drawn over what is left."""
    if not ctx.triggered or not ctx.triggered[0]["value"]:
        return no_update
    return ctx.triggered_id["effect"]
