"""The deployed model against new logs: flags, range used, residual, and the sequential test."""

import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError, nearest
from zerodrift.base.files import write_whole
from zerodrift.base.lock import lock_project
from zerodrift.base.progress import SILENT, Progress
from zerodrift.dataset.times import DAY_S
from zerodrift.export.integer_model import FLAG_NO_READING
from zerodrift.field.registry import FILE_NAME as REGISTRY
from zerodrift.field.registry import LEARNING, NO_REFERENCE, SOUND, open_registry
from zerodrift.field.state import (
    FILE_NAME,
    LogSeen,
    MonitorState,
    OutputState,
    keep_output,
    load_state,
    save_state,
)
from zerodrift.field.summary import (
    ALARM,
    STATES,
    ChangeVerdict,
    MonitorResult,
    OutputWatched,
    RangeUsed,
    UnitSought,
)
from zerodrift.field.watch import (
    AGEING,
    OTHER_MODEL,
    OTHER_UNIT,
    STEP,
    BlockMeans,
    Followed,
    Rules,
    follow,
    join_blocks,
    make_blocks,
)
from zerodrift.tasks.apply import FLAG_NAMES, Chip, load_nothing, open_applied
from zerodrift.tasks.deployed_block import find_serial
from zerodrift.tasks.monitored_log import Deployed, Left, MonitoredLog, apply_to, hash_log, open_log
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.swapped import (
    KnownUnit,
    LogPart,
    find_known,
    seek_unit,
    tell_sought,
    wants_name,
)
from zerodrift.verify.manifest import check_manifest

# What `monitor` found as Prometheus' text, for the textfile collector of its node exporter.

PREFIX = "zerodrift_monitor_"


def render_metrics(results: tuple[MonitorResult, ...]) -> str:
    """Return the text (Prometheus exposition format 0.0.4), a family after the other."""
    lines: list[str] = []
    for name, kind, told, values in _list_families(results):
        lines += [f"# HELP {PREFIX}{name} {told}", f"# TYPE {PREFIX}{name} {kind}"]
        lines += [f"{PREFIX}{name}{{{labels}}} {value}" for labels, value in values]
    return "\n".join(lines) + "\n"


def write_metrics(path: Path, results: tuple[MonitorResult, ...]) -> None:
    """Write the text, whole or not at all, as the collector asks.

    Raises:
        InputError: it cannot be written.
    """
    write_whole(path, render_metrics(results).encode())


def _list_families(
    results: tuple[MonitorResult, ...],
) -> Iterator[tuple[str, str, str, list[tuple[str, str]]]]:
    """Yield (name, type, help, [(labels, value)]) of each family that has values."""
    units = [(_label(sensor=r.sensor), r) for r in results]
    every = [
        (_label(sensor=r.sensor, output=name, unit=o.unit), o)
        for r in results
        for name, o in r.outputs.items()
    ]
    yield (
        *("alarm", "gauge", "1 where an output carries an alarm."),
        [(labels, str(int(o.state == ALARM))) for labels, o in every],
    )
    yield (
        *("state", "gauge", "1 for the state that the output is in."),
        [
            (labels + f',state="{state}"', str(int(o.state == state)))
            for labels, o in every
            for state in STATES
        ],
    )
    caused = [
        (f'{labels},cause="{o.verdict.cause}"', "1") for labels, o in every if o.verdict.cause
    ]
    moved = [(labels, repr(o.zero_moved)) for labels, o in every if o.zero_moved is not None]
    left = [(labels, repr(o.rms_residual)) for labels, o in every if o.rms_residual is not None]
    for name, told, values in (
        ("cause", "1 for the cause of an alarm.", caused),
        ("zero_moved", "Zero of the last day less that of the days learnt from.", moved),
        ("residual_rms", "RMS of the residual of the last call.", left),
    ):
        if values:
            yield name, "gauge", told, values
    named = [
        (_label(sensor=r.sensor, serial=r.other_unit.named), "1")
        for r in results
        if r.other_unit is not None and r.other_unit.named
    ]
    if named:
        yield "other_unit", "gauge", "1 for the unit that is in its place.", named
    yield (
        *("steps_total", "counter", "Steps of the firmware that were read."),
        [(labels, str(r.steps_in_all)) for labels, r in units],
    )
    flags = [
        (f'{labels},flag="{flag}"', str(count))
        for labels, r in units
        for flag, count in r.flags_in_all.items()
    ]
    if flags:
        yield "flagged_steps_total", "counter", "Steps that carry a flag of the chip.", flags
    last = [(labels, f"{r.last_s!r}") for labels, r in units if r.last_s is not None]
    if last:
        yield "last_step_seconds", "gauge", "Time of the last step that was read.", last


