"""The long short-term memory: float step, integer step, range rule.

Gate order is defined here and nowhere else: i (input), f (forget), g (candidate), o (output).

    i = sigmoid(Wi x + Ui h + bi)        f = sigmoid(Wf x + Uf h + bf)
    g = tanh(Wg x + Ug h + bg)           o = sigmoid(Wo x + Uo h + bo)
    c' = f c + i g                       h' = o tanh(c')

The integer meaning is normative and specified in `docs/reference/integer-layers.md`.

Source: Gers, Schmidhuber and Cummins, "Learning to forget: continual prediction with LSTM", 2000.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.operations.arithmetic import round_shift, saturate
from zerodrift.operations.intervals import Bound, Shift, check_shift
from zerodrift.operations.node import Writer
from zerodrift.operations.recurrent import R_Q31_MAX, RELAX_STEPS, IntegerLayer, symmetric
from zerodrift.operations.tables import (
    NODE_MAX,
    STEP_BITS,
    sigmoid_q31,
    tanh_q30,
    write_sigmoid,
    write_tanh,
)

GATES = ("i", "f", "g", "o")
CELL_LIMIT = 2**30
"""|c| as an integer never exceeds this: the step saturates there."""
CELL_BITS = (24, 27)
"""Fewest and most fractional bits of the cell state: it holds 64 or 8, where tanh has saturated."""
SLOWEST = 15
"""1 - f is at least 2**-16, so that up to 15 doublings bring it to 1/2 or more."""


@dataclass(frozen=True)
class FloatLstm:
    """Weights of an LSTM in float64, gates in the order i, f, g, o."""

    w_x: Array  # [4, H, I]
    w_h: Array  # [4, H, H]
    bias: Array  # [4, H]

    @property
    def hidden(self) -> int:
        """Number of hidden units H."""
        return int(self.w_h.shape[1])

    def run(self, x: Array, state: Array) -> tuple[Array, Array]:
        """Return outputs h [B, T, H] and the last state, for x [B, T, I] from a state [B, 2 H].

        The state is h beside c.
        """
        return self._run(x, state, relaxing=False)

    def settle(self, x: Array) -> Array:
        """Return the state at rest [B, 2 H] under constant features x [B, I], relaxed from 0."""
        start = np.zeros((x.shape[0], 2 * self.hidden))
        return self._run(np.repeat(x[:, None], RELAX_STEPS, axis=1), start, relaxing=True)[1]

    def _run(self, x: Array, state: Array, relaxing: bool) -> tuple[Array, Array]:
        """Return outputs and last state; relaxing moves c at a quarter to half of its distance."""
        hidden = self.hidden
        halves = np.repeat([0.5, 0.5, 1.0, 0.5], hidden)  # sigmoid(a) = (1 + tanh(a / 2)) / 2
        outside = (x @ self.w_x.reshape(4 * hidden, -1).T + self.bias.ravel()) * halves
        w_h = np.ascontiguousarray(self.w_h.reshape(4 * hidden, hidden).T * halves)
        h, c = state[:, :hidden], state[:, hidden:]
        outputs = np.empty((*x.shape[:2], hidden))
        for t in range(x.shape[1]):
            i, f, g, o = np.split(np.tanh(outside[:, t] + h @ w_h), 4, axis=1)
            i, f, o = (0.5 + 0.5 * gate for gate in (i, f, o))
            if relaxing:
                doublings = np.clip(np.ceil(-np.log2(1.0 - f)) - 1.0, 0.0, SLOWEST)
                c = c + 2.0 ** (doublings - 1.0) * (i * g - (1.0 - f) * c)
            else:
                c = f * c + i * g
            h = o * np.tanh(c)
            outputs[:, t] = h
        return outputs, np.concatenate([h, c], axis=1)


class LstmGates(NamedTuple):
    """What the gates of an `IntegerLstm` are at a step, each [B, H]."""

    i_q31: NDArray[np.int32]
    f_q31: NDArray[np.int32]
    g_q30: NDArray[np.int32]
    o_q31: NDArray[np.int32]


@dataclass(frozen=True)
class IntegerLstm(IntegerLayer):
    """A quantized LSTM; every array is what the C holds, in the same order."""

    gate_names: ClassVar = GATES
    w_x: NDArray[np.int16]  # [4, H, I]
    w_h: NDArray[np.int16] | NDArray[np.int8]  # [4, H, H]
    bias: NDArray[np.int32]
    """[4, H]; the rounding halves of the shifts are folded in."""
    shift: tuple[int, int, int, int]
    """Right shift from the accumulator of gate i, f, g, o to the table's t_q16."""
    cell_bits: int
    """Fractional bits of the cell state."""
    multiplier: NDArray[np.int32] | None = None
    """[4, H] for int8 recurrent weights: row scale of w_h . h; None for int16."""
    multiplier_shift: tuple[int, int, int, int] = (0, 0, 0, 0)

    @property
    def carried(self) -> int:
        """Numbers of the state: h beside c."""
        return 2 * self.hidden

    @cached_property
    def _rows(self) -> tuple[Array, Array]:
        """Return the weights [I, 4 H] and [H, 4 H], as float64 for exact products."""
        both = (w.reshape(4 * self.hidden, -1).T for w in (self.w_x, self.w_h))
        w_x, w_h = (np.ascontiguousarray(w, dtype=np.float64) for w in both)
        return w_x, w_h

    def gates(self, x: IntArray, h_q30: IntArray) -> LstmGates:
        """Return the gates for int16 features x [B, I] and the output h_q30 [B, H] before."""
        w_x, w_h = self._rows
        from_h = (round_shift(h_q30, 15).astype(np.float64) @ w_h).astype(np.int64)
        if self.multiplier is not None:
            scaled = from_h * self.multiplier.ravel().astype(np.int64)
            shifts = np.repeat(np.array(self.multiplier_shift, dtype=np.int64), self.hidden)
            from_h = (scaled + (np.left_shift(1, shifts) >> 1)) >> shifts
        total = (x.astype(np.float64) @ w_x).astype(np.int64) + self.bias.ravel() + from_h
        t_q16 = total >> np.repeat(np.array(self.shift, dtype=np.int64), self.hidden)
        i, f, g, o = np.split(t_q16, 4, axis=1)
        return LstmGates(sigmoid_q31(i), sigmoid_q31(f), tanh_q30(g), sigmoid_q31(o))

    def step(self, x: IntArray, state: IntArray) -> IntArray:
        """Return the next state [B, 2 H], h in Q1.30 beside c, from features and state."""
        gates, cell = self.gates(x, state[:, : self.hidden]), state[:, self.hidden :]
        moved = _mul_high(cell, gates.f_q31) + self._add(gates)
        return self._join(gates, np.asarray(2 * saturate(moved, -CELL_LIMIT // 2, CELL_LIMIT // 2)))

    def settle(self, x: IntArray) -> IntArray:
        """Return the state at rest [B, 2 H] under constant features x [B, I]."""
        state = np.zeros((x.shape[0], 2 * self.hidden), dtype=np.int64)
        for _ in range(RELAX_STEPS):
            gates, cell = self.gates(x, state[:, : self.hidden]), state[:, self.hidden :]
            forget = (1 << 31) - gates.f_q31.astype(np.int64)
            doublings = sum((forget < (1 << (30 - k))).astype(np.int64) for k in range(SLOWEST))
            distance = self._add(gates) - _mul_high(cell, forget)
            moved = cell + np.left_shift(distance, doublings)
            state = self._join(gates, np.asarray(saturate(moved, -CELL_LIMIT, CELL_LIMIT)))
        return state

    def _add(self, gates: LstmGates) -> IntArray:
        """Return i g with one fractional bit less than the cell state."""
        return np.asarray(round_shift(_mul_high(gates.g_q30, gates.i_q31), 30 - self.cell_bits))

    def _join(self, gates: LstmGates, cell: IntArray) -> IntArray:
        """Return the state that a cell state leads to."""
        bend = tanh_q30(round_shift(cell, self.cell_bits - 16))
        return np.concatenate([2 * _mul_high(bend, gates.o_q31), cell], axis=1)

    def write_step(self, w: Writer, x: str, state: Sequence[str]) -> list[str]:
        """Write one step; h and c after it."""
        return write_lstm_step(w, self, x, state[0], state[1])

    def write_settle(self, w: Writer, x: str) -> list[str]:
        """Write h and c at rest under constant features x [B, I]."""
        return w.repeat(
            RELAX_STEPS,
            lambda carried: write_lstm_step(w, self, x, carried[0], carried[1], relaxing=True),
            [(w.zeros(x, self.hidden), ("B", self.hidden))] * 2,
        )

    def _bound_state(self, name: str) -> list[Bound]:
        check_shift(f"{name}.cell_bits", 30 - self.cell_bits, 30 - CELL_BITS[0])
        check_shift(f"{name}.cell_bits", self.cell_bits - 16, CELL_BITS[1] - 16)
        return prove_cell(name, self.cell_bits)

    def list_shifts(self, name: str) -> list[Shift]:
        """Return every right shift in the C."""
        return [*super().list_shifts(name), Shift(f"{name}.cell_bits", self.cell_bits, 31)]

    def check_form(self, name: str) -> None:
        """Raise ValueError where the arrays do not fit together, or the cell's bits are unknown."""
        super().check_form(name)
        if not CELL_BITS[0] <= self.cell_bits <= CELL_BITS[1]:
            raise ValueError(f"node '{name}': {self.cell_bits} bits of the cell state")


def prove_cell(name: str, cell_bits: int) -> list[Bound]:
    """Return the bounds of the sums that move the cell state, which saturates at `CELL_LIMIT`."""
    bend = NODE_MAX << STEP_BITS
    add = ((bend * R_Q31_MAX >> 32) + 1 >> (30 - cell_bits)) + 1
    kept = (CELL_LIMIT * R_Q31_MAX >> 32) + 1
    half = 1 << (cell_bits - 16) >> 1
    return [
        symmetric(f"{name}.moved", kept + add, 32),
        symmetric(f"{name}.distance", kept + add, 32),
        symmetric(f"{name}.relaxed", CELL_LIMIT + ((kept + add) << SLOWEST), 64),
        symmetric(f"{name}.bend", CELL_LIMIT + half, 32),
    ]


def _mul_high(a: IntArray | NDArray[np.int32], b: IntArray | NDArray[np.int32]) -> IntArray:
    return np.asarray(round_shift(a.astype(np.int64) * b, 32))


def write_lstm_step(
    w: Writer, lstm: IntegerLstm, x: str, h_q30: str, cell: str, relaxing: bool = False
) -> list[str]:
    """Write one step of an LSTM; return h and c after it.

    Args:
        w: where to.
        lstm: the layer.
        x: [B, I] features.
        h_q30: [B, H] output before.
        cell: [B, H] cell state before.
        relaxing: towards rest under constant features, rather than in time.
    """
    hidden = lstm.hidden
    from_x = w.op("MatMul", x, w.constant(lstm.w_x.reshape(4 * hidden, -1).T))
    h_q15 = w.round_shift(h_q30, 15)
    from_h = w.op("MatMul", h_q15, w.constant(lstm.w_h.reshape(4 * hidden, hidden).T))
    if lstm.multiplier is not None:
        scaled = w.mul(from_h, w.constant(lstm.multiplier.ravel()))
        from_h = w.round_shift(scaled, np.repeat(lstm.multiplier_shift, hidden))
    total = w.add(w.add(from_x, w.constant(lstm.bias.ravel())), from_h)
    t_q16 = w.floor_shift(total, np.repeat(lstm.shift, hidden))
    i, f, g, o = w.split(t_q16, [hidden] * 4)
    i_q31, f_q31, o_q31 = (write_sigmoid(w, gate) for gate in (i, f, o))
    added = w.round_shift(w.mul(write_tanh(w, g), i_q31), 32)
    added = w.round_shift(added, 30 - lstm.cell_bits)
    if relaxing:
        forget = w.sub(w.constant(1 << 31), f_q31)
        doublings = w.constant(0)
        for k in range(SLOWEST):
            doublings = w.add(doublings, w.flag(w.op("Less", forget, w.constant(1 << (30 - k)))))
        gain = w.op("Gather", w.constant([1 << k for k in range(SLOWEST + 1)]), doublings)
        distance = w.sub(added, w.round_shift(w.mul(cell, forget), 32))
        moved = w.add(cell, w.mul(distance, gain))
        cell = w.saturate(moved, -CELL_LIMIT, CELL_LIMIT)
    else:
        moved = w.add(w.round_shift(w.mul(cell, f_q31), 32), added)
        cell = w.shift_left(w.saturate(moved, -CELL_LIMIT // 2, CELL_LIMIT // 2), 1)
    bend = write_tanh(w, w.round_shift(cell, lstm.cell_bits - 16))
    return [w.shift_left(w.round_shift(w.mul(bend, o_q31), 32), 1), cell]
