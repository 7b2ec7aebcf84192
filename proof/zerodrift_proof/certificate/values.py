"""What variables and the runtime's tables can hold.

The runtime's tables as the checker reads them.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

TYPES = {f"int{n}_t": (-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in (8, 16, 32, 64)}
TYPES |= {f"uint{n}_t": (0, 2**n - 1) for n in (8, 16, 32, 64)}
BITS = {name: int(name.strip("uint_")) for name in TYPES}
LIMITS = {f"INT{n}_MIN": TYPES[f"int{n}_t"][0] for n in (8, 16, 32, 64)}
LIMITS |= {
    f"{u}INT{n}_MAX": TYPES[f"{u.lower()}int{n}_t"][1] for u in ("", "U") for n in (8, 16, 32, 64)
}
"""Macros of stdint.h."""


class NotUnderstoodError(Exception):
    """The C holds something for which there is no rule; nothing can then be claimed of it."""


class FaultError(Exception):
    """The C does something wrong after which there is no going on, such as a read past the end."""


def is_signed(kind: str) -> bool:
    """Return whether an integer type has a sign."""
    return kind.startswith("int")


@dataclass(frozen=True)
class Value:
    """All numbers from low to high, of a C type; no partial sum behind them goes beyond `reach`."""

    low: int
    high: int
    type: str = "int32_t"
    reach: int = 0
    copy_of: tuple[int, int] | None = None
    """(block, version) of the one-element block that this is a copy of, if it is."""
    sum_of: tuple[tuple[int, int], ...] = ()
    """(block, version) of all fields of the state of which this is the checksum, if it is."""

    def __post_init__(self) -> None:
        if self.reach < self.high or self.reach < -self.low:
            object.__setattr__(self, "reach", max(self.reach, abs(self.low), abs(self.high)))

    @property
    def exact(self) -> int | None:
        """The number, where it can be but one."""
        return self.low if self.low == self.high else None

    @property
    def width(self) -> int:
        """How far the ends are apart."""
        return self.high - self.low

    def join(self, other: "Value") -> "Value":
        """Return what either can be."""
        reach = max(self.reach, other.reach)
        return Value(min(self.low, other.low), max(self.high, other.high), self.type, reach)


Cell = Value | int | None
"""What one element can be: an interval, a constant's number, or nothing written yet."""


@dataclass(eq=False)
class Block:
    """A variable: one number or an array of them, rows one after the other."""

    name: str
    type: str
    sizes: tuple[int, ...]
    """() for a single number."""
    cells: list[Cell]
    constant: bool = False
    version: int = 0
    """Counts the writes."""

    @property
    def count(self) -> int:
        """How many numbers it holds."""
        return len(self.cells)

    def value(self, at: int) -> Value:
        """Return what an element can be.

        Raises:
            FaultError: nothing may have been written there yet.
        """
        cell = self.cells[at]
        if isinstance(cell, int):
            return Value(cell, cell, self.type)
        if cell is None:
            where = f"{self.name}[{at}]" if self.sizes else self.name
            raise FaultError(f"{where} is read before anything is written there")
        return cell


@dataclass(eq=False)
class Struct:
    """A variable of a struct type."""

    name: str
    type: str
    fields: dict[str, "Block"] = field(default_factory=dict)
    tables: "dict[str, Pointer | None]" = field(default_factory=dict)
    """Its fields that point to constants."""


@dataclass(frozen=True)
class Pointer:
    """To the elements of a block from `first` on: `count` of them."""

    block: Block
    first: Value
    sizes: tuple[int, ...]
    """Of what is pointed into, from here on: () is one number, (n,) an array or a part of one."""
    constant: bool = False
    step: int = 1
    """`first` is a multiple of it from its lowest on."""

    @property
    def count(self) -> int:
        """How many elements can be reached, wherever it points."""
        count = 1
        for size in self.sizes:
            count *= size
        return count

    def values(self, count: int) -> list[Value]:
        """Return what the first `count` elements can be."""
        self.hold(count)
        if self.first.exact is not None:
            start = self.first.exact
            return [self.block.value(start + k) for k in range(count)]
        found = []
        for k in range(count):
            any_of = [self.block.value(at + k) for at in self._starts()]
            joined = any_of[0]
            for value in any_of[1:]:
                joined = joined.join(value)
            found.append(joined)
        return found

    def _starts(self) -> range:
        """Return the positions that it can have."""
        return range(self.first.low, self.first.high + 1, self.step)

    def fill(self, values: Sequence[Value]) -> None:
        """Write the elements from here on.

        Raises:
            FaultError: there are not so many, or they must not be written.
        """
        if self.constant or self.block.constant:
            raise FaultError(f"{self.block.name} is constant, and is written")
        self.hold(len(values))
        self.block.version += 1
        if self.first.exact is not None:
            start = self.first.exact
            self.block.cells[start : start + len(values)] = values
            return
        for start in self._starts():
            for k, value in enumerate(values):
                before = self.block.cells[start + k]
                if before is not None:
                    self.block.cells[start + k] = self.block.value(start + k).join(value)

    def hold(self, count: int) -> None:
        """Raise FaultError where there are less than `count` elements."""
        if count > self.count:
            place = f"{self.block.name} from {self.first.low} .. {self.first.high} on"
            raise FaultError(f"{count} elements of {place}, which has {self.count} there")


