"""The last formula of `propose` for report and page: in words, and against what is left."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zerodrift.diagnosis.formula.proposal import FormulaCurve
from zerodrift.report.svg import AxisScale, Cloud, Curve, Panel, Picture, spread

MOST_OUTPUTS = 6
"""Outputs that have a panel."""
COLUMNS = 3


@dataclass(frozen=True)
class ProposedFormula:
    """What `propose` said of the project as it is."""

    formula: str | None
    """None: there is no formula."""
    sentences: tuple[str, ...]
    curves: Mapping[str, FormulaCurve]
    """Output -> points; empty without a formula."""
    units: Mapping[str, str]


def draw_remainder(
    curves: Mapping[str, FormulaCurve], units: Mapping[str, str], width: float = 760.0
) -> Picture:
    """Return what is left against what the formula says of it, one panel for each output."""
    names = list(curves)[:MOST_OUTPUTS]
    columns = min(COLUMNS, len(names))
    each, height = width / max(columns, 1), 210.0
    panels = []
    for number, name in enumerate(names):
        x, y = np.array(curves[name].formula), np.array(curves[name].remainder)
        low, high = spread(x)
        line = np.array([low, high])
        panels.append(
            Panel(
                left=62.0 + each * (number % columns),
                top=46.0 + (height + 84.0) * (number // columns),
                width=each - 78.0,
                height=height,
                x=AxisScale(low, high, f"formula, {units[name]}"),
                y=AxisScale(*spread(y, line)),
                title=f"{name}: remainder, {units[name]}",
                clouds=(Cloud(x, y, "measured", "runs left out"),),
                curves=(Curve(line, line, "model", "all of it", "dash"),),
                stacked=True,
            )
        )
    rows = -(-len(names) // columns) if columns else 0
    words = "What the model leaves of runs left out, against what the formula says of it."
    return Picture(width, rows * (height + 84.0) + 20.0, tuple(panels), words, "formula")
