"""A low-pass of a variable step (3.16)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from zerodrift_proof.equality.node import Ends, Field, Meaning, Moment, Node, State, Values
from zerodrift_proof.equality.rules import MARGIN, bound_waiting, say_lowpass
from zerodrift_proof.equality.terms import Whole


@dataclass(frozen=True)
class LowpassAfter(Node):
    """y' = y + a (x_1 - y) + c (x - x_1), with a and c of the time since y moved."""

    kind: ClassVar[str] = "lowpass_after"
    rate_q31: int
    shift: int

    def _bound_y(self, x: Ends) -> Ends:
        return x.scale(2**24).plus(Ends(-MARGIN, MARGIN))

    def bound(self, given: Sequence[Ends]) -> Ends:
        """Return x and 2^22 counts of y on either side, by induction (section 6)."""
        return self._bound_y(given[0]).round_shift(24)

    def list_fields(self, given: Sequence[Ends]) -> list[Field]:
        """Return the input of the last step that moved y, the time since then, and y."""
        waiting = bound_waiting(self.rate_q31, self.shift)
        return [
            Field(f"{self.name}_before", "int32_t", (), *given[0]),
            Field(f"{self.name}_waiting", "int32_t", (), 0, waiting),
            Field(f"{self.name}_y", "int64_t", (), *self._bound_y(given[0])),
        ]

    def rest(self, m: Meaning, values: Values, settled: bool) -> State:
        """Begin where y = x and no time is collected."""
        x, name = values[self.inputs[0]][0], self.name
        y = m.terms.scale(x, 2**24)
        return {f"{name}_before": [x], f"{name}_waiting": [m.number(0)], f"{name}_y": [y]}

    def step(self, m: Meaning, at: Moment) -> tuple[State, list[Whole]]:
        """Collect the time, or move y on."""
        own = [at.state[f"{self.name}_{part}"][0] for part in ("before", "waiting", "y")]
        x = at.values[self.inputs[0]][0]
        moved = say_lowpass(m.terms, [*own, x, m.span], self.rate_q31, self.shift)
        after = {"before": moved.before, "waiting": moved.waiting, "y": moved.y}
        return {f"{self.name}_{part}": [value] for part, value in after.items()}, [moved.out]


NODES = (LowpassAfter,)
