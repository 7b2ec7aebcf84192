"""The deployed model against new logs: flags, range used, residual, and the sequential test."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.export.integer_model import FLAG_NO_READING
from zerodrift.field.blocks import join_blocks, make_blocks
from zerodrift.field.registry import LEARNING, NO_REFERENCE, SOUND
from zerodrift.field.state import LogSeen, MonitorState, OutputState, keep_output
from zerodrift.field.summary import (
    ALARM,
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
)
from zerodrift.tasks.apply import FLAG_NAMES, Chip
from zerodrift.tasks.monitored_log import (
    Deployed,
    Left,
    MonitoredLog,
    apply_to,
    hash_log,
    open_log,
)
from zerodrift.tasks.swapped import KnownUnit, LogPart, seek_unit, tell_sought, wants_name

ABSOLUTE_S = 1e8
"""Times from here on are dates: 1973 and later; smaller ones count from the log's begin."""
DAY_S = 86_400.0
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
        new: NDArray[np.bool_],
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

    def _count(self, log: MonitoredLog, told: Left, new: NDArray[np.bool_]) -> None:
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
