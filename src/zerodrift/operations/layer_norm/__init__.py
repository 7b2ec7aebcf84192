"""Layer normalisation: what a layer gives, less its mean over all numbers, over their deviation.

The integer meaning is normative and specified in `docs/reference/integer-layers.md`.

Source: Ba, Kiros and Hinton, "Layer normalization", 2016.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError, NoRuleError
from zerodrift.operations.arithmetic import round_shift
from zerodrift.operations.c_text import CTable, RuntimePart, make_table
from zerodrift.operations.dense import COPY_BITS
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.intervals import Bound, Interval, Shift, check_shift
from zerodrift.operations.node import IntegerNode, Names, OnnxStep, State, Values, Writer
from zerodrift.operations.signals import Real

MOST_WIDTH = 128
"""Numbers of a layer: the sum of their squares fits 62 bits."""
RAISED_BITS = 12
"""Bits that an int16 copy gets before its mean is taken off."""
PART_BITS = 26
"""Fractional bits of x less its mean, over the deviation."""
EPSILON_LIMIT = 2**60
ROUNDS = 4
"""Of Newton's rule."""
START_Q29, SLOPE_Q29, THREE_Q29 = 1143535043, 652298158, 3 << 29
"""The line 2.13 - 1.215 a, within 9 % of 1 / sqrt(a) for 1/4 <= a < 1; each round squares that."""
ROOT_SPARE = 8
"""What roundings add to sqrt(M), which no number over the root of all squares' mean exceeds."""
LARGEST_ROOT_Q29 = 2**30 + 4
"""1 / sqrt(a) is at most 2, and its roundings are small."""
LAYER_NORM = RuntimePart("zd_layer_norm.h", "zd_tanh_is_sound")


@dataclass(frozen=True)
class FloatLayerNorm:
    """gain (x - mean) / sqrt(variance + epsilon) + bias, mean and variance over all of x."""

    gain: Array  # [M]
    bias: Array  # [M]
    epsilon: float

    def step(self, x: Array) -> Array:
        """Return the layer's output [..., M] for x [..., M]."""
        centered = x - x.mean(axis=-1, keepdims=True)
        variance = np.mean(centered**2, axis=-1, keepdims=True)
        return np.asarray(self.gain * centered / np.sqrt(variance + self.epsilon) + self.bias)


def invert_root(a_q30: IntArray) -> IntArray:
    """Return 1 / sqrt(a) in Q29 of a in Q30, 1/4 <= a < 1, to about 2**-28."""
    r = START_Q29 - (SLOPE_Q29 * a_q30 >> 30)
    for _ in range(ROUNDS):
        r = r * (THREE_Q29 - ((r * r >> 29) * a_q30 >> 30)) >> 30
    return np.asarray(r)


