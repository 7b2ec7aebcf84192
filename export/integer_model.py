"""The integer model: channels, nodes, outputs and guards, as data; JSON in and out; its hash."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from zerodrift.base.errors import InputError
from zerodrift.export.model_checks import check_model
from zerodrift.base.files import write_whole
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.clock import IntegerCounter
from zerodrift.operations.exp2 import IntegerExp2
from zerodrift.operations.gru import IntegerGru
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.layers import IntegerDense, IntegerFeatureDense, IntegerGruStack
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.network import (
    IntegerDrift,
    IntegerFeatures,
    IntegerGruLayer,
    IntegerHead,
)
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.power import IntegerPower
from zerodrift.operations.signal import (
    IntegerDelay,
    IntegerDifference,
    IntegerInput,
    IntegerLowpass,
    IntegerOffset,
    IntegerProduct,
)
from zerodrift.operations.total import IntegerSum

FORMAT = 3
"""Version of the integer arithmetic; equals ZD_RUNTIME_FORMAT of the C runtime."""
OLDER_FORMAT = 2
"""Knows neither codes that mean no reading nor ranges of other inputs; a model that has none of
either is written in it, and computes the same."""
NEWER_FIELDS = ("no_reading", "ranges")
"""Left out of a model's file where they are empty."""

NODE_CLASSES: dict[str, type[IntegerNode]] = {
    cls.kind: cls
    for cls in (
        IntegerInput,
        IntegerLoad,
        IntegerCounter,
        IntegerOffset,
        IntegerDifference,
        IntegerSum,
        IntegerProduct,
        IntegerPower,
        IntegerExp2,
        IntegerLowpass,
        IntegerDelay,
        IntegerPlay,
        IntegerClip,
        IntegerFeatures,
        IntegerGruLayer,
        IntegerGruStack,
        IntegerDense,
        IntegerFeatureDense,
        IntegerHead,
        IntegerDrift,
    )
}


@dataclass(frozen=True)
class Channel:
    """One raw integer input: physical value = offset + code * lsb."""

    name: str
    unit: str
    lsb: float
    offset: float = 0.0
    bits: int = 16
    """16 or 32: width of the code."""
    source: str = ""
    """Where a log has it: temperature_degC, measured:Fz or an input's name; empty for the name."""
    no_reading: int | None = None
    """The code that means that there is no reading; None: every code is one."""

    @property
    def least(self) -> int:
        """The lowest code of the type."""
        return -(1 << (self.bits - 1))

    @property
    def most(self) -> int:
        """The highest code of the type."""
        return (1 << (self.bits - 1)) - 1


def code_type(channels: Sequence[Channel]) -> type[np.signedinteger[Any]]:
    """Return the narrowest type that holds the codes of every channel."""
    return np.int32 if any(channel.bits > 16 for channel in channels) else np.int16


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
    """Codes per step; a larger change sets the rate flag."""
    ranges: tuple[tuple[int, int, int], ...] = ()
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


@dataclass(frozen=True)
class IntegerModel:
    """Everything that the chip computes, and nothing else."""

    name: str
    sample_period_s: float
    channels: tuple[Channel, ...]
    nodes: tuple[IntegerNode, ...]
    outputs: tuple[OutputFormat, ...]
    guards: Guards
    notes: dict[str, str] = field(default_factory=dict)
    """For people (where it came from); part of the file, not of the hash."""
    prefix: str = ""
    """What the C's names begin with; empty for the name."""
    guarded: bool = False
    """Whether the state bears a checksum, which every step looks at and writes again."""

    @property
    def drift(self) -> IntegerDrift:
        """The last node, which gives the answer."""
        node = self.nodes[-1]
        assert isinstance(node, IntegerDrift)
        return node

    @property
    def feeds_back(self) -> bool:
        """Whether some node reads the previous step's drift."""
        return any(isinstance(n, IntegerLoad) for n in self.nodes)

    @property
    def code_type(self) -> type[np.signedinteger[Any]]:
        """The narrowest type that holds the codes of every channel."""
        return code_type(self.channels)

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
        return FORMAT if self.optional or self.guards.ranges else OLDER_FORMAT

    @property
    def recurrent(self) -> IntegerGruLayer | None:
        """The GRU layer, if there is one."""
        return next((n for n in self.nodes if isinstance(n, IntegerGruLayer)), None)

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
        bounds: list[Bound] = []
        for node in self.nodes:
            out, relied_on = node.prove([known[name] for name in node.inputs])
            known[node.name] = out
            bounds.extend(relied_on)
        return bounds

    def to_json(self) -> dict[str, Any]:
        """Return plain dicts, lists, numbers and strings."""
        return {
            "format": self.format,
            "name": self.name,
            "sample_period_s": self.sample_period_s,
            "channels": [_plain(c) for c in self.channels],
            "nodes": [{"kind": n.kind, **_plain(n)} for n in self.nodes],
            "outputs": [_plain(o) for o in self.outputs],
            "guards": _plain(self.guards),
            "notes": dict(sorted(self.notes.items())),
            **({"prefix": self.prefix} if self.prefix else {}),
            **({"guarded": True} if self.guarded else {}),
        }

    def to_text(self) -> str:
        """Return the model's file: canonical JSON with its hash."""
        return canonical_json({**self.to_json(), "hash": self.hash}) + "\n"

    def save(self, path: Path) -> None:
        """Write the model with its hash, whole or not at all."""
        write_whole(path, self.to_text().encode())


