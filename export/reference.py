"""The integer model run in NumPy: the normative meaning of every bit, a batch of sequences at once.

One step reads like the specification: each node in order takes its inputs' values and its state.
The generated C must equal it at 0 LSB, flags and states included.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import IntArray, Mask
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TARED,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    IntegerModel,
)
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN, CodeArray, saturate
from zerodrift.operations.load import START_PASSES
from zerodrift.operations.node import CODES, ELAPSED, PREVIOUS_DRIFT, IntegerNode, State
from zerodrift.operations.tables import is_watched
from zerodrift.operations.times import LONGEST_US, exceeds_rate, hold_time

# Many steps of the reference at once: nodes without a state are computed for all of them together.
#
# The arithmetic is that of the nodes themselves, and only the order of the loops differs: step by
# step goes over all nodes at each step; here each node goes over all steps, and those that carry
# something from one step to the next do so step by step. Every number is the same.

STRETCH_ROWS = 1 << 14
"""Steps times sequences of one stretch; more than that leaves the processor's cache."""


@dataclass(frozen=True)
class StretchResult:
    """The nodes' part of some steps of a batch."""

    nodes: dict[str, State]
    """After the last step."""
    unlimited: IntArray
    """[T, B, K] drift before it is limited."""
    drift: IntArray
    """[T, B, K]"""
    hidden: list[IntArray]
    """Per streaming recurrent layer [T, B, H] its output in Q1.30."""


def can_stretch(model: IntegerModel) -> bool:
    """Tell whether no step of a model needs more of the one before than states of its nodes.

    Not while someone is told which lines of a table are read: he is told so step by step.
    """
    return not (model.feeds_back or model.tare or model.variable_step or is_watched())


def hold_readings(codes: IntArray, missing: Mask, last: IntArray) -> IntArray:
    """Return codes [T, B, C] with the last reading in the place of each that is none.

    Args:
        codes: of the steps.
        missing: [T, B, C] which of them are none.
        last: [B, C] the readings before the first step.
    """
    if not missing.any():
        return codes
    steps = np.arange(1, len(codes) + 1)[:, None, None]
    since = np.maximum.accumulate(np.where(missing, 0, steps), axis=0)
    return np.take_along_axis(np.concatenate([last[None], codes]), since, axis=0)


def run_stretch(
    model: IntegerModel, nodes_before: Mapping[str, State], codes: IntArray
) -> StretchResult:
    """Return what the nodes make of readings [T, B, C], from a state that is not new.

    Args:
        model: one that `can_stretch`.
        nodes_before: their states before the first step.
        codes: the channels' codes, none of them missing.
    """
    steps, batch, _ = codes.shape
    flat: dict[str, IntArray] = {
        CODES: codes.reshape(steps * batch, -1),
        ELAPSED: np.zeros(steps * batch, dtype=np.int64),
    }
    nodes: dict[str, State] = {}
    hidden: list[IntArray] = []
    streaming = {layer.name for layer in model.recurrents if layer.streams}
    for node in model.nodes[:-1]:
        before = nodes_before[node.name]
        if not before:
            nodes[node.name], flat[node.name] = node.step(before, flat)
            continue
        kept: list[IntArray] | None = [] if node.name in streaming else None
        nodes[node.name], flat[node.name] = _go_on(node, before, flat, batch, kept)
        if kept is not None:
            hidden.append(np.stack(kept))
    last = model.drift
    unlimited = last.sum(flat)
    drift = last.limit(unlimited)
    nodes[last.name] = {}
    shape = (steps, batch, -1)
    return StretchResult(nodes, unlimited.reshape(shape), drift.reshape(shape), hidden)


def _go_on(
    node: IntegerNode,
    state: State,
    flat: Mapping[str, IntArray],
    batch: int,
    kept: list[IntArray] | None,
) -> tuple[State, IntArray]:
    """Return a node's state after all steps and its output at each, [T B] or [T B, width].

    Args:
        node: that has a state.
        state: before the first step.
        flat: what it reads, as its output.
        batch: B.
        kept: takes a recurrent layer's output after each step.
    """
    given = {name: flat[name] for name in (*node.inputs, CODES, ELAPSED)}
    rows = len(given[CODES])
    outputs = []
    for first in range(0, rows, batch):
        now = {name: values[first : first + batch] for name, values in given.items()}
        state, output = node.step(state, now)
        outputs.append(output)
        if kept is not None:
            kept.append(state["h_q30"])
    return state, np.concatenate(outputs)


