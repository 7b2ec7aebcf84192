"""What an operation says of itself to the proof: its numbers, ranges, fields, rest and step.

JSON values as frozen dataclasses, strictly: the fields are the keys, and each has its type.

Every operation is a module in `operations/`, written from docs/reference/integer-arithmetic.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from types import NoneType, UnionType
from typing import (
    ClassVar,
    NamedTuple,
    TypeAlias,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from zerodrift_proof.equality.kernels import Layers, Numbered, TermArithmetic
from zerodrift_proof.equality.terms import Terms, Whole

Row: TypeAlias = tuple[int, ...]
Table: TypeAlias = tuple[Row, ...]
Cube: TypeAlias = tuple[Table, ...]
"""Whole numbers by one, two and three indices; in the file lists, or an array with its shape."""
T = TypeVar("T")


MOST = {
    **dict.fromkeys(("align", "bits", "block_bits", "cell_bits", "multiplier_shift", "shift"), 63),
    **dict.fromkeys(("fraction_bits", "steps", "window"), 2**15 - 1),
}
"""Keys -> the largest number there that any C can have: of a shift, of places in a ring."""


def read_record(kind: type[T], body: object, where: str) -> T:
    """Return a JSON object as a dataclass.

    Args:
        kind: of fields that are int, float, str, bool, records, tuples of these, or any of them or
            None; a field of type object takes whatever stands there.
        body: as JSON has it.
        where: it stands, for messages.

    Raises:
        ValueError: a key is missing, unknown, or holds something else.
    """
    assert is_dataclass(kind)
    if not isinstance(body, Mapping):
        raise ValueError(f"{where}: is {body!r:.40}; expected an object")
    hints = get_type_hints(kind)
    known = {one.name: one for one in fields(kind)}
    unknown = sorted(body.keys() - known.keys())
    needed = {n for n, one in known.items() if one.default is MISSING}
    missing = sorted(needed - body.keys())
    if unknown or missing:
        raise ValueError(f"{where}: has keys {unknown} that are unknown, and lacks {missing}")
    found = {name: _read(hints[name], body[name], f"{where}.{name}") for name in body}
    for name in MOST.keys() & found.keys():
        given = found[name]
        several = given if isinstance(given, tuple) else (given,)
        if any(isinstance(n, int) and not 0 <= n <= MOST[name] for n in several):
            raise ValueError(f"{where}.{name}: is {given!r:.40}; 0 to {MOST[name]} can be")
    return kind(**found)


def _read(kind: object, value: object, where: str) -> object:
    if kind is object:
        return value
    if get_origin(kind) in (Union, UnionType):
        if value is None and NoneType in get_args(kind):
            return None
        (kind,) = (one for one in get_args(kind) if one is not NoneType)
    if kind is float and type(value) in (int, float):
        return value
    if isinstance(kind, type) and is_dataclass(kind):
        return read_record(kind, value, where)
    if get_origin(kind) is tuple:
        return _read_rows(get_args(kind), value, where)
    if type(value) is not kind:
        raise ValueError(f"{where}: is {value!r:.40}; expected {getattr(kind, '__name__', kind)}")
    return value


def _read_rows(kinds: tuple[object, ...], value: object, where: str) -> tuple[object, ...]:
    rows = _unfold(value, where) if isinstance(value, Mapping) else value
    if not isinstance(rows, list):
        raise ValueError(f"{where}: is {value!r:.40}; expected a list")
    if kinds[1:] == (...,):
        kinds = kinds[:1] * len(rows)
    if len(kinds) != len(rows):
        raise ValueError(f"{where}: has {len(rows)} entries; expected {len(kinds)}")
    return tuple(
        _read(kind, one, f"{where}[{i}]")
        for i, (kind, one) in enumerate(zip(kinds, rows, strict=True))
    )


def _unfold(array: Mapping[str, object], where: str) -> list[object]:
    """Return an array, an object of type, shape and numbers row by row, as nested lists."""
    shape, rows = array.get("shape"), array.get("data")
    count = 1
    if not isinstance(shape, list) or not isinstance(rows, list) or not shape:
        raise ValueError(f"{where}: is no array with shape and data")
    for size in shape:
        if type(size) is not int or size < 0:
            raise ValueError(f"{where}: has the shape {shape}")
        count *= size
    if len(rows) != count:
        raise ValueError(f"{where}: has {len(rows)} numbers; the shape {shape} has {count}")
    nested: list[object] = rows
    for size in shape[:0:-1]:
        nested = [nested[k : k + size] for k in range(0, len(nested), size)] if size else []
    return nested


State = dict[str, list[Whole]]
"""Field of the C's state -> its numbers."""
Values = Mapping[str, list[Whole]]
"""Node -> what it gives; of a scalar one number."""
DRIFT = "drift"
"""The state's field of the drift that the step before gave, where some node reads it."""


