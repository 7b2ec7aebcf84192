"""The further channels of a project that `init` finds, and the LSB of each."""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.conversion_config import ConversionConfig
from zerodrift.dataset.code_format import CLOCK
from zerodrift.dataset.conversions import convert
from zerodrift.dataset.design_codes import propose_codes
from zerodrift.dataset.guess_runs import SurveyedFile
from zerodrift.dataset.roles import INPUT, TEMPERATURE, Role


def write_column(files: Sequence[SurveyedFile], file: SurveyedFile, role: Role) -> str:
    """Return a column's name as zerodrift.toml has it: with its file where several have it."""
    name = role.column.name
    holders = [each for each in files if name in each.survey.source.names]
    return name if len(holders) == 1 else f"{file.name}:{name}"


def choose_inputs(files: Sequence[SurveyedFile], shared: set[str]) -> dict[str, str]:
    """Return channel -> column of one run's files, the clock first."""
    inputs: dict[str, str] = {}
    for file in files:
        for role in file.list(INPUT):
            if role.column.name in shared:
                inputs.setdefault(role.channel, write_column(files, file, role))
    clock = inputs.pop("clock", None)
    return ({"clock": clock} if clock else {}) | inputs


def choose_codes(
    columns: Sequence[tuple[str, str]], runs: Sequence[Sequence[SurveyedFile]]
) -> dict[str, tuple[str, float]]:
    """Return column -> `raw` and `lsb` that hold its lowest and highest value of all runs.

    Args:
        columns: input and its column as zerodrift.toml names it.
        runs: the files of each run, of all units of a fleet.
    """
    chosen = {}
    for name, column in columns:
        held = [
            role
            for files in runs
            for file in files
            for role in file.roles
            if column in (role.column.name, write_column(files, file, role))
        ]
        if held and name != CLOCK:
            low = min(role.column.low for role in held)
            high = max(role.column.high for role in held)
            is_degc = held[0].role == TEMPERATURE
            if held[0].column.unit in ("degF", "K"):
                by = ConversionConfig(unit=held[0].column.unit)
                low, high = (float(end) for end in convert(np.array([low, high]), by))
            chosen[column] = propose_codes(name, column, low, high, is_degc)
    return chosen
