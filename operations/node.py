"""What every node of an integer compensator has in common: names, state, step, proof."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from zerodrift.operations.arithmetic import IntArray
from zerodrift.operations.intervals import Bound, Interval

Values = Mapping[str, IntArray]
"""Node name -> its present output: [B] for a scalar signal, [B, width] for a vector."""
CODES = "codes"
"""The values under this name are the raw input codes [B, C]."""
PREVIOUS_DRIFT = "previous drift"
"""The values under this name are the drifts [B, K] that the step before gave."""
State = dict[str, IntArray]
"""What a node carries from one step to the next, by field name; arrays lead with the batch."""


@dataclass(frozen=True)
class IntegerNode:
    """One operation of the integer compensator.

    A signal is an integer q with a real value q * 2**exponent in its physical unit; the exponent is
    for people and for the quantizer, the arithmetic needs only integers.
    """

    kind: ClassVar[str]
    name: str
    """Unique in the model, a C identifier."""
    inputs: tuple[str, ...]
    """Names of the nodes it reads, all of them earlier in the model."""

    @property
    def width(self) -> int:
        """Length of the output vector; 0 for a scalar signal."""
        return 0

    def rest(self, values: Values) -> State:
        """Return the state at rest under the present inputs."""
        return {}

    def settle(self, values: Values) -> State:
        """Return the state after the present inputs have lasted forever (mostly `rest`)."""
        return self.rest(values)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the state after this step and the output."""
        raise NotImplementedError

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Return the output's intervals for any input within its own, and the bounds relied on.

        Raises:
            CheckError: something could overflow.
        """
        raise NotImplementedError

    def attributes(self) -> dict[str, Any]:
        """Return the node's own fields, for the JSON form."""
        return {k: v for k, v in self.__dict__.items() if not k.startswith("_")}
