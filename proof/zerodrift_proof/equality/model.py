"""model.json as the proof reads it: by itself, as it shares no code with what wrote the file.

Written from docs/reference/model-file.md.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from zerodrift_proof.equality.names import sanitize_names, sanitize_outputs, sanitize_prefix
from zerodrift_proof.equality.node import Node
from zerodrift_proof.equality.operations import KINDS
from zerodrift_proof.equality.operations.drift import Drift
from zerodrift_proof.equality.records import Row, read_record

FORMAT, OLDER_FORMAT = 3, 2
"""Versions of the arithmetic; the older one has no codes for no reading, ranges, conversions."""
RAW = {"uint16": (0, 2**16 - 1), "int16": (-(2**15), 2**15 - 1), "int32": (-(2**31), 2**31 - 1)}
"""What a chip may be given -> its least and largest code."""
FLAG_WARMING_UP, FLAG_TEMPERATURE_RANGE, FLAG_RATE_RANGE, FLAG_CLAMPED = 1, 2, 4, 8
FLAG_DAMAGED, FLAG_INPUT_RANGE, FLAG_NO_READING, FLAG_TARED = 16, 32, 64, 256
"""What a step may return (section 5 of the arithmetic)."""


@dataclass(frozen=True)
class Conversion:
    """The table from what the chip is given to a channel's code (2.2)."""

    name: str
    inputs: tuple[str, ...]
    channel: int
    raw: str
    formula: object
    """For people, as `error` and `worth`."""
    begin: int
    end: int
    lacks: int | None
    none: int | None
    low: int
    high: int
    block_bits: int
    first: Row
    nodes: Row
    shift: int
    lowest: int
    highest: int
    error: object
    worth: object
    junction: object = None
    fraction_bits: int | None = None

    @property
    def is_plain(self) -> bool:
        """Whether the code is what the chip is given."""
        return not self.nodes


@dataclass(frozen=True)
class Channel:
    """One input."""

    name: str
    unit: str
    lsb: float
    offset: float
    bits: int
    source: str
    no_reading: int | None = None
    conversion: Conversion | None = None

    @property
    def raw_type(self) -> str:
        """What the chip is given, in C without _t."""
        return f"int{self.bits}" if self.conversion is None else self.conversion.raw

    @property
    def raw_least(self) -> int:
        """The least that the chip may be given."""
        return RAW[self.raw_type][0]

    @property
    def raw_most(self) -> int:
        """The largest that the chip may be given."""
        return RAW[self.raw_type][1]


@dataclass(frozen=True)
class Output:
    """One output."""

    name: str
    unit: str
    lsb_per_unit: int
    full_scale: float


@dataclass(frozen=True)
class Guards:
    """What a model checks of itself while it runs (section 5)."""

    warm_up_steps: int
    temperature_channel: int
    temperature_low: int
    temperature_high: int
    rate_max: int
    ranges: tuple[tuple[int, int, int], ...] = ()
    """(channel, lowest, highest code)."""


@dataclass(frozen=True)
class _Head:
    """The file without its nodes."""

    format: int
    name: str
    sample_period_s: float
    channels: tuple[Channel, ...]
    outputs: tuple[Output, ...]
    guards: Guards
    notes: object
    prefix: str = ""
    guarded: bool = False
    tare: bool = False
    variable_step: bool = False


