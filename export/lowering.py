"""The float graph of effects and of the front end, turned into integer nodes with formats."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from zerodrift.base.errors import CheckError
from zerodrift.export.integer_model import Channel
from zerodrift.operations.clip import limit
from zerodrift.operations.counter import COUNTER_LIMIT, IntegerCounter
from zerodrift.operations.elapsed import IntegerElapsed, choose_tick
from zerodrift.operations.formats import RANGE_SPANS, SIGNAL_BITS, FormattedNodes
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.operation import Node
from zerodrift.operations.registry import OPERATIONS
from zerodrift.operations.signals import Signal, constant
from zerodrift.operations.times import US_PER_S, count_us

INPUT_SHIFT = 12
"""Fractional bits given to a 16-bit code: 2**-19 K for the TMP117's 2**-7 K."""


@dataclass(kw_only=True)
class Lowering(FormattedNodes):
    """Collects integer nodes; the same float node is lowered once.

    Args:
        channels: the raw inputs.
        sources: float signal name (as in `Node.source`) -> channel index; for `load:NAME` the
            channel of the raw output.
        limits: lowest and highest code of each channel, of a load its lowest and highest count;
            beyond them they are limited.
        outputs: names of the outputs, for the loads.
        clock_origin_s: subtracted from the clock's channel.
        ranges: lowest and highest value of float nodes over calibration, as far as known.
    """

    channels: tuple[Channel, ...]
    sources: Mapping[str, int]
    limits: tuple[tuple[int, int], ...]
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
        return limit(self, self.lower(node), *self.find_limits(node, 0.0))

    def _lower(self, node: Node) -> Signal:
        if node.op == "input":
            return self._lower_input(node)
        if node.op == "constant":
            return constant(node.constants[0])
        return OPERATIONS[node.op].lower(self, node, *(self.lower(child) for child in node.inputs))

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
            return limit(self, self._count(), 0.0, high + RANGE_SPANS * (high - low))
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
        offset, taken_off = channel.offset + origin * channel.lsb, 0.0
        if source == "clock_s":
            taken_off = self.clock_origin_s
            offset -= taken_off
        signal = Signal(name, channel.lsb / 2**shift, offset)
        return signal.standing_for("input", (), channel.lsb, channel.offset, taken_off)

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
        lsb = self.channels[index].lsb
        return Signal(self.append(node), lsb / 2**shift).standing_for("load", (), lsb)

    def _count(self) -> Signal:
        if self.variable_step:
            bits = choose_tick(self.sample_period_s)
            period_us = count_us(self.sample_period_s)
            told = IntegerElapsed("elapsed", (), COUNTER_LIMIT, bits, period_us)
            signal = Signal(self.append(told), 2.0**bits / US_PER_S)
            return signal.standing_for("counter", (), self.sample_period_s)
        counter = IntegerCounter("counter", (), COUNTER_LIMIT)
        signal = Signal(self.append(counter), self.sample_period_s)
        return signal.standing_for("counter", (), self.sample_period_s)
