"""From the hardware's raw code to the code of the quantity, by a table of straight lines."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.column_config import ConversionConfig, sum_formula
from zerodrift.base.errors import CheckError
from zerodrift.base.records import OPTIONAL
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN, saturate
from zerodrift.operations.c_text import CTable, format_int32, format_int64, make_table
from zerodrift.operations.intervals import Bound, Interval, Shift, check_limits, check_shift
from zerodrift.operations.node import IntegerNode, Writer

RAW_TYPES = {
    "uint16": (0, 2**16 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "int32": (-(2**31), 2**31 - 1),
}
"""What the hardware may hand over -> its lowest and highest code."""
MOST_LINES = 2**15 - 2
"""Places in the table are int16."""


@dataclass(frozen=True)
class IntegerConversion(IntegerNode):
    """The quantity's code of a raw code; it stands before all nodes, and before the last reading.

        place = saturate(code, low, high) - low
        b     = place >> block_bits
        parts = saturate(first[b + 1] - first[b], 1, most)
        at    = (place & (2**block_bits - 1)) * parts
        i     = saturate(first[b] + (at >> block_bits), 0, lines - 1)
        f     = at & (2**block_bits - 1)
        q     = saturate((half + nodes[i] 2**block_bits + (nodes[i + 1] - nodes[i]) f) >> shift,
                         lowest, highest)

    A block of 2**block_bits codes holds a whole number of lines of equal width. Codes outside
    begin .. end, and `lacks`, are no readings; they become `none`. Without nodes the quantity's
    code is the raw code.

    A thermocouple has a `junction`: what is looked up is then no raw code, but the sum of

        saturate(raw 2**fraction_bits + what the junction's own table gives for its code, int32)

    of which begin, end, low and high speak too; `lacks` is a raw code still.
    """

    kind: ClassVar[str] = "conversion"
    reads: ClassVar[int | None] = 0
    channel: int
    raw: str
    """uint16, int16 or int32."""
    formula: ConversionConfig
    """The exact conversion; the table is within `error` of it."""
    begin: int
    end: int
    """Raw codes beyond these are no readings."""
    lacks: int | None
    """One more raw code that is no reading."""
    none: int | None
    """The quantity's code for no reading; None: every raw code is a reading."""
    low: int
    high: int
    """Raw codes that the table covers; beyond them they are limited."""
    block_bits: int = 0
    first: tuple[int, ...] = ()
    """First line of each block, and at the end the number of lines."""
    nodes: tuple[int, ...] = ()
    """The quantity at the lines' ends, in its codes and shift - block_bits fractional bits."""
    shift: int = 0
    lowest: int = 0
    highest: int = 0
    error: float = 0.0
    """Largest distance to the formula at any code that is covered, rounding included, in the
    quantity's unit."""
    worth: tuple[float, float] = (0.0, 0.0)
    """Smallest and largest step of the quantity per raw code, in the quantity's unit."""
    junction: "IntegerConversion | None" = field(default=None, metadata=OPTIONAL)
    """From the code of the cold junction's channel to a voltage in counts of the sum."""
    fraction_bits: int | None = field(default=None, metadata=OPTIONAL)
    """Of the sum, beyond those of the raw code."""

    @property
    def least(self) -> int:
        """The lowest code of the raw type."""
        return RAW_TYPES[self.raw][0]

    @property
    def most(self) -> int:
        """The highest code of the raw type."""
        return RAW_TYPES[self.raw][1]

    @property
    def is_plain(self) -> bool:
        """Whether the quantity's code is the raw code."""
        return not self.nodes

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.nodes) - 1

    @property
    def most_parts(self) -> int:
        """The largest number of lines in a block."""
        return max(after - before for before, after in pairwise(self.first))

    @property
    def mask(self) -> int:
        """The bits of a place within its block."""
        return (1 << self.block_bits) - 1

    @property
    def half(self) -> int:
        """The rounding half of the shift."""
        return 1 << self.shift >> 1

    @property
    def by_sum(self) -> ConversionConfig:
        """What is looked up -> the quantity, exactly: of raw codes, or of the sum."""
        bits = self.fraction_bits
        return self.formula if bits is None else sum_formula(self.formula, bits)

    def add_junction(self, codes: IntArray, junction: IntArray | None) -> IntArray:
        """Return what is looked up for raw codes, the code of the cold junction added."""
        if self.junction is None:
            return codes
        assert self.fraction_bits is not None and junction is not None
        volts = self.junction.convert(junction)
        return np.asarray(saturate((codes << self.fraction_bits) + volts, INT32_MIN, INT32_MAX))

    def find_missing(self, codes: IntArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Return which of what is looked up, of any shape, are no readings."""
        missing = (codes < self.begin) | (codes > self.end)
        known = self.lacks is None or self.junction is not None
        return np.asarray(missing if known else missing | (codes == self.lacks))

    def list_missing(self) -> tuple[int, ...]:
        """Return raw codes that are no readings: those beside the readings, and the one stated."""
        if self.none is None:
            return ()
        if self.junction is not None:
            return () if self.lacks is None else (self.lacks,)
        beside = (c for c in (self.begin - 1, self.end + 1) if self.least <= c <= self.most)
        return (*beside, *(() if self.lacks is None else (self.lacks,)))

    def find(self, wanted: IntArray, junction: int | None = None) -> IntArray:
        """Return raw codes [n] whose codes are the nearest at or beyond wanted ones [n].

        They lie within those that are covered, or are a thermocouple's nearest with its cold
        junction at a code, by default in the middle of its table.
        """
        if self.is_plain:
            return np.asarray(saturate(wanted, self.least, self.most))
        rises = self.nodes[-1] >= self.nodes[0]
        low, high = np.full(wanted.shape, self.low), np.full(wanted.shape, self.high)
        while np.any(low < high):
            middle = (low + high) >> 1
            found = self._look_up(middle)
            reached = found >= wanted if rises else found <= wanted
            low, high = np.where(reached, low, middle + 1), np.where(reached, middle, high)
        if self.junction is None:
            return np.asarray(low)
        assert self.fraction_bits is not None
        middle = (self.junction.low + self.junction.high) // 2
        volts = self.junction.convert(np.array([middle if junction is None else junction]))
        raw = -((volts - low) >> self.fraction_bits)
        return np.asarray(saturate(raw, self.least + 1, self.most - 1))

    def convert(self, codes: IntArray, junction: IntArray | None = None) -> IntArray:
        """Return the quantity's codes of raw codes of any shape, both int64.

        Args:
            codes: as the chip is given them.
            junction: of the same shape, the codes of the cold junction's channel.
        """
        given = self.add_junction(codes, junction)
        found = codes if self.is_plain else self._look_up(given)
        if self.none is None:
            return found
        missing = self.find_missing(given)
        if self.junction is not None:
            missing = missing | (codes == self.lacks)
            if self.junction.lacks is not None:
                missing = missing | (junction == self.junction.lacks)
        return np.where(missing, self.none, found)

    def _look_up(self, codes: IntArray) -> IntArray:
        place = saturate(codes, self.low, self.high) - self.low
        first, nodes = np.array(self.first), np.array(self.nodes)
        block = place >> self.block_bits
        parts = saturate(first[block + 1] - first[block], 1, self.most_parts)
        at = (place & self.mask) * parts
        line = saturate(first[block] + (at >> self.block_bits), 0, self.lines - 1)
        rise = (nodes[line + 1] - nodes[line]) * (at & self.mask)
        total = self.half + (nodes[line] << self.block_bits) + rise
        return np.asarray(saturate(total >> self.shift, self.lowest, self.highest))

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound what is looked up, for any raw code and any places in the table."""
        if self.is_plain:
            return [Interval(self.least, self.most)], []
        check_shift(self.name, self.shift, 62)
        code = check_limits(self.name, self.low, self.high)
        reach = max(map(abs, self.nodes))
        total = self.half + (reach << self.block_bits) + 2 * reach * self.mask
        if self.most_parts << self.block_bits > 2**32:
            raise CheckError(
                f"{self.name}: {self.most_parts} lines in a block of 2**{self.block_bits} codes do"
                " not fit 32 bits. The model is refused; narrow the range, or take a larger lsb."
            )
        out = check_limits(f"{self.name}.limits", self.lowest, self.highest)
        return [out], [
            *self._prove_sum(),
            Bound(
                f"{self.name}_code.{'code' if self.junction is None else 'limits'}", code, 32
            ).check(),
            Bound(f"{self.name}_parts.limits", Interval(1, self.most_parts), 32).check(),
            Bound(f"{self.name}_line.limits", Interval(0, self.lines - 1), 32).check(),
            Bound(f"{self.name}.sum", Interval(-total, total), 64).check(),
            Bound(self.name, out, 32).check(),
        ]

    def _prove_sum(self) -> list[Bound]:
        """Bound what a thermocouple's table is looked up by."""
        if self.junction is None:
            return []
        assert self.fraction_bits is not None
        check_shift(f"{self.name}_sum", self.fraction_bits, 16)
        (volts,), relied_on = self.junction.prove([])
        reach = max(-self.least, self.most) << self.fraction_bits
        reach += max(abs(volts.low), abs(volts.high))
        held = Interval(max(-reach, INT32_MIN), min(reach, INT32_MAX))
        return [
            *relied_on,
            Bound(f"{self.name}_sum.sum", Interval(-reach, reach), 64).check(),
            Bound(f"{self.name}_sum", held, 32).check(),
        ]

    def check_form(self) -> None:
        """Raise ValueError where the table is malformed, or a code is outside of its type."""
        if self.raw not in RAW_TYPES:
            raise ValueError(f"'{self.name}' is given {self.raw!r}")
        if (self.junction is None) != (self.fraction_bits is None):
            raise ValueError(f"'{self.name}' has half a cold junction")
        ends = (self.begin, self.low, self.high, self.end)
        if self.junction is not None:
            self.junction.check_form()
            if self.is_plain or self.junction.is_plain or self.junction.junction is not None:
                raise ValueError(f"'{self.name}': its cold junction has no table of its own")
            if not 0 <= (self.fraction_bits or 0) <= 16 or self.junction.none is not None:
                raise ValueError(f"'{self.name}': the sum has {self.fraction_bits} bits more")
            if not min(ends) >= INT32_MIN or not max(ends) <= INT32_MAX:
                raise ValueError(f"'{self.name}': {ends} are no sums")
        elif not self.least <= min(ends) or not max(ends) <= self.most:
            raise ValueError(f"'{self.name}': {ends} are no codes of {self.raw}")
        if self.is_plain:
            return
        blocks = ((self.high - self.low) >> self.block_bits) + 1
        parts = np.diff(self.first)
        if (
            not 0 <= self.block_bits <= 31
            or len(self.first) != blocks + 1
            or self.first[0] != 0
            or parts.min() < 1
            or not 0 < self.first[-1] == self.lines <= MOST_LINES
            or max(map(abs, self.nodes)) > INT32_MAX
            or self.shift < self.block_bits
        ):
            raise ValueError(f"'{self.name}': {self.lines} lines in {blocks} blocks are no table")

    def list_shifts(self) -> list[Shift]:
        """Return every right shift of a signed number in the C."""
        if self.is_plain:
            return []
        others = [] if self.junction is None else self.junction.list_shifts()
        return [*others, Shift(f"{self.name}.shift", self.shift, 63)]

    def list_tables(self) -> tuple[CTable, ...]:
        """Return the constant tables in C."""
        if self.is_plain:
            return ()
        return (
            *(() if self.junction is None else self.junction.list_tables()),
            make_table(f"{self.name}_first", "i16", self.first),
            make_table(f"{self.name}_nodes", "i32", self.nodes),
        )

    @property
    def table_bytes(self) -> int:
        """Size of the tables in flash, in bytes."""
        own = 2 * len(self.first) + 4 * len(self.nodes)
        return own + (0 if self.junction is None else self.junction.table_bytes)

    def write(self, w: Writer, codes: str, junction: str = "") -> str:
        """Write the quantity's codes [B] of raw codes [B] in ONNX, those of a junction beside."""
        given = codes
        if self.junction is not None:
            volts = self.junction.write(w, junction)
            total = w.add(w.shift_left(codes, self.fraction_bits or 0), volts)
            given = w.saturate(total, INT32_MIN, INT32_MAX)
        found = codes if self.is_plain else self._write_look_up(w, given)
        if self.none is None:
            return found
        missing = w.op(
            "Or",
            w.op("Less", given, w.constant(self.begin)),
            w.op("Greater", given, w.constant(self.end)),
        )
        if self.lacks is not None:
            missing = w.op("Or", missing, w.op("Equal", codes, w.constant(self.lacks)))
        if self.junction is not None and self.junction.lacks is not None:
            lacks = w.op("Equal", junction, w.constant(self.junction.lacks))
            missing = w.op("Or", missing, lacks)
        return w.op("Where", missing, w.constant(self.none), found)

    def _write_look_up(self, w: Writer, codes: str) -> str:
        place = w.sub(w.saturate(codes, self.low, self.high), w.constant(self.low))
        width = w.constant(1 << self.block_bits)
        block, within = w.op("Div", place, width), w.op("Mod", place, width)  # place >= 0
        first, nodes = w.constant(self.first), w.constant(self.nodes)
        begins = w.op("Gather", first, block)
        ends = w.op("Gather", first, w.add(block, w.constant(1)))
        at = w.mul(within, w.saturate(w.sub(ends, begins), 1, self.most_parts))
        line = w.saturate(w.add(begins, w.op("Div", at, width)), 0, self.lines - 1)
        left = w.op("Gather", nodes, line)
        rise = w.sub(w.op("Gather", nodes, w.add(line, w.constant(1))), left)
        total = w.add(w.constant(self.half), w.shift_left(left, self.block_bits))
        total = w.add(total, w.mul(rise, w.op("Mod", at, width)))
        return w.saturate(w.floor_shift(total, self.shift), self.lowest, self.highest)

    def express_sum(self) -> str:
        """Return the 64-bit sum in C, of the names that the template declares."""
        name = self.name
        left = f"((int64_t){name}_nodes[{name}_line] * {format_int64(1 << self.block_bits)})"
        rise = f"((int64_t){name}_nodes[{name}_line + 1] - {name}_nodes[{name}_line])"
        within = f"(int64_t)({name}_at & {self.mask}u)"
        return f"{format_int64(self.half)} + {left} + ({rise} * {within})"

    def express_missing(self, given: str, junction: str = "") -> str:
        """Return the C of whether a raw code is no reading; empty where each is one."""
        tests = []
        if self.none is not None and self.junction is not None:
            tests.append(f"({self.name}_sum < {format_int32(self.begin)})")
            tests.append(f"({self.name}_sum > {format_int32(self.end)})")
            if self.lacks is not None:
                tests.append(f"({given} == {format_int32(self.lacks)})")
            if self.junction.lacks is not None:
                tests.append(f"({junction} == {format_int32(self.junction.lacks)})")
        elif self.none is not None:
            if self.begin > self.least:
                tests.append(f"({given} < {format_int32(self.begin)})")
            if self.end < self.most:
                tests.append(f"({given} > {format_int32(self.end)})")
            if self.lacks is not None and self.begin <= self.lacks <= self.end:
                tests.append(f"({given} == {format_int32(self.lacks)})")
        return " || ".join(tests)


NODES = (IntegerConversion,)
