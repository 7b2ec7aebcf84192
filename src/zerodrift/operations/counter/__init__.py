"""Elapsed time: a counter of steps that stops at its limit instead of wrapping."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError
from zerodrift.operations.c_text import StateField
from zerodrift.operations.errors import Error, Known, require
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.node import CODES, IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real

COUNTER_LIMIT = 2**27
"""Steps after which elapsed time stands still: 4 years at 1 s, 15 days at 10 ms."""


@dataclass(frozen=True)
class IntegerCounter(IntegerNode):
    """Steps since the start: 0 at the first step, then one more per step up to `limit`."""

    kind: ClassVar[str] = "counter"
    reads: ClassVar[int | None] = 0
    limit: int

    @property
    def ends(self) -> tuple[int, int]:
        """No count is as low as -1, and the one that it stops at."""
        return -1, self.limit

    @property
    def needs_equal_steps(self) -> bool:
        """Whether the state is valid only if all steps have the same length."""
        return True

    def rest(self, values: Values) -> State:
        """Return a count of 0, with as many entries as the batch has."""
        return {"count": np.zeros(values[CODES].shape[0], dtype=np.int64)}

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the count for the next step, and the present one."""
        count = state["count"]
        return {"count": np.minimum(count + 1, self.limit)}, count

    def elapse(self, state: State, steps: int) -> State:
        """Return the count after some steps."""
        return {"count": state["count"] + min(steps, self.limit)}

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the count, which saturates."""
        if self.limit < 1:
            raise CheckError(f"{self.name}: a limit of {self.limit} steps. The model is refused.")
        out = Interval(0, self.limit)
        return [out], [Bound(f"{self.name}.count", Interval(0, self.limit + 1), 32).check()]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return nothing: a step is counted, and stands for the sample period, in both models."""
        require(
            real.numbers == (float(out.scale),) and out.offset == 0, f"{self.name}: another unit"
        )
        return Error()

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write the count, and the next one up to the limit."""
        after = w.minimum(w.add(state["count"], w.constant(1)), w.constant(self.limit))
        return {"count": after}, state["count"]

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write a count of 0."""
        return {"count": w.mul(w.column(values[CODES], 0), w.constant(0))}

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C."""
        return (StateField(32, f"{self.name}_count", comment="steps since the start"),)

    def express_at_rest(self) -> str:
        """Return 0."""
        return "0"


NODES = (IntegerCounter,)
