"""The page as it is sent first: with the verdict, the choices and the chart already in it.

A page that came empty would ask for each of its parts, one after the other, before it drew
anything.
"""

from collections.abc import Callable, Sequence

from dash import no_update
from dash.development.base_component import Component

from zerodrift.workbench import views
from zerodrift.workbench.layout import lay_out
from zerodrift.workbench.views import Shown
from zerodrift.workbench.workplace import Workplace

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
