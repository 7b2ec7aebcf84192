"""The page: what it shows, and what its buttons do."""

import shlex
from typing import Any

import dash
from dash import Dash, Input, Output, State, ctx, html, no_update

from zerodrift.report import tables
from zerodrift.report.figures_runs import Window, draw_run, find_rows
from zerodrift.report.findings import Findings
from zerodrift.report.page import read_asset
from zerodrift.report.thin import pick_spread
from zerodrift.workbench import panels
from zerodrift.workbench.layout import PAGE, lay_out
from zerodrift.workbench.workplace import Workplace

MOST_ROWS = 100
"""Rows of the table beside the chart."""
PRACTICE_EFFECT = "zero_tempco"
NOTHING = "nothing is missing"


def make_app(workplace: Workplace) -> Dash:
    """Return the page of a project; all of its scripts and styles come from this machine."""
    app = Dash(
        "zerodrift.workbench",
        title=f"{workplace.directory.name}: zerodrift workbench",
        update_title="",
        serve_locally=True,
        suppress_callback_exceptions=True,
    )
    app.index_string = PAGE.replace("STYLE", read_asset("page.css"))
    app.layout = lay_out()
    _connect(app, workplace)
    return app


def _connect(app: Dash, place: Workplace) -> None:
    """Connect the page's parts with the workplace."""
    app.callback(
        Output("version", "data"),
        Output("job", "children"),
        Output("cancel-box", "hidden"),
        Input("tick", "n_intervals"),
        State("version", "data"),
    )(lambda _, version: poll(place, version))
    app.callback(
        Output("start", "children"),
        Output("start", "hidden"),
        Output("bench", "hidden"),
        Output("message", "children"),
        Output("message-box", "hidden"),
        Output("message-box", "className"),
        Input("version", "data"),
    )(lambda _: show_frame(place))
    app.callback(
        Output("kicker", "children"),
        Output("sensor", "children"),
        Output("subtitle", "children"),
        Output("verdict", "className"),
        Output("verdict", "children"),
        Output("guess-box", "hidden"),
        Output("guess-choice", "options"),
        Output("guess-told", "children"),
        Output("actions", "hidden"),
        Output("add", "children"),
        Output("add", "hidden"),
        Output("undo", "disabled"),
        Input("version", "data"),
        Input("guess", "data"),
        State("guess-choice", "value"),
    )(lambda _, told, guess: show_top(place, told, guess))
    app.callback(
        Output("output", "options"),
        Output("output", "value"),
        Output("run", "options"),
        Output("run", "value"),
        Output("ghost", "options"),
        Output("ghost", "value"),
        Output("effect", "options"),
        Output("effect", "value"),
        Output("present", "options"),
        Output("present", "value"),
        Input("version", "data"),
        Input("guess", "data"),
        State("output", "value"),
        State("run", "value"),
        State("ghost", "value"),
        State("effect", "value"),
        State("present", "value"),
    )(lambda _, told, *now: list_choices(place, told, *now))
    app.callback(
        Output("revision", "children"),
        Output("revision", "hidden"),
        Output("tiles", "children"),
        Output("candidates", "children"),
        Output("staircase", "children"),
        Output("errors", "children"),
        Output("model", "children"),
        Output("outcome", "children"),
        Output("firmware-told", "children"),
        Input("version", "data"),
        Input("guess", "data"),
    )(lambda _, told: show_sections(place, told))
    app.callback(
        Output("effect-told", "children"),
        Output("effect-told", "hidden"),
        Input("version", "data"),
        Input("effect", "value"),
        Input("ghost", "value"),
        Input("guess", "data"),
    )(lambda _, effect, ghost, told: tell_effect(place, effect, ghost, told))
    app.callback(
        Output("main", "figure"),
        Output("cause", "children"),
        Output("main-table", "children"),
        Output("drawn", "data"),
        Input("version", "data"),
        Input("output", "value"),
        Input("run", "value"),
        Input("ghost", "value"),
        Input("main", "relayoutData"),
        State("drawn", "data"),
    )(lambda _, *now: draw_main(place, *now))
    app.callback(
        Output("pressed", "data"),
        *[
            Input(name, "n_clicks")
            for name in (
                *("add", "undo", "look", "remove", "train", "firmware", "verify", "report"),
                *("cancel", "dismiss"),
            )
        ],
        State("add", "children"),
        State("effect", "value"),
        State("present", "value"),
        State("force", "value"),
        prevent_initial_call=True,
    )(lambda *values: press(place, *values[-4:]))
    app.callback(
        Output("begun", "data"),
        Input("begin", "n_clicks"),
        Input("practise", "n_clicks"),
        prevent_initial_call=True,
    )(lambda *_: begin(place))
    app.callback(
        Output("guess", "data"),
        Input("tell", "n_clicks"),
        prevent_initial_call=True,
    )(bool)
    app.clientside_callback(
        dash.ClientsideFunction("zerodrift", "turn"),
        Output("theme", "children"),
        Input("theme", "n_clicks"),
    )


