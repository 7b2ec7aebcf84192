"""The error between chip and float model, row by row: rounding, range, clamp, saturation.

Integer and float model are run over the same rows. A difference no larger than rounding can make is
rounding; a larger one is assigned to the cause that the row shows: a channel outside its calibrated
range, a drift at its limit, an operation or a code at its limit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, Mask
from zerodrift.c_runtime.host import HostModel
from zerodrift.dataset.bridges import predict_all
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import count_elapsed, encode_inputs
from zerodrift.export.encoding import round_channel
from zerodrift.export.float_model import FloatModel
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_RATE_RANGE,
    IntegerModel,
)
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray, IntArray
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.node import ChannelNode
from zerodrift.verify.summary import ChipError

ROUNDING_SHARE = 0.002
"""What the arithmetic's rounding may cost, as a share of the drift's own RMS."""
BEYOND_ROUNDING = 3.0
"""A row whose difference exceeds this multiple of the budgeted rounding has another cause."""


@dataclass(frozen=True)
class RunReplay:
    """One run as the chip and the float model answer it."""

    run: Run
    chip: Array
    """[n, K] the integer model's drift, in each output's unit."""
    floating: Array
    """[n, K] the float model's drift."""
    outside: Mapping[str, Mask]
    """Channel's name, or RATE -> [n] rows on which it is outside its calibrated range."""
    after: Mask
    """[n, K] rows on which an earlier stay outside still moves the answer beyond rounding."""
    clamped: Mask
    """[n, K] the drift stands at its limit."""
    rail: Mask
    """[n, C] a channel's code stands at the end of its type."""

    @property
    def is_outside(self) -> Mask:
        """[n] rows on which any channel, or the rate, is outside."""
        return np.asarray(np.any([*self.outside.values()], axis=0))

    @property
    def inside(self) -> Mask:
        """[n, K] rows that the calibrated ranges cover, after-effects apart."""
        return np.asarray(~(self.is_outside[:, None] | self.after))

    @property
    def difference(self) -> Array:
        """[n, K] integer less float model."""
        return np.asarray(self.chip - self.floating)


RATE = "rate"
"""Stands beside the channels' names in `RunReplay.outside`."""


@dataclass(frozen=True)
class ChipReplay:
    """Integer and float model over the same runs."""

    model: IntegerModel
    runs: tuple[RunReplay, ...]
    budget: Array
    """[K] RMS that rounding may cost: of the inputs' codes, and ROUNDING_SHARE of the drift."""

    @cached_property
    def saturated(self) -> tuple[Mask, ...]:
        """[n] per run: rows on which an operation or a code stands at its limit.

        Only looked for in runs with rows that nothing else explains.
        """
        found = []
        for replayed in self.runs:
            left = self._is_large(replayed) & replayed.inside & ~replayed.clamped
            stands: Mask = np.any(replayed.rail, axis=1)
            if left.any():
                stands = stands | find_saturated(self.model, replayed.run)
            found.append(stands)
        return tuple(found)

    @cached_property
    def _causes(self) -> tuple[tuple[Mask, Mask, Mask, Mask], ...]:
        """Per run the rows [n, K] that belong to each cause, in the order of `ChipError`."""
        found = []
        for replayed, saturated in zip(self.runs, self.saturated, strict=True):
            large = self._is_large(replayed)
            beyond = large & ~replayed.inside
            clamped = large & ~beyond & replayed.clamped
            full = large & ~beyond & ~clamped & saturated[:, None]
            found.append((~(beyond | clamped | full), beyond, clamped, full))
        return tuple(found)

    def split(self) -> tuple[ChipError, ...]:
        """Return the difference of each output by cause."""
        squares = np.zeros((4, self.budget.size))
        for replayed, causes in zip(self.runs, self._causes, strict=True):
            for i, rows in enumerate(causes):
                squares[i] += np.sum(np.where(rows, replayed.difference, 0.0) ** 2, axis=0)
        rms = np.sqrt(squares / max(sum(len(replayed.run) for replayed in self.runs), 1))
        return tuple(ChipError(*(float(x) for x in column)) for column in rms.T)

    def list_plain_rows(self) -> tuple[Mask, ...]:
        """Return the rows [n] of each run on which nothing but rounding separates the models."""
        plain = []
        for causes, replayed in zip(self._causes, self.runs, strict=True):
            rounding: Mask = np.all(causes[0], axis=1)
            plain.append(rounding & ~replayed.is_outside)
        return tuple(plain)

    def _is_large(self, replayed: RunReplay) -> Mask:
        """[n, K] rows that differ by more than rounding can."""
        return np.asarray(np.abs(replayed.difference) > BEYOND_ROUNDING * self.budget)


