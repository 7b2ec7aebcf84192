"""How far the sums that a recurrent layer's gates are of are from real arithmetic.

The states are taken to be the same in both, but for the rounding of the copies that are multiplied;
how much their own errors add is told beside it, as a gain per state.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import NoRuleError
from zerodrift.operations.errors import HALF, ZERO, Error, Known, SumTerm, bound_sum
from zerodrift.operations.intervals import shorten

Integers = NDArray[np.int16] | NDArray[np.int8] | NDArray[np.int32]

COPY = Fraction(1, 1 << 15)
"""What a count of a state's int16 copy stands for."""
SPARE = 2.0**-10
"""By which the errors are taken larger than found: the second derivation goes another way."""


@dataclass(frozen=True)
class RealUnit:
    """One unit of the float layer, gates in its own order."""

    bias: tuple[Fraction, ...]
    """Of a GRU r, u, n outside the reset product, n inside it; of an LSTM i, f, g, o."""
    w_x: tuple[tuple[Fraction, ...], ...]
    """[G][I]."""
    w_h: tuple[tuple[Fraction, ...], ...]
    """[G][H]."""

    @cached_property
    def most(self) -> list[Fraction]:
        """[G] the most that states of up to 1 add."""
        return [sum(map(abs, row), ZERO) for row in self.w_h]

    @classmethod
    def of(cls, numbers: Sequence[float], inputs: int, hidden: int, gates: int) -> "RealUnit":
        """Return the unit of a row as `Real` has it: four biases, w_x of each gate, then w_h."""
        given = tuple(map(Fraction, numbers))
        if len(given) != 4 + gates * (inputs + hidden):
            raise NoRuleError("a unit of a recurrent layer with another number of weights")
        first = 4 + gates * inputs
        return cls(
            given[:4],
            tuple(given[4 + g * inputs : 4 + (g + 1) * inputs] for g in range(gates)),
            tuple(given[first + g * hidden : first + (g + 1) * hidden] for g in range(gates)),
        )


@dataclass(frozen=True)
class GateArgument:
    """What a gate's activation is of: how far off by itself, how much by the states, its range."""

    error: Error
    gains: tuple[Fraction, ...]
    """[H] how much of each state's error is added."""
    low: Fraction
    high: Fraction
    """Of chip and real arithmetic."""


class SummedLayer(Protocol):
    """The integers of a recurrent layer; gate g of unit i stands at [g, i]."""

    @property
    def w_x(self) -> NDArray[np.int16]:
        """[G, H, I]."""

    @property
    def w_h(self) -> NDArray[np.int16] | NDArray[np.int8]:
        """[G, H, H]."""

    @property
    def bias(self) -> NDArray[np.int32]:
        """[4, H]; the rounding halves of the shifts are folded in."""

    @property
    def shift(self) -> tuple[int, ...]:
        """Right shift from each accumulator to the table's argument."""

    @property
    def multiplier(self) -> NDArray[np.int32] | None:
        """[G, H] of 8-bit recurrent weights."""

    @property
    def multiplier_shift(self) -> tuple[int, ...]:
        """Of the products with these multipliers."""


