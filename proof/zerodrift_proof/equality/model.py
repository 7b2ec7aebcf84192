"""model.json as the proof reads it, and the names in C of what a user named.

Written from docs/reference/model-file.md; it shares no code with what wrote the file. Names are
held against the words of C99 and C++, and the macros of their headers, since a model's header may
be included from either.
"""

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

from zerodrift_proof.equality.node import Node, Row, read_record
from zerodrift_proof.equality.operations import KINDS
from zerodrift_proof.equality.operations.drift import Drift

_WORDS = re.compile(
    "auto|break|case|char|const|continue|default|do|double|else|enum|extern|float|for|goto|if|"
    "inline|int|long|register|restrict|return|short|signed|sizeof|static|struct|switch|typedef|"
    "union|unsigned|void|volatile|while|_bool|_complex|_imaginary|asm|bool|true|false|class|"
    "new|delete|this|template|namespace|operator|private|public|protected|virtual|alignas|"
    "alignof|and|and_eq|bitand|bitor|catch|char16_t|char32_t|char8_t|compl|concept|const_cast|"
    "consteval|constexpr|constinit|co_await|co_return|co_yield|decltype|dynamic_cast|explicit|"
    "export|friend|mutable|noexcept|not|not_eq|nullptr|or|or_eq|reinterpret_cast|requires|"
    "static_assert|static_cast|thread_local|throw|try|typeid|typename|using|wchar_t|xor|xor_eq|"
    "complex|errno|imaginary|math_errhandling|stderr|stdin|stdout|main|linux|unix"
)
"""Words of C and C++, and macros of headers and compilers: no name is one of them."""
_HEADERS = re.compile(
    "assert|complex|ctype|errno|fenv|inttypes|iso646|limits|locale|math|memory|setjmp|signal|"
    "stdarg|stdbool|stddef|stdint|stdio|stdlib|stdalign|stdatomic|stdnoreturn|string|strings|"
    "tgmath|threads|time|wchar|wctype|atomic|cnd|mtx|sem"
)
"""Headers and families of functions of C: no prefix is one of them."""
_INTEGERS = (
    r"(U?INT(8|16|32|64|MAX|PTR|_(LEAST|FAST)(8|16|32|64))?|[SU]?CHAR|U?(SHRT|LONG|LLONG)|S?SIZE"
    r"|PTRDIFF|SIG_ATOMIC|WCHAR|WINT|BOOL)_(MIN|MAX|C|BIT|WIDTH)"
)
_FLOATS = (
    r"(FLT|DBL|LDBL)_(\w*DIG|\w*(MIN|MAX)(_10)?(_EXP)?|EPSILON|RADIX|ROUNDS|EVAL_METHOD|HAS_SUBNORM"
    r"|IS_IEC_60559|SNAN)|DECIMAL_DIG|FP_(INFINITE|(SUB)?NORMAL|NAN|ZERO|ILOGB0|ILOGBNAN"
    r"|FAST_FMA[FL]?)|FE_(ALL_EXCEPT|DFL_ENV|DIVBYZERO|INEXACT|INVALID|OVERFLOW|UNDERFLOW|DOWNWARD"
    r"|TONEAREST|TOWARDZERO|UPWARD)|HUGE_VAL[FL]?|MATH_(ERRNO|ERREXCEPT)"
    r"|M_(E|PI|[12]_PI|PI_[24]|2_SQRTPI|SQRT2|SQRT1_2|LN2|LN10|LOG2E|LOG10E)"
)
_OTHERS = (
    r"CLOCKS_PER_SEC|TIME_UTC|EXIT_(SUCCESS|FAILURE)|SEEK_(SET|CUR|END)|MB_(CUR|LEN)_MAX"
    r"|(RAND|TMP|FILENAME|FOPEN|PATH|NAME|OPEN|IOV|ARG)_MAX|PIPE_BUF|SIG_(DFL|ERR|IGN)"
    r"|LC_(ADDRESS|ALL|COLLATE|CTYPE|IDENTIFICATION|MEASUREMENT|MESSAGES|MONETARY|NAME|NUMERIC"
    r"|PAPER|TELEPHONE|TIME)|ATOMIC_\w+_(LOCK_FREE|INIT)|ONCE_FLAG_INIT|TSS_DTOR_ITERATIONS"
)
_MACROS = re.compile(f"{_INTEGERS}|{_FLOATS}|{_OTHERS}")
"""Macros of C's headers."""
_OWN = re.compile(
    r"h|format|manifest|forced|model_hash|model_id|code_id|channels|outputs|sample_period_us"
    r"|saved_bytes|flag_.*|fault_.*|.*_lsb_per_unit"
)
"""Macros that every model's header has, behind the prefix."""
LONGEST = 31
"""Characters that C99 tells apart in names of several files."""


def _shorten(name: str, ending: str = "") -> str:
    return name[: LONGEST - len(ending)] + ending


