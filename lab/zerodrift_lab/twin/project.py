"""A simulation as a project: its zerodrift.toml, and config and runs without a detour by files."""

import json
from collections.abc import Iterable
from pathlib import Path

from zerodrift.base.config import Config, parse_config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift_lab.twin.logger import SimulatedRun
from zerodrift_lab.twin.recipe import Recipe
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, UNITS
from zerodrift_lab.twin.simulate import Simulation

#: Channel -> column of the logs.
CHANNEL_COLUMNS = {
    "supply": "supply_V",
    "humidity": "humidity_pct",
    "ambient_light": "ambient_light_lux",
    "acceleration_x": "ax_mps2",
    "acceleration_y": "ay_mps2",
    "acceleration_z": "az_mps2",
    "clock": "clock_s",
    "body_temperature": "t_body_degC",
}

_HEAD = """\
# SIMULATED: these logs were written by `zerodrift twin`, no sensor was measured.
# What is listed under [[effect]] is in the simulated sensor; what else is in it you may find out.

[sensor]
name = {name}                    # prefix of the generated C
time = "time_s"                  # seconds since power-on
temperature = "temperature_degC" # the TMP117 on the board, 0.0078125 degC per count
sample_period_s = {period:g}              # the step of the firmware; the logs have the same
"""

_OUTPUT = """
[outputs.{name}]
measured = "{name}_{unit}"
reference = "ref_{name}_{unit}"
unit = "{unit}"
full_scale = {full_scale:g}
"""

TAIL = """
[network]                    # learns the rest: lag_bank | gru | lstm | mlp | mlp_seq | tcn | none
kind = "{network}"
hidden = 16
memory = "stream"

[quantization]
weights = "int16"                # int16 | int8

[firmware]
out = "firmware"
"""


def name_outputs() -> tuple[str, ...]:
    """Return the columns of the measured outputs, such as `Fz_N`."""
    return tuple(f"{name}_{unit}" for name, unit in zip(OUTPUTS, UNITS, strict=True))


def _list_globs(names: Iterable[str]) -> str:
    """Return the globs that match the files of these runs, as a TOML array."""
    stems = sorted({name.rpartition("_")[0] for name in names})
    return "[" + ", ".join(f'"logs/{stem}_*.csv"' for stem in stems) + "]"


def render_config(simulation: Simulation) -> str:
    """Return the text of the zerodrift.toml, which knows the told effects only."""
    recipe = simulation.recipe
    parts = [_HEAD.format(name=json.dumps(recipe.sensor_name), period=recipe.sample_period_s)]
    for name, unit, full_scale in zip(OUTPUTS, UNITS, FULL_SCALE.tolist(), strict=True):
        parts.append(_OUTPUT.format(name=name, unit=unit, full_scale=full_scale))
    if recipe.channels:
        parts.append("\n[inputs]                         # other channels, by the effects' names\n")
        parts += [
            f'{channel} = "{column}"\n'
            for channel, column in CHANNEL_COLUMNS.items()
            if channel in recipe.channels
        ]
    parts.append("\n[logs]                           # one file is one run\n")
    parts.append(f"train = {_list_globs(run.name for run in simulation.select('train'))}\n")
    if recipe.test:
        parts.append('test = ["logs/test_*.csv"]\n')
    else:
        parts.append("# no test logs: one run after the other is left out\n")
    if recipe.dwell:
        parts.append('dwell = ["logs/dwell.csv"]         # isothermal, unloaded: the noise floor\n')
    for choice in recipe.told:
        parts.append(f'\n[[effect]]\nkind = "{choice.name}"\n')
        if "order" in choice.parameters:
            parts.append(f"order = {choice.parameters['order']:.0f}\n")
    parts.append(TAIL.format(network=recipe.network))
    return "".join(parts)


def to_config(simulation: Simulation, directory: Path = Path()) -> Config:
    """Return the config that `directory/zerodrift.toml` would hold, without writing it."""
    return parse_config(render_config(simulation), directory.absolute() / "zerodrift.toml")


def to_run(run: SimulatedRun, recipe: Recipe, directory: Path = Path()) -> Run:
    """Return the run as the log's reader would give it."""
    return Run(
        name=run.name,
        group=run.name,
        part=0,
        source=directory.absolute() / "logs" / f"{run.name}.csv",
        sample_period_s=recipe.sample_period_s,
        time_s=run.time_s,
        temperature_degC=run.temperature_degC,
        measured=run.measured,
        reference=run.reference,
        inputs=dict(run.channels),
    )


def to_dataset(simulation: Simulation, directory: Path = Path()) -> Dataset:
    """Return what `load_dataset` would read from the written logs, without writing them."""

    def select(use: str) -> tuple[Run, ...]:
        runs = (to_run(run, simulation.recipe, directory) for run in simulation.select(use))
        return tuple(sorted(runs, key=lambda run: run.name))

    return Dataset(
        train=select("train"),
        test=select("test"),
        dwell=select("dwell"),
        outputs=OUTPUTS,
        units=UNITS,
        full_scale=tuple(FULL_SCALE.tolist()),
    )