class GateSums:
    """The sums of one layer's gates."""

    def __init__(
        self, layer: SummedLayer, units: Sequence[RealUnit], features: Sequence[Known]
    ) -> None:
        self._layer, self._units, self._features = layer, units, features
        copied = Error(rounding=COPY / 2)
        self._copies = [Known(-32767, 32767, COPY, ZERO, copied) for _ in units]
        self._of_states: dict[tuple[int, int], Error] = {}

    def _bound_argument(
        self, g: int, i: int, bits: int = 15, features: Sequence[Known] | None = None
    ) -> GateArgument:
        """Return the argument of a gate all of which is one sum, in 2**-bits of the table.

        Args:
            g: the gate.
            i: the unit.
            bits: fractional ones of the argument.
            features: of a part of what they can be, or else of all.
        """
        layer, unit = self._layer, self._units[i]
        count = Fraction(1, 1 << (bits + layer.shift[g]))
        constant = self._read_bias(g, i) * count - unit.bias[g]
        error = self._sum_features(g, i, count, constant, features)
        if (g, i) not in self._of_states:  # the same for each part
            self._of_states[g, i] = self._sum_states(g, i, count, ZERO)
        error += self._of_states[g, i]
        error += self._round_shift(g, Fraction(1, 1 << bits))
        return self._enclose(error, tuple(map(abs, unit.w_h[g])), self._reach(g, i, features))

    def _read_bias(self, g: int, i: int) -> Fraction:
        """Return a bias less the rounding half that is folded in."""
        return Fraction(int(self._layer.bias[g, i]) - (1 << self._layer.shift[g] >> 1))

    def _round_shift(self, g: int, scale: Fraction) -> Error:
        return Error(rounding=scale * HALF if self._layer.shift[g] else ZERO)

    def _sum_features(
        self,
        g: int,
        i: int,
        count: Fraction,
        constant: Fraction,
        features: Sequence[Known] | None = None,
    ) -> Error:
        known = features or self._features
        terms = [
            SumTerm(gain, ("features", k), x)
            for k, (gain, x) in enumerate(zip(self._units[i].w_x[g], known, strict=True))
        ]
        chip = {("features", k): int(w) * count for k, w in enumerate(self._layer.w_x[g, i])}
        return bound_sum(terms, chip, constant, "weights")

    def _sum_states(self, g: int, i: int, count: Fraction, constant: Fraction) -> Error:
        """Return the error of w_h . h but for that of the states themselves."""
        layer, rounded = self._layer, ZERO
        of_row = count
        if layer.multiplier is not None:
            of_row *= Fraction(int(layer.multiplier[g, i]), 1 << layer.multiplier_shift[g])
            rounded = count / 2 if layer.multiplier_shift[g] else ZERO
        terms = [
            SumTerm(gain, ("h", j), x)
            for j, (gain, x) in enumerate(zip(self._units[i].w_h[g], self._copies, strict=True))
        ]
        chip = {("h", j): int(w) * of_row for j, w in enumerate(layer.w_h[g, i])}
        return bound_sum(terms, chip, constant, "weights") + Error(rounding=rounded)

    def _reach_of_features(
        self, g: int, i: int, features: Sequence[Known] | None = None
    ) -> tuple[Fraction, Fraction]:
        low = high = self._units[i].bias[g]
        for w, x in zip(self._units[i].w_x[g], features or self._features, strict=True):
            off = x.error.total
            ends = (w * (x.ends[0] - off), w * (x.ends[1] + off))
            low, high = low + min(ends), high + max(ends)
        return low, high

    def _reach(self, g: int, i: int, features: Sequence[Known] | None) -> tuple[Fraction, Fraction]:
        low, high = self._reach_of_features(g, i, features)
        most = self._units[i].most[g]
        return low - most, high + most

    @staticmethod
    def _enclose(
        error: Error, gains: tuple[Fraction, ...], ends: tuple[Fraction, Fraction]
    ) -> GateArgument:
        """Return an argument whose range covers the chip: the same states, but for the error."""
        off = error.total
        return GateArgument(error, gains, ends[0] - off, ends[1] + off)


def weigh(gains: Sequence[Fraction], errors: Sequence[Fraction]) -> Fraction:
    """Return the sum of gains times the states' errors."""
    return sum((gain * e for gain, e in zip(gains, errors, strict=True)), ZERO)


def propose_errors(
    rows: Sequence[Sequence[float]], fixed: Sequence[Sequence[float]]
) -> list[Error]:
    """Return about e = rows e + fixed, and a little more, cause by cause.

    Args:
        rows: [H][H] what is made of each state's error.
        fixed: [H][causes] what is added.

    Raises:
        NoRuleError: an error grows, by the sizes of the weights.
    """
    radius = float(np.abs(np.linalg.eigvals(np.array(rows))).max())
    if radius >= 1.0:
        raise NoRuleError(
            "a recurrent layer carries errors on, and no contraction is shown: by the sizes of its "
            f"weights an error may grow {radius:.3g} times; [network] contracting = true trains one"
            " that forgets"
        )
    found = np.linalg.solve(np.eye(len(rows)) - np.array(rows), np.array(fixed))
    taken = (1 + SPARE) * np.maximum(found, 0.0)
    return [Error(*(shorten(Fraction(part)) for part in row)) for row in taken.tolist()]
