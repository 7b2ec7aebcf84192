"""Writes a simulation as a user would have it: logs, zerodrift.toml, and the truth apart."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import polars as pl

from zerodrift.base.errors import InputError
from zerodrift.base.journal import hold_project, write_all
from zerodrift_lab.twin.logger import SimulatedRun
from zerodrift_lab.twin.project import CHANNEL_COLUMNS, name_outputs, render_config
from zerodrift_lab.twin.simulate import Simulation
from zerodrift_lab.twin.truth import describe_truth

TRUTH = "truth.json"
MARKS = {
    "zerodrift.toml": b"# SIMULATED: these logs were written by `zerodrift twin",
    "README.md": b"Written by `zerodrift twin",
    TRUTH: b'"note": "The truth behind simulated logs.',
}
"""Files of a simulation -> what each says of itself."""
_README = """\
# Simulated logs

Written by `zerodrift twin` (seed {seed}). **No sensor was measured**: every number here is
simulated, after the six-axis photo-coupler sensor of arXiv 2502.17528.

- `zerodrift.toml`: what the model is told. It lists the effects that the model starts with.
- `logs/`: {count} runs at {period:g} s per sample.
- `truth.json`: what the simulated sensor does in fact. No command reads it; look only after you
  have made up your mind.

Next: `zerodrift compare`, `zerodrift diagnose`, `zerodrift add EFFECT`.
"""


def render_log(run: SimulatedRun) -> bytes:
    """Return one run as CSV, with the few decimals of a logger."""
    columns = {"time_s": run.time_s, "temperature_degC": run.temperature_degC}
    for k, name in enumerate(name_outputs()):
        columns[name] = run.measured[:, k]
    for k, name in enumerate(name_outputs()):
        columns[f"ref_{name}"] = run.reference[:, k]
    for channel, values in run.channels.items():
        columns[CHANNEL_COLUMNS[channel]] = values
    return pl.DataFrame(columns).write_csv().encode()


def render_logs(simulation: Simulation) -> dict[str, bytes]:
    """Return the logs by their name relative to the project directory."""
    return {f"logs/{run.name}.csv": render_log(run) for run in simulation.runs}


def render_project(simulation: Simulation) -> dict[str, bytes]:
    """Return every file of the project by its name relative to the project directory."""
    readme = _README.format(
        seed=simulation.recipe.seed,
        count=len(simulation.runs),
        period=simulation.recipe.sample_period_s,
    )
    return {
        **render_logs(simulation),
        "README.md": readme.encode(),
        "truth.json": (json.dumps(describe_truth(simulation), indent=1) + "\n").encode(),
        "zerodrift.toml": render_config(simulation).encode(),
    }


def replace_files(directory: Path, files: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Write files below a directory, as one change.

    Raises:
        InputError: the directory cannot be written; the old files are as they were.
    """
    contents = {directory / name: content for name, content in files.items()}
    write_all(directory, contents)
    return tuple(contents)


def write_logs(
    simulation: Simulation, directory: Path, *, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write logs, zerodrift.toml, README.md and truth.json of a simulation into a directory.

    Returns the paths written, the logs first and zerodrift.toml last.

    Raises:
        InputError: files would be overwritten without `overwrite`, or are of no simulation, or
            other logs lie where the config's globs would take them for this simulation's.
    """
    return write_project(render_project(simulation), directory, overwrite=overwrite)


def write_project(
    files: Mapping[str, bytes], directory: Path, *, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write files by their names relative to a directory; see `write_logs`."""
    with hold_project(directory):  # what a kill left among the logs is no log
        _refuse_overwriting(files, directory, overwrite)
        return replace_files(directory, files)


def _refuse_overwriting(files: Mapping[str, bytes], directory: Path, overwrite: bool) -> None:
    there = [name for name in files if (directory / name).exists()]
    if there and not overwrite:
        raise InputError(
            f"{directory / there[0]}: exists already ({len(there)} of {len(files)} files do). "
            "Name another directory by -C, or overwrite with --force."
        )
    simulated = _list_simulated(directory)
    for name in there:
        if Path(name).stem not in simulated and name not in simulated:
            raise InputError(
                f"{directory / name}: was not written by `zerodrift twin`; expected an earlier"
                " simulation, which alone --force overwrites. Move the file away, or name another"
                " directory by -C. Nothing was written."
            )
    strangers = sorted(
        path.name for path in (directory / "logs").glob("*") if f"logs/{path.name}" not in files
    )
    if strangers:
        raise InputError(
            f"{directory / 'logs' / strangers[0]}: is not of this simulation, and the globs of "
            "zerodrift.toml could mix it in. Remove it, or name another directory by -C."
        )


def _list_simulated(directory: Path) -> frozenset[str]:
    """Return the files, and the names of the runs, of the simulation that lies in a directory."""
    names = {
        name
        for name, mark in MARKS.items()
        if (directory / name).is_file() and mark in (directory / name).read_bytes()
    }
    if TRUTH in names:
        names.add("sensor.dbc")
        with suppress(ValueError, KeyError, TypeError):
            runs = json.loads((directory / TRUTH).read_text(encoding="utf-8"))["runs"]
            names |= {str(run["name"]) for run in runs}
    return frozenset(names)
