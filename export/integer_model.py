"""The integer model: channels, nodes, outputs and guards, as data; JSON in and out; its hash."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.files import write_whole
from zerodrift.base.records import OPTIONAL, Json, to_dict
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.operations.conversion import IntegerConversion
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.recurrent import IntegerRecurrent
from zerodrift.operations.times import LONGEST_US, count_us

FORMAT = 3
"""Version of the integer arithmetic; equals ZD_RUNTIME_FORMAT of the C runtime."""
OLDER_FORMAT = 2
"""Knows neither codes that mean no reading nor ranges of other inputs; a model that has none of
either is written in it, and computes the same."""


@dataclass(frozen=True)
class Channel:
    """One integer input: physical value = offset + code * lsb.

    With a conversion the chip is given other codes, which become these.
    """

    name: str
    unit: str
    lsb: float
    offset: float = 0.0
    bits: int = 16
    """16 or 32: width of the code."""
    source: str = ""
    """Where a log has it: temperature_degC, measured:Fz or an input's name; empty for the name."""
    no_reading: int | None = field(default=None, metadata=OPTIONAL)
    """The code that means that there is no reading; None: every code is one."""
    conversion: IntegerConversion | None = field(default=None, metadata=OPTIONAL)
    """From the raw code that the chip is given to the code; None: they are the same."""

    @property
    def least(self) -> int:
        """The lowest code of the type."""
        return -(1 << (self.bits - 1))

    @property
    def most(self) -> int:
        """The highest code of the type."""
        return (1 << (self.bits - 1)) - 1

    @property
    def raw_type(self) -> str:
        """The C type of what the chip is given, without its _t."""
        return f"int{self.bits}" if self.conversion is None else self.conversion.raw

    @property
    def raw_bits(self) -> int:
        """16 or 32: width of what the chip is given."""
        return 16 if self.raw_type.endswith("16") else 32

    @property
    def raw_least(self) -> int:
        """The lowest code that the chip may be given."""
        return self.least if self.conversion is None else self.conversion.least

    @property
    def raw_most(self) -> int:
        """The highest code that the chip may be given."""
        return self.most if self.conversion is None else self.conversion.most

    @property
    def raw_lacks(self) -> tuple[int, ...]:
        """Codes that the chip may be given and that mean no reading: the nearest ones, if many."""
        if self.conversion is not None and not self.conversion.is_plain:
            return self.conversion.list_missing()
        return () if self.no_reading is None else (self.no_reading,)


def code_type(channels: Sequence[Channel]) -> type[np.signedinteger]:
    """Return the narrowest signed type that holds what the chip is given of every channel."""
    return np.int32 if any(c.raw_most > 2**15 - 1 for c in channels) else np.int16


def convert_codes(channels: Sequence[Channel], given: CodeArray | IntArray) -> IntArray:
    """Return the channels' codes [..., C] of what the chip is given [..., C].

    Thermocouples come last, since they read what has become of their cold junction.
    """
    codes = given.astype(np.int64)
    for index in order_conversions(channels):
        by = channels[index].conversion
        assert by is not None
        cold = None if by.junction is None else codes[..., by.junction.channel]
        codes[..., index] = by.convert(codes[..., index], cold)
    return codes


def order_conversions(channels: Sequence[Channel]) -> list[int]:
    """Return the channels that are converted, each after that of its cold junction."""
    found = [(i, c.conversion) for i, c in enumerate(channels) if c.conversion is not None]
    return [i for i, _ in sorted(found, key=lambda one: one[1].junction is not None)]


@dataclass(frozen=True)
class OutputFormat:
    """One int32 output: physical value = code / lsb_per_unit."""

    name: str
    unit: str
    lsb_per_unit: int
    full_scale: float


@dataclass(frozen=True)
class Guards:
    """What the model checks about itself while it runs."""

    warm_up_steps: int
    """After `init` (not after `settle`) that many steps carry the warming-up flag."""
    temperature_channel: int
    temperature_low: int
    temperature_high: int
    """Codes; outside them the range flag is set."""
    rate_max: int
    """Temperature codes per step; a larger change sets the rate flag."""
    ranges: tuple[tuple[int, int, int], ...] = field(default=(), metadata=OPTIONAL)
    """(channel, lowest, highest code) of other inputs; outside them their range flag is set."""


FORCED = "forced"
"""Note of a model that was written although the gate refused it: the refusals, line by line."""

FLAG_WARMING_UP = 1
FLAG_TEMPERATURE_RANGE = 2
FLAG_RATE_RANGE = 4
FLAG_CLAMPED = 8
FLAG_DAMAGED = 16
FLAG_INPUT_RANGE = 32
FLAG_NO_READING = 64
FLAG_TARED = 256
"""128 is the application's, in the CAN frames' eight bits."""


