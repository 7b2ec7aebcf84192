"""The flags of a Cortex-M: each is worked out where it is asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.object.curves import Curves, Word
from zerodrift_proof.object.instruction import ALWAYS

Flag: TypeAlias = Callable[[], Word]


def unknown() -> Word:
    """Of a flag that is asked for: there is no rule for it."""
    raise UndecidedError("a flag that nothing has set, or that has no rule")


@dataclass(frozen=True)
class Flags:
    """How to find each flag, 0 or 1."""

    n: Flag = unknown
    z: Flag = unknown
    c: Flag = unknown
    v: Flag = unknown

    def hold(self, condition: int, curves: Curves) -> Word:
        """Return whether a condition holds.

        Raises:
            UndecidedError: it takes two flags or more, of which one is not known.
        """
        if condition == ALWAYS:
            return curves.words.number(1)
        kind = condition >> 1
        if kind < 4:
            truth = (self.z, self.c, self.n, self.v)[kind]()
        else:
            asked = (self.n(), self.v(), self.z(), self.c())
            n, v, z, c = (w.exact if isinstance(w, Whole) else None for w in asked)
            if None in (n, v, z, c):
                raise UndecidedError("a condition of numbers that are not known")
            held = (c == 1 and z == 0, n == v, n == v and z == 0)[kind - 4]
            truth = curves.words.number(int(held))
        if condition & 1:
            return curves.apply(("not",), curves.terms.negate, truth)
        return truth


def set_flags(curves: Curves, result: Word, carry: Flag, overflow: Flag) -> Flags:
    """Return the flags of a result."""
    words = curves.words
    return Flags(
        lambda: curves.apply(("sign",), words.sign, result),
        lambda: curves.apply(("zero",), words.is_zero, result),
        carry,
        overflow,
    )
