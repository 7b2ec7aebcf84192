"""Recordings as a project: its zerodrift.toml, and config and runs without a detour by files."""

import json
from collections.abc import Sequence
from pathlib import Path

from zerodrift.base.config import Config, parse_config
from zerodrift.dataset.runs import Dataset, Run
from zerodrift_lab.twin.project import CHANNEL_COLUMNS, TAIL, name_outputs
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, UNITS
from zerodrift_lab.twin.six_axis.record import Recording

#: Channels of a recording that a log can hold, `body_temperature` on request.
CHANNELS = tuple(CHANNEL_COLUMNS)

_HEAD = """\
# SIMULATED: these logs were written by `zerodrift twin --six-axis`, no sensor was measured.

[sensor]
name = {name}                    # prefix of the generated C
time = "time_s"
temperature = "temperature_degC" # the TMP117 on the board, 0.0078125 degC per count
sample_period_s = {period:g}              # the step of the firmware; the logs have the same
"""

_OUTPUT = """
[outputs.{name}]
measured = "{column}"
reference = "ref_{column}"
unit = "{unit}"
full_scale = {full_scale:g}
"""

_EFFECTS = """
[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "dark_current"
"""


def _list_files(runs: Sequence[Recording]) -> str:
    return "[" + ", ".join(json.dumps(f"logs/{run.name}.csv") for run in runs) + "]"


def render_config(
    train: Sequence[Recording],
    test: Sequence[Recording] = (),
    dwell: Sequence[Recording] = (),
    *,
    channels: Sequence[str] = (),
    name: str = "ft40",
) -> str:
    """Return the text of a zerodrift.toml for recordings of one specimen.

    `channels` are those that the logs hold, out of `CHANNELS`.
    """
    period_s = train[0].sample_period_s
    parts = [_HEAD.format(name=json.dumps(name), period=period_s)]
    for output, column, unit, full_scale in zip(
        OUTPUTS, name_outputs(), UNITS, FULL_SCALE.tolist(), strict=True
    ):
        parts.append(_OUTPUT.format(name=output, column=column, unit=unit, full_scale=full_scale))
    if channels:
        parts.append("\n[inputs]                         # other channels, by the effects' names\n")
        parts += [f'{c} = "{CHANNEL_COLUMNS[c]}"\n' for c in CHANNELS if c in channels]
    parts.append("\n[logs]                           # one file is one run\n")
    parts.append(f"train = {_list_files(train)}\n")
    if test:
        parts.append(f"test = {_list_files(test)}\n")
    else:
        parts.append("# no test logs: one run after the other is left out\n")
    if dwell:
        parts.append(f"dwell = {_list_files(dwell)} # isothermal, unloaded: the noise floor\n")
    return "".join([*parts, _EFFECTS, TAIL.format(network="none")])


def to_config(
    train: Sequence[Recording],
    test: Sequence[Recording] = (),
    dwell: Sequence[Recording] = (),
    *,
    channels: Sequence[str] = (),
    name: str = "ft40",
    directory: Path = Path(),
) -> Config:
    """Return the config that `directory/zerodrift.toml` would hold, without writing it."""
    text = render_config(train, test, dwell, channels=channels, name=name)
    return parse_config(text, directory.absolute() / "zerodrift.toml")


def to_run(recording: Recording, channels: Sequence[str] = (), directory: Path = Path()) -> Run:
    """Return the recording as the log's reader would give it."""
    available = {**recording.channels, "body_temperature": recording.body_temperature_degC}
    return Run(
        name=recording.name,
        group=recording.name,
        part=0,
        source=directory.absolute() / "logs" / f"{recording.name}.csv",
        sample_period_s=recording.sample_period_s,
        time_s=recording.time_s,
        temperature_degC=recording.temperature_degC,
        measured=recording.measured,
        reference=recording.reference,
        inputs={channel: available[channel] for channel in channels},
    )


def to_dataset(
    train: Sequence[Recording],
    test: Sequence[Recording] = (),
    dwell: Sequence[Recording] = (),
    *,
    channels: Sequence[str] = (),
    directory: Path = Path(),
) -> Dataset:
    """Return what `load_dataset` would read from the written logs, without writing them.

    `channels` are the inputs that the logs hold: `body_temperature` for the second thermometer,
    and supply, humidity, ambient_light, acceleration_x, _y, _z, clock.
    """

    def convert(runs: Sequence[Recording]) -> tuple[Run, ...]:
        return tuple(to_run(run, channels, directory) for run in runs)

    return Dataset(
        train=convert(train),
        test=convert(test),
        dwell=convert(dwell),
        outputs=OUTPUTS,
        units=UNITS,
        full_scale=tuple(FULL_SCALE.tolist()),
    )
