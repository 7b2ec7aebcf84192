"""What the page shows at a moment: one function for each group of its parts."""

import hashlib
import json
from collections.abc import Mapping, Sequence

from dash import html, no_update
from dash.development.base_component import Component

from zerodrift.base.errors import InputError
from zerodrift.base.records import to_dict
from zerodrift.diagnosis.timeline import find_timeline
from zerodrift.report.cause import name_effect
from zerodrift.workbench import outcomes, panels, recordings, units, verdicts, way
from zerodrift.workbench.chart import choose_first
from zerodrift.workbench.early import read_head, tell_project
from zerodrift.workbench.skeleton import WAITING
from zerodrift.workbench.uploads import list_logs
from zerodrift.workbench.workplace import Workplace

NOTHING = "nothing is missing"
NO_EFFECT = "none"
"""Chosen to have no effect drawn over what is left."""
PREDICTORS = {"physics": "the effects alone"}


Shown = tuple[object, ...]
"""Values of the page's parts, in the order in which the callback lists them."""


def poll(place: Workplace, version: int, recorded: str | None, registered: str | None) -> Shown:
    """Return the version if there is something new to show, how the job stands, the recordings,
    the units.

    Args:
        place: the project.
        version: that is shown.
        recorded: mark of the recordings that are shown.
        registered: mark of the units that are shown.
    """
    place.poll()
    now = place.describe()
    job = now.job
    words = "" if job is None else f"{job.title}: {job.progress or 'starting'} ({job.seconds} s)"
    version_now = now.version if now.version != version else no_update
    shown = (*show_recordings(place, recorded), *show_units(place, registered))
    return version_now, words, job is None, *shown


def show_recordings(place: Workplace, told: str | None) -> Shown:
    """Return the cards of the recordings, whether there are none, and their mark."""
    watched = place.recordings.look()
    mark = hashlib.sha256(repr(watched).encode()).hexdigest() if watched else ""
    if mark == (told or ""):
        return no_update, no_update, no_update
    return recordings.show_recordings(watched), not watched, mark


def show_units(place: Workplace, told: str | None) -> Shown:
    """Return the units of the registry, whether there are none, their serials, and their mark."""
    mark = place.units.mark()
    if mark == told:
        return tuple([no_update] * 4)
    seen = place.units.look()
    choices = units.list_serials(seen, place.sensor)
    return units.show_units(seen), not seen.standings, choices, mark


def show_unit(place: Workplace, chosen: Mapping[str, str] | None) -> list[Component]:
    """Return what is known of the unit that was chosen."""
    serial = (chosen or {}).get("unit")
    if not serial:
        return []
    try:
        events = place.units.tell_history(serial)
    except InputError as error:
        return [html.P(str(error), className="wrong")]
    known = {one.unit.serial: one for one in place.units.look().standings}
    return units.show_history(known.get(serial), events, serial)


def show_frame(place: Workplace) -> Shown:
    """Return the start page where there is no project, and the message.

    Where nothing could be found out the registry's units are all that is shown of the rest.
    """
    is_new = not place.has_project and place.findings is None
    is_stuck = not is_new and place.findings is None and not place.busy
    start: list[Component] = []
    if is_new:
        logs = list_logs(place.directory)
        start = [html.Main(panels.show_start(logs, str(place.directory)))]
    elif is_stuck:
        facts = tell_project(place.directory, place.sensor)
        start = [html.Main(panels.show_unknown(place.directory.name, facts))]
    message = place.message
    text = message.text if message is not None else ""
    kind = "message error" if message is not None and message.is_error else "message"
    layout = "layout single alone" if is_stuck else "layout"
    return start, not start, is_new, layout, text, message is None, kind


def hides(place: Workplace, told: bool | None) -> bool:
    """Return whether the verdict waits for a guess."""
    return place.is_practice and not told and place.revision is None


