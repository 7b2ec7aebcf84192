"""How the commands print: results on stdout, progress on stderr."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, fields
from typing import TYPE_CHECKING

from zerodrift.base.progress import is_watched, open_text_progress
from zerodrift.base.terminal import open_terminal

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status
    from rich.table import Table

    from zerodrift.diagnosis.advice import Advice
    from zerodrift.physics.effect import Effect
    from zerodrift.verify.summary import FirmwareSummary, StatedUncertainty

_shown: "list[Status]" = []
"""What shows progress on the terminal at present."""
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


@contextmanager
def show_progress(first: str) -> Iterator[Callable[[str], None]]:
    """Show on stderr what is being done; yields a function that takes the next description.

    Where `PROGRESS_LINES` is set in the environment, each step is a line that another program can
    read; in a notebook it is text in the cell.
    """
    with open_text_progress() as show:
        if show is not None:
            show(first)
            yield show
            return
    if not is_watched():
        yield lambda _: None
        return
    with open_terminal(stderr=True).status(first) as status:
        _shown.append(status)
        try:
            yield status.update
        finally:
            _shown.remove(status)


@contextmanager
def pause_progress() -> Iterator[None]:
    """Show no progress for as long as the user is asked something."""
    for status in _shown:
        status.stop()
    try:
        yield
    finally:
        for status in _shown:
            status.start()


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


def write_values(effect: "Effect", values: "Mapping[str, float]") -> str:
    """Return fitted values with their units."""
    return ", ".join(
        f"{name} {value:.4g} {_write_unit(effect.parameter(name).unit)}".rstrip()
        for name, value in values.items()
    )


def _write_unit(unit: str) -> str:
    """Return a unit for print; plain numbers have none."""
    return "" if unit == "1" else unit