def replay_runs(floating: FloatModel, host: HostModel, runs: Sequence[Run]) -> ChipReplay:
    """Run the integer and the float model over the same rows.

    Args:
        floating: the float model.
        host: the integer model's C, shown equal to the reference.
        runs: measurements.
    """
    model = host.model
    chip = predict_all(lambda run: _run_chip(host, run), runs)
    answers = floating.predict_all_on_chip(runs)
    budget = measure_rounding(floating, model, runs, answers)
    outputs = len(model.outputs)
    scale = np.array([output.lsb_per_unit for output in model.outputs], dtype=np.float64)
    low, high = np.array(model.drift.low), np.array(model.drift.high)
    names = [*(channel.name for channel in model.channels), RATE]
    replays = []
    for run, columns, answer in zip(runs, chip, answers, strict=True):
        drift, flags = columns[:, :outputs], columns[:, outputs].astype(np.int64)
        outside = columns[:, outputs + 1 : outputs + 1 + len(names)] > 0.0
        limited = ((flags & FLAG_CLAMPED) > 0)[:, None] & ((drift <= low) | (drift >= high))
        replays.append(
            RunReplay(
                run=run,
                chip=drift / scale,
                floating=answer,
                outside=dict(zip(names, outside.T, strict=True)),
                after=np.zeros(drift.shape, dtype=np.bool_),
                clamped=limited,
                rail=columns[:, outputs + 1 + len(names) :] > 0.0,
            )
        )
    replays = _find_after_effects(floating, model, replays, budget)
    return ChipReplay(model, tuple(replays), budget)


def _run_chip(host: HostModel, run: Run) -> Array:
    """Return [n, K + 1 + C + 1 + C] of a whole run: counts, flags, channels and rate outside,
    channels at a rail."""
    model = host.model
    codes = encode_inputs(model, run)
    trace = host.run(codes, elapsed=count_elapsed(model, run))
    return np.column_stack(
        [
            trace.drift,
            trace.flags,
            find_outside(model, codes, trace.drift, trace.flags),
            find_rails(model, codes),
        ]
    ).astype(np.float64)


def find_outside(
    model: IntegerModel, codes: CodeArray, drift: NDArray[np.int32], flags: NDArray[np.uint32]
) -> Mask:
    """Return [n, C + 1] which channels, and last the rate, are outside their calibrated ranges.

    The temperature's range, and that of every channel that has one, is that of its flag; of the
    others, and of loads, it is that beyond which the chip limits them.
    """
    outside = np.zeros((len(codes), len(model.channels) + 1), dtype=np.bool_)
    wide = model.convert(codes)
    before = np.concatenate([drift[:1], drift[:-1]]).astype(np.int64)
    for node in model.nodes:
        if isinstance(node, ChannelNode):
            value = wide[:, node.channel]
            if isinstance(node, IntegerLoad):
                value = value - before[:, node.output]
            outside[:, node.channel] |= (value < node.low) | (value > node.high)
    guards = model.guards
    for channel, low, high in guards.ranges:
        outside[:, channel] = (wide[:, channel] < low) | (wide[:, channel] > high)
    temperature = wide[:, guards.temperature_channel]
    beyond = (temperature < guards.temperature_low) | (temperature > guards.temperature_high)
    outside[:, guards.temperature_channel] = beyond
    outside[:, -1] = (flags & FLAG_RATE_RANGE) > 0
    return outside


def find_rails(model: IntegerModel, codes: CodeArray) -> Mask:
    """Return [n, C] rows on which a code stands at the end of its type."""
    least = np.array([channel.raw_least for channel in model.channels], dtype=np.int64)
    most = np.array([channel.raw_most for channel in model.channels], dtype=np.int64)
    wide = codes.astype(np.int64)
    return np.asarray((wide <= least) | (wide >= most))


