"""`monitor`: the deployed model, the state of the last call, logs and live sources."""

import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError, nearest
from zerodrift.base.lock import lock_project
from zerodrift.base.progress import SILENT, Progress
from zerodrift.field.metrics import write_metrics
from zerodrift.field.registry import FILE_NAME as REGISTRY
from zerodrift.field.registry import LEARNING, open_registry
from zerodrift.field.state import FILE_NAME, LogSeen, MonitorState, load_state, save_state
from zerodrift.field.summary import MonitorResult
from zerodrift.field.watch import OTHER_MODEL, OTHER_UNIT
from zerodrift.tasks.apply import load_nothing, open_applied
from zerodrift.tasks.deployed_block import find_serial
from zerodrift.tasks.known_units import find_known
from zerodrift.tasks.monitor import Monitor
from zerodrift.tasks.monitored_log import Deployed
from zerodrift.tasks.project import ProjectFolder
from zerodrift.verify.manifest import check_manifest

OVERLAP_S = 7200.0
"""Of a live source: how much is computed again with the next rows, so that memory settles."""
FEWEST_LINES = 3
STANDARD_INPUT = "-"
COMMAND_MARK = "command:"


@dataclass(frozen=True)
class MonitorRequest:
    """Which unit is held against which logs, and how its alarms are set."""

    project: ProjectFolder
    sources: tuple[str, ...]
    """Logs as [logs] names them, "-" for CSV on standard input, or "command:CMD"."""
    block: Path | None = None
    """The block on the unit; None: as the registry says, else the one written last."""
    loads: tuple[str, ...] = ()
    """OUTPUT=VALUE: true values in these logs."""
    when: str | None = None
    """COLUMN=VALUE: only rows with this number in this column have the known load."""
    alarms_per_unit_month: float = 0.01
    """False alarms per unit and month of 30 days, all outputs together."""
    learn_days: float = 14.0
    """The first days, which the noise in use is learnt from."""
    block_hours: float = 4.0
    """Samples are averaged over so long before they are tested."""
    state: Path | None = None
    """What is kept from call to call; None: in build/."""
    metrics: Path | None = None
    """Where Prometheus' text goes; None: nowhere."""
    reset: bool = False
    """Forget what was seen."""
    every_s: float = 3600.0
    """Of a live source: time of the log between two looks."""


def monitor_unit(request: MonitorRequest, progress: Progress = SILENT) -> MonitorResult:
    """Hold the model of the last `firmware`, with the unit's block, against new logs of its unit.

    The state goes on from call to call; another model begins anew. Of a live source, what is found
    is told after each look.

    Raises:
        InputError: a log or an option cannot be read, or there is no firmware.
        CheckError: the files of the firmware are not those that were built and checked.
    """
    if not request.sources:
        raise InputError("nothing to read; expected a log, - or command:CMD. Name one.")
    project = request.project
    deployed, place, notes = open_deployed(request)
    with lock_project(place.parent):
        state, more = open_state(place, deployed, request)
        monitor = Monitor(deployed, state)

        def look() -> MonitorResult:
            progress("testing")
            told = monitor.judge(progress)
            if monitor.wants_name:
                progress("trying the other units of the design")
                in_fleet = bool(project.sensor)
                known, unknown = find_known(project.directory, deployed, in_fleet=in_fleet)
                told = replace(told, other_unit=monitor.seek(known), notes=(*told.notes, *unknown))
            save_state(place, monitor.state)
            if request.metrics is not None:
                write_metrics(request.metrics, (told,))
            return told

        for source in request.sources:
            if source == STANDARD_INPUT or source.startswith(COMMAND_MARK):
                for chunk in live_chunks(source.removeprefix(COMMAND_MARK), deployed, request):
                    monitor.read(chunk, skip_invalid=project.skip_invalid, overlap=True)
                    told = look()
                    texts = list_texts(told)
                    texts += [told.other_unit.text] if told.other_unit is not None else []
                    progress.tell(f"{told.steps_in_all} steps; {'; '.join(texts)}")
                continue
            if not Path(source).exists():
                raise InputError(
                    f"{source}: there is no such log; expected a file or folder, - or command:CMD."
                )
            progress(f"reading {Path(source).name}")
            monitor.read(Path(source), skip_invalid=project.skip_invalid)
        told = look()
        entered = enter(project.directory, deployed, told, monitor.state.logs)
    return replace(told, notes=(*notes, *more, *told.notes, *entered))


def list_texts(told: MonitorResult) -> list[str]:
    """Return what is told of the outputs, those of which the same is told together."""
    outputs: dict[str, list[str]] = {}
    for name, output in told.outputs.items():
        outputs.setdefault(output.text, []).append(name)
    return [f"{', '.join(names)}: {text}" for text, names in outputs.items()]


def open_deployed(request: MonitorRequest) -> tuple[Deployed, Path, tuple[str, ...]]:
    """Return the unit as it is in use, the file of its state, and notes for the user.

    Raises:
        InputError: there is no firmware, no such unit, or an option cannot be read.
        CheckError: the files of the firmware are not those that were built and checked.
    """
    config = request.project.config
    applied = open_applied(config, load_logs=load_nothing, block=request.block)
    changed = [f for f in check_manifest(config, wants_inputs=False).findings if not f.is_stale]
    if changed:
        raise CheckError("the firmware is not what was built and checked: " + changed[0].text)
    loads, when = _read_loads(config, request)
    name = request.project.sensor or config.sensor_name
    serial = find_serial(config)
    deployed = Deployed(name, serial, config, applied.model, applied.uncertainty, loads, when)
    return deployed, request.state or config.build_directory / FILE_NAME, applied.notes


def _read_loads(
    config: Config, request: MonitorRequest
) -> tuple[dict[str, float], tuple[str, float] | None]:
    """Return the loads that are known, and the rows for which they are."""
    names = [output.name for output in config.outputs]
    loads = {}
    for text in request.loads:
        name, value = _read_pair("--load", text, "Fz=0")
        if name not in names:
            raise InputError(
                f"--load {text}: there is no output '{name}'{nearest(name, names)} Expected one of"
                f" {', '.join(names)}."
            )
        loads[name] = value
    when = None if request.when is None else _read_pair("--when", request.when, "idle=1")
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
    place: Path, deployed: Deployed, request: MonitorRequest
) -> tuple[MonitorState, tuple[str, ...]]:
    """Return the state to continue from, and notes for the user.

    Raises:
        InputError: it is damaged, or was started with other options.
    """
    fresh = MonitorState(
        deployed.sensor,
        deployed.model.hash,
        request.block_hours * 3600.0,
        request.alarms_per_unit_month,
        request.learn_days * 86_400.0,
    )
    if request.reset:
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


def live_chunks(source: str, deployed: Deployed, request: MonitorRequest) -> Iterator[Path]:
    """Yield files with the last rows of a live source, whenever enough have come.

    Args:
        source: - or a command, which prints CSV with a header, a row for each sample.
        deployed: gives the time that the model needs to settle.
        request: how often to read.

    Raises:
        InputError: the command cannot be started, or printed nothing.
    """
    config = deployed.config
    warm_s = deployed.model.guards.warm_up_steps * config.sample_period_s
    kept = max(FEWEST_LINES, round(max(OVERLAP_S, warm_s) / config.sample_period_s))
    wanted = max(FEWEST_LINES, round(request.every_s / config.sample_period_s))
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
