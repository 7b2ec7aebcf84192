"""How the commands print: results on stdout, progress on stderr."""

import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import astuple, fields
from typing import TYPE_CHECKING

import click

from zerodrift.base import progress
from zerodrift.base.progress import Progress, is_watched
from zerodrift.base.terminal import open_terminal
from zerodrift.cli.common import is_trusted
from zerodrift.train.summary import NetworkChoice

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from zerodrift.diagnosis.advice import Advice
    from zerodrift.verify.summary import FirmwareSummary, StatedUncertainty

LEAST_WIDTH = 120
"""Columns of a file or a pipe, which has no width of its own."""


def open_console() -> "Console":
    """Return the console for results: plain text of a fixed width unless it is a terminal."""
    width = None if sys.stdout.isatty() else LEAST_WIDTH
    return open_terminal(width=width)


def open_table(title: str, left: Sequence[str], right: Sequence[str]) -> "Table":
    """Return an empty table whose first columns are text and whose others are numbers."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    for heading in left:
        table.add_column(heading)
    for heading in right:
        table.add_column(heading, justify="right")
    return table


def print_advice(advice: "Advice | None", console: "Console") -> None:
    """Print what can and cannot be learnt from the logs, and what to record next."""
    if advice is None:
        return
    console.print("\nWhat these logs can teach:")
    for sentence in advice.explain():
        console.print(f"  {sentence}")


def print_not_testable(reasons: Mapping[str, str], console: "Console") -> None:
    """Print why effects cannot be judged, those of one reason together.

    Args:
        reasons: effect -> reason.
        console: where to.
    """
    effects: dict[str, list[str]] = {}
    for effect, why in reasons.items():
        effects.setdefault(why, []).append(effect)
    for why, names in effects.items():
        console.print(f"Not testable: {', '.join(names)}: {why}.")
    if effects:
        console.print()


class UserProgress(Progress):
    """Progress of a command: what the user is to know, and is asked, goes to stderr."""

    def tell(self, text: str) -> None:
        """Print a sentence."""
        with self.screen.pause():
            click.echo(text, err=True)

    def show(self, found: object) -> None:
        """Print what a part of the work has found."""
        with self.screen.pause():
            if isinstance(found, NetworkChoice):
                print_choice(found, open_terminal(stderr=True))

    def confirm(self, question: str) -> bool | None:
        """Ask the user, unless `--trust` was given or nobody is there."""
        if is_trusted():
            return True
        if not is_somebody_there():
            return None
        with self.screen.pause():
            return click.confirm(question, default=False, err=True)


def is_somebody_there() -> bool:
    """Return whether a user can be asked."""
    return bool(sys.stdin and sys.stdin.isatty() and is_watched())


def show_progress(first: str = "") -> AbstractContextManager[UserProgress]:
    """Show on stderr what a command is doing; the block is given what a task is handed."""
    return progress.show_progress(UserProgress, first)


def tabulate(choice: NetworkChoice) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Return heads and rows of the table as it is printed."""
    outputs = [f"{name} [{unit}]" for name, unit in choice.units.items()]
    heads = (*outputs, "times the best", "instr.", "flash B", "")
    rows = []
    for one in choice.tried:
        if one.rmse_left_out is None:
            rows.append((one.name, *("-" for _ in outputs), "-", "-", "-", one.why))
            continue
        errors = (f"{one.rmse_left_out[name]:.4g}" for name in choice.units)
        cost = ("-" if n is None else str(n) for n in (one.instructions, one.flash_bytes))
        mark = "taken" if one.name == choice.taken else "as good" if one.as_good else ""
        mark = ", ".join(word for word in (mark, one.why) if word)
        rows.append((one.name, *errors, f"{one.times_best:.3f}", *cost, mark))
    return heads, rows


def print_choice(choice: NetworkChoice, console: "Console") -> None:
    """Print the networks that `[network] kind = "auto"` tried, and its choice."""
    heads, rows = tabulate(choice)
    title = f"RMSE on runs left out, and a step on {choice.core}"
    table = open_table(title, ("network",), heads)
    for row in rows:
        table.add_row(*row)
    console.print(table)
    console.print(
        f"{choice.taken} is taken: the cheapest of those within 5 % of the best."
        f" {choice.explanation}"
    )


def print_uncertainty(stated: "Mapping[str, StatedUncertainty] | None", console: "Console") -> None:
    """Print the uncertainty of each output's compensated value by cause; nothing where none is."""
    if not stated:
        return
    table = open_table(
        "Uncertainty of a compensated value inside the calibrated ranges",
        ("output", "unit"),
        ("expanded, k = 2", "noise", "parameters", "left out", "rounding", "covered"),
    )
    for name, one in stated.items():
        causes = (one.noise, one.parameters, one.left_out, one.rounding)
        covered = "-" if one.covered is None else f"{100.0 * one.covered:.1f} %"
        numbers = (f"{value:.2g}" for value in (one.expanded, *causes))
        table.add_row(name, one.unit, *numbers, covered)
    console.print(table)
    console.print(next(iter(stated.values())).explain())


def has_other_causes(firmware: "FirmwareSummary") -> bool:
    """Tell whether more than rounding separates a chip from its float model."""
    return any(any(astuple(split)[1:]) for split in firmware.chip_error.values())


def print_chip_error(firmware: "FirmwareSummary", console: "Console") -> None:
    """Print the error between a firmware and its float model, as `firmware` measured it."""
    table = open_table(
        "The chip: integer minus float model by cause, RMS",
        ("output", "unit"),
        [
            cause.name.replace("_", " ")
            for cause in fields(next(iter(firmware.chip_error.values())))
        ],
    )
    for name, split in firmware.chip_error.items():
        table.add_row(name, firmware.units[name], *(f"{x:.2g}" for x in astuple(split)))
    console.print(table)


def print_statements(firmware: "FirmwareSummary", console: "Console") -> None:
    """Print what the gate warns of, and what was written by force.

    Why nothing was written is the command's error, which ends it.
    """
    for statement in firmware.warnings:
        console.print(f"warning: {statement.text}")
    for statement in firmware.refused if firmware.forced else ():
        console.print(f"FORCED: {statement.text}")