# --- what the callbacks do ----------------------------------------------------------------------


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
        start = [html.Main(panels.show_start(place.list_logs(), str(place.directory)))]
    message = place.message
    text = message.text if message is not None else ""
    kind = "message error" if message is not None and message.is_error else "message"
    return start, not is_new, place.findings is None, text, message is None, kind


def _hides(place: Workplace, told: bool | None) -> bool:
    """Return whether the verdict waits for a guess."""
    return place.is_practice and not told and not place.undo_stack and place.revision is None


def show_top(place: Workplace, told: bool | None, guess: str | None) -> tuple[Any, ...]:
    """Return the head of the page: the verdict, and what can be done about it."""
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 12)
    hides = _hides(place, told)
    kind, parts = panels.show_verdict(findings, diagnosing=place.diagnosing, hides=hides)
    addable = panels.list_addable(findings)
    badge = [html.Span("Simulated data", className="badge")] if findings.simulated else []
    compared = findings.told["compare"]
    effects = ", ".join(compared["effects"]) or "a constant only"
    guessed = ""
    diagnosed = findings.told["diagnose"]
    if told and guess and diagnosed is not None:
        named = addable or [NOTHING if diagnosed["verdict"] == "complete" else "unknown"]
        guessed = f"You guessed {guess}: {'so does the diagnosis' if guess in named else 'not so'}."
    choices = [NOTHING, *findings.told["catalogue"]]
    return (
        ["Workbench ", *badge],
        findings.sensor,
        f"Effects in the model: {effects}. Errors of: {compared['model']}.",
        kind,
        parts,
        not hides,
        choices,
        guessed,
        hides,
        f"Add {addable[0]}" if addable else "Add",
        not addable,
        not place.undo_stack,
    )


def list_choices(place: Workplace, told: bool | None, *now: Any) -> tuple[Any, ...]:
    """Return what can be chosen; what was chosen stays chosen as long as it is there."""
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 10)
    output, run, ghost, effect, present = now
    hides = _hides(place, told)
    compared = findings.told["compare"]
    runs = [
        {"label": t.run + ("" if t.held_out else " (learnt from)"), "value": t.run}
        for t in findings.traces
    ]
    names = [trace.run for trace in findings.traces]
    worst = compared["worst"][0] if compared["worst"] else None
    if output not in findings.outputs:
        output = worst["output"] if worst else findings.outputs[0]
    if run not in names:
        run = worst["run"] if worst else names[0]
    ghosts = [] if hides else list(place.previews)
    kinds = [term["name"] for term in findings.told["model"]["terms"]]
    others = list(findings.told["catalogue"])
    return (
        list(findings.outputs),
        output,
        runs,
        run,
        ghosts,
        ghost if ghost in ghosts else None,
        others,
        effect if effect in others else None,
        kinds,
        present if present in kinds else None,
    )


def show_sections(place: Workplace, told: bool | None) -> tuple[Any, ...]:
    """Return the sections below the chart."""
    findings = place.findings
    if findings is None:
        return tuple([no_update] * 9)
    candidates: Any = html.P("Guess first.", className="note")
    if not _hides(place, told):
        candidates = panels.show_candidates(findings)
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


def tell_effect(
    place: Workplace, effect: str | None, ghost: str | None, told: bool | None
) -> tuple[Any, bool]:
    """Return what is known about the effect that is looked at: the one chosen, or the one named."""
    findings = place.findings
    if findings is None or _hides(place, told):
        return [], True
    kind = effect or ghost or next(iter(panels.list_addable(findings)), None)
    parts = panels.show_effect(findings, kind) if kind else []
    return [html.H3(kind), *parts], not parts