@dataclass(frozen=True)
class Model:
    """What a chip computes."""

    hash: str
    """SHA-256 of the file's content without hash and notes, keys sorted, no spaces."""
    head: _Head
    nodes: tuple[Node, ...]
    drift: Drift
    """The last node, which gives the answer."""
    forced: bool
    """Whether it was written although the gate refused it."""

    @property
    def identity(self) -> int:
        """The word that marks a state as this model's."""
        return int(self.hash[:8], 16) or 1

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The inputs."""
        return self.head.channels

    @property
    def outputs(self) -> tuple[Output, ...]:
        """The outputs."""
        return self.head.outputs

    @property
    def guards(self) -> Guards:
        """What it checks of itself."""
        return self.head.guards

    @property
    def guarded(self) -> bool:
        """Whether the state has a checksum."""
        return self.head.guarded

    @property
    def tare(self) -> bool:
        """Whether the drift can be counted from a moment on."""
        return self.head.tare

    @property
    def variable_step(self) -> bool:
        """Whether each step is told the time since the last one."""
        return self.head.variable_step

    @property
    def sample_period_us(self) -> int | None:
        """The sample period as the header tells it; None where 32 bits do not hold it."""
        told = self.head.sample_period_s * 1e6
        return round(told) if told < 2**32 - 1 else None

    @property
    def period_us(self) -> int:
        """The sample period in microseconds, 1 at least."""
        return max(round(self.head.sample_period_s * 1e6), 1)

    @property
    def optional(self) -> tuple[int, ...]:
        """The channels that may have no reading."""
        return tuple(i for i, c in enumerate(self.channels) if c.no_reading is not None)

    @property
    def held(self) -> tuple[int, ...]:
        """Those of them beside the thermometer."""
        return tuple(i for i in self.optional if i != self.guards.temperature_channel)

    @property
    def format(self) -> int:
        """The oldest version of the arithmetic that knows all that the model uses."""
        newer = self.optional or self.guards.ranges or any(c.conversion for c in self.channels)
        return FORMAT if newer else OLDER_FORMAT

    @property
    def recurrents(self) -> tuple[Node, ...]:
        """The nodes that hold recurrent layers."""
        return tuple(node for node in self.nodes if node.numbered)

    @property
    def feeds_back(self) -> bool:
        """Whether some node reads the drift of the step before."""
        return any(node.reads_drift for node in self.nodes)

    @cached_property
    def prefix(self) -> str:
        """What every name of the C begins with."""
        return sanitize_prefix(self.head.prefix or self.head.name)

    @cached_property
    def channel_names(self) -> list[str]:
        """The fields of the struct of the inputs."""
        return sanitize_names((c.name for c in self.channels), "input")

    @cached_property
    def output_names(self) -> list[str]:
        """The outputs' names in the header, in lower case."""
        return sanitize_outputs((o.name for o in self.outputs), self.prefix)


def read_model(body: object, where: str = "model.json") -> Model:
    """Return the model of a file's content.

    Args:
        body: what its JSON holds.
        where: names the file in messages.

    Raises:
        ValueError: it is no integer model, or another one than its hash says.
    """
    if not isinstance(body, Mapping):
        raise ValueError(f"{where}: is no integer model")
    given = {k: v for k, v in body.items() if k != "hash"}
    text = {k: v for k, v in given.items() if k != "notes"}
    canonical = json.dumps(text, sort_keys=True, separators=(",", ":"), allow_nan=False)
    found = hashlib.sha256(canonical.encode()).hexdigest()
    if body.get("hash", found) != found:
        raise ValueError(f"{where}: its hash is {found[:12]}, it claims {body['hash']!s:.12}")
    listed = given.pop("nodes", None)
    if not isinstance(listed, list):
        raise ValueError(f"{where}: nodes: is {listed!r:.40}; expected a list")
    head = read_record(_Head, given, where)
    nodes: list[Node] = []
    for i, one in enumerate(listed):
        node = _read_node(one, f"{where}: nodes[{i}]")
        before = {earlier.name for earlier in nodes}
        if node.name in before or not before.issuperset(node.inputs):
            raise ValueError(f"{where}: nodes[{i}]: {node.name} of {node.inputs} after {before}")
        nodes.append(node)
    if not nodes or not isinstance(nodes[-1], Drift):
        raise ValueError(f"{where}: the last node is not 'drift'")
    forced = isinstance(head.notes, Mapping) and bool(head.notes.get("forced"))
    return Model(found, head, tuple(nodes), nodes[-1], forced)


def _read_node(body: object, where: str) -> Node:
    kind = body.get("kind") if isinstance(body, Mapping) else None
    if not isinstance(body, Mapping) or kind not in KINDS:
        raise ValueError(f"{where}: '{kind}' has no rule; known are {', '.join(KINDS)}")
    return read_record(KINDS[kind], {k: v for k, v in body.items() if k != "kind"}, where)