def _label(**labels: str) -> str:
    """Return labels as text, their values escaped."""
    table = str.maketrans({"\\": "\\\\", '"': '\\"', "\n": "\\n"})
    return ",".join(f'{name}="{value.translate(table)}"' for name, value in labels.items())


# The deployed model against new logs: flags, range used, residual, and the sequential test.

ABSOLUTE_S = 1e8
"""Times from here on are dates: 1973 and later; smaller ones count from the log's begin."""
UNDECIDED = "undecided"


class Monitor:
    """Monitors a unit, log by log."""

    def __init__(self, deployed: Deployed, state: MonitorState) -> None:
        self.deployed, self.state = deployed, state
        self._chip = Chip(deployed.model)
        self._flags: dict[str, int] = {}
        self._squares: dict[str, tuple[float, int]] = {}
        self._ranges: dict[str, RangeUsed] = {}
        self._logs: list[str] = []
        self._steps = 0
        self._notes: list[str] = [self._chip.note] if self._chip.note else []
        self._parts: list[LogPart] = []

    def read(self, log: Path, *, skip_invalid: bool = False, overlap: bool = False) -> None:
        """Read a log.

        Args:
            log: the log; of one that was read before, what is new is that the true value of an
                output is known now: that output alone is tested on it.
            skip_invalid: drop rows whose time is no number or does not rise.
            overlap: rows up to the last time seen are expected; they only settle the model.

        Raises:
            InputError: it cannot be read, or lacks what the model takes.
        """
        digest = hash_log(log)
        before = next((seen for seen in self.state.logs if seen.sha256 == digest), None)
        if before is not None and before.outputs is None:
            self._notes.append(f"{log}: was read before; it is passed over")
            return
        opened = open_log(self.deployed, log, skip_invalid)
        told = apply_to(self._chip, self.deployed.config, opened)
        self._notes += [*opened.notes, *told.notes]
        if before is not None:
            self._read_again(log, before, opened, told, skip_invalid)
            return
        time_s = self._place(opened.time_s, log, overlap)
        new = np.ones(time_s.size, dtype=np.bool_)
        if self.state.last_s is not None:
            new = time_s > self.state.last_s
            if not new.all() and not overlap:
                self._notes.append(
                    f"{log}: {int((~new).sum())} of {new.size} steps are not later than what was"
                    " read before; they are passed over"
                )
        if not new.any():
            return
        self._count(opened, told, new)
        shift_s, after_s = float(time_s[0] - opened.time_s[0]), self.state.last_s
        self._parts.append(LogPart(log, skip_invalid, shift_s, after_s))
        self._add(opened, told, time_s, new, tuple(told.residuals))
        self._logs.append(str(log))
        seen = LogSeen(log.name, digest, tuple(told.residuals), shift_s, after_s)
        self.state = replace(
            self.state,
            last_s=float(time_s[-1]),
            steps=self.state.steps + int(new.sum()),
            logs=self.state.logs if overlap else (*self.state.logs, seen),
        )
        if not overlap:
            self._tell_unknown(log, told)

    def _read_again(
        self, log: Path, before: LogSeen, opened: MonitoredLog, told: Left, skip_invalid: bool
    ) -> None:
        """Test a log's outputs whose true value was not known when it was read before."""
        assert before.outputs is not None
        more = tuple(name for name in told.residuals if name not in before.outputs)
        if not more:
            self._notes.append(f"{log}: was read before; it is passed over")
            self._tell_unknown(log, told)
            return
        time_s = opened.time_s + before.shift_s
        new = np.ones(time_s.size, dtype=np.bool_)
        if before.after_s is not None:
            new = time_s > before.after_s
        if not before.outputs:
            self._parts.append(LogPart(log, skip_invalid, before.shift_s, before.after_s))
        self._add(opened, told, time_s, new, more)
        self._logs.append(str(log))
        seen = replace(before, outputs=(*before.outputs, *more))
        logs = tuple(seen if one is before else one for one in self.state.logs)
        self.state = replace(self.state, logs=logs)
        self._notes.append(f"{log}: was read before; now {', '.join(more)} is tested on it, too")
        self._tell_unknown(log, told)

    def _tell_unknown(self, log: Path, told: Left) -> None:
        """Say which outputs cannot be tested on a log, and how they can."""
        unknown = [o.name for o in self.deployed.model.outputs if o.name not in told.residuals]
        if unknown:
            options = " ".join(f"--load {name}=VALUE" for name in unknown)
            self._notes.append(
                f"{log}: the true value of {', '.join(unknown)} is not known, so that it is not"
                f" tested; read the log again with {options} (0 where there was no load), or with"
                " its reference column, to test it"
            )

    def _add(
        self,
        opened: MonitoredLog,
        told: Left,
        time_s: Array,
        new: Mask,
        names: Sequence[str],
    ) -> None:
        """Add what is left of some outputs to their means."""
        outputs = dict(self.state.outputs)
        for name in names:
            residual = told.residuals[name]
            usable = new & (told.flags == 0) & np.isfinite(residual)
            blocks = make_blocks(
                time_s[usable], residual[usable], opened.temperature[usable], self.state.block_s
            )
            before = outputs.get(name, OutputState())
            joined = join_blocks(before.blocks, blocks)
            learned, finding = before.learned, before.finding
            if before.place and blocks.place.size and blocks.place[0] < before.place[-1]:
                learned, finding = None, None  # blocks have another number: all is tested anew
            outputs[name] = keep_output(joined, learned, finding)
            squares, count = self._squares.get(name, (0.0, 0))
            own = residual[usable]
            self._squares[name] = (squares + float(own @ own), count + own.size)
        self.state = replace(self.state, outputs=outputs)

    def _place(self, time_s: Array, log: Path, overlap: bool) -> Array:
        """Return times that continue from the last log, where the log's own start again."""
        last = self.state.last_s
        if time_s[0] >= ABSOLUTE_S or overlap or last is None:
            return time_s
        if last >= ABSOLUTE_S:
            raise InputError(
                f"{log}: its times count from its begin; expected dates, as in the logs before."
                " State [sensor] time with its format, or begin anew with --reset."
            )
        if time_s[0] > last:
            return time_s
        shift = last + self.deployed.config.sample_period_s - float(time_s[0])
        self._notes.append(
            f"{log}: its times begin anew; it is taken to follow the log before without a gap"
        )
        return time_s + shift

    def _count(self, log: MonitoredLog, told: Left, new: Mask) -> None:
        """Count flags and the ranges that the inputs used."""
        model = self.deployed.model
        flags, told_flags = told.flags[new], dict(self.state.flags)
        for bit, text in FLAG_NAMES.items():
            count = int(np.count_nonzero(flags & bit))
            if count:
                self._flags[text] = self._flags.get(text, 0) + count
                told_flags[text] = told_flags.get(text, 0) + count
        self.state = replace(self.state, flags=told_flags)
        guards = model.guards
        first = (guards.temperature_channel, guards.temperature_low, guards.temperature_high)
        for index, low, high in (first, *guards.ranges):
            channel = model.channels[index]
            values = log.channels[new, index]
            values = values[np.isfinite(values) & (flags & FLAG_NO_READING == 0)]
            if not values.size:
                continue
            limits = [channel.offset + code * channel.lsb for code in (low, high)]
            outside = float(np.mean((values < limits[0]) | (values > limits[1])))
            used = (float(values.min()), float(values.max()))
            before = self._ranges.get(channel.name)
            if before is not None:
                used = (min(used[0], before.low), max(used[1], before.high))
                part = values.size / (self._steps + values.size)
                outside = part * outside + (1.0 - part) * before.outside
            self._ranges[channel.name] = RangeUsed(
                channel.unit, *used, limits[0], limits[1], outside
            )
        self._steps += int(new.sum())

    def judge(self, say: Callable[[str], None] = lambda _: None) -> MonitorResult:
        """Run the sequential test on all logs that were read; return its result."""
        outputs, watched = dict(self.state.outputs), {}
        state = self.state
        number = max(1, len(outputs))
        for output in self.deployed.model.outputs:
            uncertainty = None
            if self.deployed.uncertainty is not None:
                found = self.deployed.uncertainty.outputs.get(output.name)
                uncertainty = found.standard if found is not None else None
            own = outputs.get(output.name)
            if own is None or not own.place:
                watched[output.name] = _tell_nothing(output.unit, uncertainty)
                continue
            say(f"testing {output.name}")
            rules = Rules(
                state.per_month / number,
                state.block_s,
                uncertainty if uncertainty is not None else float(np.std(own.residual)),
                state.learn_s,
            )
            blocks = _whole_blocks(own.blocks, self.deployed.config.sample_period_s, rules)
            followed = follow(blocks, rules, own.learned)
            settled = own.finding if own.finding is not None and own.finding.told else None
            finding = settled or followed.finding or own.finding
            followed = Followed(followed.learned, finding, followed.ready)
            outputs[output.name] = keep_output(own.blocks, followed.learned, finding)
            squares, count = self._squares.get(output.name, (0.0, 0))
            told, verdict, text = _tell(
                self.deployed.sensor, output.name, output.unit, blocks, followed, rules
            )
            watched[output.name] = OutputWatched(
                unit=output.unit,
                state=told,
                verdict=verdict,
                text=text,
                blocks=blocks.place.size,
                blocks_to_learn=followed.ready,
                rms_residual=float(np.sqrt(squares / count)) if count else None,
                uncertainty=uncertainty,
                zero_moved=_measure_move(blocks, followed, rules),
            )
        self.state = replace(state, outputs=outputs)
        return MonitorResult(
            sensor=self.deployed.sensor,
            model_hash=self.deployed.model.hash,
            alarm=any(one.state == ALARM for one in watched.values()),
            alarms_per_unit_month=state.per_month,
            logs=tuple(self._logs),
            steps=self._steps,
            steps_in_all=state.steps,
            flags=self._flags,
            flags_in_all=state.flags,
            ranges=self._ranges,
            outputs=watched,
            last_s=state.last_s,
            notes=tuple(dict.fromkeys(self._notes)),
        )

    @property
    def wants_name(self) -> bool:
        """Whether another unit is in place, so that `seek` may say which."""
        return wants_name(self.state)

    def seek(self, units: Sequence[KnownUnit]) -> UnitSought | None:
        """Return which of the other units of the design is in place, by the logs read so far.

        Args:
            units: those that are known; none gives None.
        """
        parts, self._parts = self._parts, []
        self.state = seek_unit(self.deployed, self._chip, self.state, parts, units)
        return tell_sought(self.state)