class Moment(NamedTuple):
    """What a step may read."""

    state: State
    """All fields as they were."""
    codes: Sequence[Whole]
    """Of the channels."""
    values: Values
    """Of the nodes before it."""


class Ends(NamedTuple):
    """The range of a whole number, both ends included."""

    low: int
    high: int

    def plus(self, other: "Ends") -> "Ends":
        """Return the range of a sum."""
        return Ends(self.low + other.low, self.high + other.high)

    def minus(self, other: "Ends") -> "Ends":
        """Return the range of a difference of independent numbers."""
        return Ends(self.low - other.high, self.high - other.low)

    def times(self, other: "Ends") -> "Ends":
        """Return the range of a product of independent numbers."""
        corners = [a * b for a in self for b in other]
        return Ends(min(corners), max(corners))

    def scale(self, factor: int) -> "Ends":
        """Return the range of the number times a factor."""
        return self.times(Ends(factor, factor))

    def shift(self, by: int) -> "Ends":
        """Return the range of the number >> by."""
        return Ends(self.low >> by, self.high >> by)

    def round_shift(self, by: int) -> "Ends":
        """Return the range of round_shift(number, by)."""
        half = 1 << by >> 1
        return Ends(self.low + half, self.high + half).shift(by)

    def saturate(self, low: int, high: int) -> "Ends":
        """Return the range of saturate(number, low, high)."""
        return Ends(min(max(self.low, low), high), min(max(self.high, low), high))


ANY = Ends(-(2**31), 2**31 - 1)
"""Of a vector: no field of a state depends on more than that each number fits 32 bits."""


def bound_dot(bias: int, factors: Sequence[int], given: Sequence[Ends]) -> Ends:
    """Return the range of bias + sum of products."""
    total = Ends(bias, bias)
    for factor, one in zip(factors, given, strict=True):
        total = total.plus(one.scale(factor))
    return total


@dataclass(frozen=True)
class Field:
    """A field of the state in C, and what a sound state holds there."""

    name: str
    type: str
    sizes: tuple[int, ...] = ()
    low: int | None = None
    """None: anything."""
    high: int | None = None

    @property
    def count(self) -> int:
        """How many numbers it holds."""
        count = 1
        for size in self.sizes:
            count *= size
        return count


class Meaning(TermArithmetic):
    """What operations compute with: terms, the model's recurrent layers, the time of a step."""

    def __init__(self, terms: Terms, layers: Sequence[Numbered]) -> None:
        """Know the layers of all nodes."""
        super().__init__(terms)
        self.layers = Layers(terms, layers)
        self.span = self.number(0)
        """Of a variable step: the time since the last one."""

    def select(self, table: Mapping[int, Whole], at: Whole) -> Whole:
        """Return the table's entry at a place within its range."""
        return self.terms.select(at, {i: table[i] for i in range(at.low, at.high + 1)})


@dataclass(frozen=True)
class Node:
    """An operation of a model; a subclass has the keys of the file as its fields."""

    kind: ClassVar[str]
    """As the file calls it."""
    reads_drift: ClassVar[bool] = False
    """Whether a step reads the drift that the step before gave."""
    name: str
    inputs: tuple[str, ...]
    """The nodes that it reads, in the order of the formulas."""

    @property
    def numbered(self) -> list[Numbered]:
        """The recurrent layers in it, from the bottom up, named as in the C."""
        return []

    @property
    def streams(self) -> bool:
        """Whether recurrent layers carry their states from sample to sample."""
        return False

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return the range of what it gives, for any inputs in theirs; left out for a vector."""
        return ANY

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return what it has in the state, in the order of the C."""
        return []

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Return its fields at rest under the values of the nodes before it.

        Args:
            m: what to compute with.
            values: of the nodes before it.
            settled: after the inputs have lasted forever, or at the start.
        """
        return {}

    def give_at_rest(self, m: Meaning, at: Moment) -> list[Whole]:
        """Return what it gives under a settled state: what the nodes behind it settle under."""
        return self.step(m, at)[1]

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Return its fields after a step, and what it gives.

        Args:
            m: what to compute with.
            at: what it may read.
        """
        return {}, self.compute(m, [at.values[name] for name in self.inputs])

    def compute(self, m: Meaning, given: Sequence[list[Whole]]) -> list[Whole]:
        """Return what an operation without a state makes of its inputs."""
        raise NotImplementedError
