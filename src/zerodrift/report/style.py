"""Colours, line kinds and type that every figure shares; all readable without colour."""

import plotly.graph_objects as go

ACCENT = "#1668b8"
"""The model, and whatever a page wants looked at."""
MEASURED = "#8a94a0"
LEFT = "#5b6876"
HEATING = "#d1610a"
COOLING = "#1668b8"
STILL = "#8a94a0"
FLOOR = "#7a8794"
MARKED = "rgba(214, 158, 22, 0.20)"
MARKED_EDGE = "#b7860b"
GRID = "rgba(128, 140, 152, 0.22)"
INK = "#3c4650"
"""Type in figures: readable on white and, lightened by the page, on dark ground."""

SERIES = ("#1668b8", "#d1610a", "#3f8f5f", "#8a5aa8", "#8c7a2b", "#b23a5b", "#4b8a99", "#6b7480")
"""Lines of equal standing; their dashes and marks differ too."""
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
MARKS = ("circle", "square", "diamond", "triangle-up", "x", "star", "cross", "hexagon")
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"


def apply_style(figure: go.Figure, height: int, **layout: object) -> go.Figure:
    """Return the figure in the common style: no box, quiet grid, legend on top."""
    figure.update_layout(
        template="none",
        height=height,
        font={"family": FONT, "size": 12, "color": INK},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        margin={"l": 64, "r": 16, "t": 40, "b": 44},
        legend={"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom", "xanchor": "left"},
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": STILL, "activecolor": ACCENT},
        hoverlabel={"font": {"family": FONT, "size": 12}},
        **layout,
    )
    axis = {
        "gridcolor": GRID,
        "zeroline": False,
        "linecolor": GRID,
        "ticks": "outside",
        "tickcolor": GRID,
        "ticklen": 4,
        "title": {"font": {"size": 12}, "standoff": 8},
    }
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis)
    figure.update_annotations(font={"size": 12})
    return figure


def wash(colour: str, opacity: float = 0.28) -> str:
    """Return a colour `#rrggbb` made transparent, which prints smaller than a transparent mark."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity:g})"


def dash_of(number: int) -> str:
    """Return the dash of the nth of several lines."""
    return DASHES[number % len(DASHES)]


def mark_of(number: int) -> str:
    """Return the mark of the nth of several lines."""
    return MARKS[number % len(MARKS)]


def colour_of(number: int) -> str:
    """Return the colour of the nth of several lines."""
    return SERIES[number % len(SERIES)]


def line_across(level: float, x_axis: str, y_axis: str) -> dict[str, object]:
    """Return a dotted level across a subplot, such as axes `x2` and `y2`, as a layout's shape."""
    return {
        "type": "line",
        "xref": f"{x_axis} domain",
        "yref": y_axis,
        "x0": 0,
        "x1": 1,
        "y0": level,
        "y1": level,
        "line": {"dash": "dot", "color": FLOOR, "width": 1},
    }


def line_up(place: float, x_axis: str, y_axis: str) -> dict[str, object]:
    """Return a thin line from the bottom to the top of a subplot, as a layout's shape."""
    return {
        "type": "line",
        "xref": x_axis,
        "yref": f"{y_axis} domain",
        "x0": place,
        "x1": place,
        "y0": 0,
        "y1": 1,
        "line": {"color": FLOOR, "width": 0.5},
    }


def shade(start: float, stop: float, x_axis: str, y_axis: str) -> dict[str, object]:
    """Return a marked stretch of a subplot, as a layout's shape."""
    return {
        "type": "rect",
        "xref": x_axis,
        "yref": f"{y_axis} domain",
        "x0": start,
        "x1": stop,
        "y0": 0,
        "y1": 1,
        "fillcolor": MARKED,
        "line": {"width": 1, "color": MARKED_EDGE, "dash": "dot"},
    }