# The integer model run in NumPy: the normative meaning of every bit, a batch of sequences at once.

Observer = Callable[[int, dict[str, IntArray]], None]
"""Called after every step with its number and the values of all nodes."""


@dataclass(frozen=True)
class ModelState:
    """The state of a batch of B running compensators; all zero where one is new."""

    nodes: dict[str, State]
    steps: IntArray
    """[B] steps since `init`, saturating at max(warm_up_steps, 1); 0: new, no reading yet."""
    previous: IntArray  # [B] last temperature code
    held: IntArray
    """[B, H] last readings of the other inputs that may have none."""
    slept: IntArray
    """[B, 1] microseconds to add to the next step with a variable step, else [B, 0]."""
    tare: IntArray
    """[B, 2 K + 1] where the drift can be counted from a moment on, else [B, 0]: the last answers,
    the drifts that are taken off, and 0 before the first answer, 1 after it, 2 once tared."""
    drift: IntArray
    """[B, K] drift of the last step where the model reads it, else [B, 0]."""

    def pack(self) -> IntArray:
        """Return all of it as [B, n]: steps, previous, held, slept, tare, drift, then the nodes.

        Delay lines and windows stand oldest first, whatever ring the C keeps them in.
        """
        batch = self.steps.size
        columns = [self.steps[:, None], self.previous[:, None], self.held]
        columns += [self.slept, self.tare, self.drift]
        for state in self.nodes.values():
            columns += [state[key].reshape(batch, -1) for key in sorted(state)]
        return np.concatenate(columns, axis=1)

    def unpack(self, packed: IntArray) -> "ModelState":
        """Return the state that `pack` turned into `packed` [B, n]; self gives the layout."""
        slept = 2 + self.held.shape[1]
        tare = slept + self.slept.shape[1]
        drift = tare + self.tare.shape[1]
        batch, column = packed.shape[0], drift + self.drift.shape[1]
        first_field = column
        nodes: dict[str, State] = {}
        for name, state in self.nodes.items():
            fields = {}
            for key in sorted(state):
                shape = state[key].shape[1:]
                size = int(np.prod(shape, dtype=np.int64))
                fields[key] = packed[:, column : column + size].reshape((batch, *shape))
                column += size
            nodes[name] = fields
        return ModelState(
            nodes=nodes,
            steps=packed[:, 0],
            previous=packed[:, 1],
            held=packed[:, 2:slept],
            slept=packed[:, slept:tare],
            tare=packed[:, tare:drift],
            drift=packed[:, drift:first_field],
        )

    def choose(self, rows: Mask, other: "ModelState") -> "ModelState":
        """Return the state whose rows [B] are those of another."""
        return self.unpack(np.where(rows[:, None], other.pack(), self.pack()))


@dataclass(frozen=True)
class ReferenceTrace:
    """The results of a run, step by step."""

    drift: NDArray[np.int32]  # [B, T, K]
    flags: NDArray[np.uint32]  # [B, T]
    hidden: NDArray[np.int32]
    """[B, T, H] outputs of streaming recurrent layers in Q1.30 after each step; H = 0 without."""
    state: ModelState


