"""An instruction of Armv6-M or Armv7E-M, decoded."""

from dataclasses import dataclass

SP, LR, PC = 13, 14, 15
ALWAYS = 14
"""The condition of what has none."""


@dataclass(frozen=True, slots=True)
class Instruction:
    """What an encoding says. Registers are 0 to 15; -1 where there is none."""

    name: str
    size: int
    """2 or 4 bytes."""
    d: int = -1
    n: int = -1
    m: int = -1
    a: int = -1
    """The third operand, or the upper half of a long result."""
    value: int = 0
    """An immediate, an offset in bytes or a branch's distance from the next instruction but one."""
    shift: str = "lsl"
    by: int = 0
    sets: bool = False
    """Whether flags are set."""
    registers: tuple[int, ...] = ()
    before: bool = False
    """Of an address: the offset is added before the access."""
    back: bool = False
    """Of an address: it is written back."""
    condition: int = ALWAYS
    carry: int | None = None
    """Of an immediate: the carry that making it leaves."""
