"""What `monitor` opens: the deployed model, the state of the last call, and live sources."""

import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Protocol

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError, nearest
from zerodrift.field.registry import LEARNING, open_registry
from zerodrift.field.registry_file import FILE_NAME as REGISTRY
from zerodrift.field.state import FILE_NAME, LogSeen, MonitorState, load_state
from zerodrift.field.summary import MonitorResult
from zerodrift.field.watch import OTHER_MODEL, OTHER_UNIT
from zerodrift.fleet.sensors import load_unit
from zerodrift.tasks.applied_model import load_nothing, open_applied
from zerodrift.tasks.deployed_block import find_serial
from zerodrift.tasks.monitored_log import Deployed
from zerodrift.verify.manifest import check_manifest

OVERLAP_S = 7200.0
"""Of a live source: how much is computed again with the next rows, so that memory settles."""
FEWEST_LINES = 3


class Options(Protocol):
    """The options that are read here."""

    @property
    def sensor(self) -> str | None:
        """A unit of a fleet."""
        ...

    @property
    def block(self) -> Path | None:
        """The block that is on the unit."""
        ...

    @property
    def loads(self) -> tuple[str, ...]:
        """OUTPUT=VALUE."""
        ...

    @property
    def when(self) -> str | None:
        """COLUMN=VALUE."""
        ...

    @property
    def alarms_per_unit_month(self) -> float:
        """False alarms per unit and month."""
        ...

    @property
    def learn_days(self) -> float:
        """Days that the noise is learnt from."""
        ...

    @property
    def block_hours(self) -> float:
        """Length of a block in hours."""
        ...

    @property
    def state(self) -> Path | None:
        """File of the state."""
        ...

    @property
    def reset(self) -> bool:
        """Whether to begin anew."""
        ...

    @property
    def every_s(self) -> float:
        """Time in s between two reads of a live source."""
        ...


def open_deployed(directory: Path, options: Options) -> tuple[Deployed, Path, tuple[str, ...]]:
    """Return the unit as it is in use, the file of its state, and notes for the user.

    Raises:
        InputError: there is no firmware, no such unit, or an option cannot be read.
        CheckError: the files of the firmware are not those that were built and checked.
    """
    config = load_unit(directory, options.sensor)
    applied = open_applied(config, load_logs=load_nothing, block=options.block)
    changed = [f for f in check_manifest(config, wants_inputs=False).findings if not f.is_stale]
    if changed:
        raise CheckError("the firmware is not what was built and checked: " + changed[0].text)
    loads, when = _read_loads(config, options)
    name = options.sensor or config.sensor_name
    serial = find_serial(config)
    deployed = Deployed(name, serial, config, applied.model, applied.uncertainty, loads, when)
    return deployed, options.state or config.build_directory / FILE_NAME, applied.notes


def _read_loads(
    config: Config, options: Options
) -> tuple[dict[str, float], tuple[str, float] | None]:
    """Return the loads that are known, and the rows for which they are."""
    names = [output.name for output in config.outputs]
    loads = {}
    for text in options.loads:
        name, value = _read_pair("--load", text, "Fz=0")
        if name not in names:
            raise InputError(
                f"--load {text}: there is no output '{name}'{nearest(name, names)} Expected one of"
                f" {', '.join(names)}."
            )
        loads[name] = value
    when = None if options.when is None else _read_pair("--when", options.when, "idle=1")
    return loads, when


def _read_pair(option: str, text: str, example: str) -> tuple[str, float]:
    name, found, value = text.rpartition("=")
    try:
        if found and name:
            return name.strip(), float(value)
    except ValueError:
        pass
    raise InputError(f"{option} {text}: expected a name and a number, such as {example}.")


