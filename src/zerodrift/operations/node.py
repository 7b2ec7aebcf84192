"""What every node of an integer compensator has in common: names, state, step, proof."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeAlias

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import NoRuleError
from zerodrift.operations.c_text import CTable, RuntimePart, StateField
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.intervals import Bound, Interval, Shift
from zerodrift.operations.signals import Real

if TYPE_CHECKING:
    from zerodrift.operations.onnx_writer import OnnxWriter

Values = Mapping[str, IntArray]
"""Node name -> its present output: [B] for a scalar signal, [B, width] for a vector."""
CODES = "codes"
"""The values under this name are the raw input codes [B, C]."""
PREVIOUS_DRIFT = "previous drift"
"""The values under this name are the drifts [B, K] that the step before gave."""
ELAPSED = "elapsed"
"""The values under this name are the microseconds [B] since the last step, where it is told."""
State = dict[str, IntArray]
"""What a node carries from one step to the next, by field name; arrays lead with the batch."""
Writer: TypeAlias = "OnnxWriter"
"""Writes ONNX; its module imports onnx, which only the exporter needs."""
Names = Mapping[str, str]
"""The same in ONNX: node or field -> name of its value, int64 with the batch first."""
OnnxStep = tuple[dict[str, str], str]
"""Names of the state after a step, by field, and of the output."""


@dataclass(frozen=True)
class IntegerNode:
    """One operation of the integer compensator.

    A signal is an integer q with the physical value q * scale + offset (`signals.Signal`); scale
    and offset serve the quantizer and messages, the arithmetic needs only integers.
    """

    kind: ClassVar[str]
    reads: ClassVar[int | None] = 1
    """Number of inputs; None: any."""
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

    def at_rest(self, state: State, values: Values) -> IntArray:
        """Return the output under a state that is settled: what other nodes settle under."""
        return self.step(state, values)[1]

    @property
    def needs_equal_steps(self) -> bool:
        """Whether the state is valid only if all steps have the same length."""
        return False

    @property
    def needs_variable_step(self) -> bool:
        """Whether the step takes the time since the last one."""
        return False

    @property
    def reads_drift(self) -> bool:
        """Whether the step takes the drift that the step before gave."""
        return False

    def elapse(self, state: State, steps: int) -> State:
        """Return the state at rest of a log that begins some steps after power-on."""
        return state

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Return the output's intervals for any input within its own, and the bounds relied on.

        Raises:
            CheckError: something could overflow.
        """
        raise NotImplementedError

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C, for the certificate."""
        return []

    @property
    def idle(self) -> frozenset[str]:
        """Names of bounds in `prove` of what this node's C leaves out."""
        return frozenset()

    @property
    def ends(self) -> tuple[int, int] | None:
        """The values at which the result stands at a limit of its own; None without one."""
        return None

    def check_form(self) -> None:
        """Raise ValueError where the fields of a node from a file do not fit together."""

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Return how far the output can be from what it stands for in real arithmetic.

        It holds for any codes and any number of steps since both were at rest under the same ones.

        Args:
            real: what a signal of this node stands for.
            out: the signal's range and meaning.
            inputs: what is known of the signals that `real` reads, with their errors.

        Raises:
            NoRuleError: there is no rule for this; a model with this node has no proven bound.
        """
        raise NoRuleError(f"'{self.kind}' has no error rule")

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write the state at rest under the present inputs in ONNX."""
        return {}

    def write_settle(self, w: Writer, values: Names) -> dict[str, str]:
        """Write the state after the present inputs have lasted forever (mostly `rest`)."""
        return self.write_rest(w, values)

    def write_at_rest(self, w: Writer, values: Names, state: Names) -> str:
        """Write the output under a state that is settled."""
        return self.write_step(w, values, state)[1]

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write a step in ONNX; return the state after it and the output."""
        raise NotImplementedError

    @property
    def stateful(self) -> bool:
        """Whether the node carries something from one step to the next."""
        return bool(self.list_state())

    def list_state(self) -> tuple[StateField, ...]:
        """Return the fields of the state in C, in their order."""
        return ()

    @property
    def parts(self) -> tuple[RuntimePart, ...]:
        """The parts of the C runtime beyond the common one that the step needs."""
        return ()

    def express(self) -> str:
        """Return the C expression of a number: of the inputs' names, and a call that moves a state.

        All other C is in `c.j2` beside the operation, a macro for each of `NodeText`'s faces.
        """
        raise NotImplementedError

    def express_at_rest(self) -> str:
        """Return the C expression of a number that has a state, at rest."""
        return self.inputs[0]

    def list_tables(self) -> tuple[CTable, ...]:
        """Return the constant tables in C that the self-test takes the CRC of."""
        return ()

    def attributes(self) -> dict[str, object]:
        """Return the node's own fields, for the JSON form."""
        return {k: v for k, v in self.__dict__.items() if not k.startswith("_")}


@dataclass(frozen=True)
class ChannelNode(IntegerNode):
    """A node that reads a raw code, limited to low .. high and given `shift` fractional bits."""

    channel: int
    low: int
    high: int
    shift: int