def _whole_blocks(blocks: BlockMeans, period_s: float, rules: Rules) -> BlockMeans:
    """Return the blocks without the last one, if that may still gain samples."""
    if not blocks.place.size or blocks.count[-1] >= round(rules.block_s / period_s):
        return blocks
    return blocks.first(blocks.place.size - 1)


def _measure_move(blocks: BlockMeans, followed: Followed, rules: Rules) -> float | None:
    """Return the median of the last day's means less that of the days of learning."""
    if followed.learned is None:
        return None
    later = blocks.place > blocks.place[-1] - DAY_S / rules.block_s
    begin = blocks.residual[: followed.learned.blocks]
    return float(np.median(blocks.residual[later]) - np.median(begin))


def _tell_nothing(unit: str, uncertainty: float | None) -> OutputWatched:
    return OutputWatched(
        unit=unit,
        state=NO_REFERENCE,
        blocks=0,
        blocks_to_learn=0,
        rms_residual=None,
        uncertainty=uncertainty,
        zero_moved=None,
        verdict=ChangeVerdict(),
        text="the true value is not known: flags and range alone are watched until a log is read"
        " with its reference column or --load",
    )


def tell_date(time_s: float) -> str:
    """Return a time as a date, or, on a clock that counts from the first log, in days."""
    if time_s < ABSOLUTE_S:
        return f"day {time_s / DAY_S:.1f}"
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _tell(
    sensor: str, output: str, unit: str, blocks: BlockMeans, followed: Followed, rules: Rules
) -> tuple[str, ChangeVerdict, str]:
    """Return the state of an output, the finding, and what to do.

    A change is told with the time in which it began. What moved while there are no logs moved at
    once or slowly, which the logs before and after do not tell apart.
    """
    finding = followed.finding
    if finding is None:
        if followed.learned is None:
            text = f"learning the noise: {blocks.place.size} of {followed.ready} blocks"
            return LEARNING, ChangeVerdict(), text
        return SOUND, ChangeVerdict(), "nothing has changed"
    alarm_at, since = (
        tell_date(float(blocks.place[i]) * rules.block_s) for i in (finding.alarm, finding.since)
    )
    low, high = finding.begun or _surround(blocks, finding.since)
    from_s, to_s = float(low) * rules.block_s, float(high) * rules.block_s
    between = f"between {tell_date(from_s)} and {tell_date(to_s)}"
    gap_s = _find_gap(blocks, low, high) * rules.block_s
    cause = finding.cause if finding.told is not None else UNDECIDED
    zero, size = f"the zero of {output}", f"{finding.size:.2g} {unit}"
    at_once = (
        f"{between}, at once or slowly: there are no logs of {gap_s / DAY_S:.2g} days of this time"
        if gap_s
        else f"at once, {between}"
    )
    text = {
        STEP: f"recalibrate {sensor}: {zero} moved by {size} {at_once}",
        AGEING: (
            f"recalibrate {sensor}: {zero} moves by {finding.per_day:.2g} {unit} a day along a line"
            f" that began {between}; by {size} until this was sure"
        ),
        OTHER_MODEL: (
            f"check {sensor}: {output} follows temperature as with the right model it would not,"
            " from the first sample on; another unit's model or block is in use, or the unit was"
            " swapped before"
        ),
        OTHER_UNIT: (
            f"check {sensor}: since a time {between} {output} has another zero and follows"
            " temperature; another unit, or another block, is in its place"
        ),
        UNDECIDED: (
            f"watch {sensor}: {output} has changed, {between}; what it is, is not sure yet, most"
            f" likely {finding.cause} ({100.0 * finding.probability:.0f} %)"
        ),
    }[cause]
    told_size = finding.size if finding.cause in (STEP, AGEING) else None
    return (
        ALARM,
        ChangeVerdict(
            cause=cause,
            probability=finding.probability,
            alarm_at=alarm_at,
            since=since,
            from_s=from_s,
            to_s=to_s,
            size=told_size,
            per_day=finding.per_day if cause == AGEING else None,
        ),
        text,
    )


def _surround(blocks: BlockMeans, since: int) -> tuple[int, int]:
    """Return the numbers of the blocks between whose begins a block and the gap before it lie."""
    return int(blocks.place[max(since - 1, 0)]) + min(since, 1), int(blocks.place[since]) + 1


def _find_gap(blocks: BlockMeans, low: int, high: int) -> int:
    """Return the largest number of blocks without logs, one after the other, in a span."""
    inside = blocks.place[(blocks.place >= low) & (blocks.place < high)]
    ends = np.concatenate([[low - 1], inside, [high]])
    return int(np.diff(ends).max()) - 1


# `monitor`: the deployed model, the state of the last call, logs and live sources.

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
        request.learn_days * DAY_S,
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
            f" {kept.per_month:g} --learn-days {kept.learn_s / DAY_S:g}; expected the same, as a"
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