class Reference:
    """Runs an `IntegerModel`."""

    def __init__(self, model: IntegerModel) -> None:
        self.model = model
        self._full = max(model.guards.warm_up_steps, 1)
        self._optional = np.array([c.no_reading is not None for c in model.channels])
        self._no_reading = np.array([c.no_reading or 0 for c in model.channels], dtype=np.int64)
        self._slept = int(model.variable_step)
        self._outputs = len(model.outputs)

    def start(self, codes: IntArray, *, settled: bool, elapsed: int = 0) -> ModelState:
        """Return the state before the first step, whose codes [B, C] are given.

        Args:
            codes: [B, C] as the chip is given them; a step's time behind them counts for nothing.
            settled: True for `settle` (at rest at these codes, or new where one is no reading),
                False for `init` (new), after which the first step that has readings takes its
                linear parts to be at rest but the network to be cold.
            elapsed: steps since power-on, for a log that starts later; 0 on the chip.
        """
        return self._start(self._split(codes)[0], settled=settled, elapsed=elapsed)

    def sleep(self, state: ModelState, age_us: int) -> ModelState:
        """Return a saved state as it is restored after some time, of a model with a variable step.

        Args:
            state: that was saved.
            age_us: microseconds since then, 0 .. 2**64 - 1.
        """
        slept = np.minimum(state.slept + min(age_us, LONGEST_US), LONGEST_US)
        return replace(state, slept=slept)

    def take_tare(self, state: ModelState) -> ModelState:
        """Return the state after `tare`: drift counts from the last answer, where there is one."""
        count, tare = self._outputs, state.tare.copy()
        answered = tare[:, -1] > 0
        tare[answered, count:-1] = tare[answered, :count]
        tare[answered, -1] = 2
        return replace(state, tare=tare)

    def release_tare(self, state: ModelState) -> ModelState:
        """Return the state after `untare`: drift counts from 0."""
        tare = state.tare.copy()
        tare[:, -1] = np.minimum(tare[:, -1], 1)
        return replace(state, tare=tare)

    def _count_from(
        self, state: ModelState, drift: IntArray, flags: IntArray
    ) -> tuple[ModelState, IntArray, IntArray]:
        """Return the state with the answers kept, drift [B, K] from the tare on, and flags [B]."""
        count = self._outputs
        tared = state.tare[:, -1] == 2
        wide = drift - state.tare[:, count:-1]
        counted = np.where(tared[:, None], saturate(wide, INT32_MIN, INT32_MAX), drift)
        limited = tared & (counted != wide).any(axis=1)
        kept = np.where(tared, 2, 1)[:, None]
        tare = np.concatenate([drift, state.tare[:, count:-1], kept], axis=1)
        raised = (flags | (FLAG_CLAMPED * limited)) + FLAG_TARED * tared
        return replace(state, tare=tare), counted, np.asarray(raised)

    def _split(self, given: IntArray) -> tuple[IntArray, IntArray]:
        """Return the channels' codes [..., C] and the time of the step [...], 0 if none is told."""
        codes = self.model.convert(given)
        if not self.model.variable_step:
            return codes, np.zeros(codes.shape[:-1], dtype=np.int64)
        return codes[..., :-1], hold_time(codes[..., -1])

    def _start(self, codes: IntArray, *, settled: bool, elapsed: int) -> ModelState:
        """Return the state before the first step, whose channels' codes [B, C] are given."""
        state = self._begin(codes, settled=settled, elapsed=elapsed)
        new = np.asarray(self._find_missing(codes).any(axis=1) | (not settled))
        return state.choose(new, state.unpack(np.zeros_like(state.pack())))

    def _begin(self, codes: IntArray, *, settled: bool, elapsed: int = 0) -> ModelState:
        """Return the state at rest at codes [B, C], all of which are readings."""
        batch = codes.shape[0]
        drift = np.zeros((batch, len(self.model.outputs)), dtype=np.int64)
        for _ in range(START_PASSES if self.model.feeds_back else 0):
            drift = self._rest(codes, drift, settled, elapsed)[1]
        return ModelState(
            nodes=self._rest(codes, drift, settled, elapsed)[0],
            steps=np.full(batch, self._full if settled else 0, dtype=np.int64),
            previous=codes[:, self.model.guards.temperature_channel].astype(np.int64),
            held=codes[:, self.model.held].astype(np.int64),
            slept=np.zeros((batch, self._slept), dtype=np.int64),
            tare=np.zeros((batch, (2 * self._outputs + 1) * self.model.tare), dtype=np.int64),
            drift=drift if self.model.feeds_back else drift[:, :0],
        )

    def _find_missing(self, codes: IntArray) -> Mask:
        """Return where codes [B, C] mean that there is no reading."""
        return np.asarray((codes == self._no_reading) & self._optional)

    def _hold(self, state: ModelState, codes: IntArray, missing: Mask) -> IntArray:
        """Return codes [B, C] with the last reading in the place of each that is none."""
        return np.where(missing, self._recall(state, codes), codes)

    def _recall(self, state: ModelState, codes: IntArray) -> IntArray:
        """Return codes [B, C] with the last readings of all channels that may have none."""
        last = codes.copy()
        last[:, self.model.guards.temperature_channel] = state.previous
        last[:, self.model.held] = state.held
        return last

    def _rest(
        self, codes: IntArray, drift: IntArray, settled: bool, elapsed: int
    ) -> tuple[dict[str, State], IntArray]:
        """Return all nodes' states at rest, and the drift [B, K] there."""
        values: dict[str, IntArray] = {CODES: codes.astype(np.int64), PREVIOUS_DRIFT: drift}
        values[ELAPSED] = np.zeros(codes.shape[0], dtype=np.int64)
        states: dict[str, State] = {}
        stacked = sum(layer.streams for layer in self.model.recurrents) > 1
        resting = dict(values)  # what settles stands on what is settled, not a step further
        for node in self.model.nodes:
            given = resting if stacked else values
            state = node.settle(given) if settled else node.rest(given)
            states[node.name] = node.elapse(state, elapsed)
            _, values[node.name] = node.step(states[node.name], values)
            if stacked:
                resting[node.name] = node.at_rest(states[node.name], resting)
        return states, values[self.model.drift.name]

    def step(
        self, state: ModelState, codes: IntArray
    ) -> tuple[ModelState, dict[str, IntArray], IntArray, IntArray]:
        """Return the next state, all nodes' values, drift [B, K] and flags [B].

        While a state is new and an input has no reading, it stays new, and all values are 0.
        """
        return self._step(state, *self._split(codes))

    def _step(
        self, state: ModelState, codes: IntArray, time_us: IntArray
    ) -> tuple[ModelState, dict[str, IntArray], IntArray, IntArray]:
        """Return what `step` does, of the channels' codes and the time of the step."""
        missing = self._find_missing(codes)
        no_reading, new = missing.any(axis=1), state.steps == 0
        if no_reading.any():
            codes = self._hold(state, codes, missing)
        begins, waits = new & ~no_reading, new & no_reading
        if begins.any():
            state = state.choose(begins, self._begin(codes, settled=False))
        span_us = time_us
        if self._slept:
            span_us = np.minimum(time_us + state.slept[:, 0], LONGEST_US)
        span_us = np.where(new, 0, span_us)  # nothing lies before the first step
        after, values, drift, flags = self._advance(state, codes, span_us)
        if self.model.tare:
            after, drift, flags = self._count_from(after, drift, flags)
        if waits.any():
            after = after.choose(waits, state)
            values = {
                name: np.where(waits.reshape(-1, *(1,) * (x.ndim - 1)), 0, x)
                for name, x in values.items()
            }
            drift = np.where(waits[:, None], 0, drift)
            flags = np.where(waits, self._flag_start(state), flags)
        return after, values, drift, np.asarray(flags + FLAG_NO_READING * no_reading)

    def _advance(
        self, state: ModelState, codes: IntArray, span_us: IntArray
    ) -> tuple[ModelState, dict[str, IntArray], IntArray, IntArray]:
        """Return what a step makes of readings [B, C]: state, values, drift [B, K], flags [B]."""
        values: dict[str, IntArray] = {CODES: codes, PREVIOUS_DRIFT: state.drift, ELAPSED: span_us}
        states: dict[str, State] = {}
        for node in self.model.nodes[:-1]:
            states[node.name], values[node.name] = node.step(state.nodes[node.name], values)
        last = self.model.drift
        unlimited = last.sum(values)
        drift = last.limit(unlimited)
        states[last.name], values[last.name] = {}, drift
        flags = self._flags(state, codes, span_us, (unlimited != drift).any(axis=1))
        after = ModelState(
            nodes=states,
            steps=np.minimum(state.steps + 1, self._full),
            previous=codes[:, self.model.guards.temperature_channel],
            held=codes[:, self.model.held],
            slept=np.zeros_like(state.slept),
            tare=state.tare,
            drift=drift if self.model.feeds_back else state.drift,
        )
        return after, values, drift, flags

    def _flag_start(self, state: ModelState) -> IntArray:
        return np.asarray(FLAG_WARMING_UP * (state.steps < self.model.guards.warm_up_steps))

    def _flags(
        self, state: ModelState, codes: IntArray, span_us: IntArray, clamped: Mask
    ) -> IntArray:
        guards = self.model.guards
        temperature = codes[:, guards.temperature_channel]
        outside = (temperature < guards.temperature_low) | (temperature > guards.temperature_high)
        beyond = np.zeros_like(outside)
        for channel, low, high in guards.ranges:
            beyond |= (codes[:, channel] < low) | (codes[:, channel] > high)
        change = temperature - state.previous
        if self.model.variable_step:
            fast = exceeds_rate(change, guards.rate_max, span_us, self.model.period_us)
        else:
            fast = np.abs(change) > guards.rate_max
        return np.asarray(
            self._flag_start(state)
            + FLAG_INPUT_RANGE * beyond
            + FLAG_TEMPERATURE_RANGE * outside
            + FLAG_RATE_RANGE * fast
            + FLAG_CLAMPED * clamped
        )

    def _stretch(
        self, state: ModelState, codes: IntArray
    ) -> tuple[ModelState, IntArray, IntArray, IntArray]:
        """Return what T times `_step` does of codes [T, B, C], from a state that is not new.

        That is the state afterwards, drift [T, B, K], flags [T, B], and hidden [T, B, H].
        """
        at, steps = self.model.guards.temperature_channel, len(codes)
        missing = self._find_missing(codes)
        codes = hold_readings(codes, missing, self._recall(state, codes[0]))
        done = run_stretch(self.model, state.nodes, codes)
        temperature = codes[:, :, at]
        counted = np.minimum(state.steps + np.arange(steps + 1)[:, None], self._full)
        before = replace(
            state,
            steps=counted[:-1].ravel(),
            previous=np.concatenate([state.previous, temperature[:-1].ravel()]),
        )
        clamped = (done.unlimited != done.drift).any(axis=2).ravel()
        flat = codes.reshape(temperature.size, -1)
        flags = self._flags(before, flat, np.zeros(temperature.size, dtype=np.int64), clamped)
        after = replace(
            state,
            nodes=done.nodes,
            steps=counted[-1],
            previous=temperature[-1],
            held=codes[-1][:, self.model.held],
        )
        raised = flags.reshape(temperature.shape) + FLAG_NO_READING * missing.any(axis=2)
        empty = np.empty((*temperature.shape, 0), dtype=np.int64)
        return after, done.drift, raised, np.concatenate([empty, *done.hidden], axis=2)

    def run(
        self,
        codes: CodeArray,
        *,
        settled: bool = True,
        elapsed: int = 0,
        state: ModelState | None = None,
        observe: Observer | None = None,
    ) -> ReferenceTrace:
        """Run T steps over codes [B, T, C], from `state` or else from `start` at codes[:, 0].

        With a variable step, its time in microseconds is the last column.
        """
        batch, steps, _ = codes.shape
        by_step = np.ascontiguousarray(codes.swapaxes(0, 1))
        wide, times_us = self._split(by_step)
        now = state or self._start(wide[0], settled=settled, elapsed=elapsed)
        layers = [layer for layer in self.model.recurrents if layer.streams]
        hidden = sum(now.nodes[layer.name]["h_q30"].shape[1] for layer in layers)
        drift = np.empty((steps, batch, len(self.model.outputs)), dtype=np.int32)
        flags = np.empty((steps, batch), dtype=np.uint32)
        states = np.empty((steps, batch, hidden), dtype=np.int32)
        at_once = (
            max(1, STRETCH_ROWS // max(batch, 1))
            if observe is None and can_stretch(self.model)
            else 1
        )
        t = 0
        while t < steps:
            if at_once > 1 and now.steps.all():
                part = slice(t, t + at_once)
                now, drift[part], flags[part], states[part] = self._stretch(now, wide[part])
                t += at_once
                continue
            now, values, drift[t], flags[t] = self._step(now, wide[t], times_us[t])
            if layers:
                states[t] = np.concatenate([now.nodes[n.name]["h_q30"] for n in layers], axis=1)
            if observe is not None:
                observe(t, values)
            t += 1
        return ReferenceTrace(
            drift=np.ascontiguousarray(drift.swapaxes(0, 1)),
            flags=np.ascontiguousarray(flags.T),
            hidden=np.ascontiguousarray(states.swapaxes(0, 1)),
            state=now,
        )
