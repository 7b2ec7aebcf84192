"""The paper's four tables, its figures beside those of the twin, as Markdown and as CSV."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift_lab.methods import METHODS
from zerodrift_lab.paper.plan import Plan
from zerodrift_lab.paper.published import NONE, SOURCE, TABLES, WALKING, PublishedTable
from zerodrift_lab.paper.store import Cell
from zerodrift_lab.paper.study import Outcome
from zerodrift_lab.paper.summary import Outcomes, Spread, pool_percent, summarise
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS

FLOOR = "noise floor"
FEET = ("left foot", "right foot")
"""The two walks; the twin's feet are two draws of the protocol."""
POOLED = "all"
SIMULATED = "simulated"


@dataclass(frozen=True)
class Line:
    """One row of a table."""

    name: str
    """Method, `none` or the noise floor."""
    title: str
    published: tuple[float | None, ...]
    """Per axis of the table; None where the paper prints none."""
    simulated: tuple[Spread, ...]
    """Per axis of the table."""


@dataclass(frozen=True)
class Table:
    """One table, both sources."""

    name: str
    title: str
    axes: tuple[str, ...]
    units: tuple[str, ...]
    lines: tuple[Line, ...]
    note: str


def build_tables(plan: Plan, outcomes: Outcomes) -> list[Table]:
    """Return the four tables."""
    by_method = {
        method: outcomes.get(cell for cell in plan.table_cells() if cell.method == method)
        for method in plan.methods
    }
    return [_build(published, by_method) for published in TABLES]


def _build(published: PublishedTable, by_method: dict[str, list[Outcome]]) -> Table:
    feet: tuple[str, ...] = FEET if published is WALKING else ("",)
    pooled = published.axes == (POOLED,)
    axes = (POOLED, *OUTPUTS) if pooled else published.axes
    index = [OUTPUTS.index(axis) for axis in axes if axis != POOLED]
    anyone = next(iter(by_method.values()))
    lines = []
    for foot in feet:
        run = FEET.index(foot) + 1 if foot else 0
        for name in (NONE, *by_method, FLOOR):
            found = by_method.get(name, anyone)
            spreads = [
                summarise(_read(outcome, published.name, name, run)[k] for outcome in found)
                for k in index
            ]
            if pooled:
                first = summarise(_pool(outcome, published.name, name) for outcome in found)
                spreads.insert(0, first)
            key = f"{name}, {foot}" if foot else name
            printed = published.rows.get(key, (None,) * len(published.axes))
            lines.append(
                Line(
                    key,
                    (METHODS[name].title if name in METHODS else name)
                    + (f", {foot}" if foot else ""),
                    (*printed, *(None,) * (len(axes) - len(printed))),
                    tuple(spreads),
                )
            )
    units = tuple("% of the drift" if a == POOLED else UNITS[OUTPUTS.index(a)] for a in axes)
    return Table(published.name, published.title, axes, units, tuple(lines), published.note)


def _read(outcome: Outcome, test: str, name: str, run: int) -> list[float]:
    """Return [K] of a row: errors of a method, of none, or the floor; of one run where asked."""
    told = outcome.result["tests"][test]
    if run:
        told = told["runs"][f"test_{test}_{run}"]
    key = {NONE: "none", FLOOR: "floor"}.get(name, "rmse")
    return [float(x) for x in told[key]]


def _pool(outcome: Outcome, test: str, name: str) -> float:
    if name in METHODS:
        return pool_percent(outcome, test)
    values = outcome.floor(test) if name == FLOOR else outcome.none(test)
    return 100.0 * float(np.sqrt(np.mean((values / outcome.scale()) ** 2)))


def render_table(table: Table) -> str:
    """Return a table as Markdown."""
    heads = [f"{axis}, {unit}" for axis, unit in zip(table.axes, table.units, strict=True)]
    rows = [["", "source", *heads], ["---", "---", *["---:"] * len(heads)]]
    for line in table.lines:
        if any(value is not None for value in line.published):
            cells = ["" if value is None else f"{value:.4g}" for value in line.published]
            rows.append([line.title, "paper", *cells])
        rows.append([line.title, SIMULATED, *(spread.write() for spread in line.simulated)])
    text = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    note = f"\n\n{table.note}" if table.note else ""
    return f"### {table.title} (simulated beside the paper)\n\n{text}{note}\n"


def render_csv(tables: Sequence[Table]) -> str:
    """Return all tables in long form."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        ["table", "method", "axis", "unit", "source", "median", "quartile_1", "quartile_3", "fits"]
    )
    for table in tables:
        for line in table.lines:
            for axis, unit, printed, spread in zip(
                table.axes, table.units, line.published, line.simulated, strict=True
            ):
                place = [table.name, line.name, axis]
                if printed is not None:
                    # The chamber's figures have no unit in the paper.
                    shown = "not stated" if axis == POOLED else unit
                    writer.writerow([*place, shown, SOURCE, f"{printed:g}", "", "", ""])
                figures = [f"{x:.6g}" for x in (spread.median, spread.low, spread.high)]
                writer.writerow([*place, unit, SIMULATED, *figures, spread.count])
    return out.getvalue()


def find_cells(plan: Plan, method: str) -> list[Cell]:
    """Return the fits of a method that the tables rest on."""
    return [cell for cell in plan.table_cells() if cell.method == method]
