"""A project's beginning: a zerodrift.toml guessed from its logs, or brought up to date."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.config import FILE_NAME, TRAIN, Config, parse_config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.journal import write_text
from zerodrift.dataset.guess import Guess, guess_project
from zerodrift.dataset.guess_runs import LogFiles
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.physics.fit import fit_config
from zerodrift.report.results import GuessedColumns, InitColumn, InitResult
from zerodrift.tasks.init_toml import TARED, write_config, write_selectors
from zerodrift.tasks.trust import claim

NOT_YET = "the logs cannot be used yet"
#: Use -> words in a log's name that suggest it.
USE_WORDS = {"dwell": ("dwell", "isothermal", "noise"), "test": ("test", "walk", "valid")}


@dataclass(frozen=True)
class InitRequest:
    """Which logs a project begins with."""

    directory: Path
    """Of the zerodrift.toml to be written."""
    logs: tuple[Path, ...]
    """Files or folders, seen from the current directory, then from the project's."""
    force: bool = False
    """Overwrite an existing zerodrift.toml."""
    period_s: float | None = None
    """Interval between rows, for logs without times."""

    def __post_init__(self) -> None:
        """Refuse a beginning without a log, or over a project that there is.

        Raises:
            InputError: as said.
        """
        if not self.logs:
            raise InputError(
                "init: no log is named; expected files or folders to guess from, such as"
                " `zerodrift init logs/`, or --upgrade for a project that there is."
            )
        if self.target.exists() and not self.force:
            raise InputError(f"{self.target}: exists already; --force overwrites it.")

    @property
    def target(self) -> Path:
        """The file that is written."""
        return self.directory / FILE_NAME


@dataclass(frozen=True)
class InitOutcome:
    """What was guessed, and written."""

    target: Path
    guess: Guess
    selectors: dict[str, list[str]]
    """train | test | dwell -> selectors."""

    @property
    def result(self) -> InitResult:
        """As the command prints it."""
        guess = self.guess
        return InitResult(
            file=str(self.target),
            time=guess.time.name,
            temperature=guess.temperature,
            sample_period_s=guess.sample_period_s,
            outputs={
                o.name: GuessedColumns(o.measured, o.reference, o.unit, o.full_scale)
                for o in guess.outputs
            },
            inputs=guess.inputs,
            logs={use: tuple(files) for use, files in self.selectors.items()},
            check=tuple(guess.checks),
            columns=tuple(
                InitColumn(c.file, c.column, c.role, c.unit, c.low, c.high, c.why)
                for c in guess.seen
            ),
        )


def begin(request: InitRequest, ask: Callable[[Guess], Guess] = lambda guess: guess) -> InitOutcome:
    """Write a commented zerodrift.toml guessed from logs.

    Args:
        request: which logs, and where.
        ask: returns the guess with the user's answers.

    Raises:
        InputError: the logs cannot be read, or hold nothing that can be guessed.
    """
    directory, target = request.directory, request.target
    places = [log if log.exists() else directory / log for log in request.logs]
    guess = ask(guess_project(places, request.period_s, directory))
    uses = _sort_by_use(guess.logs)
    selectors = {use: write_selectors(runs, directory) for use, runs in uses.items()}
    if len(guess.logs) == 1 and len(guess.runs) < 2:
        only = selectors[TRAIN][0]
        selectors = {"train": [f"{only}@0%:60%"], "test": [f"{only}@60%:100%"], "dwell": []}
    text = write_config(guess, selectors)
    config = parse_config(text, target.absolute())
    try:
        told = _explain_tare(config, load_dataset(config))
    except InputError as error:
        guess = replace(guess, refused=str(error), checks=(*guess.checks, f"{NOT_YET}: {error}"))
    else:
        if told:
            guess = replace(
                guess,
                checks=(*guess.checks, f"[logs] tared is not stated: {told}"),
                alternatives={**guess.alternatives, TARED: (told,)},
            )
            text = write_config(guess, selectors)
    write_text(target, text)
    claim(directory)
    return InitOutcome(target, guess, selectors)


def _explain_tare(config: Config, dataset: Dataset) -> str:
    """Return why the logs look as if each had been zeroed by itself; "" where they do not.

    What cannot be fitted yet is left to the next command, which names it.
    """
    try:
        model = fit_config(config, dataset)
    except ZerodriftError:
        return ""
    if not model.tared:
        return ""
    spread = [float(x) for x in np.std([*model.offsets.values()], axis=0)]
    named = ", ".join(
        f"{name} {x:.2g} {unit}"
        for name, unit, x in zip(dataset.outputs, dataset.units, spread, strict=True)
    )
    return (
        f"at the same temperature the runs differ by offsets of their own ({named} RMS): true if"
        " each log was zeroed by itself, false if these are errors of the sensor"
    )


def _sort_by_use(logs: Sequence[LogFiles]) -> dict[str, list[LogFiles]]:
    """Sort logs into train, test and dwell by words in their names; never leave train empty."""
    uses: dict[str, list[LogFiles]] = {"train": [], "test": [], "dwell": []}
    for log in logs:
        name = log.path.stem.lower()
        found = [use for use, words in USE_WORDS.items() if any(word in name for word in words)]
        uses[found[0] if found else "train"].append(log)
    if not uses[TRAIN]:
        return {"train": list(logs), "test": [], "dwell": []}
    return uses
