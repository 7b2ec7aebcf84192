"""The error between chip and float model, row by row: rounding, range, clamp, saturation.

Integer and float model are run over the same rows. A difference no larger than rounding can make is
rounding; a larger one is assigned to the cause that the row shows: a channel outside its calibrated
range, a drift at its limit, an operation or a code at its limit.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.c_runtime.host import HostModel
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.dataset.runs import Run, predict_all
from zerodrift.export.compose import count_elapsed, encode_inputs
from zerodrift.export.encoding import round_channel
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_RATE_RANGE,
    IntegerModel,
)
from zerodrift.export.quantize import choose_feature_exponents, quantize_graph
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.operations.backend import NumpyOperations
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.node import ChannelNode
from zerodrift.operations.operation import Node, list_nodes
from zerodrift.verify.mismatch import label_columns
from zerodrift.verify.summary import ChipError

# The error that each operation of the chip's arithmetic adds, in the outputs' units, and over
# time.
#
# The integer model differs from the float one in many small ways. To separate them, the float model
# is turned into the integer one node by node, in the order of the arithmetic: up to some node all
# is as on the chip, from there on all is float. The change of the answer when a node becomes
# integer is that node's cost. The costs, as signals, add up to the whole difference.

LONGEST_RUN_STEPS = 20_000
DECADES = (100, 1000, 10_000, 100_000, 1_000_000)


@dataclass(frozen=True)
class NodeCost:
    """What one node of the integer model adds to the error."""

    node: str
    kind: str
    rms: Array
    """[K] in the outputs' units."""


@dataclass(frozen=True)
class Span:
    """The difference of integer and float model between two steps of a long run."""

    first_step: int
    last_step: int
    rms: Array
    """[K] in the outputs' units."""


@dataclass(frozen=True)
class ErrorBudget:
    """Where the error of the integer model comes from."""

    total: Array
    """[K] RMS difference of integer and float model, in the outputs' units."""
    nodes: tuple[NodeCost, ...]
    """In the order of the arithmetic; as signals they add up to the total."""
    over_time: tuple[Span, ...]

    @property
    def largest(self) -> tuple[NodeCost, ...]:
        """The nodes by their largest share of any output's total, largest first."""
        floor = np.maximum(self.total, np.finfo(np.float64).tiny)
        return tuple(sorted(self.nodes, key=lambda n: -float((n.rms / floor).max())))


def measure_budget(
    described: FloatModel,
    calibration: Calibration,
    host: HostModel,
    runs: Sequence[Run],
    steps: int = DECADES[-1],
    *,
    plain: Sequence[Mask] | None = None,
) -> ErrorBudget:
    """Return the error budget of a quantized compensator.

    Args:
        described: the float model that was quantized.
        calibration: what it was quantized with.
        host: the integer model's C, built to be observed and shown equal to the reference.
        runs: measurements, preferably held out.
        steps: length of the run that is followed over time.
        plain: [n] per run: rows that count, those on which nothing but rounding separates the two
            models; None: all.
    """
    masks = plain or [np.ones(len(run), dtype=np.bool_) for run in runs]
    there = np.concatenate([mask[:LONGEST_RUN_STEPS] for mask in masks])
    longest = max((_take_longest(*pair) for pair in zip(runs, masks, strict=True)), key=len)
    runs = [run.at_rest().take(slice(LONGEST_RUN_STEPS)) for run in runs]  # as the C is started
    levels = _Levels(described, calibration, host.model)
    traces = [_observe(host, run) for run in runs]
    inputs = [described.read_inputs_on_chip(run) for run in runs]
    answers = [
        np.concatenate(parts) for parts in zip(*levels.answer_all(inputs, traces), strict=True)
    ]
    answers = [answer[there] for answer in answers]
    costs = [after - before for before, after in itertools.pairwise(answers)]
    kinds = {node.name: node.kind for node in host.model.nodes}
    return ErrorBudget(
        total=_rms(answers[-1] - answers[0]),
        nodes=tuple(
            NodeCost(name, kinds[name], _rms(cost))
            for name, cost in zip(levels.order, costs, strict=True)
        ),
        over_time=follow_over_time(described, host, longest, steps),
    )