@dataclass(frozen=True)
class Address:
    """Of a struct, or of its bytes where it was cast."""

    struct: Struct
    constant: bool = False
    bytes: bool = False


Found: TypeAlias = Value | Pointer | Address | Struct | None
"""What an expression gives; None where a function returns nothing."""
Holder: TypeAlias = Block | Struct | Pointer | Address
"""What a variable is: pointers and addresses are parameters, or point to constants."""


def make_block(
    name: str, kind: str, sizes: Sequence[int], cell: Cell, constant: bool = False
) -> Block:
    """Return a variable, each element of which is `cell`."""
    count = 1
    for size in sizes:
        count *= size
    return Block(name, kind, tuple(sizes), [cell] * count, constant)


def anything(kind: str) -> Value:
    """Return any bit pattern of a type."""
    return Value(*TYPES[kind], kind)


@dataclass(frozen=True)
class LayerNumbers:
    """A recurrent layer of G gates as the C has it, for the check of the error bound."""

    w_x: list[int]
    """[H][G][I]."""
    w_h: list[int]
    """[H][G][H]."""
    bias: list[int]
    """[H][4]: of a GRU r, u, n, n inside the reset product; of an LSTM i, f, g, o."""
    shifts: list[int]
    multipliers: list[int]
    """[H][G] of 8-bit recurrent weights; else empty."""
    multiplier_shifts: list[int]
    inputs: int
    hidden: int


@dataclass(frozen=True)
class GruNumbers(LayerNumbers):
    """A GRU."""

    after: bool


@dataclass(frozen=True)
class LstmNumbers(LayerNumbers):
    """An LSTM."""

    cell_bits: int


def read_lines(tables: Mapping[str, list[int]]) -> list[tuple[int, int]]:
    """Return tanh in Q0.30 at the first and last input of each of the 512 lines of its table.

    Either the 513 nodes are stored, or offset and slope of each line over the position. A runtime
    without a network has no such table, and no lines.
    """
    if not any(name.startswith("zd_tanh_") for name in tables):
        return []
    if nodes := tables.get("zd_tanh_nodes_q19"):
        pairs = itertools.pairwise(nodes)
        lines = [(a << 11, (a << 11) + (b - a) * 2047) for a, b in pairs]
    else:
        both = zip(tables["zd_tanh_offset_q30"], tables["zd_tanh_slope_q19"], strict=False)
        lines = []
        for line, (offset, slope) in enumerate(both, -256):
            ends = [slope * ((line << 11) + f) for f in (0, 2047)]
            if max(map(abs, ends)) >= 1 << 31:
                raise NotUnderstoodError(f"line {line} of tanh: the slope's product overflows")
            lines.append((offset + ends[0], offset + ends[1]))
        _require_half(tables)
        raised = [offset + 2**30 for offset in tables["zd_tanh_offset_q30"]]
        if tables.get("zd_sigmoid_offset_q31", raised) != raised:
            raise NotUnderstoodError("zd_sigmoid_offset_q31 is not half a unit above tanh's")
    if len(lines) != 512:
        raise NotUnderstoodError(f"tanh has {len(lines)} lines; 512 are read")
    return lines


def _require_half(tables: Mapping[str, list[int]]) -> None:
    """Raise where the lines that are read at -Os are not those of the whole table, on either side.

    They lie from 0 on; the last one is level and holds beyond; at -t the offset's sign changes.
    """

    def pair(stem: str) -> list[tuple[int, int]]:
        names = (f"zd_tanh_{stem}offset_q30", f"zd_tanh_{stem}slope_q19")
        return list(zip(*(tables[name] for name in names), strict=False))

    if "zd_tanh_half_offset_q30" in tables:
        half, whole = pair("half_"), pair("")
        sizes = {len(tables[f"zd_tanh_half_{name}"]) for name in ("offset_q30", "slope_q19")}
        half += [half[-1]] * (256 - len(half))
        mirrored = [(-offset, slope) for offset, slope in reversed(half)]
        if len(sizes) > 1 or half[-1][1] != 0 or mirrored + half != whole[:512]:
            raise NotUnderstoodError("zd_tanh_half_* is not the table of the other cores")