def open_state(
    place: Path, deployed: Deployed, options: Options
) -> tuple[MonitorState, tuple[str, ...]]:
    """Return the state to continue from, and notes for the user.

    Raises:
        InputError: it is damaged, or was started with other options.
    """
    fresh = MonitorState(
        deployed.sensor,
        deployed.model.hash,
        options.block_hours * 3600.0,
        options.alarms_per_unit_month,
        options.learn_days * 86_400.0,
    )
    if options.reset:
        return fresh, ()
    kept = load_state(place)
    if kept is None:
        return fresh, ()
    if kept.sensor != deployed.sensor:
        raise InputError(
            f"{place}: is the state of {kept.sensor}; expected that of {deployed.sensor}. Name"
            " another file by --state."
        )
    if kept.model_hash != deployed.model.hash:
        return fresh, (f"{place.name}: is of another model; the unit is learnt anew",)
    if (kept.block_s, kept.per_month, kept.learn_s) != (
        fresh.block_s,
        fresh.per_month,
        fresh.learn_s,
    ):
        raise InputError(
            f"{place}: was begun with --block-hours {kept.block_s / 3600.0:g} --false-alarms"
            f" {kept.per_month:g} --learn-days {kept.learn_s / 86_400.0:g}; expected the same, as a"
            " test that changes on the way has no stated rate. Repeat them, or begin anew with"
            " --reset."
        )
    return kept, ()


def enter(
    directory: Path, deployed: Deployed, told: MonitorResult, logs: Sequence[LogSeen]
) -> tuple[str, ...]:
    """Enter logs and what was found into the registry where there is one; return notes.

    A unit of a fleet is entered under its name, any other under `[firmware] serial` or, without
    one, the sensor's name.

    Raises:
        InputError: it cannot be written.
    """
    path, serial = directory / REGISTRY, deployed.serial
    if not path.is_file():
        return ()
    with open_registry(path) as registry:
        if not registry.knows(serial):
            way = f"Enter it by `zerodrift registry add {serial}`"
            if deployed.config.unit_build is None and not deployed.config.block.serial:
                way += ", or state its serial number as [firmware] serial"
            return (f"{path.name}: there is no unit {serial}; nothing was entered. {way}.",)
        registry.add_logs(serial, tuple((log.sha256, log.name) for log in logs))
        for name, output in told.outputs.items():
            cause = output.verdict.cause
            # How far the learning is changes with each log, and is no event of its own.
            text = "learning the noise" if output.state == LEARNING else output.text
            if told.other_unit is not None and cause in (OTHER_UNIT, OTHER_MODEL):
                text += f"; {told.other_unit.text}"
            registry.add_finding(serial, name, cause or output.state, text)
    if serial == deployed.sensor:
        return ()
    return (f"{path.name}: entered under the serial number {serial} of [firmware]",)


def live_chunks(source: str, deployed: Deployed, options: Options) -> Iterator[Path]:
    """Yield files with the last rows of a live source, whenever enough have come.

    Args:
        source: - or a command, which prints CSV with a header, a row for each sample.
        deployed: gives the time that the model needs to settle.
        options: how often to read.

    Raises:
        InputError: the command cannot be started, or printed nothing.
    """
    config = deployed.config
    warm_s = deployed.model.guards.warm_up_steps * config.sample_period_s
    kept = max(FEWEST_LINES, round(max(OVERLAP_S, warm_s) / config.sample_period_s))
    wanted = max(FEWEST_LINES, round(options.every_s / config.sample_period_s))
    with tempfile.TemporaryDirectory(prefix="zerodrift-") as scratch, _open(source) as stream:
        header = stream.readline()
        if not header.strip():
            raise InputError(f"{source}: gave nothing; expected CSV with a header.")
        path, lines, new = Path(scratch) / "live.csv", [], 0
        for line in stream:
            if not line.strip():
                continue
            lines.append(line)
            new += 1
            if new >= wanted:
                path.write_text(header + "".join(lines), encoding="utf-8")
                yield path
                lines, new = lines[-kept:], 0
        if new and len(lines) >= FEWEST_LINES:
            path.write_text(header + "".join(lines), encoding="utf-8")
            yield path


@contextmanager
def _open(source: str) -> Iterator[IO[str]]:
    """Open standard input, or what a command prints; the command ends with the block."""
    if source == "-":
        yield sys.stdin
        return
    try:
        process = subprocess.Popen(shlex.split(source), stdout=subprocess.PIPE, text=True)
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"command:{source}: cannot be started ({error}). Correct it.") from error
    assert process.stdout is not None
    try:
        yield process.stdout
    finally:
        process.stdout.close()
        process.terminate()
        process.wait()
