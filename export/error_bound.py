"""Bounds the distance of the chip's drift from the float model in real arithmetic, per output.

The float model is the graph with the parameters as they were before rounding, limited where the
chip is; both are given the same codes and were at rest under the same ones. Where the chip converts
raw codes, the float model has their exact quantity. The bound goes through
what the answers stand for (`Real`) and asks each integer node for its error (`bound_error`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from zerodrift.base.errors import NoRuleError
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import Quantized
from zerodrift.operations.arithmetic import INT16_MAX
from zerodrift.operations.errors import NONE, Error, Known, bound_in_place
from zerodrift.operations.gate_sums import COPY
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.intervals import Interval, shorten
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.recurrent import STATE, WAYS, IntegerRecurrent
from zerodrift.operations.signals import Real, Signal

HOLDS = "same start, any input, any run length; the float model is limited where the chip is"
BY_RANGE = "; the network's states may lie anywhere between -1 and 1, in chip and float model"
EXACT = "; both are given the same raw codes, the float model exactly converted"
ROUNDS = 60
"""Of the loop in which a load's error is that of the drift before; it closes, or no bound holds."""
OF_COPY = Error(rounding=COPY / 2)
"""Of a layer below another one: what reads it reads an int16 copy."""
SPARE = Fraction(1, 1 << 20)
"""By which an error of the loop is taken larger than found, so that it closes at all."""


@dataclass(frozen=True)
class ErrorBound:
    """The proven bounds of the outputs, or why there are none."""

    outputs: tuple[Error, ...]
    """Per output in its unit; empty where nothing is proven."""
    why: str = ""
    """Why nothing is proven, or nothing but what the range of a network's states gives."""
    answers: tuple[Signal, ...] = ()
    """What the bound is about: the drifts' signals, and by `meaning` all that they stand for."""
    holds: str = HOLDS
    """Conditions under which the bound holds."""


def bound_errors(quantized: Quantized) -> ErrorBound:
    """Return the largest distance of the chip's drift from the float model's, for any codes.

    Where effects read the load, its error is that of the drift of the step before. An error that
    the rules give back no larger, put in its place, holds by induction over the steps.
    """
    known = _prove_intervals(quantized.model)
    found = _close(quantized.model, known, quantized.answers)
    if found.outputs:
        return found
    ranged = _rest_on_range(quantized.answers)
    if all(a is b for a, b in zip(ranged, quantized.answers, strict=True)):
        return found
    again = _close(quantized.model, known, ranged)
    if not again.outputs:
        return found
    spans = _list_spans(quantized.model)
    if any(error.total >= span for error, span in zip(again.outputs, spans, strict=True)):
        return found  # the limits of the answer say as much
    return replace(again, why=found.why, holds=again.holds + BY_RANGE)


def _close(
    model: IntegerModel, known: Mapping[str, Sequence[Interval]], answers: tuple[Signal, ...]
) -> ErrorBound:
    """Return the errors of answers, those of the loads closed over the steps."""
    spans = _list_spans(model)
    try:
        drift = [NONE] * len(model.outputs)
        holds = HOLDS + (EXACT if model.conversions else "")
        for _ in range(ROUNDS):
            found = _Pass(model, known, drift).bound(answers)
            closed = all(a.covers(b) for a, b in zip(drift, found, strict=True))
            if closed or not model.feeds_back:
                return ErrorBound(tuple(found), answers=answers, holds=holds)
            if any(error.total > span for error, span in zip(found, spans, strict=True)):
                break
            drift = [error.scale(1 + SPARE) for error in found]
    except NoRuleError as error:
        return ErrorBound((), str(error))
    return ErrorBound((), "effects of the load give an error of the drift back enlarged")


def _list_spans(model: IntegerModel) -> list[Fraction]:
    """Return how far apart the limits of each output are, in its unit."""
    last = model.drift
    ends = zip(last.low, last.high, model.outputs, strict=True)
    return [Fraction(high - low, output.lsb_per_unit) for low, high, output in ends]


def _rest_on_range(answers: Sequence[Signal]) -> tuple[Signal, ...]:
    """Return the answers, made of a network's topmost states of which only the range is known."""
    done: dict[int, Signal] = {}

    def rest(signal: Signal) -> Signal:
        real = signal.meaning
        if real is None:
            return signal
        if id(real) not in done:
            if real.operation in WAYS:
                done[id(real)] = signal.standing_for(STATE)
            else:
                inputs = [rest(x) for x in real.inputs]
                same = all(a is b for a, b in zip(inputs, real.inputs, strict=True))
                made = signal.standing_for(real.operation, inputs, *real.numbers)
                done[id(real)] = signal if same else made
        return done[id(real)]

    return tuple(rest(answer) for answer in answers)


def round_up(x: Fraction) -> float:
    """Return the float at or just above x."""
    near = float(x)
    return near if Fraction(near) >= x else math.nextafter(near, math.inf)