def canonical_json(body: Any) -> str:
    """Return the one JSON text of a value: sorted keys, no spaces, no NaN."""
    return json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {
            "dtype": value.dtype.name,
            "shape": list(value.shape),
            "data": value.ravel().tolist(),
        }
    if isinstance(value, np.integer):
        return int(value)
    if hasattr(value, "__dataclass_fields__"):
        values = {f.name: getattr(value, f.name) for f in fields(value)}
        return {
            k: _plain(v) for k, v in values.items() if k not in NEWER_FIELDS or v not in ((), None)
        }
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    return value


_INTEGER_TYPES = ("int8", "int16", "int32", "int64")


def _array(path: str, body: Any) -> np.ndarray[Any, np.dtype[Any]]:
    try:
        dtype, shape, data = body["dtype"], body["shape"], body["data"]
    except (TypeError, KeyError) as error:
        raise InputError(f"{path}: expected an array with dtype, shape and data") from error
    if dtype not in _INTEGER_TYPES or not all(isinstance(n, int) and n >= 0 for n in shape):
        raise InputError(f"{path}: array of {dtype!r} with shape {shape!r}; expected integers")
    size = 1
    for n in shape:
        size *= n
    if len(data) != size or not all(type(v) is int for v in data):
        raise InputError(f"{path}: {len(data)} entries do not fill shape {shape}")
    info = np.iinfo(dtype)
    if any(v < info.min or v > info.max for v in data):
        raise InputError(f"{path}: an entry does not fit {dtype}")
    return np.array(data, dtype=dtype).reshape(shape)


def _typed(path: str, value: Any) -> Any:
    if isinstance(value, dict) and "dtype" in value:
        return _array(path, value)
    if isinstance(value, list):
        return tuple(_typed(path, v) for v in value)
    return value


def _build(cls: type[Any], path: str, body: Any) -> Any:
    names = {f.name for f in fields(cls)}
    if not isinstance(body, dict) or not names - {*NEWER_FIELDS} <= set(body) <= names:
        found = sorted(body) if isinstance(body, dict) else type(body).__name__
        raise InputError(f"{path}: expected the fields {sorted(names)}, found {found}")
    return cls(**{k: _read_field(f"{path}.{k}", k, v) for k, v in body.items()})


def _read_field(path: str, key: str, value: Any) -> Any:
    """Return a field of a node; `gru` is a layer, `lower` a list of them."""
    if key == "gru":
        return _build(IntegerGru, path, value)
    if key == "lower" and value and isinstance(value, list):
        return tuple(_build(IntegerGru, f"{path}[{i}]", v) for i, v in enumerate(value))
    return _typed(path, value)


def _nodes(path: str, bodies: Any) -> Iterator[IntegerNode]:
    seen: set[str] = set()
    for i, body in enumerate(bodies):
        where = f"{path}: nodes[{i}]"
        kind = body.get("kind") if isinstance(body, dict) else None
        if kind not in NODE_CLASSES:
            raise InputError(
                f"{where}: unknown kind {kind!r}; expected one of {list(NODE_CLASSES)}"
            )
        node = _build(NODE_CLASSES[kind], where, {k: v for k, v in body.items() if k != "kind"})
        missing = [name for name in node.inputs if name not in seen]
        if missing or node.name in seen:
            raise InputError(f"{where}: '{node.name}' reads {missing}, which are not earlier nodes")
        seen.add(node.name)
        yield node


def load_model(path: Path) -> IntegerModel:
    """Read a model written by `IntegerModel.save`.

    Raises:
        InputError: no such file, not JSON, another format, fields missing or unknown, entries that
            do not fit their type, or a hash that does not match (the file was edited or damaged).
        CheckError: a bound of the arithmetic does not hold.
    """
    try:
        body = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no integer model. Run `zerodrift firmware`.") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: cannot be read as a model ({error}). Run `zerodrift export`."
        ) from error
    if not isinstance(body, dict) or body.get("format") not in (OLDER_FORMAT, FORMAT):
        raise InputError(
            f"{path}: not an integer model of format {OLDER_FORMAT} or {FORMAT}."
            " Run `zerodrift export`."
        )
    claimed = body.pop("hash", None)
    try:
        model = IntegerModel(
            name=body["name"],
            sample_period_s=body["sample_period_s"],
            channels=tuple(_build(Channel, f"{path}: channels", c) for c in body["channels"]),
            nodes=tuple(_nodes(str(path), body["nodes"])),
            outputs=tuple(_build(OutputFormat, f"{path}: outputs", o) for o in body["outputs"]),
            guards=_build(Guards, f"{path}: guards", body["guards"]),
            notes=body["notes"],
            prefix=body.get("prefix", ""),
            guarded=body.get("guarded", False),
        )
        found = model.hash
    except KeyError as error:
        raise InputError(
            f"{path}: the field {error} is missing. Run `zerodrift export`."
        ) from error
    except (TypeError, AttributeError, ValueError) as error:
        raise InputError(
            f"{path}: not built like an integer model ({error}). Run `zerodrift export`."
        ) from error
    if not model.nodes or not isinstance(model.nodes[-1], IntegerDrift):
        raise InputError(f"{path}: the last node is not 'drift'. Run `zerodrift export`.")
    if found != claimed:
        raise InputError(
            f"{path}: its hash is {found[:12]}, the file claims {str(claimed)[:12]}; it was"
            " edited or damaged. Run `zerodrift export`."
        )
    check_model(str(path), model)
    return model
