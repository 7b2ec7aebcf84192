"""Which of Plotly's scripts the page loads: the whole one, or a small one where it is installed."""

import sys
from pathlib import Path

from plotly.offline import get_plotlyjs_version

BASIC = Path("share") / "zerodrift" / "plotly-basic.min.js"
"""Below the environment's own folder; `make setup-page` puts it there."""


def find_bundle() -> Path | None:
    """Return Plotly's basic bundle, where one is installed that is of the same version.

    It holds lines and bars, which is all that the page draws, and is a quarter of the whole; the
    page is ready in about half the time. Without it the page loads what came with Plotly.
    """
    path = Path(sys.prefix) / BASIC
    try:
        with path.open("rb") as stream:
            head = stream.read(200)
    except OSError:
        return None
    wanted = f"plotly.js (basic - minified) v{get_plotlyjs_version()}\n"
    return path if wanted.encode() in head else None
