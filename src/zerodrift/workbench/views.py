"""What the page shows at a moment: one function for each group of its parts."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

from dash import html, no_update
from dash.development.base_component import Component

from zerodrift.base.errors import InputError
from zerodrift.base.records import to_dict
from zerodrift.codegen.application import write_snippet
from zerodrift.diagnosis.history import find_timeline
from zerodrift.discovery.summary import explain_plan
from zerodrift.report import tables
from zerodrift.report.cause import name_effect
from zerodrift.report.findings import Findings
from zerodrift.report.pictures import draw_error_budget, draw_programme, draw_remainder
from zerodrift.report.results import ApplyResult, PlanResult, ProposeResult, TrainResult
from zerodrift.report.sentences import explain_black_boxes
from zerodrift.verify.summary import FirmwareSummary, LogsRefused, VerifySummary
from zerodrift.workbench import panels, recordings, units
from zerodrift.workbench.chart import choose_first
from zerodrift.workbench.early import WAITING, read_head, tell_project
from zerodrift.workbench.panels import show_picture, show_table
from zerodrift.workbench.path import BUSY, DONE, NEXT, Offer, ProjectStanding, ProjectWay, find_path
from zerodrift.workbench.uploads import list_logs
from zerodrift.workbench.workplace import Outcome, Workplace

# The way from logs to a report as the page shows it: its steps, and the one thing to do now.

SIGNS = {DONE: "✓", NEXT: "→", BUSY: "…"}
WORDS = {DONE: " (done)", NEXT: " (next)", BUSY: " (being done)"}
"""For those who hear the page."""


def describe_standing(place: Workplace) -> ProjectStanding:
    """Return what is known of a project, as far as the way goes."""
    return ProjectStanding(
        findings=place.findings,
        job=find_job(place),
        refused=dict(place.refused),
        proposed="propose" in place.done,
        planned="plan" in place.done,
        verified="verify" in place.done,
        applied="apply" in place.done,
        reported="report" in place.done,
    )


def find_job(place: Workplace) -> str:
    """Return what runs and has to be waited for; curves that follow a verdict do not count."""
    job, findings = place.job, place.findings
    if job is None or not job.running:
        return ""
    is_told = findings is not None and findings.diagnosed is not None and not place.outdated
    return "" if job.name == "look" and is_told else job.name


def show_way(place: Workplace) -> list[Component]:
    """Return the steps, the next one with its reason, and what else there is."""
    path = find_path(describe_standing(place))
    steps = [
        html.Li(
            [
                html.Span(SIGNS.get(step.state, "○"), className="sign", **{"aria-hidden": "true"}),
                html.B(step.title),
                html.Span(WORDS.get(step.state, ""), className="hidden"),
                html.Span(step.found, className="found"),
            ],
            className=step.state,
        )
        for step in path.steps
    ]
    return [html.Ol(steps, className="way"), html.Div(_show_now(path), className="now")]


def _show_now(path: ProjectWay) -> list[Component]:
    parts: list[Component] = []
    if path.weak:
        parts.append(html.P(f"Weak evidence: {path.weak}.", className="weak"))
    buttons = [make_offer(path.offer, primary=True)] if path.offer is not None else []
    buttons += [make_offer(offer) for offer in path.others]
    parts.append(html.P(path.reason, className="reason"))
    parts.append(html.Div(buttons, className="adds", id="adds"))
    return parts


def make_offer(offer: Offer, *, primary: bool = False) -> Component:
    """Return what is offered as a button, or as a link where it is a download."""
    kind = "primary" if primary else ""
    if offer.button == "download":
        return html.A(offer.words, href="/firmware.zip", download="", className=f"button {kind}")
    more = {"data-effect": offer.effect} if offer.effect else {}
    return html.Button(offer.words, className=kind, **{"data-press": offer.button, **more})


# What a command that leaves the model as it is found: training, firmware, formula, report.


def show_outcome(outcome: Outcome) -> list[Component]:
    """Return what the last command found, in a sentence or a few."""
    if isinstance(outcome, VerifySummary):
        return _show_verified(outcome)
    if isinstance(outcome, FirmwareSummary):
        return _show_built(outcome)
    if isinstance(outcome, LogsRefused):
        return _show_refused_logs(outcome)
    if isinstance(outcome, ProposeResult):
        return _show_proposed(outcome)
    if isinstance(outcome, PlanResult):
        return _show_planned(outcome)
    if isinstance(outcome, ApplyResult):
        return _show_applied(outcome)
    if isinstance(outcome, TrainResult):
        rmse = ", ".join(
            f"{n} {tables.write_number(o.held_out.rmse)} {o.unit}"
            for n, o in outcome.outputs.items()
        )
        kept = "with a network" if outcome.network else "without a network"
        return [html.P(f"Trained {kept}; held-out RMSE: {rmse}.")]
    return [
        html.P(
            [
                "Report written: ",
                html.A("open report.html", href="/report.html", target="_blank"),
                " or ",
                html.A("download it", href="/report.html", download="report.html"),
                ".",
            ]
        )
    ]


def _show_applied(outcome: ApplyResult) -> list[Component]:
    lines = []
    for log in outcome.logs:
        drifts = ", ".join(
            f"{name} {tables.write_number(o.rms_drift)} {o.unit}" for name, o in log.outputs.items()
        )
        lines.append(
            f"Applied to {log.log}, {log.steps} steps, into {log.file}. RMS drift: {drifts}."
        )
    return [html.P(line) for line in lines]


def _show_verified(outcome: VerifySummary) -> list[Component]:
    equal = "equal in every bit" if outcome.bit_exact else "DIFFERENT"
    backends = " = ".join(outcome.backends)
    lines = [f"Verified: {equal} over {outcome.vectors} steps on {backends}."]
    lines += [finding.text for finding in (*outcome.changed, *outcome.stale)]
    lines += [f"{f.name} in the header is not the model's." for f in outcome.header]
    lines += outcome.failures
    lines += [f"Not checked: {n.what} ({n.why})." for n in outcome.not_checked]
    return [html.P(line) for line in lines]


def _show_built(outcome: FirmwareSummary) -> list[Component]:
    if not outcome.written:
        lines = [f"Refused, nothing was written: {one.text}" for one in outcome.refused]
        return [html.P(line, className="standing") for line in lines]
    equal = "bit-exact" if outcome.bit_exact else "DIFFERENT"
    return [
        html.P(
            f"Built: flash {outcome.flash_bytes} B, RAM {outcome.ram_bytes} B, stack "
            f"{outcome.stack_bytes} B on {outcome.core}; {equal} over {outcome.vectors} steps."
        )
    ]


def _show_refused_logs(outcome: LogsRefused) -> list[Component]:
    entries = dict.fromkeys(f'"{one.run}: {one.kind}"' for one in outcome.refused)
    return [
        *(
            html.P(f"Refused, nothing was written: {one.text}.", className="standing")
            for one in outcome.refused
        ),
        html.P(
            [
                "Mend the logs, or leave the runs out. If they are right as they are, say so in"
                " zerodrift.toml: ",
                html.Code(f"[logs] accept = [{', '.join(entries)}]"),
            ]
        ),
    ]


def _show_uncertainty(findings: Findings) -> list[Component]:
    if not findings.uncertainty:
        return []
    return [show_table(tables.tabulate_uncertainty(findings.uncertainty), folded=True)]


def _show_proposed(outcome: ProposeResult) -> list[Component]:
    if not outcome.found:
        nearest = f" Nearest: {outcome.nearest}." if outcome.nearest else ""
        told = [html.P(f"No formula was found: {outcome.reason}.{nearest}")]
        return told + [html.P(line, className="note") for line in explain_black_boxes(outcome)]
    units = {name: error.unit for name, error in outcome.rmse_left_out.items()}
    errors = ", ".join(
        f"{name} {tables.write_number(e.before)} to {tables.write_number(e.after)} {e.unit}"
        for name, e in outcome.rmse_left_out.items()
    )
    file = f"{outcome.kind}.py"
    commands = f"zerodrift propose --write {file} && zerodrift add {file}"
    return [
        html.P([html.Code(outcome.formula), f" ({outcome.physics})"], className="standing"),
        html.P(f"RMSE on runs left out: {errors}."),
        show_picture(draw_remainder(outcome.curves, units)),
        *[html.P(told, className="note") for told in explain_black_boxes(outcome)],
        html.P(f"To confirm it: {outcome.next_experiment}", className="note"),
        html.P(["To use it as an effect of your own: ", html.Code(commands)], className="note"),
    ]


def _show_planned(outcome: PlanResult) -> list[Component]:
    """Return a programme as a picture, what it is expected to tell, and where its files are."""
    told = [html.P(line) for line in explain_plan(outcome, Path())]
    notes = [html.P(line, className="note") for line in outcome.notes]
    return [show_picture(draw_programme(outcome)), *told, *notes]


def is_refused(outcome: Outcome | None) -> bool:
    """Tell whether the last command's outcome says why no firmware was written."""
    if isinstance(outcome, FirmwareSummary):
        return not outcome.written
    return isinstance(outcome, LogsRefused)


