"""Which of the paper's claims come out on the twin: computed from the results, never assumed."""

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from zerodrift_lab.methods import METHODS
from zerodrift_lab.paper.plan import DEFAULT, PAPER_GRU, TRAINED, Plan
from zerodrift_lab.paper.published import (
    CHAMBER,
    COOLING,
    HEATING,
    NONE,
    WALKING,
    PublishedTable,
)
from zerodrift_lab.paper.study import Outcome
from zerodrift_lab.paper.summary import (
    Outcomes,
    Spread,
    compare_errors,
    measure_ratio,
    summarise,
)
from zerodrift_lab.paper.tables import find_cells
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS

HOLDS = "comes out"
WEAKER = "comes out, but weaker"
REVERSED = "comes out the other way round"
UNDECIDED = "is not told apart"
FAILS = "does not come out"

EQUAL = 1.05
"""Ratios between this and its inverse are no difference."""
MUCH_WEAKER = 0.5
"""Share of the paper's factor below which a claim comes out weaker,"""
HARDLY = 0.25
"""and share of its logarithm below which it does not come out."""


@dataclass(frozen=True)
class Finding:
    """A claim of the paper, and what the twin says of it."""

    name: str
    claim: str
    published: float
    """The factor in the paper."""
    simulated: Spread
    """The factor on the twin."""
    verdict: str
    unit: str = "times"

    def explain(self) -> str:
        """Return the finding in a sentence."""
        return (
            f"{self.claim}: {self.verdict}. Paper: {self.published:.3g} {self.unit}; simulated: "
            f"{self.simulated.write()} {self.unit}."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as JSON values."""
        return {**asdict(self), "sentence": self.explain()}


def judge_factor(published: float, simulated: Spread) -> str:
    """Return what becomes of a claimed factor above 1."""
    if simulated.high < 1.0 / EQUAL:
        return REVERSED
    if simulated.low < EQUAL:
        return UNDECIDED
    if simulated.high >= MUCH_WEAKER * published:
        return HOLDS
    return WEAKER if np.log(simulated.high) >= HARDLY * np.log(published) else FAILS


def find_all(plan: Plan, outcomes: Outcomes) -> list[Finding]:
    """Return what becomes of every claim."""
    findings = []
    for table in (CHAMBER, COOLING, HEATING):
        findings += _rank(table, plan, outcomes)
    findings.append(_find_same_information(plan, outcomes))
    findings += _find_headlines(plan, outcomes)
    return findings


def _rank(table: PublishedTable, plan: Plan, outcomes: Outcomes) -> list[Finding]:
    """Return a finding for each step of the ranking that a table shows."""
    printed = {name: np.array(row) for name, row in table.rows.items()}
    order = sorted(printed, key=lambda name: -float(np.mean(np.log(printed[name]))))
    found = []
    for worse, better in pairwise(order):
        factor = compare_errors(printed[worse], printed[better])
        if factor < EQUAL:
            continue
        spread = _compare(plan, outcomes, worse, better, table.name)
        claim = f"{_entitle(better)} better than {_entitle(worse)}, {table.title.lower()}"
        verdict = judge_factor(factor, spread)
        found.append(Finding(f"{table.name}: {better} < {worse}", claim, factor, spread, verdict))
    return found


def _compare(plan: Plan, outcomes: Outcomes, worse: str, better: str, test: str) -> Spread:
    others = outcomes.get(find_cells(plan, better))
    if worse == NONE:
        return summarise(compare_errors(o.none(test), o.rmse(test)) for o in others)
    return measure_ratio(outcomes, outcomes.get(find_cells(plan, worse)), others, test)


def _find_same_information(plan: Plan, outcomes: Outcomes) -> Finding:
    """Return how far apart the networks of the same ten samples are, at most."""
    groups = [outcomes.get(find_cells(plan, method)) for method in TRAINED]
    apart = []
    for first in groups[0]:
        alike = [first] + [o for group in groups[1:] for o in group if _is_alike(o, first)]
        sizes = [float(np.mean(np.log(o.rmse(CHAMBER.name)))) for o in alike]
        apart.append(float(np.exp(max(sizes) - min(sizes))))
    spread = summarise(apart)
    printed = [CHAMBER.rows[method][0] for method in TRAINED]
    factor = max(printed) / min(printed)
    names = ", ".join(_entitle(method) for method in TRAINED)
    claim = f"Of the networks that see the same ten samples ({names}), one far ahead of another"
    return Finding("same information", claim, factor, spread, judge_factor(factor, spread))


def _is_alike(one: Outcome, other: Outcome) -> bool:
    return (one.cell.sensor, one.cell.seed) == (other.cell.sensor, other.cell.seed)


def _find_headlines(plan: Plan, outcomes: Outcomes) -> list[Finding]:
    """Return the claims of the paper's abstract."""
    gru = outcomes.get(find_cells(plan, PAPER_GRU))
    found = []
    fz = OUTPUTS.index("Fz")
    for claim, worse, factor in (
        ("The GRU's error about a hundredth of the linear fit's, chamber", "lsm_linear", 100.0),
        ("The GRU's error about a quarter of the MLP's, chamber", "mlp", 4.0),
    ):
        spread = _compare(plan, outcomes, worse, PAPER_GRU, CHAMBER.name)
        verdict = judge_factor(factor, spread)
        found.append(Finding(f"headline: {worse}", claim, factor, spread, verdict))
    for table, name in ((HEATING, "heating"), (WALKING, "walking")):
        spread = summarise(float(o.none(table.name)[fz] / o.rmse(table.name)[fz]) for o in gru)
        factor = (
            table.rows[NONE][fz] / table.rows[PAPER_GRU][fz]
            if table is HEATING
            else table.rows["none, left foot"][fz] / table.rows[f"{PAPER_GRU}, left foot"][fz]
        )
        claim = f"Drift in Fz less by the GRU, {name}"
        verdict = judge_factor(factor, spread)
        found.append(Finding(f"headline: Fz {name}", claim, factor, spread, verdict))
    spread = summarise(
        max(float(np.max(100.0 * o.rmse(t.name) / FULL_SCALE)) for t in (COOLING, HEATING))
        for o in gru
    )
    verdict = HOLDS if spread.high <= 0.2 * EQUAL else FAILS
    claim = "The GRU's error at most about 0.2 % of full scale, heating and cooling"
    return [*found, Finding("headline: full scale", claim, 0.2, spread, verdict, "%")]


def _entitle(name: str) -> str:
    return METHODS[name].title if name in METHODS else "uncompensated"


def summarise_default(plan: Plan, outcomes: Outcomes) -> list[str]:
    """Return how the project's default compares with the paper's GRU, in sentences."""
    ours, gru = (outcomes.get(find_cells(plan, m)) for m in (DEFAULT, PAPER_GRU))
    if not ours or not gru:
        return []
    parts = []
    for table in (CHAMBER, COOLING, HEATING, WALKING):
        ratio = measure_ratio(outcomes, gru, ours, table.name)
        parts.append(f"{table.name} {ratio.write()}")
    return [
        f"Error of the paper's GRU over that of the default ({METHODS[DEFAULT].title}), both "
        f"trained on the same chamber logs: {'; '.join(parts)}."
    ]
