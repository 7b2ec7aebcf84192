"""The page: which of its parts listen to which."""

from collections.abc import Callable, Sequence

import dash
from dash import Dash, Input, Output, State, dcc, html, no_update
from dash.development.base_component import Component

from zerodrift.report.page import read_asset
from zerodrift.report.svg import write_style
from zerodrift.workbench import views
from zerodrift.workbench.early import CAUSE, CONTENTS, OTHER_STEPS, write_frame
from zerodrift.workbench.views import Shown
from zerodrift.workbench.workplace import Workplace

# The page without anything in it yet: places for what the callbacks bring.

POLL_MS = 500
MOVES = (
    ("earlier", "← Earlier"),
    ("later", "Later →"),
    ("closer", "Closer"),
    ("wider", "Wider"),
    ("whole", "Whole run"),
)
STORES = ("guess", "picks", "below", "chosen")
"""Of them `picks` and `chosen`, a unit, are written by the page's script: what is chosen now."""
EARLY = """\
window.zdFirst = (function () {
  const inner = document.documentElement.clientWidth, em = 16;
  const page = Math.min(inner, 94 * em);
  const width = inner <= 68 * em ? inner - 2.2 * em : page - 4 * em - 15.5 * em;
  const wish = JSON.stringify({ width: Math.max(width - 15, 240) });
  return fetch("/picture?wish=" + encodeURIComponent(wish))
    .then((answer) => (answer.ok ? answer.json() : null))
    .then((told) => {
      const main = document.querySelector("#skeleton #main");
      if (told?.svg && main) { main.innerHTML = '<div class="sketch">' + told.svg + "</div>"; }
      return told;
    })
    .catch(() => null);
})();
new MutationObserver((changes, observer) => {
  if (document.querySelector("#react-entry-point main")) {
    document.getElementById("skeleton")?.remove();
    observer.disconnect();
  }
}).observe(document.documentElement, { childList: true, subtree: true });
"""
"""Asks for the chart while the page's other scripts are still being read, and takes the frame away
in the very moment in which the page stands in its place."""
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta name="viewport" content="width=device-width, initial-scale=1">
{%metas%}
<link rel="preload" as="fetch" href="/_dash-layout" crossorigin>
<link rel="preload" as="fetch" href="/_dash-dependencies" crossorigin>
<title>{%title%}</title>
<script>EARLY</script>
<style>STYLE</style>
{%css%}
</head>
<body>
{%app_entry%}
<footer class="scripts">{%config%}{%scripts%}{%renderer%}</footer>
</body>
</html>
"""


def lay_out() -> Component:
    """Return the whole page."""
    stores = [dcc.Store(id=name) for name in STORES]
    return html.Div(
        [
            dcc.Interval(id="tick", interval=POLL_MS),
            dcc.Store(id="version", data=-1),
            *stores,
            html.Div(
                [html.Div(id="job", role="status"), _press("Cancel", "cancel")],
                id="job-box",
                hidden=True,
            ),
            html.Div(
                [html.P("", id="message", role="alert"), _press("Dismiss", "dismiss")],
                id="message-box",
                hidden=True,
            ),
            html.Div(id="recordings", hidden=True, **{"data-told": ""}),
            html.Div(id="start", hidden=True, className="layout single"),
            html.Div(
                [_lay_out_contents(), html.Main([*_lay_out_top(), *_lay_out_sections()], id="top")],
                id="bench",
                className="layout",
                hidden=True,
            ),
        ]
    )


def _lay_out_contents() -> Component:
    links = [html.Li(html.A(words, href=f"#{where}")) for where, words in CONTENTS]
    theme = html.Button("Dark page", id="theme", className="theme")
    return html.Nav([html.Ol(links), theme], className="contents", **{"aria-label": "Contents"})


def _choose(
    words: str, name: str, *, store: str = "picks", empty: str | None = "choose"
) -> Component:
    """Return a list to choose from, with its words; its choices come by `data-choices`.

    Args:
        words: what is chosen.
        name: of the list.
        store: which is told what is chosen.
        empty: words for nothing chosen; without them there is always a choice.
    """
    told = {"data-store": store, **({} if empty is None else {"data-empty": empty})}
    return html.Label([words, html.Select(id=name, **told)], className="wide")


def _press(words: str, button: str, **options: object) -> Component:
    """Return a button that has the server do something."""
    return html.Button(words, id=button, **{"data-press": button}, **options)


def _lay_out_top() -> list[Component]:
    """Return the head: verdict, guess, actions, and what the last change brought."""
    return [
        html.P(id="kicker", className="kicker"),
        html.H1(id="sensor"),
        html.P(id="subtitle", className="subtitle"),
        html.Section(id="verdict", className="verdict none"),
        html.Div(
            [
                _choose("My guess", "guess-choice"),
                html.Button("Now tell me", id="tell", className="primary"),
            ],
            id="guess-box",
            className="actions",
            hidden=True,
        ),
        html.P(id="guess-told", className="note"),
        html.Section(id="way", **{"aria-label": "The way from logs to a report"}),
        html.Details(
            [
                html.Summary(OTHER_STEPS),
                html.Div(
                    [
                        html.Div(
                            [
                                _choose("another effect", "effect"),
                                _press("Add it", "add-chosen"),
                            ],
                            className="pair",
                        ),
                        html.Label(
                            className="check",
                            **{
                                "data-check": "force",
                                "data-words": "keep it even if it does not help",
                            },
                        ),
                        _press("Undo", "undo"),
                        _press("Redo", "redo"),
                        _press("Look again", "look"),
                    ],
                    className="actions",
                ),
            ],
            id="actions",
        ),
        html.Div(id="effect-told", className="card", hidden=True),
        html.Section(id="revision", className="card", hidden=True),
        html.Div(id="tiles", className="tiles"),
    ]


def _lay_out_sections() -> list[Component]:
    """Return the sections below the head."""
    ghost = "the one that the verdict names"
    choices = [
        _choose("Output", "output", store="view", empty=None),
        _choose("Run", "run", store="view", empty=None),
        _choose("Drawn over what is left", "ghost", store="view", empty=ghost),
        html.Label(["What is left, against", html.Select(id="against")], className="wide"),
    ]
    chart = html.Div(
        id="main",
        tabIndex="0",
        role="group",
        **{"aria-label": "The chart: arrow keys read it, with Shift they mark, Enter zooms there"},
    )
    table = [
        html.Summary("What is drawn, as a table", id="main-summary"),
        html.Div(id="main-table", className="scroll", tabIndex="0"),
    ]
    buttons = ("Train", "train"), ("Build firmware", "firmware"), ("Verify", "verify")
    return [
        _section(
            "measured",
            CAUSE,
            html.Div(choices, className="choices"),
            html.Figure(chart),
            html.Div(
                [
                    *(html.Button(w, id=name, **{"data-move": name}) for name, w in MOVES),
                    html.Button("Zoom to what is marked", id="to-mark", disabled=True),
                ],
                className="actions moves",
                role="group",
                **{"aria-label": "Part of the run that is shown"},
            ),
            html.Div(id="cause"),
            html.Details(table, id="main-details"),
        ),
        _section(
            "candidates-section",
            "What is missing, and why not the others",
            html.Div(id="candidates"),
        ),
        _section("staircase-section", "The staircase of errors", html.Div(id="staircase")),
        _section("errors-section", "Errors", html.Div(id="errors")),
        _section(
            "model-section",
            "Effects in the model",
            html.Div(id="model"),
            html.Div(
                [_choose("Effect", "present"), _press("Remove", "remove")],
                className="actions",
            ),
        ),
        _section(
            "firmware-section",
            "Firmware",
            html.Div(
                [
                    *(_press(words, name) for words, name in buttons),
                    _press("Apply to the test logs", "apply"),
                    _press("Write report", "report"),
                ],
                className="actions",
            ),
            html.Div(id="outcome", role="status"),
            html.Div(id="firmware-told"),
        ),
        _section(
            "chip-section",
            "The chip's own C, in this page",
            html.P(id="chip-told", className="note"),
            html.Div([_load_chip()], className="actions"),
            html.Div(id="chip"),
        ),
        _section(
            "units-section",
            "Units in use",
            html.Div(id="units", **{"data-told": ""}),
            html.Div(
                [
                    _choose("Unit", "unit", store="chosen", empty=None),
                    html.Div(id="unit-told"),
                ],
                id="unit-box",
                hidden=True,
            ),
        ),
    ]


def _load_chip() -> Component:
    words = "Bring the C into the page"
    return html.Button(words, id="load-chip", **{"data-press": "chip"})


def _section(name: str, title: str, *parts: Component) -> Component:
    return html.Section([html.H2(title), *parts], id=name)


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


# The page: which of its parts listen to which.


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
