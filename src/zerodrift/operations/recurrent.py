"""What all recurrent layers have in common: names, the proof through a stack, the state at rest."""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import IntArray
from zerodrift.base.config import LONGEST_WINDOW
from zerodrift.base.errors import CheckError, NoRuleError
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN, round_shift
from zerodrift.operations.dense import COPY_BITS
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.intervals import Bound, Interval, Shift, check_shift
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real

H_LIMIT_Q30 = 2**30 - 2**15 + 1
"""|h| in Q1.30 never exceeds this: the recurrent invariant (see `gru.cell.prove_state`)."""
R_Q31_MAX = 2**31 - 2**15
RELAX_STEPS = 64
STATE = "state"
"""What a state stands for of which no more is said than that it lies between -1 and 1."""
WAYS = ("gru_after", "gru_before", "lstm", "recurrent")
"""What states of recurrent layers stand for by the way they came about."""
NO_RULE = "a recurrent layer of this kind carries errors on, and no contraction is shown"


class IntegerLayer:
    """One layer of a stack; its arrays are what the C holds, in the same order.

    A layer has 16-bit features and a state [B, carried] whose first numbers are its output h in
    Q1.30.
    """

    gate_names: ClassVar[tuple[str, ...]]
    w_x: NDArray[np.int16]  # [gates, H, I]
    w_h: NDArray[np.int16] | NDArray[np.int8]  # [gates, H, H]
    bias: NDArray[np.int32]  # [4, H]
    shift: tuple[int, ...]
    multiplier: NDArray[np.int32] | None
    multiplier_shift: tuple[int, ...]

    @property
    def hidden(self) -> int:
        """Number of hidden units H."""
        return int(self.w_h.shape[1])

    @property
    def inputs(self) -> int:
        """Number of features I."""
        return int(self.w_x.shape[2])

    @property
    def carried(self) -> int:
        """Numbers of the state."""
        return self.hidden

    def step(self, x: IntArray, state: IntArray) -> IntArray:
        """Return the next state from int16 features x [B, I] and the state."""
        raise NotImplementedError

    def settle(self, x: IntArray) -> IntArray:
        """Return the state at rest under constant features x [B, I]."""
        raise NotImplementedError

    def write_step(self, w: Writer, x: str, state: Sequence[str]) -> list[str]:
        """Write a step; the state's parts, [B, H] each, begin with h."""
        raise NotImplementedError

    def write_settle(self, w: Writer, x: str) -> list[str]:
        """Write the parts of the state at rest under constant features."""
        raise NotImplementedError

    def prove(self, name: str, features: list[Interval]) -> list[Bound]:
        """Return the bounds of every accumulator for any features within their intervals.

        Sums of absolute values bound every partial sum, whatever the order of summation.

        Raises:
            CheckError: an accumulator could overflow.
        """
        for gate, gate_name in enumerate(self.gate_names):
            check_shift(f"{name}.{gate_name}", self.shift[gate], 31)
            check_shift(f"{name}.{gate_name}.multiplier", self.multiplier_shift[gate], 62)
        bounds: list[Bound] = []
        for j in range(self.hidden):
            for gate, gate_name in enumerate(self.gate_names):
                row = f"{name}.{gate_name}[{j}]"
                from_x = sum(
                    abs(int(w)) * f.magnitude
                    for w, f in zip(self.w_x[gate, j], features, strict=True)
                )
                product = int(np.abs(self.w_h[gate, j].astype(np.int64)).sum()) * INT16_MAX
                if self.multiplier is not None:
                    bounds.append(symmetric(f"{row}.product", product, 32))
                    scaled = product * abs(int(self.multiplier[gate, j]))
                    shift = self.multiplier_shift[gate]
                    bounds.append(symmetric(f"{row}.scaled", scaled + (1 << shift >> 1), 64))
                    product = (scaled >> shift) + 1
                inside, product = self._bound_inside(row, gate, j, product)
                bounds += inside
                total = abs(int(self.bias[gate, j])) + from_x + product
                bounds.append(symmetric(row, total, 32))
        return [bound.check() for bound in (*bounds, *self._bound_state(name))]

    def _bound_inside(self, row: str, gate: int, j: int, product: int) -> tuple[list[Bound], int]:
        """Return the bounds of what is done to a recurrent product, and its largest value then."""
        return [], product

    def _bound_state(self, name: str) -> list[Bound]:
        """Return the bounds of what moves the state."""
        raise NotImplementedError

    def list_shifts(self, name: str) -> list[Shift]:
        """Return every right shift in the C."""
        shifts = []
        for gate, by, scaled_by in zip(
            self.gate_names, self.shift, self.multiplier_shift, strict=True
        ):
            shifts.append(Shift(f"{name}.{gate}.shift", by, 31))
            if self.multiplier is not None:
                shifts.append(Shift(f"{name}.{gate}.multiplier_shift", scaled_by, 62))
        return shifts

    def check_form(self, name: str) -> None:
        """Raise ValueError where the arrays do not fit together."""
        hidden, inputs, count = self.hidden, self.inputs, len(self.gate_names)
        shapes = [self.w_x.shape, self.w_h.shape, self.bias.shape]
        wanted = [(count, hidden, inputs), (count, hidden, hidden), (4, hidden)]
        if self.multiplier is not None:
            shapes.append(self.multiplier.shape)
            wanted.append((count, hidden))
        if shapes != wanted or hidden == 0:
            raise ValueError(f"node '{name}': arrays {shapes} do not fit together")