def show_firmware(findings: Findings, outcome: Outcome | None = None) -> list[Component]:
    """Return the last firmware where it is current: to take away, to use, and what it rests on.

    Args:
        findings: hold the firmware, or why there is none.
        outcome: what the last command found; reasons that it shows are not told twice.
    """
    firmware, certificate = findings.firmware, findings.certificate
    if firmware is None and is_refused(outcome):
        return []
    if firmware is None:
        return [html.P(findings.firmware_note, className="note")]
    compared = findings.comparison
    note = [html.P(findings.firmware_note, className="note")] if findings.firmware_note else []
    said = [f"Built by force, though refused: {one.text}" for one in firmware.refused]
    said += [f"Warning: {one.text}" for one in firmware.warnings]
    return [
        *note,
        *(html.P(line, className="standing") for line in said),
        *_show_delivery(firmware),
        show_picture(draw_error_budget(firmware, compared)),
        show_table(tables.tabulate_budget(firmware, compared), folded=True),
        show_table(tables.tabulate_chip_error(firmware), folded=True),
        *_show_uncertainty(findings),
        show_table(tables.tabulate_firmware(firmware)),
        *(
            [show_table(tables.tabulate_certificate(certificate), folded=True)]
            if certificate
            else []
        ),
    ]


def _show_delivery(firmware: FirmwareSummary) -> list[Component]:
    """Return the download, what to add to a build, and the lines that call it."""
    sources = [name for name in firmware.files if name.endswith(".c")]
    headers = [name for name in firmware.files if name.endswith(".h")]
    folders = dict.fromkeys(str(PurePosixPath(name).parent) for name in headers)
    download = html.A(
        "Download the firmware (zip)",
        href="/firmware.zip",
        download="",
        className="button primary",
        id="download",
    )
    return [
        html.P([download]),
        html.P(
            f"To flash: add {', '.join(sources)} to the build of your own program, with the "
            f"folder {', '.join(folders)} and its {len(headers)} headers on the include path. It "
            f"is C99 without heap or libm, and needs {firmware.flash_bytes} B of flash, "
            f"{firmware.ram_bytes} B of RAM for each sensor and {firmware.stack_bytes} B of stack "
            f"on {firmware.core}."
        ),
        html.Div(
            [
                html.Pre(
                    write_snippet(firmware.files, tuple(firmware.units)), id="snippet", tabIndex="0"
                ),
                html.Button("Copy", **{"data-copy": "snippet"}),
            ],
            className="snippet",
        ),
    ]


# What the page shows at a moment: one function for each group of its parts.

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
    kind, parts = panels.show_verdict(findings, diagnosing=place.diagnosing, hides=waits)
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
        [] if waits else show_way(place),
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
        show_way(place),
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
        candidates = panels.show_candidates(findings, place.previews)
    outcome = place.outcome
    return (
        candidates,
        panels.show_staircase(findings),
        panels.show_errors(findings, hides=waits),
        panels.show_model(findings),
        show_outcome(outcome) if outcome is not None else [],
        show_firmware(findings, outcome),
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
    parts = panels.show_effect(findings, effect)
    return [html.H3(effect), *parts], not parts
