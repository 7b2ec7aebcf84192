"""The gated recurrent unit: float step, integer step, range rule and the order of its C data.

Gate order is defined here and nowhere else: r (reset), u (update), n (candidate). The update gate
is kept as u = 1 - z = sigmoid(-z_preactivation), since that is what the state moves by:

    r = sigmoid(Wr x + Ur h + br)        u = sigmoid(Wu x + Uu h + bu)
    n = tanh(Wn x + bn + r * (Un h + cn))          reset "after" the recurrent product (PyTorch)
    n = tanh(Wn x + bn + Un (r * h))               reset "before" it (the paper)
    h' = h + u * (n - h)

The integer meaning is normative and specified in `docs/reference/integer-arithmetic.md`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.intervals import Bound
from zerodrift.operations.node import Writer
from zerodrift.operations.recurrent import (
    H_LIMIT_Q30,
    R_Q31_MAX,
    RELAX_STEPS,
    IntegerLayer,
    symmetric,
)
from zerodrift.operations.tables import sigmoid_q31, tanh_q30, write_sigmoid, write_tanh

RESETS = ("after", "before")
GATES = ("r", "u", "n")
U_RELAX_Q31 = 2**30


@dataclass(frozen=True)
class FloatGru:
    """Weights of a GRU in float64, gates in the order r, u, n."""

    w_x: Array  # [3, H, I]
    w_h: Array  # [3, H, H]
    bias: Array
    """[4, H]: r, u, n outside the reset product, n inside it (0 for reset "before")."""
    reset: str
    """"after" or "before" the recurrent product."""

    def step(self, x: Array, h: Array) -> Array:
        """Return the next state [B, H] from features x [B, I] and state h [B, H]."""
        return self.run(x[:, None], h)[:, 0]

    def run(self, x: Array, h: Array) -> Array:
        """Return the states [B, T, H] for features x [B, T, I], from state h [B, H]."""
        hidden, after = self.w_h.shape[1], self.reset == "after"
        outside = x @ self.w_x.reshape(3 * hidden, -1).T + self.bias[:3].ravel()
        outside[..., : 2 * hidden] *= 0.5  # sigmoid(a) = (1 + tanh(a / 2)) / 2
        w_all = self.w_h.reshape(3 * hidden, hidden).T * np.repeat([0.5, 0.5, 1.0], hidden)
        w_gates, w_n = np.ascontiguousarray(w_all[:, : 2 * hidden]), w_all[:, 2 * hidden :]
        states = np.empty((x.shape[0], x.shape[1], hidden))
        for t in range(x.shape[1]):
            given = outside[:, t]
            product = h @ (w_all if after else w_gates)
            gates = 0.5 + 0.5 * np.tanh(given[:, : 2 * hidden] + product[:, : 2 * hidden])
            r, u = gates[:, :hidden], gates[:, hidden:]
            inside = r * (product[:, 2 * hidden :] + self.bias[3]) if after else (r * h) @ w_n
            h = h + u * (np.tanh(given[:, 2 * hidden :] + inside) - h)
            states[:, t] = h
        return states

    def settle(self, x: Array) -> Array:
        """Return the state at rest [B, H] under constant features x [B, I], relaxed from 0."""
        kept = np.array([1.0, 0.0, 1.0, 1.0])[:, None]  # the update gate is sigmoid(0) = 1/2
        w_x, w_h = (w * kept[:3, :, None] for w in (self.w_x, self.w_h))
        held = FloatGru(w_x, w_h, self.bias * kept, self.reset)
        start = np.zeros((x.shape[0], self.w_h.shape[1]))
        return held.run(np.repeat(x[:, None], RELAX_STEPS, axis=1), start)[:, -1]


class IntegerGates(NamedTuple):
    """What a step of an `IntegerGru` goes through, each [B, H]."""

    r_q31: NDArray[np.int32]
    u_q31: NDArray[np.int32]
    n_q30: NDArray[np.int32]
    product: IntArray
    """Reset "after": the sum inside the reset product, at `IntegerGru.inside_scale`; "before":
    r h in Q0.15."""


@dataclass(frozen=True)
class _Rows:
    """An `IntegerGru` with the rows of its gates side by side, as float64 for the products."""

    w_x_t: Array  # [I, 3 H]
    w_h_t: Array  # [H, 3 H]
    bias: Array  # [3 H]
    shift: NDArray[np.int32]  # [3 H]
    multiplier: IntArray  # [3 H]; empty for int16
    multiplier_shift: IntArray  # [3 H]


def _stack(weights: NDArray[np.int16] | NDArray[np.int8]) -> Array:
    """Return weights [3, H, n] as [n, 3 H], for products with row vectors."""
    return np.ascontiguousarray(weights.reshape(-1, weights.shape[2]).T, dtype=np.float64)


@dataclass(frozen=True)
class IntegerGru(IntegerLayer):
    """A quantized GRU; every array is what the C holds, in the same order."""

    gate_names: ClassVar = GATES
    w_x: NDArray[np.int16]  # [3, H, I]
    w_h: NDArray[np.int16] | NDArray[np.int8]  # [3, H, H]
    bias: NDArray[np.int32]
    """[4, H]: r, u, n outside, n inside; the rounding halves of the shifts are folded in."""
    shift: tuple[int, int, int]
    """Right shift from the accumulator of gate r, u, n to the table's t_q16."""
    reset: str
    multiplier: NDArray[np.int32] | None = None
    """[3, H] for int8 recurrent weights: row scale of w_h . h; None for int16."""
    multiplier_shift: tuple[int, int, int] = (0, 0, 0)

    @cached_property
    def _rows(self) -> _Rows:
        multiplier = np.zeros(0) if self.multiplier is None else self.multiplier.ravel()
        return _Rows(
            w_x_t=_stack(self.w_x),
            w_h_t=_stack(self.w_h),
            bias=self.bias[:3].ravel().astype(np.float64),
            shift=np.repeat(np.array(self.shift, dtype=np.int32), self.hidden),
            multiplier=multiplier.astype(np.int64),
            multiplier_shift=np.repeat(np.array(self.multiplier_shift), self.hidden),
        )

    def _recurrent(self, h_q15: IntArray, rows: slice) -> Array:
        """Return w_h . h of some rows [B, rows] in their gates' accumulator formats.

        Here and in `gates` accumulators are integers held exactly in float64: the certificate
        bounds them and their partial sums by 2**31.
        """
        product = h_q15.astype(np.float64) @ self._rows.w_h_t[:, rows]
        if self.multiplier is None:
            return np.asarray(product)
        shift = self._rows.multiplier_shift[rows]
        scaled = product.astype(np.int64) * self._rows.multiplier[rows] + (1 << shift >> 1)
        return (scaled >> shift).astype(np.float64)

    @property
    def inside_scale(self) -> float:
        """Real value of one count of the sum inside the reset product."""
        return 2.0 ** -(self.shift[2] + 17)

    def dequantize_recurrent(self) -> Array:
        """Return the recurrent weights [3, H, H] as the integers act."""
        exponents = np.array([self.shift[0] + 15, self.shift[1] + 15, self.shift[2] + 16])
        exponents[2] += self.reset == "after"
        weights = self.w_h.astype(np.float64)
        if self.multiplier is not None:
            weights = weights * self.multiplier[:, :, None]
            exponents += np.array(self.multiplier_shift)
        return np.asarray(weights * 2.0 ** (15.0 - exponents[:, None, None]))

    def gates(self, x: IntArray, h_q30: IntArray) -> IntegerGates:
        """Return the gates for int16 features x [B, I] and state h_q30 [B, H]."""
        hidden, after = self.hidden, self.reset == "after"
        ru, n = slice(0, 2 * hidden), slice(2 * hidden, 3 * hidden)
        from_x = x.astype(np.float64) @ self._rows.w_x_t + self._rows.bias
        from_h = self._recurrent(round_shift(h_q30, 15), slice(0, n.stop if after else ru.stop))
        a_ru = (from_x[:, ru] + from_h[:, ru]).astype(np.int32)
        ru_q31 = sigmoid_q31(a_ru >> self._rows.shift[ru])
        r_q31, u_q31 = ru_q31[:, :hidden], ru_q31[:, hidden:]
        if after:
            product = (from_h[:, n] + self.bias[3]).astype(np.int64)
            a_n = from_x[:, n].astype(np.int64) + round_shift(product * r_q31, 32)
        else:
            product = round_shift(h_q30 * r_q31, 46)
            a_n = (from_x[:, n] + self._recurrent(product, n)).astype(np.int64)
        return IntegerGates(r_q31, u_q31, tanh_q30(a_n >> self.shift[2]), product)

    def step(self, x: IntArray, h_q30: IntArray) -> IntArray:
        """Return the next state [B, H] in Q1.30 from int16 features x [B, I] and state h_q30."""
        return self.move(self.gates(x, h_q30), h_q30)

    @staticmethod
    def move(gates: IntegerGates, h_q30: IntArray) -> IntArray:
        """Return the state [B, H] in Q1.30 that the gates lead to from h_q30."""
        return np.asarray(h_q30 + 2 * round_shift((gates.n_q30 - h_q30) * gates.u_q31, 32))

    def settle(self, x: IntArray) -> IntArray:
        """Return the state at rest [B, H] in Q1.30 under constant features x [B, I]."""
        h_q30 = np.zeros((x.shape[0], self.hidden), dtype=np.int64)
        for _ in range(RELAX_STEPS):
            n_q30 = self.gates(x, h_q30).n_q30
            h_q30 = np.asarray(h_q30 + 2 * round_shift((n_q30 - h_q30) * U_RELAX_Q31, 32))
        return h_q30

    def write_step(self, w: Writer, x: str, state: Sequence[str]) -> list[str]:
        """Write one step."""
        return [write_gru_step(w, self, x, state[0])]

    def write_settle(self, w: Writer, x: str) -> list[str]:
        """Write the state at rest under constant features x [B, I]."""
        half = w.constant(U_RELAX_Q31)
        return w.repeat(
            RELAX_STEPS,
            lambda carried: [write_gru_step(w, self, x, carried[0], half)],
            [(w.zeros(x, self.hidden), ("B", self.hidden))],
        )

    def _bound_inside(self, row: str, gate: int, j: int, product: int) -> tuple[list[Bound], int]:
        if GATES[gate] != "n" or self.reset != "after":
            return [], product
        inside = abs(int(self.bias[3, j])) + product
        return [symmetric(f"{row}.inside", inside, 32)], (inside * R_Q31_MAX >> 32) + 1

    def _bound_state(self, name: str) -> list[Bound]:
        return [prove_state(name)]

    def check_form(self, name: str) -> None:
        """Raise ValueError where the arrays do not fit together, or the reset is unknown."""
        super().check_form(name)
        if self.reset not in RESETS:
            raise ValueError(f"node '{name}': reset {self.reset!r:.40}; expected one of {RESETS}")


