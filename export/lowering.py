"""The float graph of an effect or of the front end, turned into integer nodes with formats."""

from dataclasses import dataclass, field, replace

from zerodrift.errors import CheckError
from zerodrift.export.integer_model import Channel
from zerodrift.operations.graph import Node
from zerodrift.operations.intervals import Interval
from zerodrift.operations.lowpass import lowpass_coefficients
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.signal import (
    LOWPASS_FRACTION,
    IntegerDelay,
    IntegerDifference,
    IntegerInput,
    IntegerLowpass,
    IntegerOffset,
    IntegerProduct,
)

INPUT_SHIFT = 12
"""Fractional bits given to a raw code: 2**-19 K for the TMP117's 2**-7 K."""
SIGNAL_BITS = 30
"""A product is shifted until its magnitude is below 2**30, so that differences still fit."""


@dataclass(frozen=True)
class Signal:
    """An integer signal q and its meaning: physical value = q * scale + offset.

    A constant has no node (an empty name), scale 0 and its value as offset.
    """

    node: str
    scale: float
    offset: float = 0.0


@dataclass
class Lowering:
    """Collects integer nodes; the same float node is lowered once.

    Args:
        channels: the raw inputs.
        sources: float signal name (as in `Node.source`) -> channel index.
        limits: lowest and highest code of each channel; codes outside are limited to them.
        sample_period_s: the firmware's step.
    """

    channels: tuple[Channel, ...]
    sources: dict[str, int]
    limits: tuple[tuple[int, int], ...]
    sample_period_s: float
    nodes: list[IntegerNode] = field(default_factory=list)
    intervals: dict[str, list[Interval]] = field(default_factory=dict)
    _lowered: dict[int, Signal] = field(default_factory=dict)
    _kept: list[Node] = field(default_factory=list)  # ids stay unique while the nodes live

    def append(self, node: IntegerNode) -> str:
        """Add an integer node, prove it, and return its name."""
        interval, _ = node.prove([self.intervals[name] for name in node.inputs])
        self.nodes.append(node)
        self.intervals[node.name] = interval
        return node.name

    def lower(self, node: Node) -> Signal:
        """Return the integer signal of a float node, adding what it needs.

        Raises:
            CheckError: the operation has no integer form yet, or a value cannot be bounded.
        """
        if id(node) not in self._lowered:
            self._kept.append(node)
            self._lowered[id(node)] = self._lower(node)
        return self._lowered[id(node)]

    def _name(self, kind: str) -> str:
        return f"{kind}_{len(self.nodes)}"

    def _lower(self, node: Node) -> Signal:
        if node.op == "input":
            return self._lower_input(node.source)
        if node.op == "constant":
            return Signal("", 0.0, node.constants[0])
        arguments = [self.lower(child) for child in node.inputs]
        match node.op:
            case "affine":
                gain, offset = node.constants
                x = arguments[0]
                return replace(x, scale=x.scale * gain, offset=x.offset * gain + offset)
            case "total" | "difference":
                sign = 1.0 if node.op == "total" else -1.0
                return self._lower_sum(arguments[0], arguments[1], sign)
            case "product":
                return self._multiply(*arguments)
            case "power" if node.constants[0] in (1.0, 2.0, 3.0, 4.0):
                result = arguments[0]
                for _ in range(int(node.constants[0]) - 1):
                    result = self._multiply(result, arguments[0])
                return result
            case "lowpass":
                return self._lower_lowpass(arguments[0], node.constants[0])
            case "delay":
                return self._lower_delay(arguments[0], node.constants[0])
        raise CheckError(
            f"the operation '{node.op}' in {node!r} has no fixed-point form in this version;"
            " remove the effect that uses it, or keep it for analysis only"
        )

    def _lower_input(self, source: str) -> Signal:
        if source not in self.sources:
            raise CheckError(
                f"the signal '{source}' is not an input of the firmware; it has"
                f" {sorted(self.sources)}. Name its column under [inputs], or remove the effect."
            )
        index = self.sources[source]
        low, high = self.limits[index]
        channel = self.channels[index]
        name = self.append(
            IntegerInput(
                name=f"in_{index}",
                inputs=(),
                channel=index,
                low=low,
                high=high,
                shift=INPUT_SHIFT,
            )
        )
        return Signal(name, channel.lsb / 2**INPUT_SHIFT, channel.offset)

    def _lower_sum(self, a: Signal, b: Signal, sign: float) -> Signal:
        """Return a + sign * b, which needs a node only where both move."""
        offset = a.offset + sign * b.offset
        if not b.node:
            return replace(a, offset=offset)
        if not a.node:
            return Signal(b.node, sign * b.scale, offset)
        if a.scale != -sign * b.scale:
            raise CheckError(
                f"the sum of '{a.node}' and '{b.node}' with different scales has no fixed-point"
                " form in this version"
            )
        node = IntegerDifference(name=self._name("difference"), inputs=(a.node, b.node))
        return Signal(self.append(node), a.scale, offset)

    def _remove_offset(self, x: Signal) -> Signal:
        """Return the same physical signal with offset 0, as far as the format resolves it."""
        offset = round(-x.offset / x.scale)
        if offset == 0:
            return replace(x, offset=0.0)
        node = IntegerOffset(name=self._name("offset"), inputs=(x.node,), offset=offset)
        return Signal(self.append(node), x.scale)

    def _multiply(self, a: Signal, b: Signal) -> Signal:
        if not a.node or not b.node:
            moving, factor = (b, a.offset) if not a.node else (a, b.offset)
            return replace(moving, scale=moving.scale * factor, offset=moving.offset * factor)
        same = a == b
        a = self._remove_offset(a)
        b = a if same else self._remove_offset(b)
        largest = self.intervals[a.node][0].magnitude * self.intervals[b.node][0].magnitude
        shift = max(0, largest.bit_length() - SIGNAL_BITS)
        node = IntegerProduct(name=self._name("product"), inputs=(a.node, b.node), shift=shift)
        return Signal(self.append(node), a.scale * b.scale * 2.0**shift)

    def _lower_lowpass(self, x: Signal, tau_s: float) -> Signal:
        if tau_s <= 0.0 or not x.node:
            return x
        decay, b0, _ = lowpass_coefficients(self.sample_period_s, tau_s)
        share = 1.0 - decay
        exponent = 0
        while share * 2.0 ** (exponent + 1) < 1.0:
            exponent += 1
        m_q31 = min(round(share * 2.0 ** (31 + exponent)), 2**31 - 1)
        if exponent > 31:
            raise CheckError(
                f"a time constant of {tau_s:g} s is over 2^31 steps of {self.sample_period_s:g} s;"
                " hold it at a smaller value or use a longer sample period"
            )
        node = IntegerLowpass(
            name=self._name("lowpass"),
            inputs=(x.node,),
            c_q24=round(b0 * 2**LOWPASS_FRACTION),
            m_q31=m_q31,
            shift=31 + exponent - 22,
        )
        return Signal(self.append(node), x.scale, x.offset)

    def _lower_delay(self, x: Signal, delay_s: float) -> Signal:
        steps = round(delay_s / self.sample_period_s)
        if abs(steps * self.sample_period_s - delay_s) > 1e-6 * max(delay_s, 1e-9):
            raise CheckError(
                f"a delay of {delay_s:g} s is no whole number of steps of"
                f" {self.sample_period_s:g} s; this version has no fixed-point form for it"
            )
        if steps == 0 or not x.node:
            return x
        node = IntegerDelay(name=self._name("delay"), inputs=(x.node,), steps=steps)
        return Signal(self.append(node), x.scale, x.offset)
