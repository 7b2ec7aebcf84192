"""The float graph of effects and of the front end, turned into integer nodes with formats."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from zerodrift.base.errors import CheckError
from zerodrift.export.formats import (
    EXACT_BITS,
    RANGE_SPANS,
    SIGNAL_BITS,
    FormattedNodes,
    Signal,
)
from zerodrift.export.integer_model import Channel
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.clock import COUNTER_LIMIT, IntegerCounter
from zerodrift.operations.delay import delay_taps
from zerodrift.operations.exp2 import EXPONENT_BITS, EXPONENT_LIMIT, IntegerExp2
from zerodrift.operations.graph import Node
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.lowpass import lowpass_coefficients
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.polynomial import fit_octave
from zerodrift.operations.power import IntegerPower, power
from zerodrift.operations.signal import (
    LOWPASS_FRACTION,
    IntegerDelay,
    IntegerDifference,
    IntegerInput,
    IntegerLowpass,
)

INPUT_SHIFT = 12
"""Fractional bits given to a 16-bit code: 2**-19 K for the TMP117's 2**-7 K."""
LARGEST_WHOLE_POWER = 16
POWER_DEGREE = 8
"""Degree of the polynomial of a power on one octave; within 2**-27 of it."""


@dataclass(kw_only=True)
class Lowering(FormattedNodes):
    """Collects integer nodes; the same float node is lowered once.

    Args:
        channels: the raw inputs.
        sources: float signal name (as in `Node.source`) -> channel index; for `load:NAME` the
            channel of the raw output.
        limits: lowest and highest code of each channel, of a load its lowest and highest count;
            beyond them they are limited.
        sample_period_s: the firmware's step.
        outputs: names of the outputs, for the loads.
        clock_origin_s: subtracted from the clock's channel.
        ranges: lowest and highest value of float nodes over calibration, as far as known.
    """

    channels: tuple[Channel, ...]
    sources: Mapping[str, int]
    limits: tuple[tuple[int, int], ...]
    sample_period_s: float
    outputs: tuple[str, ...] = ()
    clock_origin_s: float = 0.0
    _lowered: dict[Node, Signal] = field(default_factory=dict)

    def lower(self, node: Node) -> Signal:
        """Return the integer signal of a float node, adding what it needs.

        Raises:
            CheckError: the operation has no integer form for these constants, or a value cannot be
                bounded.
        """
        if node not in self._lowered:
            self._lowered[node] = self._lower(node)
        return self._lowered[node]

    @property
    def signals(self) -> Mapping[Node, Signal]:
        """The integer signal of every float node that was lowered."""
        return self._lowered

    def lower_feature(self, node: Node) -> Signal:
        """Return the integer signal of a feature, held where it goes far beyond calibration."""
        x = self.lower(node)
        low, high = self.find_limits(node, 0.0)
        return self._lower_clip(x, low, high)

    def _lower(self, node: Node) -> Signal:
        if node.op == "input":
            return self._lower_input(node)
        if node.op == "constant":
            return Signal("", 0.0, node.constants[0])
        arguments = [self.lower(child) for child in node.inputs]
        x = arguments[0]
        match node.op:
            case "affine":
                gain, offset = node.constants
                if gain == 0.0:
                    return Signal("", 0.0, offset)
                return replace(x, scale=x.scale * gain, offset=x.offset * gain + offset)
            case "total":
                return self._lower_sum(node, x, arguments[1], 1.0)
            case "difference":
                return self._lower_sum(node, x, arguments[1], -1.0)
            case "product":
                return self.multiply(x, arguments[1], node)
            case "power":
                return self._lower_power(node, x)
            case "exp2":
                return self._lower_exp2(node, x)
            case "lowpass":
                return self._lower_lowpass(node, x)
            case "delay":
                return self._lower_delay(x, node.constants[0])
            case "play":
                return self._lower_play(x, node.constants[0])
            case "clip":
                return self._lower_clip(x, *node.constants)
        raise CheckError(
            f"the operation '{node.op}' in {node!r} has no fixed-point form in this version;"
            " remove the effect that uses it, or keep it for analysis only"
        )

    def _lower_input(self, node: Node) -> Signal:
        source = node.source
        if source in self.sources:
            if source.startswith("load:"):
                return self._lower_load(source)
            return self._lower_channel(source)
        if source == "elapsed_s":
            return self._count()
        if source == "clock_s":
            low, high = self.ranges.get(node, (0.0, math.inf))
            return self._lower_clip(self._count(), 0.0, high + RANGE_SPANS * (high - low))
        raise CheckError(
            f"the signal '{source}' is not an input of the firmware; it has"
            f" {sorted(self.sources)}. Name its column under [inputs], or remove the effect."
        )

    def _lower_channel(self, source: str) -> Signal:
        index = self.sources[source]
        low, high = self.limits[index]
        channel = self.channels[index]
        wide = channel.bits > 16
        origin = (low + high) // 2 if wide else 0
        shift = INPUT_SHIFT
        if wide:
            shift = max(0, min(SIGNAL_BITS - (high - low).bit_length(), 30))
        name = f"in_{index}"
        node = IntegerInput(
            name=name,
            inputs=(),
            channel=index,
            low=low,
            high=high,
            shift=shift,
            origin=origin,
        )
        self.append(node)
        offset = channel.offset + origin * channel.lsb
        if source == "clock_s":
            offset -= self.clock_origin_s
        return Signal(name, channel.lsb / 2**shift, offset)

    def _lower_load(self, source: str) -> Signal:
        index = self.sources[source]
        low, high = self.limits[index]
        largest = max(abs(low), abs(high), 1)
        shift = max(0, min(SIGNAL_BITS - largest.bit_length(), 30))
        node = IntegerLoad(
            name=f"load_{index}",
            inputs=(),
            channel=index,
            output=self.outputs.index(source.removeprefix("load:")),
            low=low,
            high=high,
            shift=shift,
        )
        return Signal(self.append(node), self.channels[index].lsb / 2**shift)

    def _count(self) -> Signal:
        return Signal(
            self.append(IntegerCounter("counter", (), COUNTER_LIMIT)), self.sample_period_s
        )

    def _lower_sum(self, node: Node, a: Signal, b: Signal, sign: float) -> Signal:
        """Return a + sign * b, which needs a node only where both move."""
        offset = a.offset + sign * b.offset
        if not b.node:
            return replace(a, offset=offset)
        if not a.node:
            return Signal(b.node, sign * b.scale, offset)
        scale = a.scale + sign * b.scale
        if a.node == b.node:
            return Signal(a.node, scale, offset) if scale else Signal("", 0.0, offset)
        if a.scale == -sign * b.scale:
            out = self.intervals[a.node][0] - self.intervals[b.node][0]
            if out.magnitude < 2**EXACT_BITS:
                difference = IntegerDifference(self.new_name("difference"), (a.node, b.node))
                return Signal(self.append(difference), a.scale, offset)
        low, high = self.find_limits(node, offset)
        return self.add([a, replace(b, scale=sign * b.scale)], low, high, offset)

    def _lower_power(self, node: Node, x: Signal) -> Signal:
        exponent = node.constants[0]
        whole = round(exponent)
        if exponent <= 0.0 or (exponent > LARGEST_WHOLE_POWER):
            raise CheckError(
                f"a power of {exponent:g} in {node!r} has no fixed-point form; above 0 up to"
                f" {LARGEST_WHOLE_POWER} have. Write the effect with another exponent."
            )
        if not x.node:
            return Signal("", 0.0, float(power(np.array(x.offset), exponent)))
        if abs(exponent - whole) < 1e-12:
            return self._raise_whole(node, x, whole)
        return self._raise_broken(node, x, exponent)

    def _raise_whole(self, node: Node, x: Signal, whole: int) -> Signal:
        """Return x**whole by squares and products, the last of which is limited to its range."""
        if whole == 1:
            return x
        x = self.fit(self.remove_offset(x), EXACT_BITS)
        factors: list[Signal | None] = []  # of the running result: itself, or x
        for digit in bin(whole)[3:]:
            factors += [None, x] if digit == "1" else [None]
        result = x
        for i, factor in enumerate(factors):
            last = i == len(factors) - 1
            result = self.multiply(result, factor or result, node if last else None)
        return result

    def _raise_broken(self, node: Node, x: Signal, exponent: float) -> Signal:
        if x.scale < 0.0:
            x = self.negate(x)
        x = self.fit(self.remove_offset(x), EXACT_BITS)
        top = self.find_limits(node, 0.0)[1] ** (1.0 / exponent)
        x = self._lower_clip(x, -math.inf, top)
        if not x.node:
            return Signal("", 0.0, float(power(np.array(x.offset), exponent)))
        largest = max(self.intervals[x.node][0].high, 1)
        octaves = largest.bit_length() - 1
        bits = 29 - math.ceil(exponent)
        high = min(round(2.0 ** (bits + exponent)), 2**30)
        gain_bits = 30 - math.ceil(octaves * exponent)
        gains = tuple(round(2.0 ** (n * exponent + gain_bits)) for n in range(octaves + 1))
        shift = max(0, (high * gains[-1]).bit_length() - SIGNAL_BITS)
        raised = IntegerPower(
            name=self.new_name("power"),
            inputs=(x.node,),
            octave=fit_octave(lambda v: float(v**exponent), POWER_DEGREE, bits),
            low=1 << bits,
            high=high,
            gains=gains,
            shift=shift,
        )
        scale = float(x.scale**exponent * 2.0 ** (shift - bits - gain_bits))
        return Signal(self.append(raised), scale)

    def _lower_exp2(self, node: Node, x: Signal) -> Signal:
        if not x.node:
            return Signal("", 0.0, 2.0 ** min(max(x.offset, -EXPONENT_LIMIT), EXPONENT_LIMIT))
        one = 2.0**EXPONENT_BITS
        name = self.new_name("exp2")
        coefficients, bias, shift = self.format_row(
            [x], np.array([x.scale * one]), x.offset * one, name
        )
        interval = self.intervals[x.node][0]
        ends = sorted(end * x.scale + x.offset for end in (interval.low, interval.high))
        top = min(self.find_limits(node, 0.0)[1], 2.0**EXPONENT_LIMIT)
        high = min(math.log2(top), ends[1] + 1.0 / one, EXPONENT_LIMIT)
        high_q24 = math.floor(high * one)
        low_q24 = min(round(-EXPONENT_LIMIT * one), high_q24)
        octave = high_q24 >> EXPONENT_BITS
        power = IntegerExp2(
            name, (x.node,), coefficients[0], bias, shift, low_q24, high_q24, octave
        )
        return Signal(self.append(power), 2.0 ** (octave - SIGNAL_BITS))

    def _lower_lowpass(self, node: Node, x: Signal) -> Signal:
        tau_s = node.constants[0]
        if tau_s <= 0.0 or not x.node:
            return x
        _, b0, _ = lowpass_coefficients(self.sample_period_s, tau_s)
        share = -math.expm1(-self.sample_period_s / tau_s)
        exponent = -math.frexp(share)[1]
        if exponent > 31:
            raise CheckError(
                f"a time constant of {tau_s:g} s is over 2^31 steps of {self.sample_period_s:g} s;"
                " hold it at a smaller value or use a longer sample period"
            )
        x = self.fit(x, SIGNAL_BITS)
        lowpass = IntegerLowpass(
            name=self.new_name("lowpass"),
            inputs=(x.node,),
            c_q24=round(b0 * 2**LOWPASS_FRACTION),
            m_q31=min(round(share * 2.0 ** (31 + exponent)), 2**31 - 1),
            shift=31 + exponent - 22,
        )
        return Signal(self.append(lowpass), x.scale, x.offset)

    def _lower_delay(self, x: Signal, delay_s: float) -> Signal:
        whole, share = delay_taps(self.sample_period_s, delay_s)
        newer_q31 = round((1.0 - share) * 2.0**31) if share > 1e-6 else 0
        steps = whole if newer_q31 == 0 else whole + 1
        if newer_q31 >= 2**31:  # a share below the resolution
            steps, newer_q31 = whole, 0
        if steps == 0 or not x.node:
            return x
        if steps > 32767:
            raise CheckError(
                f"a delay of {delay_s:g} s is {steps} steps of {self.sample_period_s:g} s; the"
                " firmware's ring holds 32767. Use a shorter delay or a longer sample period."
            )
        node = IntegerDelay(self.new_name("delay"), (x.node,), steps, newer_q31)
        return Signal(self.append(node), x.scale, x.offset)

    def _lower_play(self, x: Signal, half_width: float) -> Signal:
        if half_width <= 0.0 or not x.node:
            return x
        x = self.fit(x, SIGNAL_BITS + 1)
        interval = self.intervals[x.node][0]
        width = round(half_width / abs(x.scale))
        span = interval.high - interval.low
        # A slack wider than everything that x can do is no other than one of that width.
        node = IntegerPlay(self.new_name("play"), (x.node,), min(width, span))
        return Signal(self.append(node), x.scale, x.offset)

    def _lower_clip(self, x: Signal, low: float, high: float) -> Signal:
        if not x.node:
            return Signal("", 0.0, min(max(x.offset, low), high))
        interval = self.intervals[x.node][0]
        ends = sorted((end - x.offset) / x.scale for end in (low, high))
        if ends[0] <= interval.low and interval.high <= ends[1]:
            return x
        if ends[1] <= interval.low or interval.high <= ends[0]:  # always at the same limit
            value = ends[1] if ends[1] <= interval.low else ends[0]
            return Signal("", 0.0, value * x.scale + x.offset)
        bottom = round(min(max(ends[0], interval.low), interval.high))
        top = round(min(max(ends[1], interval.low), interval.high))
        node = IntegerClip(self.new_name("clip"), (x.node,), bottom, top)
        return Signal(self.append(node), x.scale, x.offset)