def prove_state(name: str) -> Bound:
    """Return the bound of n - h, which rests on the recurrent invariant |h| <= H_LIMIT_Q30.

    Invariant, by induction from h = 0: let d = n - h. The step adds 2 round(d u / 2) which lies
    within 1 of d u, and u <= 1 - 2**-16. Where |d| >= 2**16 the step therefore does not pass n, and
    |n| <= 2**30 - 2**15; where |d| < 2**16 it passes n by at most 1.
    """
    reach = (2**30 - 2**15) + H_LIMIT_Q30
    return symmetric(f"{name}.state_step", reach, 32)


def write_gru_step(w: Writer, gru: IntegerGru, x: str, h_q30: str, u_q31: str | None = None) -> str:
    """Write one step of a GRU.

    Args:
        w: where to.
        gru: the layer.
        x: [B, I] features.
        h_q30: [B, H] state.
        u_q31: what to move by instead of the update gate.
    """
    hidden, after = gru.hidden, gru.reset == "after"
    halves = (2 * hidden, hidden)
    from_x = w.op("MatMul", x, w.constant(gru.w_x.reshape(3 * hidden, -1).T))
    from_x = w.add(from_x, w.constant(gru.bias[:3].ravel()))
    x_ru, x_n = w.split(from_x, halves)
    h_q15 = w.round_shift(h_q30, 15)
    if after:
        h_ru, h_n = w.split(_write_recurrent(w, gru, h_q15, slice(0, 3)), halves)
    else:
        h_ru = _write_recurrent(w, gru, h_q15, slice(0, 2))
    shifts = np.repeat(gru.shift[:2], hidden)
    ru_q31 = write_sigmoid(w, w.floor_shift(w.add(x_ru, h_ru), shifts))
    r_q31, update_q31 = w.split(ru_q31, (hidden, hidden))
    if after:
        inside = w.add(h_n, w.constant(gru.bias[3]))
        a_n = w.add(x_n, w.round_shift(w.mul(inside, r_q31), 32))
    else:
        rh_q15 = w.round_shift(w.mul(h_q30, r_q31), 46)
        a_n = w.add(x_n, _write_recurrent(w, gru, rh_q15, slice(2, 3)))
    n_q30 = write_tanh(w, w.floor_shift(a_n, gru.shift[2]))
    move = w.round_shift(w.mul(w.sub(n_q30, h_q30), u_q31 or update_q31), 32)
    return w.add(h_q30, w.shift_left(move, 1))


def _write_recurrent(w: Writer, gru: IntegerGru, h_q15: str, gates: slice) -> str:
    """Write w_h . h of some gates, [B, gates * H], in their accumulators' formats."""
    rows = gru.w_h[gates].reshape(-1, gru.hidden)
    product = w.op("MatMul", h_q15, w.constant(rows.T))
    if gru.multiplier is None:
        return product
    scaled = w.mul(product, w.constant(gru.multiplier[gates].ravel()))
    return w.round_shift(scaled, np.repeat(gru.multiplier_shift[gates], gru.hidden))