def _prove_intervals(model: IntegerModel) -> dict[str, list[Interval]]:
    known: dict[str, list[Interval]] = {}
    for node in model.nodes:
        known[node.name], _ = node.prove([known[name] for name in node.inputs])
    return known


def _list_signals(answers: Sequence[Signal]) -> list[Signal]:
    """Return the answers and all signals that they are made of, each once."""
    found: dict[int, Signal] = {}
    left = list(answers)
    while left:
        signal = left.pop()
        if signal.meaning is not None and id(signal.meaning) not in found:
            found[id(signal.meaning)] = signal
            left.extend(signal.meaning.inputs)
    return list(found.values())


class _Pass:
    """One way through what the answers stand for."""

    def __init__(
        self,
        model: IntegerModel,
        intervals: Mapping[str, Sequence[Interval]],
        drift: Sequence[Error],
    ) -> None:
        self._nodes = {node.name: node for node in model.nodes}
        self._model, self._intervals, self._drift = model, dict(intervals), drift
        self._copied: set[str] = set()
        for layer in (one for node in model.recurrents for one in node.list_lower()):
            self._copied.add(layer.name)
            self._nodes[layer.name] = layer
            self._intervals[layer.name] = [Interval(-INT16_MAX, INT16_MAX)] * layer.width
        self._errors: dict[int, Error] = {}
        self._states: dict[str, list[Error]] = {}
        self._answers: Sequence[Signal] = ()

    def bound(self, answers: Sequence[Signal]) -> list[Error]:
        """Return the errors of the answers, each in its unit."""
        self._answers = answers
        return [self._bound(answer) for answer in answers]

    def _know(self, signal: Signal) -> Known:
        """Return a signal's range and meaning, without its error."""
        if not signal.node:
            return Known(0, 0, Fraction(0), Fraction(signal.offset))
        scale = Fraction(signal.scale)
        if signal.node == self._model.drift.name:
            scale = Fraction(1, self._model.outputs[signal.index].lsb_per_unit)
        interval = self._intervals[signal.node][signal.index]
        return Known(interval.low, interval.high, scale, Fraction(signal.offset))

    def _bound(self, signal: Signal) -> Error:
        real = signal.meaning
        if real is None:
            raise NoRuleError(f"nothing is said of what '{signal.node}' stands for")
        if id(real) not in self._errors:
            self._errors[id(real)] = self._apply_rule(signal, real)
        return self._errors[id(real)]

    def _apply_rule(self, signal: Signal, real: Real) -> Error:
        out = self._know(signal)
        if real.operation == "constant":
            return Error(coefficients=shorten(abs(out.offset - Fraction(real.numbers[0]))))
        inputs = [self._know_with_error(x) for x in real.inputs]
        moving = [x for x in real.inputs if x.node]
        own = (signal.node, signal.index)
        if (moving and all((x.node, x.index) == own for x in moving)) or not signal.node:
            return bound_in_place(signal, real, out, inputs)
        node = self._nodes[signal.node]
        if isinstance(node, IntegerRecurrent):
            if real.operation == STATE:
                return Error(range=1 + out.magnitude)
            error = self._bound_states(node, inputs)[signal.index]
            return error + OF_COPY if signal.node in self._copied else error
        if real.operation == "load":
            inputs = [self._know_drift(signal)]
        error = node.bound_error(real, out, inputs)
        if real.operation == "input":
            error += self._find_conversion(signal)
        return error

    def _bound_states(self, node: IntegerRecurrent, inputs: Sequence[Known]) -> list[Error]:
        """Return the errors of all units of a recurrent layer, which depend on each other."""
        if node.name not in self._states:
            found = [x for x in _list_signals(self._answers) if x.node == node.name]
            rows = [x.meaning for x in sorted(found, key=lambda x: x.index)]
            meant = [row for row in rows if row is not None]
            self._states[node.name] = node.bound_states(meant, inputs)
        return self._states[node.name]

    def _find_conversion(self, signal: Signal) -> Error:
        """Return how far the code of an input is from the exact quantity of what the chip is given.

        Limits of codes, which both models have, bring the two no further apart.
        """
        node = self._nodes[signal.node]
        assert isinstance(node, IntegerInput)
        by = self._model.channels[node.channel].conversion
        return NONE if by is None else Error(conversion=Fraction(by.error))

    def _know_with_error(self, signal: Signal) -> Known:
        known, error = self._know(signal), self._bound(signal)
        return Known(known.low, known.high, known.scale, known.offset, error)

    def _know_drift(self, load: Signal) -> Known:
        """Return what is known of the drift of the step before, in counts, for a load."""
        node = self._nodes[load.node]
        assert isinstance(node, IntegerLoad)
        k = node.output
        counts = Fraction(self._model.outputs[k].lsb_per_unit)
        interval = self._intervals[self._model.drift.name][k]
        return Known(
            interval.low, interval.high, Fraction(1), Fraction(0), self._drift[k].scale(counts)
        )
