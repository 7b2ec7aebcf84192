"""Parts of the C of every operation: fields of the state, tables, numbers as text."""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


class FieldNumber(int):
    """A number that the C reads from the unit's block: there it is the field's name.

    Its value is used only where templates test a number, such as for 0, before they write it.
    """

    text: str

    def __new__(cls, value: int, text: str) -> "FieldNumber":
        """Return the number.

        Args:
            value: stands for any that a block may hold.
            text: C of the field.
        """
        number = super().__new__(cls, value)
        number.text = text
        return number

    def __str__(self) -> str:
        return self.text

    def __format__(self, spec: str) -> str:
        return self.text


@dataclass(frozen=True)
class StateField:
    """One field of the state's struct after `identity` and `steps`."""

    bits: int
    name: str
    sizes: tuple[int, ...] = ()
    comment: str = ""
    unsigned: bool = False
    oldest: str = ""
    """Of a ring: the field with the place of its oldest entry."""

    @property
    def type(self) -> str:
        """Its type, or that of its elements."""
        return f"{'u' * self.unsigned}int{self.bits}_t"

    @property
    def elements(self) -> list[str]:
        """Return the number, or each number of an array, as C text after the state's name."""
        found = [self.name]
        for size in self.sizes:
            found = [f"{text}[{k}]" for text in found for k in range(size)]
        return found


def list_ring(node: str, name: str, bits: int, sizes: tuple[int, ...]) -> tuple[StateField, ...]:
    """Return the fields of a ring of the last sizes[0] entries."""
    oldest = f"{node}_oldest"
    return (
        StateField(bits, f"{node}_{name}", sizes, oldest=oldest),
        StateField(16, oldest, unsigned=True),
    )


@dataclass(frozen=True, order=True)
class RuntimePart:
    """A header of the runtime, and its function that checks its table."""

    header: str
    is_sound: str


@dataclass(frozen=True)
class CTable:
    """A constant array of the generated C, as the self-test reads it."""

    name: str
    type: str
    """i16, i32, u8 or i64."""
    numbers: tuple[int, ...]
    rows: int = 0
    """0 for one dimension."""

    @property
    def words(self) -> list[int]:
        """The numbers as the 32-bit words of the CRC; of 64 bits the lower half is first."""
        if self.type != "i64":
            return list(self.numbers)
        return [word for n in self.numbers for word in (n & 0xFFFFFFFF, (n >> 32) & 0xFFFFFFFF)]


def make_table(
    name: str, kind: str, numbers: Iterable[int] | NDArray[np.signedinteger], rows: int = 0
) -> CTable:
    """Return the table of an array of any shape."""
    return CTable(name, kind, tuple(map(int, np.asarray(numbers).ravel())), rows)


def crc_of_words(numbers: Iterable[int]) -> int:
    """Return the CRC-32 of numbers as 32-bit words, the least significant byte first."""
    return zlib.crc32(np.array([int(n) & 0xFFFFFFFF for n in numbers], dtype="<u4").tobytes())


def format_numbers(values: Iterable[int], per_line: int = 12) -> str:
    """Return an initialiser list's inside, wrapped and indented by four spaces."""
    texts = [format_int32(int(v)) for v in values]
    lines = [texts[i : i + per_line] for i in range(0, len(texts), per_line)]
    return ",\n".join("    " + ", ".join(line) for line in lines)


def format_int32(value: int) -> str:
    """Return a C expression of type int for any int32 (the lowest has no literal)."""
    if isinstance(value, FieldNumber):
        return value.text
    return "(-2147483647 - 1)" if value == -(2**31) else str(value)


def format_int64(value: int) -> str:
    """Return a C99 expression for any int64, constant unless a block holds it."""
    if isinstance(value, FieldNumber):
        return value.text
    value = int(value)
    return f"(-INT64_C({2**63 - 1}) - 1)" if value == -(2**63) else f"INT64_C({value})"


def format_factor(value: int) -> str:
    """Return a C expression of type int64_t, to multiply an int32 with."""
    if isinstance(value, FieldNumber):
        return f"(int64_t){value.text}"
    value = int(value)
    return f"(int64_t){value}" if -(2**31) < value < 2**31 else format_int64(value)