def symmetric(where: str, magnitude: int, bits: int) -> Bound:
    """Return the bound of what lies between -magnitude and magnitude."""
    return Bound(where, Interval(-magnitude, magnitude), bits)


class IntegerRecurrent(IntegerNode):
    """One or several recurrent layers: a step per sample, or afresh over a window.

    The output is the topmost layer's state in Q1.30, which is the field "h_q30" of what is carried.
    """

    window: int

    if TYPE_CHECKING:  # a field of one kind of layer

        @property
        def layers(self) -> Sequence[IntegerLayer]:
            """All layers from the bottom up."""

    @property
    def width(self) -> int:
        """Number of hidden units H of the topmost layer."""
        return self.layers[-1].hidden

    @property
    def needs_equal_steps(self) -> bool:
        """Whether the state is valid only if all steps have the same length."""
        return True

    @property
    def streams(self) -> bool:
        """Whether the state is carried from sample to sample."""
        return not self.window

    def name_layers(self, mark: str) -> list[str]:
        """Return the layers' names from the bottom up: several are numbered after a mark."""
        return number_layers(self.name, len(self.layers), mark)

    def rest(self, values: Values) -> State:
        """Return cold states: all zero, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            return {"window": np.repeat(x[:, None, :], self.window, axis=1)}
        return self._join(self._zeros(x))

    def settle(self, values: Values) -> State:
        """Return the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.rest(values)
        states: list[IntArray] = []
        x = values[self.inputs[0]]
        for layer in self.layers:
            states.append(layer.settle(x))
            x = round_shift(states[-1][:, : layer.hidden], COPY_BITS)
        return self._join(states)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return the next states and the topmost output in Q1.30."""
        x = values[self.inputs[0]]
        if not self.window:
            states = self._step_all(x, self._split(state))
            return self._join(states), states[-1][:, : self.width]
        window = np.concatenate([state["window"][:, 1:], x[:, None, :]], axis=1)
        states = self._zeros(x)
        for k in range(self.window):
            states = self._step_all(window[:, k], states)
        return {"window": window}, states[-1][:, : self.width]

    def _step_all(self, x: IntArray, states: Sequence[IntArray]) -> list[IntArray]:
        after: list[IntArray] = []
        for layer, state in zip(self.layers, states, strict=True):
            after.append(layer.step(x, state))
            x = round_shift(after[-1][:, : layer.hidden], COPY_BITS)
        return after

    def _zeros(self, x: IntArray) -> list[IntArray]:
        return [np.zeros((x.shape[0], layer.carried), dtype=np.int64) for layer in self.layers]

    def _split(self, state: State) -> list[IntArray]:
        """Return the layers' states from the bottom up."""
        raise NotImplementedError

    def _join(self, states: Sequence[IntArray]) -> State:
        """Return the state that `_split` takes apart."""
        raise NotImplementedError

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound every accumulator of every layer; a window's position needs 16 bits."""
        names = self.name_layers(".")
        bounds = prove_layers(names, self.layers, inputs[0], bool(self.window))
        if self.window:
            bounds.append(Bound(f"{self.name}.window", Interval(1, self.window), 16).check())
        return [Interval(-H_LIMIT_Q30, H_LIMIT_Q30)] * self.width, bounds

    def write_rest(self, w: Writer, values: Names) -> dict[str, str]:
        """Write all zero, or a window filled with the present features."""
        x = values[self.inputs[0]]
        if self.window:
            newest = w.op("Unsqueeze", x, w.constant([1]))
            return {"window": w.op("Tile", newest, w.constant([1, self.window, 1]))}
        zeros = [[w.zeros(x, n.hidden)] * (n.carried // n.hidden) for n in self.layers]
        return self._write_joined(w, zeros)

    def write_settle(self, w: Writer, values: Names) -> dict[str, str]:
        """Write the states at rest under the present features, from the bottom up."""
        if self.window:
            return self.write_rest(w, values)
        states: list[list[str]] = []
        for layer in self.layers:
            x = w.round_shift(states[-1][0], COPY_BITS) if states else values[self.inputs[0]]
            states.append(layer.write_settle(w, x))
        return self._write_joined(w, states)

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write a step in time of all layers, or the whole window from zero."""
        x = values[self.inputs[0]]
        if not self.window:
            states = self._write_all(w, x, self._write_split(w, state))
            return self._write_joined(w, states), states[-1][0]
        window = w.op("Unsqueeze", x, w.constant([1]))
        if self.window > 1:
            ends = (w.constant([end]) for end in (1, self.window, 1))
            window = w.op("Concat", w.op("Slice", state["window"], *ends), window, axis=1)
        counts = [layer.carried // layer.hidden for layer in self.layers]
        widths = [
            n.hidden for n, count in zip(self.layers, counts, strict=True) for _ in range(count)
        ]
        ends_at = np.cumsum([0, *counts]).tolist()

        def body(carried: Sequence[str], slices: Sequence[str]) -> tuple[list[str], list[str]]:
            parts = [carried[a:b] for a, b in itertools.pairwise(ends_at)]
            return [name for part in self._write_all(w, slices[0], parts) for name in part], []

        after = w.scan(
            body,
            [(w.zeros(x, width), ("B", width)) for width in widths],
            [(w.op("Transpose", window, perm=[1, 0, 2]), ("B", self.layers[0].inputs))],
            [],
        )
        return {"window": window}, after[ends_at[-2]]

    def _write_all(self, w: Writer, x: str, states: Sequence[Sequence[str]]) -> list[list[str]]:
        after: list[list[str]] = []
        for layer, state in zip(self.layers, states, strict=True):
            below = w.round_shift(after[-1][0], COPY_BITS) if after else x
            after.append(layer.write_step(w, below, state))
        return after

    def _write_split(self, w: Writer, state: Names) -> list[list[str]]:
        """Write the parts of the layers' states from the bottom up."""
        raise NotImplementedError

    def _write_joined(self, w: Writer, states: Sequence[Sequence[str]]) -> dict[str, str]:
        """Write the state that `_write_split` takes apart."""
        raise NotImplementedError

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Raise: a state's error is bounded with those of all others, by `bound_states`."""
        raise NoRuleError(NO_RULE)

    def bound_states(self, rows: Sequence[Real], inputs: Sequence[Known]) -> list[Error]:
        """Return the error of every unit of the topmost state, whatever the number of steps.

        Args:
            rows: what each of them stands for.
            inputs: what is known of the features.

        Raises:
            NoRuleError: no contraction is shown, without which errors may grow from step to step.
        """
        raise NoRuleError(NO_RULE)

    def list_lower(self) -> "list[IntegerRecurrent]":
        """Return the layers below the topmost, each as a node by itself, named as in bounds."""
        return []

    def at_rest(self, state: State, values: Values) -> IntArray:
        """Return the topmost output as it stands in a carried state, which is last there."""
        if self.streams:
            return np.asarray(state["h_q30"][:, -self.width :])
        return super().at_rest(state, values)

    def write_at_rest(self, w: Writer, values: Names, state: Names) -> str:
        """Write the topmost output as it stands in a carried state."""
        if not self.streams:
            return super().write_at_rest(w, values, state)
        ends = (w.constant([end]) for end in (-self.width, 2**31 - 1, 1))
        return w.op("Slice", state["h_q30"], *ends)

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C."""
        pairs = zip(self.name_layers("."), self.layers, strict=True)
        return [shift for name, layer in pairs for shift in layer.list_shifts(name)]

    def check_form(self) -> None:
        """Raise ValueError where the window is too long, or a layer's arrays do not fit."""
        if not 0 <= self.window <= LONGEST_WINDOW:
            raise ValueError(
                f"node '{self.name}' has a window of {self.window}, not 0 to {LONGEST_WINDOW}"
            )
        if not self.layers:
            raise ValueError(f"node '{self.name}' has no layer")
        for layer in self.layers:
            layer.check_form(self.name)


def number_layers(name: str, count: int, mark: str) -> list[str]:
    """Return the names of a stack's layers, the lowest first: several are numbered after a mark."""
    return [name] if count == 1 else [f"{name}{mark}{level}" for level in range(count)]


def prove_layers(
    names: Sequence[str], layers: Sequence[IntegerLayer], below: list[Interval], windowed: bool
) -> list[Bound]:
    """Bound every accumulator of a stack; an output's int16 copy is at most 32767.

    Args:
        names: of the layers, for the bounds.
        layers: from the bottom up.
        below: of the features, int16.
        windowed: the features of a window are taken to be any int16, so that the proof does not
            depend on the stored values.

    Raises:
        CheckError: a layer does not read as many values as the one below gives, or is not safe.
    """
    if windowed:
        below = [Interval(INT16_MIN, INT16_MAX)] * layers[0].inputs
    bounds: list[Bound] = []
    for name, layer in zip(names, layers, strict=True):
        if layer.inputs != len(below):
            raise CheckError(
                f"{name}: the layer reads {layer.inputs} values, and gets {len(below)}."
                " The model is refused."
            )
        bounds += layer.prove(name, below)
        below = [Interval(-INT16_MAX, INT16_MAX)] * layer.hidden
    return bounds