def _take_longest(run: Run, mask: Mask) -> Run:
    """Return the longest stretch of a run's rows that count, begun at rest."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    begins, ends = edges[::2], edges[1::2]
    if not begins.size:
        return run.at_rest().take(slice(0))
    longest = int(np.argmax(ends - begins))
    first = int(begins[longest])
    last = min(int(ends[longest]), first + LONGEST_RUN_STEPS)
    return run.at_rest().take(slice(first, last))


def follow_over_time(
    described: FloatModel, host: HostModel, run: Run, steps: int
) -> tuple[Span, ...]:
    """Return the difference of integer and float model by decades of a run without end.

    Args:
        described: the float model.
        host: the integer model's C.
        run: is played forwards and backwards in turn, so that nothing jumps.
        steps: how far.
    """
    endless = repeat_run(run, steps)
    scale = np.array([output.lsb_per_unit for output in host.model.outputs], dtype=np.float64)
    drift = np.empty((steps, scale.size))
    codes = encode_inputs(host.model, endless)
    for first in range(0, steps, LONGEST_RUN_STEPS):  # bounds the memory of the trace
        part = host.run(
            codes[first : first + LONGEST_RUN_STEPS],
            restart=first == 0,
            elapsed=count_elapsed(host.model, endless),
        )
        drift[first : first + LONGEST_RUN_STEPS] = part.drift / scale
    difference = drift - described.predict_on_chip(endless)
    ends = [0, *(d for d in DECADES if d < steps), steps]
    return tuple(
        Span(first, last, _rms(difference[first:last])) for first, last in itertools.pairwise(ends)
    )


def repeat_run(run: Run, steps: int) -> Run:
    """Return `steps` samples of a run that goes to its end and back again, over and over."""
    period = np.concatenate([np.arange(len(run)), np.arange(len(run))[::-1]])
    order = np.resize(period, steps)
    return replace(
        run,
        time_s=run.time_s[0] + np.arange(steps) * run.sample_period_s,
        temperature_degC=run.temperature_degC[order],
        measured=run.measured[order],
        reference=run.reference[order],
        inputs={name: values[order] for name, values in run.inputs.items()},
    )


class _Levels:
    """The model with its first nodes as on the chip and the others in float."""

    def __init__(
        self, described: FloatModel, calibration: Calibration, model: IntegerModel
    ) -> None:
        self._float, self._model = described, model
        quantized = quantize_graph(described, calibration)
        self._nodes = list_nodes([*described.features, *described.taps])
        self._features, self._signals = quantized.features, quantized.signals
        self._scales = quantized.scales
        self._feature_scale = 2.0 ** -choose_feature_exponents(calibration).astype(np.float64)
        self.order = [node.name for node in model.nodes]

    def answer_all(
        self, inputs: Sequence[Mapping[str, Array]], traces: Sequence[Mapping[str, Array]]
    ) -> list[list[Array]]:
        """Return the drift [n, K] of every run at every level, from all float to all integer."""
        levels = [set(self.order[:count]) for count in range(len(self.order) + 1)]
        parts = [
            [self._evaluate(level, *run) for level in levels]
            for run in zip(inputs, traces, strict=True)
        ]
        network, window = self._float.network, self._float.window
        first, floating = 0, iter(list[Array]())
        if network is not None:
            first = self.order.index("features") + 2  # the level with a layer on the chip
            taken = [x for run in parts for _, x in run[:first]]
            floating = iter(run_together(network, taken, window))
        lsb_per_unit = np.array([output.lsb_per_unit for output in self._model.outputs])
        found = []
        for run, trace in zip(parts, traces, strict=True):
            answers = [physical + next(floating) for physical, _ in run[:first]]
            for level, (physical, x) in zip(levels[first:-1], run[first:], strict=False):
                answers.append(physical + self._run_network(level, x, trace))
            found.append([*answers, trace["drift"] / lsb_per_unit])
        return found

    def _run_network(
        self, level: set[str], features: Array, trace: Mapping[str, Array]
    ) -> Array | float:
        """Return the network's answer [n, K] with its first nodes as on the chip; 0 without one."""
        network, scales = self._float.network, self._scales
        if network is None or scales is None:
            return 0.0
        if "head" in level:
            return np.asarray(trace["head"] * 2.0**-scales.head + network.head_bias)
        known = {
            layer: trace[name] * 2.0**-exponents
            for name, (layer, exponents) in scales.layers.items()
            if name in level
        }
        return network.answer_from(features, self._float.window, known)

    def _evaluate(
        self, level: set[str], inputs: Mapping[str, Array], trace: Mapping[str, Array]
    ) -> tuple[Array, Array]:
        """Return the physical part [n, K] and the network's features [n, I], if there is one."""
        count = next(iter(trace.values())).shape[0]
        ops = NumpyOperations(self._float.sample_period_s, (count,))
        values: dict[Node, Array] = {}
        for node in self._nodes:
            signal = self._signals[node]
            if signal.node in level:
                values[node] = trace[signal.node][:, 0] * signal.scale + signal.offset
            elif node.op == "input":
                values[node] = inputs[node.source][:count]
            else:
                arguments = [values[child] for child in node.inputs]
                values[node] = ops.compute(node, arguments)
        physical = np.broadcast_to(self._float.offset, (count, self._float.offset.size)).copy()
        for node, signal, row in zip(
            self._float.features, self._features, self._float.coefficients, strict=True
        ):
            if signal.node in level:  # as the chip holds it far beyond calibration
                value = trace[signal.node][:, 0] * signal.scale + signal.offset
            else:
                value = values[node]
            physical += value[:, None] * row
        if self._float.network is None:
            return physical, np.zeros((count, 0))
        if "features" in level:
            return physical, trace["features"] * self._feature_scale
        assert self._float.tap_mean is not None and self._float.whitening is not None
        taps = np.stack([values[node] for node in self._float.taps], axis=1)
        return physical, (taps - self._float.tap_mean) @ self._float.whitening.T