@dataclass(frozen=True)
class IntegerModel:
    """Everything that the chip computes, and nothing else."""

    name: str
    sample_period_s: float
    channels: tuple[Channel, ...]
    nodes: tuple[IntegerNode, ...]
    outputs: tuple[OutputFormat, ...]
    guards: Guards
    notes: Mapping[str, str] = field(default_factory=dict)
    """For people (where it came from); part of the file, not of the hash."""
    prefix: str = field(default="", metadata=OPTIONAL)
    """What the C's names begin with; empty for the name."""
    guarded: bool = field(default=False, metadata=OPTIONAL)
    """Whether the state has a checksum, which every step checks and updates."""
    tare: bool = field(default=False, metadata=OPTIONAL)
    """Whether the drift can be counted from a moment on."""
    variable_step: bool = field(default=False, metadata=OPTIONAL)
    """Whether each step is given the time since the last one; `sample_period_s` is then the logs'
    period, and that of calls without a time."""

    @property
    def drift(self) -> IntegerDrift:
        """The last node, which gives the answer."""
        node = self.nodes[-1]
        assert isinstance(node, IntegerDrift)
        return node

    @property
    def feeds_back(self) -> bool:
        """Whether some node reads the previous step's drift."""
        return any(node.reads_drift for node in self.nodes)

    @property
    def code_type(self) -> type[np.signedinteger]:
        """The narrowest type that holds the codes of every channel, and the time of a step."""
        return np.int64 if self.variable_step else code_type(self.channels)

    @property
    def columns(self) -> int:
        """How many numbers a step is given: the channels' codes and, last, microseconds."""
        return len(self.channels) + self.variable_step

    @property
    def period_us(self) -> int:
        """The sample period in microseconds."""
        return count_us(self.sample_period_s)

    @property
    def conversions(self) -> tuple[IntegerConversion, ...]:
        """The conversions from what the chip is given to the channels' codes, in their order."""
        return tuple(c.conversion for c in self.channels if c.conversion is not None)

    def convert(self, given: CodeArray) -> IntArray:
        """Return the channels' codes [..., C] of what the chip is given [..., C]; a step's time
        behind them stays as it is."""
        return convert_codes(self.channels, given)

    @property
    def optional(self) -> tuple[int, ...]:
        """The channels that may have no reading."""
        return tuple(i for i, c in enumerate(self.channels) if c.no_reading is not None)

    @property
    def held(self) -> tuple[int, ...]:
        """Those of them beside the thermometer: the state keeps the last reading of each."""
        return tuple(i for i in self.optional if i != self.guards.temperature_channel)

    @property
    def format(self) -> int:
        """The oldest version of the arithmetic that knows all that the model uses."""
        return FORMAT if self.optional or self.guards.ranges or self.conversions else OLDER_FORMAT

    @property
    def recurrent(self) -> IntegerGruLayer | None:
        """The first GRU layer, if there is one: the one whose kernels are looked at alone."""
        return next((n for n in self.nodes if isinstance(n, IntegerGruLayer)), None)

    @property
    def recurrents(self) -> tuple[IntegerRecurrent, ...]:
        """All recurrent layers, of whatever kind."""
        return tuple(n for n in self.nodes if isinstance(n, IntegerRecurrent))

    @property
    def streams(self) -> bool:
        """Whether some recurrent layer carries its state from sample to sample."""
        return any(layer.streams for layer in self.recurrents)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the canonical JSON without the notes, as 64 hexadecimal digits."""
        body = self.to_json()
        body.pop("notes")
        return hashlib.sha256(canonical_json(body).encode()).hexdigest()

    @property
    def identity(self) -> int:
        """The first 32 bits of the hash: the word that marks a state as this model's."""
        return int(self.hash[:8], 16) or 1

    def prove(self) -> list[Bound]:
        """Return every bound the arithmetic relies on, for any input codes.

        Raises:
            CheckError: a bound does not hold; the model must not be generated.
        """
        known: dict[str, list[Interval]] = {}
        bounds = [bound for by in self.conversions for bound in by.prove([])[1]]
        for node in self.nodes:
            out, relied_on = node.prove([known[name] for name in node.inputs])
            known[node.name] = out
            bounds.extend(relied_on)
        return [*bounds, *self.prove_times()]

    def prove_times(self) -> list[Bound]:
        """Return the bound of the time slept, where steps are told their time."""
        held = Bound("slept.us", Interval(0, LONGEST_US), 64)
        return [held.check()] if self.variable_step else []

    def to_json(self) -> dict[str, Json]:
        """Return plain dicts, lists, numbers and strings."""
        nodes: list[Json] = [{"kind": node.kind, **to_dict(node)} for node in self.nodes]
        return {"format": self.format, **to_dict(self), "nodes": nodes}

    def to_text(self) -> str:
        """Return the model's file: canonical JSON with its hash."""
        return canonical_json({**self.to_json(), "hash": self.hash}) + "\n"

    def save(self, path: Path) -> None:
        """Write the model with its hash, whole or not at all."""
        write_whole(path, self.to_text().encode())


def canonical_json(body: Json) -> str:
    """Return the one JSON text of a value: sorted keys, no spaces, no NaN."""
    return json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)