def show_top(place: Workplace, told: bool | None, picks: Mapping[str, str] | None) -> Shown:
    """Return the head of the page: the verdict, and what can be done about it.

    All that stands above the chart is here: what came later would move the chart under the pointer.
    """
    findings, guess = place.findings, (picks or {}).get("guess-choice")
    revision = place.revision
    if findings is None:
        return _show_head(place)
    waits = hides(place, told)
    kind, parts = verdicts.show_verdict(findings, diagnosing=place.diagnosing, hides=waits)
    addable = list(findings.diagnosed.named) if findings.diagnosed is not None else []
    badge = [html.Span("Simulated data", className="badge")] if findings.simulated else []
    timeline = find_timeline(findings.steps)
    effects = ", ".join(findings.comparison.effects) or "a constant only"
    guessed = ""
    explained = findings.diagnosed
    if told and guess and explained is not None:
        is_complete = explained.diagnosis.verdict == "complete"
        named = addable or [NOTHING if is_complete else "unknown"]
        guessed = f"You guessed {guess}: {'so does the diagnosis' if guess in named else 'not so'}."
    model = PREDICTORS.get(findings.predictor, f"effects and network ({findings.predictor})")
    return (
        ["Workbench ", *badge],
        findings.sensor,
        f"Effects in the model: {effects}. What is left is what {model} leave.",
        kind,
        parts,
        not waits,
        write_choices([NOTHING, *findings.catalogue]),
        guessed,
        waits,
        [] if waits else way.show_way(place),
        timeline.undo is None,
        timeline.redo is None,
        "1" if place.outdated else "",
        panels.show_tiles(findings),
        panels.show_revision(revision) if revision is not None else [],
        revision is None,
    )


def _show_head(place: Workplace) -> Shown:
    """Return the head of the page while nothing is found: its frame, and what is being done."""
    head = read_head(place.directory, place.sensor)
    if head is None:
        return tuple([no_update] * 16)
    return (
        ["Workbench "],
        head.name,
        head.subtitle,
        "verdict none",
        panels.show_reading(head.logs),
        True,
        no_update,
        "",
        False,
        way.show_way(place),
        True,
        True,
        WAITING,
        panels.show_empty_tiles(),
        [],
        True,
    )


def list_choices(place: Workplace, told: bool | None) -> Shown:
    """Return what can be chosen of output, run, ghost, effect and present, each as JSON.

    What is chosen is up to the page's script: an answer of the server may be older than the
    user's choice.
    """
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 5)
    first_output, first_run = choose_first(findings)
    runs = [(t.run + ("" if t.held_out else " (learnt from)"), t.run) for t in findings.traces]
    ghosts = [] if hides(place, told) else list(place.previews)
    kinds = [term.name for term in findings.model.terms]
    return (
        write_choices(findings.outputs, first_output),
        json.dumps({"choices": runs, "first": first_run}),
        json.dumps({"choices": [(name, name) for name in [*ghosts, NO_EFFECT]], "first": ""}),
        write_choices(list(findings.catalogue)),
        write_choices(kinds),
    )


def show_chart(place: Workplace, told: bool | None) -> Shown:
    """Return what the chart is of, so that the page's script asks for it anew; and the segments."""
    findings = place.findings
    if findings is None:
        return WAITING if place.busy else no_update, no_update
    effect = name_effect(findings)
    mark = f"{place.shown} {effect} {' '.join(place.previews)}"
    return mark, panels.show_segments(findings, hides=hides(place, told))


def write_choices(names: Sequence[str], first: str = "") -> str:
    """Return what can be chosen as the page's script reads it.

    Args:
        names: each its own words.
        first: chosen as long as the user chose nothing; nothing, where left out.
    """
    return json.dumps({"choices": [(name, name) for name in names], "first": first})


def show_sections(place: Workplace, told: bool | None) -> Shown:
    """Return the sections below the chart."""
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 9)
    candidates: Component | list[Component] = html.P("Guess first.", className="note")
    waits = hides(place, told)
    if not waits:
        candidates = verdicts.show_candidates(findings, place.previews)
    outcome = place.outcome
    return (
        candidates,
        panels.show_staircase(findings),
        panels.show_errors(findings, hides=waits),
        panels.show_model(findings),
        outcomes.show_outcome(outcome) if outcome is not None else [],
        outcomes.show_firmware(findings, outcome),
        *show_chip(place),
    )


def show_chip(place: Workplace) -> Shown:
    """Return whether there is no firmware to run in the page, words on it, and what is run."""
    firmware = place.findings.firmware if place.findings is not None else None
    if firmware is None:
        return True, "There is no current firmware; build it first.", ""
    if place.chip is None or place.chip_folder is None:
        words = "Compiles the folder's C to WebAssembly and replays the runs beside the reference."
        return False, words, ""
    words = " ".join(f"{note}." for note in place.chip.notes)
    if place.chip.model_hash != firmware.model_hash:
        words = f"This is the C of an earlier firmware. {words}"
    return False, words, json.dumps({"at": place.chip_folder.name, **to_dict(place.chip)})


def tell_effect(
    place: Workplace, picks: Mapping[str, str] | None, told: bool | None
) -> tuple[list[Component], bool]:
    """Return all that is known about the effect that was chosen in the list of effects."""
    findings, effect = place.findings, (picks or {}).get("effect")
    if findings is None or not effect or hides(place, told):
        return [], True
    parts = verdicts.show_effect(findings, effect)
    return [html.H3(effect), *parts], not parts