def draw_main(
    place: Workplace,
    output: str | None,
    run: str | None,
    ghost: str | None,
    moved: dict[str, Any] | None,
    drawn: list[Any] | None,
) -> tuple[Any, ...]:
    """Return the chart of one run, refined to the part that is shown, and what went on there."""
    findings = place.findings
    names = [trace.run for trace in findings.traces] if findings is not None else []
    if findings is None or output not in findings.outputs or run not in names:
        return tuple([no_update] * 4)
    window = Window(run)
    wanted = [place.shown, output, run, ghost]
    # Several inputs may have changed at once, so one of them alone says little.
    if drawn == wanted:
        if {told["prop_id"] for told in ctx.triggered} != {"main.relayoutData"} or moved is None:
            return tuple([no_update] * 4)
        ends = [moved.get(f"xaxis2.range[{i}]") for i in (0, 1)]
        if "xaxis2.range" in moved:
            ends = moved["xaxis2.range"]
        if ends[0] is not None and ends[1] is not None:
            window = Window(run, *sorted(3600.0 * float(end) for end in ends if end is not None))
        elif not moved.get("xaxis2.autorange"):
            return tuple([no_update] * 4)
    k = findings.outputs.index(output)
    curve = place.preview(ghost, run) if ghost else None
    figure = draw_run(
        findings.find_trace(run),
        findings.told["compare"],
        output,
        window,
        ghost=None if curve is None else curve[k],
        ghost_name=ghost or "",
    )
    segments = [
        f"{number}: {s['pattern']} ({s['from_s']:.6g} to {s['to_s']:.6g} s, RMSE {s['rmse']:.3g} "
        f"{findings.units[k]})"
        for number, s in enumerate(findings.told["compare"]["worst"], 1)
        if s["run"] == run and s["output"] == output
    ]
    cause = "Worst segments here: " + "; ".join(segments) if segments else "No worst segment here"
    cause += ". Dotted lines: ± noise floor. Drag to zoom, double-click to go back."
    table = panels.show_table(tabulate_part(findings, k, window))
    return figure, cause, table, wanted


def tabulate_part(findings: Findings, k: int, window: Window) -> tables.Table:
    """Return rows of the part that is drawn, evenly spread, a hundred at most."""
    trace = findings.find_trace(window.run)
    start, stop = find_rows(trace, window)
    rows = start + pick_spread(stop - start, MOST_ROWS)
    cells = tuple(
        tuple(
            tables.write_number(float(value), 6)
            for value in (
                trace.time_s[row],
                trace.temperature_degC[row],
                trace.drift[k, row],
                trace.drift[k, row] - trace.error[k, row],
                trace.error[k, row],
            )
        )
        for row in rows
    )
    unit = findings.units[k]
    headings = (
        *("time, s", "temperature, degC", f"drift as measured, {unit}"),
        *(f"model, {unit}", f"what is left, {unit}"),
    )
    note = "Samples, evenly spread over the part that is shown; zoom for more."
    return tables.Table("Samples", headings, cells, texts=0, note=note)


def _choose_form(place: Workplace, kind: str) -> list[str]:
    """Return the options with which the diagnosis proposed an effect; none for another one."""
    told = (place.findings.told.get("diagnose") if place.findings else None) or {}
    words = shlex.split(told.get("command") or "")
    return words[3:] if words[2:3] == [kind] else []


def press(
    place: Workplace,
    add_label: str | None,
    effect: str | None,
    present: str | None,
    force: list[str] | None,
) -> Any:
    """Do what a button says."""
    button = ctx.triggered_id
    if not ctx.triggered or not ctx.triggered[0]["value"]:
        return no_update
    if button == "add":
        kind = effect or (add_label or "").removeprefix("Add").strip()
        if not kind:
            place.tell("Choose an effect to add.", is_error=False)
        else:
            options = [*_choose_form(place, kind), *(["--force"] if force else [])]
            place.run("add", f"Adding {kind}", ["add", kind, "--json", *options])
    elif button == "remove":
        if not present:
            place.tell("Choose the effect to remove.", is_error=False)
        else:
            kind, _, signal = present.partition("[")
            options = ["--set", f"signal={signal.rstrip(']')}"] if signal else []
            place.run("remove", f"Removing {present}", ["remove", kind, "--json", *options])
    elif button == "undo":
        place.undo()
    elif button == "look":
        place.look()
    elif button == "cancel":
        place.cancel()
    elif button == "dismiss":
        place.dismiss()
    else:
        titles = {
            "train": "Training",
            "firmware": "Building firmware",
            "verify": "Verifying",
            "report": "Writing the report",
        }
        options = ["--no-diagnose"] if button == "report" else []
        place.run(button, titles[button], [button, "--json", *options])
    return no_update


def begin(place: Workplace) -> Any:
    """Begin a project: from the logs in the directory, or from simulated ones."""
    if not ctx.triggered or not ctx.triggered[0]["value"]:
        return no_update
    if ctx.triggered_id == "begin":
        place.run("init", "Guessing columns", ["init", *place.list_logs(), "--json"])
    else:
        told = ["--told", PRACTICE_EFFECT, "--mystery", "1", "--seed", str(draw_seed())]
        place.run("twin", "Simulating a sensor", ["twin", *told, "--json"])
    return no_update


def draw_seed() -> int:
    """Return a seed that nobody knows, for a practice case."""
    import secrets

    return secrets.randbelow(1_000_000)
