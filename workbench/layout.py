"""The page without anything in it yet: places for what the callbacks bring."""

from dash import dcc, html
from dash.development.base_component import Component

from zerodrift.workbench import panels

POLL_MS = 500
CONTENTS = (
    ("top", "Verdict"),
    ("measured", "Measured and model"),
    ("candidates-section", "What is missing"),
    ("staircase-section", "Staircase"),
    ("errors-section", "Errors"),
    ("model-section", "Effects"),
    ("firmware-section", "Firmware"),
)
MOVES = (
    ("earlier", "← Earlier"),
    ("later", "Later →"),
    ("closer", "Closer"),
    ("wider", "Wider"),
    ("whole", "Whole run"),
)
PLOTLY = "/_dash-component-suites/plotly/package_data/plotly.min.js"
"""Of Dash's own routes. Asked for at once, it is compiled while the other scripts run; left to
Dash, it would be asked for when the page is there, and the page would wait for it."""
STORES = ("guess", "drawn", "view", "picks", "below")
"""Of them `view` and `picks` are written by the page's script: what is chosen now."""
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta name="viewport" content="width=device-width, initial-scale=1">
{%metas%}
<link rel="preload" as="script" href="PLOTLY">
<link rel="preload" as="script" href="/_dash-component-suites/dash/dcc/async-graph.js">
<link rel="preload" as="fetch" href="/_dash-layout" crossorigin>
<link rel="preload" as="fetch" href="/_dash-dependencies" crossorigin>
<title>{%title%}</title>
<style>STYLE</style>
{%css%}
</head>
<body>
{%app_entry%}
<footer class="scripts">{%config%}{%scripts%}<script src="PLOTLY"></script>{%renderer%}</footer>
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
    force = dcc.Checklist(["keep it even if it does not help"], [], id="force")
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
        html.Div(
            [
                html.Div(id="adds", className="adds"),
                html.Div(
                    [
                        _choose("another effect", "effect"),
                        _press("Add it", "add-chosen"),
                    ],
                    className="pair",
                ),
                html.Label(force),
                _press("Undo", "undo"),
                _press("Look again", "look"),
            ],
            id="actions",
            className="actions",
        ),
        html.Div(id="effect-told", className="card", hidden=True),
        html.Section(id="revision", className="card", hidden=True),
        html.Div(id="tiles", className="tiles"),
    ]


def _lay_out_sections() -> list[Component]:
    """Return the sections below the head."""
    ghost = "an effect, drawn over what is left"
    choices = [
        _choose("Output", "output", store="view", empty=None),
        _choose("Run", "run", store="view", empty=None),
        _choose("What would it look like", "ghost", store="view", empty=ghost),
    ]
    chart = dcc.Graph(id="main", config=panels.GRAPH, style={"height": "520px"})
    table = [
        html.Summary("What is drawn, as a table", id="main-summary"),
        html.Div(id="main-table"),
    ]
    buttons = ("Train", "train"), ("Build firmware", "firmware"), ("Verify", "verify")
    return [
        _section(
            "measured",
            "Measured, model, and what is left",
            html.Div(choices, className="choices"),
            html.Figure(chart),
            html.Div(
                [html.Button(words, id=name) for name, words in MOVES],
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
                    _press("Write report", "report"),
                ],
                className="actions",
            ),
            html.Div(id="outcome", role="status"),
            html.Div(id="firmware-told"),
        ),
    ]


def _section(name: str, title: str, *parts: Component) -> Component:
    return html.Section([html.H2(title), *parts], id=name)