def run_together(network: FloatNetwork, features: Sequence[Array], window: int) -> list[Array]:
    """Return the network's answers [n, K] for each of several feature sequences [n, I], from rest.

    Args:
        network: the float network.
        features: sequences of any lengths; equal ones are computed once.
        window: samples per window; 0 carries the state.
    """
    keys = [x.tobytes() for x in features]
    distinct = list(dict(zip(keys, features, strict=True)).values())
    if window:
        found = [network.answer_from(x, window, {}) for x in distinct]
    else:
        longest = max(len(x) for x in distinct)
        padded = np.stack([np.pad(x, ((0, longest - len(x)), (0, 0)), "edge") for x in distinct])
        answers = network.run(padded, network.settle(padded[:, 0]))
        found = [answer[: len(x)] for x, answer in zip(distinct, answers, strict=True)]
    by_key = dict(zip(dict.fromkeys(keys), found, strict=True))
    return [by_key[key] for key in keys]


def _observe(host: HostModel, run: Run) -> dict[str, Array]:
    """Return the values [n, width] of every node as the C computes them."""
    codes = encode_inputs(host.model, run)
    columns = host.run(codes, elapsed=count_elapsed(host.model, run)).nodes.astype(np.float64)
    assert columns.shape[1] == len(label_columns(host.model))
    trace, first = {}, 0
    for node in host.model.nodes:
        trace[node.name] = columns[:, first : first + max(node.width, 1)]
        first += max(node.width, 1)
    return trace


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(x**2, axis=0)))


# The error between chip and float model, row by row: rounding, range, clamp, saturation.

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

    def predict_limited(run: Run) -> Array:
        return floating.predict_on_chip(_limit_outside(model, run, floating.predict_on_chip(run)))

    limited = predict_all(predict_limited, [replayed.run for replayed in concerned])
    by_name = {r.run.name: answer for r, answer in zip(concerned, limited, strict=True)}
    marked = []
    for replayed in replays:
        if replayed.run.name in by_name:
            moved = np.abs(by_name[replayed.run.name] - replayed.floating)
            marked.append(replace(replayed, after=moved > BEYOND_ROUNDING * budget))
        else:
            marked.append(replayed)
    return marked


def _limit_outside(model: IntegerModel, run: Run, answer: Array) -> Run:
    """Return a run with temperature, inputs and loads as the chip limits them, where it flags them.

    A load is what was measured less the answer [n, K] of the step before.
    """
    guards = model.guards
    inputs, temperature, measured = dict(run.inputs), run.temperature_degC, run.measured.copy()
    before = np.concatenate([answer[:1], answer[:-1]])
    for node in model.nodes:
        if isinstance(node, IntegerLoad):
            k, lsb = node.output, model.channels[node.channel].lsb
            load = np.clip(measured[:, k] - before[:, k], lsb * node.low, lsb * node.high)
            measured[:, k] = load + before[:, k]
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
    return replace(run, temperature_degC=temperature, inputs=inputs, measured=measured)


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
