"""The page: which of its parts listen to which."""

import dash
from dash import ALL, Dash, Input, Output, State

from zerodrift.report.page import read_asset
from zerodrift.workbench import views
from zerodrift.workbench.actions import begin, press
from zerodrift.workbench.chart import MOVES, draw_main, go_to_segment
from zerodrift.workbench.layout import PAGE, lay_out
from zerodrift.workbench.workplace import Workplace

BUTTONS = (
    *("add-chosen", "undo", "look", "remove", "train", "firmware", "verify", "report"),
    *("cancel", "dismiss"),
)


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
    _connect_frame(app, workplace)
    _connect_findings(app, workplace)
    _connect_chart(app, workplace)
    _connect_buttons(app, workplace)
    return app


def _connect_frame(app: Dash, place: Workplace) -> None:
    """Connect what stands around the findings: progress, messages, the start page, the theme."""
    app.callback(
        Output("version", "data"),
        Output("job", "children"),
        Output("job-box", "hidden"),
        Input("tick", "n_intervals"),
        State("version", "data"),
    )(lambda _, version: views.poll(place, version))
    app.callback(
        Output("start", "children"),
        Output("start", "hidden"),
        Output("bench", "hidden"),
        Output("message", "children"),
        Output("message-box", "hidden"),
        Output("message-box", "className"),
        Input("version", "data"),
    )(lambda _: views.show_frame(place))
    app.clientside_callback(
        dash.ClientsideFunction("zerodrift", "turn"),
        Output("theme", "children"),
        Input("theme", "n_clicks"),
    )


def _connect_findings(app: Dash, place: Workplace) -> None:
    """Connect what tells what was found; what lies below the chart waits until that is drawn."""
    app.clientside_callback(
        dash.ClientsideFunction("zerodrift", "waitForChart"),
        Output("below", "data"),
        Input("version", "data"),
    )
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
        Output("adds", "children"),
        Output("undo", "disabled"),
        Input("version", "data"),
        Input("guess", "data"),
        State("guess-choice", "value"),
    )(lambda _, told, guess: views.show_top(place, told, guess))
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
    )(lambda _, told, *now: views.list_choices(place, told, *now))
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
        Input("below", "data"),
        Input("guess", "data"),
    )(lambda _, told: views.show_sections(place, told))
    app.callback(
        Output("effect-told", "children"),
        Output("effect-told", "hidden"),
        Input("version", "data"),
        Input("effect", "value"),
        Input("guess", "data"),
    )(lambda _, effect, told: views.tell_effect(place, effect, told))


def _connect_chart(app: Dash, place: Workplace) -> None:
    """Connect the chart with what chooses its part."""
    app.callback(
        Output("main", "figure"),
        Output("cause", "children"),
        Output("main-table", "children"),
        Output("drawn", "data"),
        Input("version", "data"),
        Input("output", "value"),
        Input("run", "value"),
        Input("ghost", "value"),
        Input("goto", "data"),
        *[Input(name, "n_clicks") for name in MOVES],
        Input("main", "relayoutData"),
        State("drawn", "data"),
    )(lambda _, *now: draw_main(place, *now[:4], *now[-2:]))
    app.callback(
        Output("output", "value", allow_duplicate=True),
        Output("run", "value", allow_duplicate=True),
        Output("goto", "data"),
        Input({"type": "segment", "number": ALL}, "n_clicks"),
        prevent_initial_call=True,
    )(lambda _: go_to_segment(place))
    app.callback(
        Output("ghost", "value", allow_duplicate=True),
        Input({"type": "draw", "effect": ALL}, "n_clicks"),
        prevent_initial_call=True,
    )(lambda _: views.choose_ghost())


def _connect_buttons(app: Dash, place: Workplace) -> None:
    """Connect the buttons that do something to the project."""
    app.callback(
        Output("pressed", "data"),
        *[Input(name, "n_clicks") for name in BUTTONS],
        Input({"type": "add", "effect": ALL, "place": ALL}, "n_clicks"),
        State("effect", "value"),
        State("present", "value"),
        State("force", "value"),
        prevent_initial_call=True,
    )(lambda *values: press(place, *values[-3:]))
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
