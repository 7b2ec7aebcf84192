"""How far a step of one unit of an integer LSTM is from that of real arithmetic.

For the derivation see `zerodrift.operations.lstm.error`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from zerodrift.operations.enclosure import shorten
from zerodrift.operations.errors import Error, Known, require
from zerodrift.operations.gate_sums import GateArgument, GateSums, RealUnit
from zerodrift.operations.lstm.cell import CELL_LIMIT, IntegerLstm
from zerodrift.operations.table_error import (
    SigmoidError,
    bound_sigmoid,
    bound_sigmoid_table,
    bound_slope,
    bound_tanh,
)
from zerodrift.operations.tables import T_MAX, sigmoid_q31

Moved = Sequence[Fraction]
"""By how much the arguments of i, f, g, o are moved by errors of the outputs."""
ONE, QUARTER = Fraction(1), Fraction(1, 4)
OF_BEND = Fraction(1, 1 << 17)
"""The cell state is rounded to the table's argument, counts of 2**-16."""
OF_OUTPUT = Fraction(1, 1 << 30)
"""o tanh(c) is rounded to counts of 2**-29."""
HIGHEST = 11
"""The largest argument of a forget gate: 1 - F is then above 2**-16, as the way to rest has it."""


@dataclass(frozen=True)
class Gate:
    """How far a gate is off, how much by what its argument is, and the most that it is."""

    error: Error
    slope: Fraction
    most: Fraction
    """Of its size, on the chip and in real arithmetic."""


@dataclass(frozen=True)
class Forget:
    """A forget gate: its argument, how far the table of 1 - f is off, the most and least it is."""

    argument: GateArgument
    table: SigmoidError
    most: Fraction
    left: Fraction
    """The least 1 - f, on the chip and in real arithmetic."""

    @property
    def factor(self) -> Fraction:
        """What exp(d) (exp(d) - 1) is multiplied by in s."""
        return (1 + self.table.share + self.table.rest) * (1 + self.table.share)

    @property
    def of_s(self) -> Fraction:
        """s f + t = s (f + r) + r."""
        return self.most + self.table.rest


@dataclass(frozen=True)
class LstmStepError:
    """What a step of one unit adds to errors while the features lie in one part.

    The errors e of the outputs move the arguments of i, f, g, o by four numbers, which are given.
    """

    own: Error
    """K at e = 0 without the forget gate."""
    of_input: Fraction
    """By how much K grows with what the input gate's argument is moved by."""
    of_candidate: Fraction
    forget: Forget
    size: Fraction
    """The largest |I G| / U."""
    reach: Fraction
    """The largest |C| and |c| that steps within the part lead to, with what is rounded."""
    output: Gate
    after: Error
    """What the table of tanh and the last roundings add."""

    def slip(self, moved: Moved) -> Fraction:
        """Return d."""
        return self.forget.argument.error.total + moved[1]

    def of_forget(self, d: Fraction) -> Fraction:
        """Return s f + t; exp(d) (exp(d) - 1) <= d (1 + 2 d) to d = 1/4."""
        table = self.forget.table
        s = table.share + self.forget.factor * d * (1 + 2 * d)
        return self.forget.of_s * s + table.rest

    def grow_cell(self, moved: Moved, size: Fraction) -> Fraction:
        """Return K(e) for cell states of up to a size."""
        added = self.own.total + self.of_input * moved[0] + self.of_candidate * moved[2]
        return added + size * self.of_forget(self.slip(moved))

    def grow_output(self, moved: Moved, cell: Fraction, bend: Fraction) -> Fraction:
        """Return F(e) for a K(e) and the largest tanh(m)."""
        gate = self.output.error.total + self.output.slope * moved[3]
        return self.output.most * cell + bend * gate + self.after.total


class StepRules(GateSums):
    """The error rules of one layer."""

    def __init__(
        self, lstm: IntegerLstm, units: Sequence[RealUnit], features: Sequence[Known]
    ) -> None:
        super().__init__(lstm, units, features)
        self._lstm = lstm
        self._tanh = bound_tanh() / (1 << 30)

    @property
    def most(self) -> Fraction:
        """The largest cell state that its integer holds."""
        return Fraction(CELL_LIMIT, 1 << self._lstm.cell_bits)

    def list_gains(self, j: int) -> tuple[tuple[Fraction, ...], ...]:
        """Return [4][H] how much the argument of i, f, g, o is moved by each output's error."""
        return tuple(tuple(map(abs, row)) for row in self._units[j].w_h)

    def bound_step(self, j: int, features: Sequence[Known]) -> LstmStepError:
        """Return what one step makes of the errors, for unit j and features within a part.

        Raises:
            NoRuleError: a forget gate might come too near to 1.
        """
        i, o = self._bound_gate(0, j, features), self._bound_gate(3, j, features)
        g, forget = self._bound_candidate(j, features), self._bound_forget(j, features)
        rounded = Fraction(2, 1 << self._lstm.cell_bits) + Fraction(1, 1 << 30)
        added = i.error.scale(g.most) + g.error.scale(i.most) + Error(rounding=rounded)
        of_input = shorten(g.most * i.slope / forget.left)
        of_candidate = shorten(i.most * g.slope / forget.left)
        size = shorten(i.most * g.most / forget.left)
        reach = (i.most * g.most + rounded) / forget.left
        after = Error(table=self._tanh, rounding=OF_BEND).scale(o.most) + Error(rounding=OF_OUTPUT)
        own = added.scale(1 / forget.left)
        return LstmStepError(own, of_input, of_candidate, forget, size, reach, o, after)

    def _bound_gate(self, g: int, j: int, features: Sequence[Known]) -> Gate:
        """Return what is known of the input or output gate."""
        a = self._bound_argument(g, j, features=features)
        slope = shorten(bound_slope(a.low / 2, a.high / 2)) / 4
        most = min(shorten(bound_sigmoid(a.high).high + self._tanh / 2), ONE)
        low, high = math.floor(a.low * (1 << 15)), math.ceil(a.high * (1 << 15))
        of_line = bound_sigmoid_table(low, high)
        near_0 = of_line.share * min(most, QUARTER) + of_line.rest * most
        error = a.error.scale(slope) + Error(table=shorten(min(self._tanh / 2, near_0)))
        return Gate(error, slope, most)

    def _bound_candidate(self, j: int, features: Sequence[Known]) -> Gate:
        a = self._bound_argument(2, j, 16, features)
        slope = shorten(bound_slope(a.low, a.high))
        size = max(abs(a.low), abs(a.high))
        most = min(shorten(2 * bound_sigmoid(2 * size).high - 1 + self._tanh), ONE)
        error = a.error.scale(slope) + Error(table=self._tanh)
        return Gate(error, slope, most)

    def _bound_forget(self, j: int, features: Sequence[Known]) -> Forget:
        a = self._bound_argument(1, j, features=features)
        require(
            a.high <= HIGHEST,
            "no contraction of an LSTM is shown: its forget gate comes so near to 1 that it hardly"
            " forgets; [network] contracting = true trains one that stays away from it",
        )
        low, high = math.floor(a.low * (1 << 15)), math.ceil(a.high * (1 << 15))
        largest = int(sigmoid_q31(np.array([min(high, T_MAX)]))[0])
        most = min(shorten(bound_sigmoid(a.high).high + self._tanh / 2), ONE)
        left = Fraction((1 << 31) - largest, 1 << 31)
        table = bound_sigmoid_table(-high, -low)
        return Forget(a, table, most, min(left, bound_sigmoid(-a.high).low))
