"""From outcomes to figures: medians and quartiles over specimens and seeds, and paired ratios."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift_lab.paper.store import Cell
from zerodrift_lab.paper.study import Outcome


@dataclass(frozen=True)
class Spread:
    """A median with its quartiles over specimens and seeds."""

    median: float
    low: float
    high: float
    count: int

    def write(self, digits: int = 3) -> str:
        """Return `median (low to high)`, or the value alone where there is but one."""
        if self.count == 1:
            return f"{self.median:.{digits}g}"
        return f"{self.median:.{digits}g} ({self.low:.{digits}g} to {self.high:.{digits}g})"


def summarise(values: Iterable[float]) -> Spread:
    """Return median and quartiles.

    Raises:
        ValueError: there are no values.
    """
    x = np.array(list(values), dtype=np.float64)
    if not x.size:
        raise ValueError("nothing to summarise")
    low, median, high = np.percentile(x, [25.0, 50.0, 75.0])
    return Spread(float(median), float(low), float(high), int(x.size))


class Outcomes:
    """The outcomes of a study, found by what their cells say."""

    def __init__(self, outcomes: Sequence[Outcome]) -> None:
        self._by_cell: Mapping[Cell, Outcome] = {o.cell: o for o in outcomes}

    def get(self, cells: Iterable[Cell]) -> list[Outcome]:
        """Return those outcomes of cells that there are."""
        return [self._by_cell[cell] for cell in cells if cell in self._by_cell]

    def pair(
        self, ones: Sequence[Outcome], others: Sequence[Outcome]
    ) -> list[tuple[Outcome, Outcome]]:
        """Return outcomes of the same specimen and seed.

        Where one of the two was fitted for a single seed, since none changes it, that stands for
        all seeds.
        """
        pairs = []
        for longer, shorter, turned in ((ones, others, False), (others, ones, True)):
            if len(longer) < len(shorter):
                continue
            for a in longer:
                alike = [b for b in shorter if b.cell.sensor == a.cell.sensor]
                same = [b for b in alike if b.cell.seed == a.cell.seed] or alike[:1]
                pairs += [(b, a) if turned else (a, b) for b in same]
            break
        return pairs


def pool_percent(outcome: Outcome, test: str) -> float:
    """Return all axes together in % of the chamber's drift."""
    return 100.0 * float(np.sqrt(np.mean((outcome.rmse(test) / outcome.scale()) ** 2)))


def pool_floors(outcome: Outcome, test: str) -> float:
    """Return all axes together in multiples of the noise floor."""
    return float(np.sqrt(np.mean((outcome.rmse(test) / outcome.floor(test)) ** 2)))


def compare_errors(one: Array, other: Array) -> float:
    """Return the geometric mean over axes of one error over another."""
    return float(np.exp(np.mean(np.log(one / other))))


def measure_ratio(
    outcomes: Outcomes, ones: Sequence[Outcome], others: Sequence[Outcome], test: str
) -> Spread:
    """Return the errors of ones over those of others, paired by specimen and seed."""
    pairs = outcomes.pair(ones, others)
    return summarise(compare_errors(a.rmse(test), b.rmse(test)) for a, b in pairs)
