"""How near to its bound each accumulator came, by the kind of its node."""

import re
from typing import Any

import numpy as np

BINS = 1000
"""Of the histogram of observed / bound."""


class Tightness:
    """Histograms of observed / bound, by kind of node and by what the bound is of."""

    def __init__(self) -> None:
        self._bins: dict[str, dict[int, int]] = {}

    def add(self, kinds: dict[str, str], where: str, ratio: float) -> None:
        """Count one bound.

        Args:
            kinds: name of a node -> its kind.
            where: name of the bound.
            ratio: largest observed magnitude over that of the bound.
        """
        node = re.split(r"[.\[]", where)[0]
        rest = re.sub(r"^\.\d+", "", where.removeprefix(node))  # a layer of a stack
        kind = "gru" if kinds[node] == "gru_stack" else kinds[node]
        bins = self._bins.setdefault(kind + re.sub(r"\d+", "*", rest), {})
        place = int(np.ceil(ratio * BINS))
        bins[place] = bins.get(place, 0) + 1

    def to_json(self) -> dict[str, dict[str, int]]:
        """Return plain dicts."""
        return {name: {str(k): n for k, n in bins.items()} for name, bins in self._bins.items()}

    def merge(self, body: dict[str, Any]) -> None:
        """Add what `to_json` gave."""
        for name, bins in body.items():
            mine = self._bins.setdefault(name, {})
            for place, count in bins.items():
                mine[int(place)] = mine.get(int(place), 0) + count

    def table(self) -> str:
        """Return a table: how many bounds of each kind, and quantiles of observed / bound in %."""
        lines = [f"  {'bound':24} {'how many':>9} {'median':>8} {'9 of 10':>8} {'largest':>8}"]
        for name, bins in sorted(self._bins.items()):
            places = np.array(sorted(bins))
            counts = np.cumsum([bins[place] for place in places])
            cells = [places[np.searchsorted(counts, q * counts[-1])] for q in (0.5, 0.9, 1.0)]
            percent = " ".join(f"{100 * cell / BINS:6.1f} %" for cell in cells)
            lines.append(f"  {name:24} {counts[-1]:9d} {percent}")
        return "\n".join(lines)
