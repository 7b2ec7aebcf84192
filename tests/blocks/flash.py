"""Two slots of simulated flash, of which the power is cut at every erase and every word.

An erase or a word that is cut leaves anything where it was at work, and all else as it was.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from zerodrift.c_runtime.host import HostModel

WORD_BYTES = 8
PAGE_BYTES = 256
"""Small, so that an update has several erases too."""


@dataclass
class Slots:
    """The content of both slots, each of whole pages."""

    content: list[bytearray]

    @classmethod
    def holding(cls, first: bytes, second: bytes) -> "Slots":
        """Return slots that hold two blocks, erased behind them."""
        size = -(-max(len(first), len(second)) // PAGE_BYTES) * PAGE_BYTES
        return cls([bytearray(block.ljust(size, b"\xff")) for block in (first, second)])

    def copy(self) -> "Slots":
        """Return slots of their own with the same content."""
        return Slots([bytearray(slot) for slot in self.content])

    def update(self, slot: int, block: bytes, cut: int, torn: np.random.Generator) -> bool:
        """Erase a slot and write a block, until the power is cut at an operation.

        Args:
            slot: 0 or 1.
            block: what is written.
            cut: at which operation, erases first; beyond the last one: not at all.
            torn: says what the operation leaves that was cut.

        Returns:
            Whether it came to the end.
        """
        pages = range(0, len(self.content[slot]), PAGE_BYTES)
        operations = [(at, PAGE_BYTES, b"\xff" * PAGE_BYTES) for at in pages]
        operations += [
            (at, WORD_BYTES, block[at : at + WORD_BYTES]) for at in range(0, len(block), WORD_BYTES)
        ]
        for number, (at, length, after) in enumerate(operations):
            if number == cut:
                before = bytes(self.content[slot][at : at + length])
                self.content[slot][at : at + length] = tear(before, after, torn)
                return False
            self.content[slot][at : at + length] = after
        return True

    def choose(self, host: HostModel) -> int | None:
        """Return the slot that the program takes."""
        return host.choose_block(*map(bytes, self.content))


def tear(before: bytes, after: bytes, rng: np.random.Generator) -> bytes:
    """Return what an operation that was cut leaves: any bits, each old or new, or all of either."""
    manner = rng.integers(4)
    noise = rng.integers(0, 256, len(before), dtype=np.uint8)
    if manner == 0:
        return noise.tobytes()
    old, new = (np.frombuffer(part, dtype=np.uint8) for part in (before, after))
    if manner == 1:
        return ((old & noise) | (new & ~noise)).tobytes()
    return (before, after)[manner - 2]


def count_operations(block: bytes) -> int:
    """Return how many operations an update has."""
    pages = -(-len(block) // PAGE_BYTES)
    return pages + len(block) // WORD_BYTES


def cut_everywhere(
    host: HostModel, old: bytes, new: bytes, tears: int, seed: int
) -> Iterator[tuple[int | None, bool]]:
    """Yield what the program chooses after each cut, and whether that is a whole block.

    An update is cut at every operation, with several values of what was torn. The next start goes
    on with what it chooses and repeats the update, which is cut at an operation drawn for it.
    """
    rng = np.random.default_rng(seed)
    for slot in (0, 1):
        blocks = (new, old) if slot == 0 else (old, new)
        before = Slots.holding(*((b"", old) if slot == 0 else (old, b"")))
        for cut in range(count_operations(new) + 1):
            for _ in range(tears):
                slots = before.copy()
                slots.update(slot, new, cut, rng)
                yield judge(slots, host, blocks, slot)
                chosen = slots.choose(host)
                again = 1 - chosen if chosen is not None else slot
                slots.update(again, new, int(rng.integers(count_operations(new) + 1)), rng)
                yield judge(slots, host, (new, new) if again != slot else blocks, again)


def judge(
    slots: Slots, host: HostModel, blocks: tuple[bytes, bytes], written: int
) -> tuple[int | None, bool]:
    """Return what is chosen, and whether it is one of the blocks, whole."""
    chosen = slots.choose(host)
    if chosen is None:
        return None, False
    content = bytes(slots.content[chosen])
    return chosen, any(content.startswith(block) for block in blocks)