def sanitize_name(text: str, fallback: str) -> str:
    """Return a text's letters and digits as a lower-case name that C, C++ and the runtime lack."""
    name = _shorten(re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")).rstrip("_") or fallback
    if name[0] in "0123456789":
        name = _shorten(f"x{name}").rstrip("_")
    if re.match(r"zd(_|$)", name):
        name = _shorten(f"x_{name}").rstrip("_")
    return _shorten(name, "_x") if _WORDS.fullmatch(name) else name


def sanitize_prefix(text: str) -> str:
    """Return what a model's files and functions are called."""
    name = sanitize_name(text, "sensor")
    return f"{name}_x" if _HEADERS.fullmatch(name) else name


def sanitize_outputs(texts: Iterable[str], prefix: str) -> list[str]:
    """Return the outputs' names, none of which makes a macro that is there already."""

    def is_taken(name: str) -> bool:
        return bool(_MACROS.fullmatch(f"{prefix}_{name}".upper()) or _OWN.fullmatch(name))

    return sanitize_names(texts, "output", is_taken)


def sanitize_names(
    texts: Iterable[str], fallback: str, is_taken: Callable[[str], bool] = lambda _: False
) -> list[str]:
    """Return a name for each text, in order; of equal ones the later get _2, _3, ..."""
    names: list[str] = []
    for text in texts:
        first = sanitize_name(text, fallback)
        if is_taken(first):
            first = _shorten(first, "_x")
        name, count = first, 1
        while name in names:
            count += 1
            name = _shorten(first, f"_{count}")
        names.append(name)
    return names


FORMAT = 3
"""Version of the arithmetic, which knows what the older one did."""
RAW = {"uint16": (0, 2**16 - 1), "int16": (-(2**15), 2**15 - 1), "int32": (-(2**31), 2**31 - 1)}
"""What a chip may be given -> its least and largest code."""


class Flag(IntEnum):
    """What a step may return (section 5 of the arithmetic)."""

    WARMING_UP = 1
    TEMPERATURE_RANGE = 2
    RATE_RANGE = 4
    CLAMPED = 8
    DAMAGED = 16
    INPUT_RANGE = 32
    NO_READING = 64
    TARED = 256


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


@dataclass(frozen=True, kw_only=True)
class Model(_Head):
    """What a chip computes."""

    hash: str
    """SHA-256 of the file's content without hash and notes, keys sorted, no spaces."""
    nodes: tuple[Node, ...]
    drift: Drift
    """The last node, which gives the answer."""

    @property
    def identity(self) -> int:
        """The word that marks a state as this model's."""
        return int(self.hash[:8], 16) or 1

    @property
    def forced(self) -> bool:
        """Whether it was written although the gate refused it."""
        return isinstance(self.notes, Mapping) and bool(self.notes.get("forced"))

    @property
    def sample_period_us(self) -> int | None:
        """The sample period as the header tells it; None where 32 bits do not hold it."""
        told = self.sample_period_s * 1e6
        return round(told) if told < 2**32 - 1 else None

    @property
    def period_us(self) -> int:
        """The sample period in microseconds, 1 at least."""
        return max(round(self.sample_period_s * 1e6), 1)

    @property
    def optional(self) -> tuple[int, ...]:
        """The channels that may have no reading."""
        return tuple(i for i, c in enumerate(self.channels) if c.no_reading is not None)

    @property
    def held(self) -> tuple[int, ...]:
        """Those of them beside the thermometer."""
        return tuple(i for i in self.optional if i != self.guards.temperature_channel)

    @property
    def recurrents(self) -> tuple[Node, ...]:
        """The nodes that hold recurrent layers."""
        return tuple(node for node in self.nodes if node.numbered)

    @property
    def feeds_back(self) -> bool:
        """Whether some node reads the drift of the step before."""
        return any(node.reads_drift for node in self.nodes)

    @cached_property
    def c_prefix(self) -> str:
        """What every name of the C begins with."""
        return sanitize_prefix(self.prefix or self.name)

    @cached_property
    def channel_names(self) -> list[str]:
        """The fields of the struct of the inputs."""
        return sanitize_names((c.name for c in self.channels), "input")

    @cached_property
    def output_names(self) -> list[str]:
        """The outputs' names in the header, in lower case."""
        return sanitize_outputs((o.name for o in self.outputs), self.c_prefix)


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
    if (claimed := body.get("hash", found)) != found:
        raise ValueError(f"{where}: its hash is {found[:12]}, it claims {claimed!s:.12}")
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
    _check_places(where, head, nodes)
    return Model(**vars(head), hash=found, nodes=tuple(nodes), drift=nodes[-1])


def _check_places(where: str, head: _Head, nodes: list[Node]) -> None:
    """Raise where something reads a channel or an output that is not there."""
    channels, outputs = len(head.channels), len(head.outputs)
    for one in head.channels:
        if one.bits not in (16, 32) or one.raw_type not in RAW:
            raise ValueError(f"{where}: channel '{one.name}' has {one.bits} bits, {one.raw_type}")
    read = [("channel", head.guards.temperature_channel, channels)]
    read += [("channel", channel, channels) for channel, _, _ in head.guards.ranges]
    for node in nodes:
        most = {"channel": channels, "output": outputs}
        read += [(name, vars(node).get(name, 0), count) for name, count in most.items()]
        if any(layer.inputs < 1 for layer in node.numbered):
            raise ValueError(f"{where}: '{node.name}' has a layer that reads nothing")
    for name, index, count in read:
        if not 0 <= index < count:
            raise ValueError(f"{where}: {name} {index} of {count} is read")


def _read_node(body: object, where: str) -> Node:
    kind = body.get("kind") if isinstance(body, Mapping) else None
    if not isinstance(body, Mapping) or not isinstance(kind, str) or kind not in KINDS:
        raise ValueError(f"{where}: '{kind}' has no rule; known are {', '.join(KINDS)}")
    return read_record(KINDS[kind], {k: v for k, v in body.items() if k != "kind"}, where)