def list_constants(width: int) -> tuple[int, int, int]:
    """Return what follows from the number of numbers M: 2**p / M, p, and sqrt(M) in Q26."""
    mean_shift = 27 + width.bit_length() - 1
    reciprocal = ((1 << mean_shift + 1) // width + 1) // 2
    return reciprocal, mean_shift, math.isqrt(width << 2 * PART_BITS)


@dataclass(frozen=True)
class IntegerLayerNorm(IntegerNode):
    """The normalisation of the int16 copies of a layer: exact sums, one root of 28 bits."""

    kind: ClassVar[str] = "layer_norm"
    align: tuple[int, ...]
    """[M] shifts that bring the copies, raised by `RAISED_BITS`, to one scale."""
    gain: NDArray[np.int32]
    """[M]"""
    shift: tuple[int, ...]
    """[M] from the product with the gain to the result."""
    bias: NDArray[np.int32]
    """[M] in the result's unit."""
    epsilon: int
    """M epsilon in the unit of the squares."""

    @property
    def width(self) -> int:
        """Number of numbers M."""
        return len(self.align)

    @property
    def constants(self) -> tuple[int, int, int]:
        """Reciprocal, its shift, and root, which follow from M."""
        return list_constants(self.width)

    def step(self, state: State, values: Values) -> tuple[State, IntArray]:
        """Return gain (x - mean) / sqrt(variance + epsilon) + bias."""
        reciprocal, mean_shift, root = self.constants
        raised = round_shift(values[self.inputs[0]], COPY_BITS) << RAISED_BITS
        v = _round_each(raised, np.array(self.align))
        mean = round_shift(v.sum(axis=1, keepdims=True) * reciprocal, mean_shift)
        d = v - mean
        squares = self.epsilon + (d * d).sum(axis=1, keepdims=True)
        doublings = np.zeros_like(squares)
        for by in (32, 16, 8, 4, 2):
            some = np.where(squares < 1 << (62 - by), by, 0)
            squares = squares << some
            doublings = doublings + some
        scale = invert_root(squares >> 32) * root >> 29
        part = _round_each(d * scale, 31 - doublings // 2)
        product = part * self.gain.astype(np.int64)
        return {}, np.asarray(_round_each(product, np.array(self.shift)) + self.bias)

    def prove(self, inputs: list[list[Interval]]) -> tuple[list[Interval], list[Bound]]:
        """Bound the sums, whatever their order, the products and the results.

        About any number c the squares sum up to no more than those about 0 and M times what c is
        from the mean, squared: that is at most `astray`.
        """
        name, width, half = self.name, self.width, 1 << COPY_BITS >> 1
        if len(inputs[0]) != width:
            raise CheckError(
                f"{name}: normalises {width} values, and gets {len(inputs[0])}. The model is"
                " refused."
            )
        reciprocal, mean_shift, root = self.constants
        reach = []
        for i, x in enumerate(inputs[0]):
            check_shift(f"{name}[{i}].align", self.align[i], 62)
            check_shift(f"{name}[{i}].shift", self.shift[i], 62)
            reach.append(
                (x.round_shift(COPY_BITS).scale(1 << RAISED_BITS))
                .round_shift(self.align[i])
                .magnitude
            )
        total = sum(reach)
        scaled = total * reciprocal + (1 << mean_shift >> 1)
        mean = (scaled >> mean_shift) + 1
        astray = total * abs(reciprocal * width - (1 << mean_shift)) // (width << mean_shift) + 2
        squares = self.epsilon + sum(v * v for v in reach) + width * astray * astray
        scale = LARGEST_ROOT_Q29 * root >> 29
        bounds = [
            Bound(f"{name}.sum", _symmetric(total), 64),
            Bound(f"{name}.mean", _symmetric(scaled), 64),
            Bound(f"{name}.difference", _symmetric(max(reach) + mean), 32),
            Bound(f"{name}.squares", Interval(0, squares), 63),
            Bound(f"{name}.scale", Interval(0, scale), 32),
            Bound(f"{name}.part", _symmetric((max(reach) + mean) * scale + (1 << 30)), 64),
        ]
        out = []
        for i in range(width):
            product = (root + ROOT_SPARE) * abs(int(self.gain[i])) + (1 << self.shift[i] >> 1)
            largest = (product >> self.shift[i]) + 1 + abs(int(self.bias[i]))
            bounds += [
                Bound(f"{name}[{i}].product", _symmetric(product), 64),
                Bound(f"{name}[{i}]", _symmetric(largest + half), 32),
                Bound(f"{name}[{i}].copy", _symmetric(largest).round_shift(COPY_BITS), 16),
            ]
            out.append(_symmetric(largest))
        return out, [bound.check() for bound in bounds]

    def bound_error(self, real: Real, out: Known, inputs: Sequence[Known]) -> Error:
        """Raise NoRuleError: it occurs with recurrent layers, and has no largest slope of its own.

        Where all numbers are alike it takes an error times 1 / sqrt(epsilon), some hundred times.
        """
        raise NoRuleError(
            "a layer normalisation takes an error of nearly equal numbers times 1 / sqrt(epsilon)"
        )

    def write_step(self, w: Writer, values: Names, state: Names) -> OnnxStep:
        """Write gain (x - mean) / sqrt(variance + epsilon) + bias."""
        reciprocal, mean_shift, root = self.constants
        raised = w.shift_left(w.round_shift(values[self.inputs[0]], COPY_BITS), RAISED_BITS)
        v = w.round_shift(raised, self.align)
        axis = w.constant([1])
        total = w.op("ReduceSum", v, axis, keepdims=1)
        mean = w.round_shift(w.mul(total, w.constant(reciprocal)), mean_shift)
        d = w.sub(v, mean)
        squares = w.op("ReduceSum", w.mul(d, d), axis, keepdims=1)
        squares = w.add(squares, w.constant(self.epsilon))
        halves = w.constant(0)  # doublings / 2
        for by in (32, 16, 8, 4, 2):
            few = w.flag(w.op("Less", squares, w.constant(1 << (62 - by))))
            more = w.mul(few, w.constant((1 << by) - 1))
            squares = w.mul(squares, w.add(more, w.constant(1)))
            halves = w.add(halves, w.mul(few, w.constant(by // 2)))
        scale = w.floor_shift(
            w.mul(_write_root(w, w.floor_shift(squares, 32)), w.constant(root)), 29
        )
        divisor = w.op("Gather", w.constant([1 << (31 - k) for k in range(32)]), halves)
        half = w.op("Gather", w.constant([1 << (31 - k) >> 1 for k in range(32)]), halves)
        sum_ = w.add(w.mul(d, scale), half)
        part = w.op("Div", w.sub(sum_, w.op("Mod", sum_, divisor)), divisor)
        product = w.mul(part, w.constant(self.gain))
        return {}, w.add(w.round_shift(product, self.shift), w.constant(self.bias))

    @property
    def parts(self) -> tuple[RuntimePart, ...]:
        """The function that normalises."""
        return (LAYER_NORM,)

    def list_tables(self) -> tuple[CTable, ...]:
        """Return the constant tables in C."""
        return (
            make_table(f"{self.name}_align", "u8", self.align),
            make_table(f"{self.name}_gain", "i32", self.gain),
            make_table(f"{self.name}_shift", "u8", self.shift),
            make_table(f"{self.name}_bias", "i32", self.bias),
        )

    def list_shifts(self) -> list[Shift]:
        """Return every right shift in the C that follows from the model."""
        each = (("align", self.align), ("shift", self.shift))
        return [
            *(Shift(f"{self.name}[{i}].{n}", s, 62) for n, row in each for i, s in enumerate(row)),
            Shift(f"{self.name}.mean_shift", self.constants[1], 62),
        ]

    def check_form(self) -> None:
        """Raise ValueError where the fields do not fit together."""
        width = self.width
        if not 1 <= width <= MOST_WIDTH:
            raise ValueError(f"node '{self.name}' has {width} numbers; 1 to {MOST_WIDTH} can be")
        if not len(self.shift) == self.gain.size == self.bias.size == width:
            raise ValueError(f"node '{self.name}': its rows have different lengths")
        if self.gain.ndim != 1 or self.bias.ndim != 1:
            raise ValueError(f"node '{self.name}': gain and bias are rows of {width} numbers")
        if not 1 <= self.epsilon <= EPSILON_LIMIT:
            raise ValueError(f"node '{self.name}': epsilon is {self.epsilon}; 1 to 2^60 can be")


def _round_each(x: IntArray, shift: IntArray) -> IntArray:
    """Return round_shift of each number by its own shift."""
    return np.asarray((x + (np.left_shift(np.int64(1), shift) >> 1)) >> shift)


def _symmetric(magnitude: int) -> Interval:
    return Interval(-magnitude, magnitude)


def _write_root(w: Writer, a_q30: str) -> str:
    """Write 1 / sqrt(a) in Q29."""
    slope = w.floor_shift(w.mul(a_q30, w.constant(SLOPE_Q29)), 30)
    r = w.sub(w.constant(START_Q29), slope)
    for _ in range(ROUNDS):
        square = w.floor_shift(w.mul(w.floor_shift(w.mul(r, r), 29), a_q30), 30)
        r = w.floor_shift(w.mul(r, w.sub(w.constant(THREE_Q29), square)), 30)
    return r


NODES = (IntegerLayerNorm,)
