"""The memory that a kernel sees: the program's constants, its arguments and its stack.

Each array that it is given, and the stack, lies at an address that is a symbol: they may be
anywhere, but do not overlap. What is below the stack pointer is nobody's: an interrupt may write
there at any time.
"""

from dataclasses import dataclass, field

from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.object.image import Image
from zerodrift_proof.object.words import WORD, Words

LOWEST = -(1 << 16)
"""Of the stack, in bytes from where a call finds it."""


@dataclass
class Area:
    """An array or the stack."""

    name: str
    base: Whole
    """Its address."""
    first: int
    """Bytes from the base where it may be read from."""
    end: int
    align: int
    """2 or 4: what the base is a multiple of."""
    writable: bool = False
    write_end: int = 0
    """Bytes from the base up to where it may be written."""
    words: dict[int, Whole] = field(default_factory=dict)
    """By their place, a multiple of 4."""
    halves: dict[int, Whole] = field(default_factory=dict)
    """Numbers with a sign, by their place; no place is in both."""


class ObjectMemory:
    """Loads and stores of words and halves."""

    def __init__(self, words: Words, image: Image) -> None:
        """Begin with the program's constants."""
        self.words, self.image = words, image
        self.areas: dict[int, Area] = {}
        """By the number of the base."""

    def give(self, area: Area) -> Whole:
        """Add an area; return its address."""
        self.areas[area.base.number] = area
        return area.base

    def _find(self, address: Whole) -> tuple[Area | None, int]:
        """Return where an address lies: an area and a place in it, or None and a number."""
        constant, sums = self.words.terms.split(address)
        sums = tuple((n, f % WORD) for n, f in sums if f % WORD)
        at = (constant + WORD // 2) % WORD - WORD // 2
        if not sums:
            return None, at % WORD
        if len(sums) == 1 and sums[0][1] == 1 and sums[0][0] in self.areas:
            return self.areas[sums[0][0]], at
        raise UndecidedError("an address that is not known")

    def _hold(self, area: Area, at: int, size: int, floor: int, write: bool) -> None:
        end = area.write_end if write else area.end
        first = max(area.first, floor) if area.name == "stack" else area.first
        if (write and not area.writable) or at < first or at + size > end:
            done = "written" if write else "read"
            raise UndecidedError(f"{size} bytes at {at} of {area.name} are {done}")

    def load(self, address: Whole, size: int, signed: bool, floor: int, loose: bool) -> Whole:
        """Return what lies at an address.

        Args:
            address: of the first byte.
            size: 2 or 4 bytes.
            signed: whether fewer than 4 are extended with their sign.
            floor: the stack pointer, in bytes from where it was at the call.
            loose: whether the instruction may read a word from any even address.
        """
        area, at = self._find(address)
        if area is None:
            if at % (2 if loose and size == 4 and self.image.unaligned else size):
                raise UndecidedError(f"{size} bytes are read at {at:#x}")
            content = self.image.read(at, size)
            if content is None:
                raise UndecidedError(f"{at:#x} is read, which may change or is not there")
            return self.words.number(int.from_bytes(content, "little", signed=signed or size == 4))
        self._hold(area, at, size, floor, False)
        aligned = at % size == 0 and size <= area.align
        if not (aligned or (loose and self.image.unaligned and at % 2 == 0)):
            raise UndecidedError(f"{size} bytes are read at {at} of {area.name}")
        if size == 4:
            if at in area.words:
                return area.words[at]
            return self.words.pack(self._half(area, at), self._half(area, at + 2))
        half = self._half(area, at)
        return half if signed else self.words.residue(half, 16, False)

    def _half(self, area: Area, at: int) -> Whole:
        whole = at & ~3
        if whole in area.words:
            word = area.words[whole]
            return self.words.high_half(word) if at & 2 else self.words.low_half(word)
        if at not in area.halves:
            raise UndecidedError(f"{area.name} is read at {at} before it is written")
        return area.halves[at]

    def store(self, address: Whole, size: int, value: Whole, floor: int) -> None:
        """Write a word or half to an address."""
        area, at = self._find(address)
        if area is None:
            raise UndecidedError(f"{at:#x} is written")
        self._hold(area, at, size, floor, True)
        if at % size or size > area.align:
            raise UndecidedError(f"{size} bytes are written at {at} of {area.name}")
        if size == 4:
            area.halves.pop(at, None)
            area.halves.pop(at + 2, None)
            area.words[at] = value
            return
        whole = at & ~3
        if whole in area.words:
            low, high = self._half(area, whole), self._half(area, whole + 2)
            del area.words[whole]
            area.halves[whole], area.halves[whole + 2] = low, high
        area.halves[at] = self.words.low_half(value)

    def release(self, floor: int) -> None:
        """Forget what lies below the stack pointer."""
        for area in self.areas.values():
            if area.name == "stack":
                for cells in (area.words, area.halves):
                    for at in [at for at in cells if at < floor]:
                        del cells[at]
