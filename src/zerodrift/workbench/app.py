"""The page: which of its parts listen to which."""

import dash
from dash import Dash, Input, Output, State

from zerodrift.report.page import read_asset
from zerodrift.report.svg import write_style
from zerodrift.workbench import views
from zerodrift.workbench.early import write_frame
from zerodrift.workbench.first import (
    CHART,
    CHOICES,
    FRAME,
    RECORDINGS,
    TOP,
    UNITS,
    Places,
    lay_out_first,
)
from zerodrift.workbench.layout import EARLY, PAGE
from zerodrift.workbench.workplace import Workplace


class _Page(Dash):  # type: ignore[misc,unused-ignore]
    """The page, with its frame shown until its scripts have drawn it."""

    place: Workplace

    def interpolate_index(self, app_entry: str = "", **parts: str) -> str:
        """Return the page's HTML."""
        if self.place.has_project and (self.place.busy or self.place.findings is not None):
            frame = write_frame(self.place.directory, self.place.sensor)
            app_entry = f'<div id="skeleton">{frame}</div>{app_entry}'
        return str(super().interpolate_index(app_entry=app_entry, **parts))


def make_app(workplace: Workplace) -> Dash:
    """Return the page of a project; all of its scripts and styles come from this machine."""
    app = _Page(
        "zerodrift.workbench",
        title=f"{workplace.directory.name}: zerodrift workbench",
        update_title="",
        serve_locally=True,
        assets_ignore=r"_worker\.js$",  # no script of the page: it runs in a thread of its own
        suppress_callback_exceptions=True,
    )
    app.place = workplace
    app.index_string = PAGE.replace("EARLY", EARLY).replace(
        "STYLE", read_asset("page.css") + write_style()
    )
    app.layout = lambda: lay_out_first(workplace)
    _connect_frame(app, workplace)
    _connect_findings(app, workplace)
    _connect_chart(app, workplace)
    return app


def _list(places: Places) -> list[Output]:
    return [Output(name, attribute) for name, attribute in places]


def _connect_frame(app: Dash, place: Workplace) -> None:
    """Connect what stands around the findings: progress, messages, the start page, the theme."""
    app.callback(
        Output("version", "data"),
        Output("job", "children"),
        Output("job-box", "hidden"),
        *_list(RECORDINGS),
        *_list(UNITS),
        Input("tick", "n_intervals"),
        State("version", "data"),
        State("recordings", "data-told"),
        State("units", "data-told"),
        prevent_initial_call=True,
    )(lambda _, version, recorded, units: views.poll(place, version, recorded, units))
    app.callback(
        Output("unit-told", "children"),
        Input("chosen", "data"),
        Input("units", "data-told"),
        prevent_initial_call=True,
    )(lambda chosen, _: views.show_unit(place, chosen))
    app.callback(
        *_list(FRAME),
        Input("version", "data"),
        prevent_initial_call=True,
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
        *_list(TOP),
        Input("version", "data"),
        Input("guess", "data"),
        State("picks", "data"),
        prevent_initial_call=True,
    )(lambda _, told, picks: views.show_top(place, told, picks))
    app.callback(
        *_list(CHOICES),
        Input("version", "data"),
        Input("guess", "data"),
        prevent_initial_call=True,
    )(lambda _, told: views.list_choices(place, told))
    app.callback(
        Output("candidates", "children"),
        Output("staircase", "children"),
        Output("errors", "children"),
        Output("model", "children"),
        Output("outcome", "children"),
        Output("firmware-told", "children"),
        Output("load-chip", "disabled"),
        Output("chip-told", "children"),
        Output("chip", "data-chip"),
        Input("below", "data"),
        Input("guess", "data"),
    )(lambda _, told: views.show_sections(place, told))
    app.callback(
        Output("effect-told", "children"),
        Output("effect-told", "hidden"),
        Input("version", "data"),
        Input("picks", "data"),
        Input("guess", "data"),
        prevent_initial_call=True,
    )(lambda _, picks, told: views.tell_effect(place, picks, told))


def _connect_chart(app: Dash, place: Workplace) -> None:
    """Connect the chart's place with what it is of; the page's script draws it."""
    app.callback(
        *_list(CHART),
        Input("version", "data"),
        Input("guess", "data"),
        prevent_initial_call=True,
    )(lambda _, told: views.show_chart(place, told))
    app.callback(
        Output("guess", "data"),
        Input("tell", "n_clicks"),
        prevent_initial_call=True,
    )(bool)
