"""The page: which of its parts listen to which."""

from collections.abc import Callable, Sequence

import dash
from dash import Dash, Input, Output, State, no_update
from dash.development.base_component import Component

from zerodrift.report.page import read_asset
from zerodrift.report.svg import write_style
from zerodrift.workbench import views
from zerodrift.workbench.early import write_frame
from zerodrift.workbench.layout import EARLY, PAGE, lay_out
from zerodrift.workbench.views import Shown
from zerodrift.workbench.workplace import Workplace

# The page as it is sent first: with the verdict, the choices and the chart already in it.
#
# A page that came empty would ask for each of its parts, one after the other, before it drew
# anything.

Places = tuple[tuple[str, str], ...]
"""Parts of the page that one function fills: id and property of each."""

FRAME: Places = (
    ("start", "children"),
    ("start", "hidden"),
    ("bench", "hidden"),
    ("bench", "className"),
    ("message", "children"),
    ("message-box", "hidden"),
    ("message-box", "className"),
)
RECORDINGS: Places = (
    ("recordings", "children"),
    ("recordings", "hidden"),
    ("recordings", "data-told"),
)
UNITS: Places = (
    ("units", "children"),
    ("unit-box", "hidden"),
    ("unit", "data-choices"),
    ("units", "data-told"),
)
TOP: Places = (
    ("kicker", "children"),
    ("sensor", "children"),
    ("subtitle", "children"),
    ("verdict", "className"),
    ("verdict", "children"),
    ("guess-box", "hidden"),
    ("guess-choice", "data-choices"),
    ("guess-told", "children"),
    ("actions", "hidden"),
    ("way", "children"),
    ("undo", "disabled"),
    ("redo", "disabled"),
    ("bench", "data-stale"),
    ("tiles", "children"),
    ("revision", "children"),
    ("revision", "hidden"),
)
CHOICES: Places = tuple(
    (name, "data-choices") for name in ("output", "run", "ghost", "effect", "present")
)
CHART: Places = (("main", "data-shown"), ("cause", "children"))


def lay_out_first(place: Workplace) -> Component:
    """Return the whole page, what is known by now filled in; the rest comes by the callbacks."""
    # Read before all else: what changes meanwhile is then shown by the page's next request.
    version = place.version
    page = lay_out()
    shown: Sequence[tuple[Places, Callable[[], Shown]]] = (
        (FRAME, lambda: views.show_frame(place)),
        (RECORDINGS, lambda: views.show_recordings(place, None)),
        (UNITS, lambda: views.show_units(place, None)),
        (TOP, lambda: views.show_top(place, None, None)),
        (CHOICES, lambda: views.list_choices(place, None)),
        (CHART, lambda: views.show_chart(place, None)),
    )
    for places, show in shown:
        for (name, attribute), value in zip(places, show(), strict=True):
            if value is not no_update:
                setattr(page[name], attribute, value)
    page["version"].data = version
    return page


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