def measure_rounding(
    floating: FloatModel, model: IntegerModel, runs: Sequence[Run], answers: Sequence[Array]
) -> Array:
    """Return the RMS [K] that rounding is budgeted with, in the outputs' units.

    It is the change of the float model's answer when its inputs are rounded to codes, which no
    arithmetic on the chip can correct, and ROUNDING_SHARE of the drift for all arithmetic after
    that.
    """
    rounded = predict_all(lambda run: floating.predict_on_chip(_round_inputs(model, run)), runs)
    inputs = np.concatenate(rounded) - np.concatenate(answers)
    drift = np.concatenate([run.drift - run.drift.mean(axis=0) for run in runs])
    own = ROUNDING_SHARE**2 * np.mean(drift**2, axis=0)
    return np.asarray(np.sqrt(np.mean(inputs**2, axis=0) + own))


def _round_inputs(model: IntegerModel, run: Run) -> Run:
    """Return a run with every channel rounded to its codes, however large these would be."""
    names = [output.name for output in model.outputs]
    inputs, measured = dict(run.inputs), run.measured.copy()
    temperature = run.temperature_degC
    for channel in model.channels:
        if channel.source == "temperature_degC":
            temperature = round_channel(channel, temperature)
        elif channel.source.startswith(MEASURED):
            k = names.index(channel.source.removeprefix(MEASURED))
            measured[:, k] = round_channel(channel, measured[:, k])
        else:
            inputs[channel.source] = round_channel(channel, run.inputs[channel.source])
    return replace(run, temperature_degC=temperature, measured=measured, inputs=inputs)


def _find_after_effects(
    floating: FloatModel, model: IntegerModel, replays: Sequence[RunReplay], budget: Array
) -> list[RunReplay]:
    """Mark the rows on which the float model remembers more than the chip could see.

    Outside its range the chip limits a channel, and a lag carries the error on. Its extent is the
    change of the float model's answer when the same rows are limited.
    """
    if not any(replayed.is_outside.any() for replayed in replays):
        return list(replays)
    groups = {r.run.group for r in replays if r.is_outside.any()}
    concerned = [r for r in replays if r.run.group in groups]
    limited = predict_all(
        lambda run: floating.predict_on_chip(_limit_outside(model, run)),
        [replayed.run for replayed in concerned],
    )
    by_name = {r.run.name: answer for r, answer in zip(concerned, limited, strict=True)}
    marked = []
    for replayed in replays:
        if replayed.run.name in by_name:
            moved = np.abs(by_name[replayed.run.name] - replayed.floating)
            marked.append(replace(replayed, after=moved > BEYOND_ROUNDING * budget))
        else:
            marked.append(replayed)
    return marked


def _limit_outside(model: IntegerModel, run: Run) -> Run:
    """Return a run with its temperature and inputs as the chip limits them, where it flags them."""
    guards = model.guards
    inputs, temperature = dict(run.inputs), run.temperature_degC
    for node in model.nodes:
        if not isinstance(node, IntegerInput):
            continue
        channel = model.channels[node.channel]
        low, high = (channel.offset + channel.lsb * end for end in (node.low, node.high))
        if node.channel == guards.temperature_channel:
            bottom = channel.offset + channel.lsb * guards.temperature_low
            top = channel.offset + channel.lsb * guards.temperature_high
            beyond = (temperature < bottom) | (temperature > top)
            temperature = np.where(beyond, np.clip(temperature, low, high), temperature)
        else:
            inputs[channel.source] = np.clip(run.inputs[channel.source], low, high)
    return replace(run, temperature_degC=temperature, inputs=inputs)


def find_saturated(model: IntegerModel, run: Run) -> Mask:
    """Return [n] rows of a run, begun at rest, on which an operation stands at its limit."""
    codes = encode_inputs(model, run)
    stands = np.zeros(len(codes), dtype=np.bool_)
    limits = [(node.name, *ends) for node in model.nodes if (ends := node.ends)]

    def look(step: int, values: dict[str, IntArray]) -> None:
        for name, low, high in limits:
            value = values[name][0]
            if np.any((value <= low) | (value >= high)):
                stands[step] = True
                return

    Reference(model).run(codes[None], elapsed=count_elapsed(model, run), observe=look)
    return stands
