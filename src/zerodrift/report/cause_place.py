"""Where the panes of the cause picture stand, before anything is known that is drawn in them."""

from collections.abc import Sequence
from dataclasses import dataclass

MARGIN_LEFT, MARGIN_RIGHT, MARGIN_TOP, MARGIN_BOTTOM = 62.0, 12.0, 26.0, 42.0
GAP = 27.0
"""Pixels between panes, for their headings."""
TALL, LOW = 128.0, 74.0
"""Pixels of a pane of drift, and of one of a channel."""
WIDE = 860.0
"""Pixels from which on the scatter stands beside the panes and not below."""
SHARE_OF_PANES = 0.6
NARROW = 560.0
"""Pixels below which a pane's title stands above its legend."""
STACKED = 17.0


@dataclass(frozen=True)
class CauseGeometry:
    """Places in pixels of the picture."""

    panes: tuple[tuple[float, float], ...]
    """Top and height of each, from top to bottom."""
    width: float
    """Of each pane, from `MARGIN_LEFT` on."""
    scatter: tuple[float, float, float, float]
    """Left, top, width and height."""
    bottom: float
    """Height of the whole picture."""
    is_narrow: bool
    """Whether titles stand above legends."""


def lay_out_cause(tall: Sequence[bool], width: float) -> CauseGeometry:
    """Return where everything stands.

    Args:
        tall: for each pane whether it shows the drift, or else a channel.
        width: of the whole picture; from `WIDE` on the scatter stands beside the panes.
    """
    is_wide = width >= WIDE
    room = SHARE_OF_PANES * width if is_wide else width
    inner = room - MARGIN_LEFT - MARGIN_RIGHT
    is_narrow = inner < NARROW
    gap = GAP + (STACKED if is_narrow else 0.0)
    top = MARGIN_TOP + (STACKED if is_narrow else 0.0)
    panes = []
    for is_tall in tall:
        height = TALL if is_tall else LOW
        panes.append((top, height))
        top += height + gap
    bottom = top - gap + MARGIN_BOTTOM
    if is_wide:
        left, side = room + MARGIN_LEFT, width - room - MARGIN_LEFT - MARGIN_RIGHT
        above = MARGIN_TOP + 2.0 * STACKED
        scatter = (left, above, side, bottom - MARGIN_BOTTOM - above)
    else:
        scatter = (MARGIN_LEFT, bottom + GAP + 2.0 * STACKED, inner, max(0.62 * inner, 200.0))
        bottom = scatter[1] + scatter[3] + MARGIN_BOTTOM
    return CauseGeometry(tuple(panes), inner, scatter, bottom, is_narrow)
